"""A driver whose base never stops by itself, and the stopper that watches over both.

The wrapped driver runs only while its stopper is there, and each command that it is given feeds
the stopper: at least one a tick, so that a guardian that no longer decides is noticed.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Coroutine
from typing import Any

from swarmd.core.clock import boottime
from swarmd.core.errors import DriverError
from swarmd.core.values import ZERO, Twist
from swarmd.driver_api.driver import Driver, Finding, Sink, ZeroSenderSpec
from swarmd.driver_api.watchdog import FAREWELL, FAULT, READY, SILENCE, TICK, ZEROS

log = logging.getLogger(__name__)

START_WITHIN = 10.0
SILENT_AFTER = 1.0
"""Seconds without an answer after which the stopper counts as lost."""
_FEED_EVERY = 0.04


class WatchdogProcess:
    """The guardian's end: starts a stopper, feeds it, and knows when it is lost.

    `name` (None: none): see `stopper.name_of`. `tie`: a process whose end ends the stopper too.
    """

    def __init__(self, spec: ZeroSenderSpec, *, name: str | None, tie: int | None = None) -> None:
        self._loop = asyncio.get_running_loop()
        self._first: asyncio.Future[bytes] = self._loop.create_future()
        self._lost: asyncio.Future[str] = self._loop.create_future()
        self._fed = self._waiting = 0.0
        self._frozen = -1
        self.pid = 0
        self.says_zero = False
        with contextlib.ExitStack() as left:
            try:
                self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                left.callback(self._socket.close)
                with theirs:
                    self._process = _started(spec, theirs.fileno(), name, tie)
            except OSError as error:
                raise DriverError(f"no stopper: {error.strerror}; is the machine full?") from error
            left.pop_all()
        self._socket.setblocking(False)
        self._loop.add_reader(self._socket, self._on_readable)

    async def start(self) -> None:
        """Wait until it is connected; DriverError with its reason if it cannot be."""
        try:
            async with asyncio.timeout(START_WITHIN):
                said = await self._first
        except TimeoutError:
            raise DriverError(f"the stopper was not ready within {START_WITHIN:g} s") from None
        await asyncio.to_thread(self._process.wait)  # it has detached, or ended
        if not said.startswith(READY):
            raise DriverError(f"no stopper: {said[1:].decode(errors='replace') or 'see the log'}")
        self.pid = int(said[1:])

    async def lost(self) -> str:
        """Wait until it is lost; why."""
        return await asyncio.shield(self._lost)

    def feed(self) -> None:
        """One tick: never blocks."""
        now = boottime()
        if now - self._fed < _FEED_EVERY:
            return
        if self._fed and now - self._fed >= SILENCE:
            self._on_readable()  # this process stood still; what was said meanwhile comes first
        self._fed = now
        if self._waiting and now - self._waiting > SILENT_AFTER:
            self._on_readable()  # its answers may have waited for this loop
            if self._waiting and now - self._waiting > SILENT_AFTER and not self._lost.done():
                with contextlib.suppress(OSError):  # it has not hung up, so this is its id still
                    self._frozen = os.pidfd_open(self.pid)
                self._lose(f"has not answered for {SILENT_AFTER:g} s")
        self._waiting = self._waiting or now
        with contextlib.suppress(OSError):  # full or gone: it does not answer
            self._socket.send(TICK)

    def close(self) -> None:
        """Say farewell; it sends zeros a little longer and ends."""
        with contextlib.suppress(OSError):
            self._socket.send(FAREWELL)
        self.hang_up()
        if self._process.poll() is None:  # it has not even begun
            self._process.kill()
            self._process.wait()

    def bury(self) -> None:
        """Kill it if its silence has cost it its post: frozen, it would keep the robot's name."""
        if self._frozen >= 0:
            with contextlib.suppress(ProcessLookupError):  # it was only slow
                signal.pidfd_send_signal(self._frozen, signal.SIGKILL)
            os.close(self._frozen)
            self._frozen = -1

    def _on_readable(self) -> None:
        while self._socket.fileno() >= 0:
            try:
                frame = self._socket.recv(1024)
            except BlockingIOError:
                return
            except OSError:
                frame = b""
            if frame in (TICK, ZEROS):
                self._waiting = 0.0
                self.says_zero = frame == ZEROS
            elif not self._first.done():
                self._first.set_result(frame or FAULT)
            if not frame:
                self._lose("has ended")
                self.hang_up()

    def _lose(self, why: str) -> None:
        if not self._lost.done():
            self._lost.set_result(why)

    def hang_up(self) -> None:
        """Close without a word, as a guardian that is killed does."""
        if self._socket.fileno() >= 0:
            self._loop.remove_reader(self._socket)
            self._socket.close()


def _started(
    spec: ZeroSenderSpec, fd: int, name: str | None, tie: int | None
) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-P", "-m", "swarmd.driver_api.watchdog", "--fd", str(fd)]
    command += ["--maker", spec.maker, "--options", json.dumps(dict(spec.options))]
    command += [] if name is None else ["--name", name]
    command += [] if tie is None else ["--tie", str(tie)]
    return subprocess.Popen(
        command,
        pass_fds=(fd,),
        start_new_session=True,  # a Ctrl-C is the guardian's alone
        stdin=subprocess.DEVNULL,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
    )


class WatchedDriver:
    """Runs `driver` only while a stopper, made from `spec`, watches over its base."""

    def __init__(
        self, driver: Driver, spec: ZeroSenderSpec, *, name: str, tie: int | None = None
    ) -> None:
        self.is_simulated = driver.is_simulated
        self._driver, self._spec, self._name, self._tie = driver, spec, name, tie
        self._watchdog: WatchdogProcess | None = None
        self._before: WatchdogProcess | None = None

    async def run(self, sink: Sink) -> None:
        """Run the driver until cancelled, or until its stopper is lost: then DriverError."""
        sink.state(False, "waits for its stopper")
        if self._before is not None:
            self._before.bury()
        self._before = watchdog = WatchdogProcess(self._spec, name=self._name, tie=self._tie)
        try:
            await watchdog.start()
            log.info("stopper ready as process %d", watchdog.pid)
            self._watchdog = watchdog
            await _while_guarded(self._driver.run(sink), watchdog)
        finally:
            self._watchdog = None
            watchdog.close()

    def send(self, twist: Twist, scan_seq: int, requested_scan_seq: int) -> None:
        """Feed the stopper and hand a command on: zero while it says zero, dropped without it."""
        if self._watchdog is not None:
            self._watchdog.feed()
            told = ZERO if self._watchdog.says_zero else twist
            self._driver.send(told, scan_seq, requested_scan_seq)

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """The driver's findings, and whether a stopper can be started; moves nothing."""
        looking = asyncio.create_task(self._driver.check(seconds))
        try:
            with contextlib.closing(WatchdogProcess(self._spec, name=None)) as watchdog:
                async with asyncio.timeout(seconds):
                    await watchdog.start()
            mine = Finding("watchdog", True, "starts; the base has no timeout")
        except (DriverError, TimeoutError) as error:
            mine = Finding("watchdog", False, str(error) or f"not ready within {seconds:g} s")
        return (*await looking, mine)


async def _while_guarded(life: Coroutine[Any, Any, None], watchdog: WatchdogProcess) -> None:
    living, losing = asyncio.create_task(life), asyncio.create_task(watchdog.lost())
    try:
        await asyncio.wait({living, losing}, return_when=asyncio.FIRST_COMPLETED)
        if not living.done():
            raise DriverError(f"the stopper {losing.result()}; it is started anew")
        living.result()
    finally:
        for task in (living, losing):
            task.cancel()
        await asyncio.gather(living, losing, return_exceptions=True)
