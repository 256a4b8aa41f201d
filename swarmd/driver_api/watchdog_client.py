"""The daemon's side of the watchdog: a driver that runs only while its base has a watchdog.

Each command, at least one per tick, feeds the watchdog. So the watchdog detects a daemon that has
stopped deciding.
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
from swarmd.core.finding import Finding
from swarmd.core.values import ZERO, Twist
from swarmd.driver_api.driver import Driver, Sink, ZeroSenderSpec
from swarmd.driver_api.watchdog import FAREWELL, FAULT, READY, TICK, TICK_TIMEOUT, ZEROS

log = logging.getLogger(__name__)

START_TIMEOUT = 10.0
ANSWER_TIMEOUT = 1.0
"""Seconds without an answer after which the watchdog counts as lost."""
_FEED_PERIOD = 0.04


class WatchdogProcess:
    """Starts a watchdog process, feeds it, and detects its end.

    `name`: the robot's name of `watchdog_name` (watchdog.py), which only one watchdog can hold: a
    new watchdog takes the place of an earlier watchdog with this name. None: without a name. `tie`:
    the id of a process whose end also ends the watchdog. The watchdog sets the attribute
    `requires_zero`: while True, the caller must command zero.
    """

    def __init__(self, spec: ZeroSenderSpec, *, name: str | None, tie: int | None = None) -> None:
        self._loop = asyncio.get_running_loop()
        self._first: asyncio.Future[bytes] = self._loop.create_future()
        self._lost: asyncio.Future[str] = self._loop.create_future()
        self._fed_at = 0.0
        self._unanswered_since = 0.0
        self._frozen = -1
        self.pid = 0
        self.requires_zero = False
        with contextlib.ExitStack() as left:
            try:
                self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                left.callback(self._socket.close)
                with theirs:
                    self._process = _started(spec, theirs.fileno(), name, tie)
            except OSError as error:
                raise DriverError(f"no watchdog: {error.strerror}; is the machine full?") from error
            left.pop_all()
        self._socket.setblocking(False)
        self._loop.add_reader(self._socket, self._on_readable)

    async def start(self) -> None:
        """Wait until the watchdog is ready; DriverError with the reason if it fails."""
        try:
            async with asyncio.timeout(START_TIMEOUT):
                frame = await self._first
        except TimeoutError:
            raise DriverError(f"the watchdog was not ready within {START_TIMEOUT:g} s") from None
        await asyncio.to_thread(self._process.wait)  # returns once the watchdog detached or ended
        if not frame.startswith(READY):
            raise DriverError(f"no watchdog: {frame[1:].decode(errors='replace') or 'see the log'}")
        self.pid = int(frame[1:])

    async def lost(self) -> str:
        """Wait until the watchdog is lost; returns the reason."""
        return await asyncio.shield(self._lost)

    def feed(self, hint: str = "") -> None:
        """Send a tick to the watchdog; never blocks.

        `hint`: the form of zero that the base understands (at most 15 ASCII characters), for the
        zero sender of the watchdog; empty: unknown.
        """
        now = boottime()
        if now - self._fed_at < _FEED_PERIOD:
            return
        if self._fed_at and now - self._fed_at >= TICK_TIMEOUT:
            self._on_readable()  # this process was suspended: read the waiting answers first
        self._fed_at = now
        if self._is_late(now):
            self._on_readable()  # answers may have waited for this loop
            if self._is_late(now) and not self._lost.done():
                with contextlib.suppress(OSError):  # the open socket shows that the pid is valid
                    self._frozen = os.pidfd_open(self.pid)
                self._lose(f"has not answered for {ANSWER_TIMEOUT:g} s")
        self._unanswered_since = self._unanswered_since or now
        with contextlib.suppress(OSError):  # socket full or closed: the missing answer shows that
            self._socket.send(TICK + hint.encode())

    def close(self) -> None:
        """Send the farewell: the watchdog sends zeros for the rest of its 2 s, and ends."""
        with contextlib.suppress(OSError):
            self._socket.send(FAREWELL)
        self.hang_up()
        if self._process.poll() is None:  # the watchdog has not detached yet
            self._process.kill()
            self._process.wait()

    def kill_if_frozen(self) -> None:
        """Kill a watchdog that was lost by freezing, which would keep the robot's name."""
        if self._frozen >= 0:
            with contextlib.suppress(ProcessLookupError):  # it was only slow, and has ended
                signal.pidfd_send_signal(self._frozen, signal.SIGKILL)
            os.close(self._frozen)
            self._frozen = -1

    def _is_late(self, now: float) -> bool:
        since = self._unanswered_since
        return since > 0.0 and now - since > ANSWER_TIMEOUT

    def _on_readable(self) -> None:
        while self._socket.fileno() >= 0:
            try:
                frame = self._socket.recv(1024)
            except BlockingIOError:
                return
            except OSError:
                frame = b""
            if frame in (TICK, ZEROS):
                self._unanswered_since = 0.0
                self.requires_zero = frame == ZEROS
            elif not self._first.done():
                self._first.set_result(frame or FAULT)
            if not frame:
                self._lose("has ended")
                self.hang_up()

    def _lose(self, why: str) -> None:
        if not self._lost.done():
            self._lost.set_result(why)

    def hang_up(self) -> None:
        """Close the socket without a farewell, as the end of a killed daemon does."""
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
        start_new_session=True,  # keeps a Ctrl-C in the terminal from the watchdog
        stdin=subprocess.DEVNULL,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
    )


class WatchedDriver:
    """Runs `driver` only while a watchdog, made from `spec`, watches its base."""

    def __init__(
        self, driver: Driver, spec: ZeroSenderSpec, *, name: str, tie: int | None = None
    ) -> None:
        self.is_simulated = driver.is_simulated
        self.wrapped = driver
        self._spec = spec
        self._name = name
        self._tie = tie
        self._watchdog: WatchdogProcess | None = None
        self._before: WatchdogProcess | None = None

    async def run(self, sink: Sink) -> None:
        """Run the driver until cancelled, or until its watchdog is lost: then DriverError."""
        sink.state(False, "waits for its watchdog")
        if self._before is not None:
            self._before.kill_if_frozen()
        self._before = watchdog = WatchdogProcess(self._spec, name=self._name, tie=self._tie)
        try:
            await watchdog.start()
            log.info("watchdog ready as process %d", watchdog.pid)
            self._watchdog = watchdog
            await _while_watched(self.wrapped.run(sink), watchdog)
        finally:
            self._watchdog = None
            watchdog.close()

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        """Feed the watchdog and pass a command on.

        The command becomes zero while the watchdog `requires_zero`, and is dropped without a
        watchdog.
        """
        if self._watchdog is not None:
            self._watchdog.feed(getattr(self.wrapped, "zero_hint", ""))
            command = ZERO if self._watchdog.requires_zero else twist
            self.wrapped.send(command, scan_seq, requested_scan_seq, is_stopped=is_stopped)

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """The driver's findings, and whether a watchdog can be started; moves nothing."""
        checking = asyncio.create_task(self.wrapped.check(seconds))
        try:
            with contextlib.closing(WatchdogProcess(self._spec, name=None)) as watchdog:
                async with asyncio.timeout(seconds):
                    await watchdog.start()
            own = Finding("watchdog", True, "starts; the base has no timeout")
        except (DriverError, TimeoutError) as error:
            own = Finding("watchdog", False, str(error) or f"not ready within {seconds:g} s")
        return (*await checking, own)


async def _while_watched(run: Coroutine[Any, Any, None], watchdog: WatchdogProcess) -> None:
    running = asyncio.create_task(run)
    losing = asyncio.create_task(watchdog.lost())
    try:
        await asyncio.wait({running, losing}, return_when=asyncio.FIRST_COMPLETED)
        if not running.done():
            raise DriverError(f"the watchdog {losing.result()}; it is started again")
        running.result()
    finally:
        for task in (running, losing):
            task.cancel()
        await asyncio.gather(running, losing, return_exceptions=True)
