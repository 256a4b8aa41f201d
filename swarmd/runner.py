"""Runners carry a robot's commands to its pattern: inline, or in a child process."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from swarmd.errors import CodecError, PluginError, unknown
from swarmd.frames import Command, Died, Event, Failed, Kill, Load, Refused
from swarmd.framing import decode_event, encode_command
from swarmd.plugins import check_single, installed_patterns, pattern_names
from swarmd.processes import how_it_ended

if TYPE_CHECKING:
    from swarmd.stage import Stage  # for patterns: 7 MB of numpy.random that a guardian can spare

OUT_OF_MEMORY = 77
AT_ONCE = 8  # frames read before the loop's other work: a flood must not bind the guardian
FIRST_RESPAWN = 0.05
LAST_RESPAWN = 5.0


class Runner(Protocol):
    """Carries commands to a pattern and its answers back."""

    def send(self, command: Command) -> None:
        """Hand a command over; never blocks. The robot keeps at most one step in flight."""

    def events(self) -> Iterable[Event]:
        """The answers since the last call, in order."""


class InlineRunner:
    """Runs the pattern in this process, at once: for lockstep and tests."""

    def __init__(self, stage: Callable[[], Stage]) -> None:
        self._make = stage
        self._stage = stage()
        self._events: deque[Event] = deque()

    def send(self, command: Command) -> None:
        """Carry the command out now; its answer waits in `events`."""
        if isinstance(command, Kill):
            self._stage = self._make()
            return
        if isinstance(command, Load) and command.is_fresh:
            self._stage = self._make()
        event = self._stage.handle(command)
        if event is not None:
            self._events.append(event)

    def events(self) -> Iterable[Event]:
        """The answers since the last call, in order."""
        while self._events:
            yield self._events.popleft()


class _Host:
    """One child process and the guardian's end of its socket."""

    def __init__(self, loop: asyncio.AbstractEventLoop, owner: ProcessRunner) -> None:
        self._loop = loop
        self._owner = owner
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.socket = ours
        ours.setblocking(False)
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 18)
        theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 18)
        # -P: a random.py where this is called is not to shadow a module.
        command = [sys.executable, "-P", "-m", "swarmd.host"]
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
            self._owner.on_frame(self, b"" if flags & socket.MSG_TRUNC else frame)
            if self.socket.fileno() < 0:  # what it said led to its end
                return

    def _on_end(self) -> None:
        self._loop.remove_reader(self._pidfd)
        os.close(self._pidfd)
        self._pidfd = -1
        code = self.process.wait()
        self._owner.buried(self)
        self._signal()  # what the pattern may have forked
        if self.socket.fileno() >= 0:
            self._on_readable()
            self._loop.remove_reader(self.socket)
            self.socket.close()
            self._owner.on_end(self, code)


class ProcessRunner:
    """Keeps one warm pattern host; must live on the loop's thread, from before Zenoh is opened.

    `wake` is called when there are events. A host that ends by itself is replaced, after a pause
    that grows if it keeps ending before it said anything.
    """

    def __init__(
        self, loop: asyncio.AbstractEventLoop, plugin_dir: Path | None, wake: Callable[[], None]
    ) -> None:
        self._loop = loop
        self._plugin_dir = plugin_dir
        self._installed = installed_patterns()
        self._wake = wake
        self._events: deque[Event] = deque()
        self._generation = 0
        self._pause = FIRST_RESPAWN
        self._respawn: asyncio.TimerHandle | None = None
        self._is_closed = False
        self._dying: list[_Host] = []
        self.dropped = 0
        self._host: _Host | None = _Host(loop, self)

    @property
    def pid(self) -> int | None:
        """The present host's process id; None between two hosts."""
        return None if self._host is None else self._host.process.pid

    def send(self, command: Command) -> None:
        """Hand a command over; never blocks. What a stopped host cannot take is dropped."""
        if isinstance(command, Kill):
            self._replace()
            return
        if isinstance(command, Load) and command.is_fresh:
            self._replace()
        self._generation = command.generation
        try:
            frame = encode_command(command, self._origins(command))
        except (PluginError, CodecError) as error:
            kind = Refused if isinstance(command, Load) else Failed
            self._events.append(kind(command.generation, str(error)))
            self._loop.call_soon(self._wake)
            return
        host = self._host or self._start()
        try:
            host.socket.send(frame)
        except OSError:  # full, or just ended: silence and the pidfd are watched
            self.dropped += 1

    def events(self) -> Iterable[Event]:
        """The answers since the last call, in order."""
        while self._events:
            yield self._events.popleft()

    def close(self) -> None:
        """End the host."""
        self._is_closed = True
        if self._respawn is not None:
            self._respawn.cancel()
        self._kill()
        for host in list(self._dying):
            host.reap()

    def buried(self, host: _Host) -> None:
        """A host's process has been waited for."""
        if host in self._dying:
            self._dying.remove(host)

    def on_frame(self, host: _Host, frame: bytes) -> None:
        """A host said something."""
        if host is not self._host:
            return
        self._pause = FIRST_RESPAWN
        try:
            event = decode_event(frame)
        except CodecError as error:
            event = Failed(self._generation, str(error))
        self._events.append(event)
        self._wake()

    def on_end(self, host: _Host, code: int) -> None:
        """A host ended by itself."""
        if host is not self._host:
            return
        self._host = None
        text = f"its process {how_it_ended(code)}"
        if code == OUT_OF_MEMORY:
            text = "its process needed more memory than it may have"
        self._events.append(Died(self._generation, text))
        if not self._is_closed:
            self._respawn = self._loop.call_later(self._pause, self._start_again)
            self._pause = min(2.0 * self._pause, LAST_RESPAWN)
        self._wake()

    def _origins(self, command: Command) -> Mapping[str, tuple[str, bool]]:
        if not isinstance(command, Load):
            return {}
        found = pattern_names(self._plugin_dir, self._installed)
        if command.pattern not in found:  # perhaps installed meanwhile; reading that takes 2 ms
            self._installed = installed_patterns()
            found = pattern_names(self._plugin_dir, self._installed)
        if command.pattern not in found:
            raise PluginError(unknown("pattern", command.pattern, found))
        check_single(command.pattern, found[command.pattern])
        return {name: (origin.value, origin.is_file) for name, origin in found.items()}

    def _replace(self) -> None:
        self._kill()
        self._start_again()

    def _kill(self) -> None:
        if self._host is not None:
            self._host.kill()
            self._dying.append(self._host)
            self._host = None

    def _start_again(self) -> None:
        if self._host is None and not self._is_closed:
            self._start()

    def _start(self) -> _Host:
        if self._respawn is not None:
            self._respawn.cancel()
            self._respawn = None
        self._host = _Host(self._loop, self)
        return self._host
