"""The daemon's side of pattern hosts: starts, limits and ends the child processes.

A trial loads a pattern in a second host beside the host in use. After the trial that second host
has the pattern's code loaded, and may replace the host in use.

`robot/pattern_run.py` has the deadlines of a load and a step.

- The first host is a fork of the daemon (`forked.py`). A later host starts by exec: a fork beside
  an open Zenoh session hung each time.
- The kernel ends a host when the thread ends that started the host. So the main thread starts all
  hosts, and they end with the daemon.
- The socket does not block, and a frame is dropped if the socket is full. At most one step is
  outstanding. With a pipe, nine seconds of old commands piled up behind a frozen child.
- A pidfd shows the end of the host, since a child that the pattern forks can keep the socket open.
- The daemon has short time slices (`core/processes.py`), the host has default slices. With default
  slices the daemon waited 0.46 ms (p50) and 6 ms (p90) for an answer on a busy machine, with short
  slices 0.08 ms and 0.5 ms.
- The sandbox (`sandbox.py`) costs 3 ms of processor time at the start.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import msgspec

from swarmd.core.errors import CodecError
from swarmd.core.host_messages import HostEvent, Loaded, LoadRefused, PatternFailed, TrialDone
from swarmd.core.messages import Sandbox
from swarmd.core.processes import (
    LOAD_GROWTH,
    OUT_OF_MEMORY,
    STEP_GROWTH,
    how_it_ended,
    limit_growth,
)
from swarmd.pattern_host.forked import ONE_THREAD, ForkedHost, host_sockets, take_forked_host
from swarmd.pattern_host.wire import decode_event, decode_sandbox
from swarmd.robot.timeouts import LOAD_TIMEOUT

MAX_FRAMES_PER_READ = 8
"""Frames read before the loop's other work, so that a flood does not block the daemon."""


class HostOwner(Protocol):
    """Receives the frames and the end of a host."""

    def on_frame(self, host: HostProcess, frame: bytes) -> None:
        """Take a frame of the host; an empty frame stands for a frame that was too long."""

    def on_end(self, host: HostProcess, code: int) -> None:
        """Act on a host that ended by itself, with the exit code `code`."""

    def on_reaped(self, host: HostProcess) -> None:
        """Forget a host whose process has been waited for (waitpid)."""


def why_it_ended(code: int) -> str:
    """The end of a host in words."""
    if code == OUT_OF_MEMORY:
        return "its process needed more memory than it may have"
    return f"its process {how_it_ended(code)}"


@dataclass(frozen=True, slots=True)
class HostSettings:
    """Settings of every pattern host.

    `readable`, `secret`: the folders that its sandbox permits and denies (`sandbox.confine`).
    """

    printed: int  # the file descriptor that takes the prints of the host
    readable: Sequence[Path] = ()
    secret: Sequence[Path] = ()


class HostProcess:
    """One pattern host (child process), and the daemon's end of its socket.

    `sandbox`: the accesses that the kernel denies the host. The host reports them before any plugin
    code runs; None until then.
    """

    def __init__(
        self, loop: asyncio.AbstractEventLoop, owner: HostOwner, settings: HostSettings
    ) -> None:
        self._loop = loop
        self.owner = owner
        self.sandbox: Sandbox | None = None
        folders = [[str(path.absolute()) for path in settings.readable]]
        folders += [[str(path.absolute()) for path in settings.secret]]
        forked = take_forked_host(folders, settings.printed)
        self.process: subprocess.Popen[bytes] | ForkedHost
        self.process, self.socket = forked or _execute(folders, settings.printed)
        self.socket.setblocking(False)
        self._pidfd = os.pidfd_open(self.process.pid)
        loop.add_reader(self.socket, self._on_readable)
        # A child that the pattern forks keeps the socket open, so only the pidfd shows the end.
        loop.add_reader(self._pidfd, self._on_end)

    def load(self, frame: bytes) -> None:
        """Send a Load; the host's memory may grow by LOAD_GROWTH from now on. OSError."""
        self._limit(LOAD_GROWTH)
        self.socket.send(frame)

    def end_load(self) -> None:
        """After the answer to a Load: the host's memory may grow by STEP_GROWTH from now on."""
        self._limit(STEP_GROWTH)

    def kill(self) -> None:
        """Kill the process and all its child processes; the owner receives no more frames."""
        self._loop.remove_reader(self.socket)
        self.socket.close()
        self._kill_group()

    def reap(self) -> None:
        """Wait for the end of a host that was killed."""
        if self._pidfd >= 0:
            self._on_end()

    def _limit(self, growth: int) -> None:
        # Set by the daemon: a host that may raise its own limit for a load could always raise it.
        if self._pidfd >= 0:
            with contextlib.suppress(OSError):  # the process has just ended
                limit_growth(growth, self.process.pid)

    def _kill_group(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)

    def _on_readable(self) -> None:
        for _ in range(MAX_FRAMES_PER_READ):
            try:
                frame, _, flags, _ = self.socket.recvmsg(1 << 18)
            except BlockingIOError:
                return
            except OSError:
                frame = b""
                flags = 0
            if not frame:  # the socket is closed; `_on_end` follows by the pidfd
                self._loop.remove_reader(self.socket)
                return
            if self.sandbox is None:
                self.sandbox = decode_sandbox(frame)
                continue
            # A frame that is too long counts as undecodable.
            self.owner.on_frame(self, b"" if flags & socket.MSG_TRUNC else frame)
            if self.socket.fileno() < 0:  # the owner has killed this host because of the frame
                return

    def _on_end(self) -> None:
        self._loop.remove_reader(self._pidfd)
        os.close(self._pidfd)
        self._pidfd = -1
        code = self.process.wait()
        self.owner.on_reaped(self)
        self._kill_group()  # ends processes that the pattern forked
        if self.socket.fileno() >= 0:
            self._on_readable()
            self._loop.remove_reader(self.socket)
            self.socket.close()
            self.owner.on_end(self, code)


def _execute(
    folders: Sequence[Sequence[str]], printed: int
) -> tuple[subprocess.Popen[bytes], socket.socket]:
    ours, theirs = host_sockets()
    # -P: a random.py in the current folder must not shadow a module.
    command = [sys.executable, "-P", "-m", "swarmd.pattern_host"]
    command += [str(theirs.fileno()), str(os.getpid()), msgspec.json.encode(folders).decode()]
    with theirs:
        process = subprocess.Popen(
            command,
            pass_fds=(theirs.fileno(),),
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stderr=printed,
            env={**os.environ, **ONE_THREAD},
        )
    return process, ours


def trial_done(generation: int, event: HostEvent | None) -> TrialDone:
    """The result of trial `generation`, made of the host's answer to the load.

    A pattern that takes longer to load than LOAD_TIMEOUT of a run is refused: no run could load it.
    """
    if isinstance(event, LoadRefused):
        return TrialDone(generation, event.text, event.refusal)
    if isinstance(event, PatternFailed):
        return TrialDone(generation, event.text)
    if not isinstance(event, Loaded):
        return TrialDone(generation, "it gave no answer to a load")
    is_late = event.took >= LOAD_TIMEOUT
    text = f"loading took {event.took:.1f} s; a run waits for {LOAD_TIMEOUT:.0f} s"
    return TrialDone(generation, text if is_late else "")


class TrialProcess:
    """A trial of new code: a pattern is loaded in a second host, beside the host in use.

    `on_done` is called once with the result, unless `end` comes first. The second host stays after
    the result: `hand_over` gives it to the runner, which then uses it, or `end` kills it.
    `on_reaped` is called after the process of the second host has been waited for.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        generation: int,
        frame: bytes,
        on_done: Callable[[TrialDone], None],
        on_reaped: Callable[[HostProcess], None],
        settings: HostSettings,
    ) -> None:
        self.on_reaped = on_reaped
        self._generation = generation
        self._on_done = on_done
        self._is_done = False
        self._host: HostProcess | None = HostProcess(loop, self, settings)
        with contextlib.suppress(OSError):  # the process has just ended; the pidfd shows that
            self._host.load(frame)

    def end(self) -> HostProcess | None:
        """Kill the process; returns the host if its process must still be waited for."""
        host = self._host
        self._host = None
        if host is not None:
            host.kill()
        return host

    def hand_over(self, owner: HostOwner) -> HostProcess | None:
        """Give the host to `owner`; None if the host has ended or has not answered yet."""
        if self._host is None or not self._is_done:
            return None
        host = self._host
        self._host = None
        host.owner = owner
        return host

    def on_frame(self, host: HostProcess, frame: bytes) -> None:
        """Take the answer to the load."""
        host.end_load()
        try:
            self._finish(trial_done(self._generation, decode_event(frame)))
        except CodecError as error:
            self._finish(TrialDone(self._generation, str(error)))

    def on_end(self, host: HostProcess, code: int) -> None:
        """Fail the trial: the load has ended the host."""
        self._host = None
        text = f"while it was being loaded {why_it_ended(code)}"
        self._finish(TrialDone(self._generation, text))

    def _finish(self, result: TrialDone) -> None:
        if not self._is_done:
            self._is_done = True
            self._on_done(result)
