"""A pattern host as its guardian sees it: a child process and a socket, on the guardian's loop.

Tries whether a pattern can be loaded, in a host of its own beside the one in force.

A host in which it was loaded is fresh and warm: it may take the place of the one in force.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from typing import Protocol

from swarmd.core.errors import CodecError
from swarmd.core.host_messages import HostEvent, Loaded, LoadRefused, PatternFailed, TrialDone
from swarmd.core.processes import how_it_ended
from swarmd.pattern_host.wire import decode_event
from swarmd.robot.pattern_run import LOAD_TIMEOUT

OUT_OF_MEMORY = 77
AT_ONCE = 8  # frames read before the loop's other work: a flood must not bind the guardian


class Owner(Protocol):
    """Who started a host, and hears what it says."""

    def on_frame(self, host: HostProcess, frame: bytes) -> None:
        """It said something; empty if that was too long to be read."""

    def on_end(self, host: HostProcess, code: int) -> None:
        """It ended by itself."""

    def buried(self, host: HostProcess) -> None:
        """Its process has been waited for."""


def why_it_ended(code: int) -> str:
    """A host's end in words."""
    if code == OUT_OF_MEMORY:
        return "its process needed more memory than it may have"
    return f"its process {how_it_ended(code)}"


class HostProcess:
    """One child process and the guardian's end of its socket; `owner` hears all of it."""

    def __init__(self, loop: asyncio.AbstractEventLoop, owner: Owner) -> None:
        self._loop = loop
        self.owner = owner
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.socket = ours
        ours.setblocking(False)
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 18)
        theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 18)
        # -P: a random.py where this is called is not to shadow a module.
        command = [sys.executable, "-P", "-m", "swarmd.pattern_host.worker"]
        command += ["--fd", str(theirs.fileno()), "--parent", str(os.getpid())]
        with theirs:
            self.process = subprocess.Popen(
                command,
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
                stdin=subprocess.DEVNULL,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            )
        self._pidfd = os.pidfd_open(self.process.pid)
        loop.add_reader(self.socket, self._on_readable)
        loop.add_reader(self._pidfd, self._on_end)  # end of file never comes if a pattern forked
        self.has_answered = False

    def kill(self) -> None:
        """End it and all that it started; nothing more is heard of it."""
        self._loop.remove_reader(self.socket)
        self.socket.close()
        self._signal()

    def reap(self) -> None:
        """Wait for the end of a host that was killed."""
        if self._pidfd >= 0:
            self._on_end()

    def _signal(self) -> None:
        try:
            os.killpg(self.process.pid, signal.SIGKILL)
        except ProcessLookupError:
            return

    def _on_readable(self) -> None:
        for _ in range(AT_ONCE):
            try:
                frame, _, flags, _ = self.socket.recvmsg(1 << 18)
            except BlockingIOError:
                return
            except OSError:
                frame, flags = b"", 0
            if not frame:  # closed: the pidfd tells how it ended
                self._loop.remove_reader(self.socket)
                return
            self.has_answered = True
            self.owner.on_frame(self, b"" if flags & socket.MSG_TRUNC else frame)
            if self.socket.fileno() < 0:  # what it said led to its end
                return

    def _on_end(self) -> None:
        self._loop.remove_reader(self._pidfd)
        os.close(self._pidfd)
        self._pidfd = -1
        code = self.process.wait()
        self.owner.buried(self)
        self._signal()  # what the pattern may have forked
        if self.socket.fileno() >= 0:
            self._on_readable()
            self._loop.remove_reader(self.socket)
            self.socket.close()
            self.owner.on_end(self, code)


def trial_done(generation: int, event: HostEvent | None) -> TrialDone:
    """The result of the trial `generation`, from the answer to its load.

    A pattern that loads more slowly than a run waits is refused: it could not be run again.
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


class Trial:
    """One Load in a process of its own, which stays until `end` or `hand_over`.

    `tell` is called once, unless `end` comes first; `buried` when its process has been waited for.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        generation: int,
        frame: bytes,
        tell: Callable[[TrialDone], None],
        buried: Callable[[HostProcess], None],
    ) -> None:
        self.buried = buried
        self._generation = generation
        self._tell = tell
        self._is_told = False
        self._host: HostProcess | None = HostProcess(loop, self)
        with contextlib.suppress(OSError):  # it has just ended: the pidfd is watched
            self._host.socket.send(frame)

    def end(self) -> tuple[HostProcess, ...]:
        """Kill its process; whoever is still to be waited for."""
        host, self._host = self._host, None
        if host is None:
            return ()
        host.kill()
        return (host,)

    def hand_over(self, owner: Owner) -> HostProcess | None:
        """The host, to be `owner`'s from now on; None if it has ended or has not answered."""
        if self._host is None or not self._is_told:
            return None
        host, self._host = self._host, None
        host.owner = owner
        return host

    def on_frame(self, host: HostProcess, frame: bytes) -> None:
        """It answered."""
        try:
            self._done(trial_done(self._generation, decode_event(frame)))
        except CodecError as error:
            self._done(TrialDone(self._generation, str(error)))

    def on_end(self, host: HostProcess, code: int) -> None:
        """It ended by itself, which no load may do."""
        self._host = None
        text = f"while it was being loaded {why_it_ended(code)}"
        self._done(TrialDone(self._generation, text))

    def _done(self, result: TrialDone) -> None:
        if not self._is_told:
            self._is_told = True
            self._tell(result)
