"""Carries a robot's commands to its pattern, inline or in a child process; logs its prints."""

from __future__ import annotations

import asyncio
import dataclasses
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace

from swarmd.core import host_messages
from swarmd.core.errors import CodecError, PluginError, UnknownPatternError, unknown
from swarmd.core.messages import Sandbox
from swarmd.core.token_bucket import TokenBucket
from swarmd.pattern_host.host_process import (
    HostProcess,
    HostSettings,
    TrialProcess,
    trial_done,
    why_it_ended,
)
from swarmd.pattern_host.wire import decode_event, encode_command
from swarmd.plugins import Origin, check_single, installed_patterns, pattern_names, places_of

if TYPE_CHECKING:
    from swarmd.pattern_host.executor import PatternExecutor

log = logging.getLogger(__name__)
print_log = logging.getLogger("swarmd.pattern")

MIN_RESPAWN_DELAY = 0.05
MAX_RESPAWN_DELAY = 5.0

Overlay = Callable[[Mapping[str, Origin], host_messages.Load, bool], Mapping[str, Origin]]
"""The robot's own patterns, a load and whether it is a trial, to all patterns for that load."""
# logged lines of a pattern: per second, and in one burst
PRINT_RATE = 20.0
PRINT_BURST = 100.0
MAX_LINE = 500  # bytes
_READ = 65536
_PAUSE = 0.02
"""s between two reads: a pattern that prints more than 3 MB/s waits, and not the daemon."""


class InlineRunner:
    """Runs the pattern in this process, within `send`: for lockstep and tests."""

    def __init__(self, make_executor: Callable[[], PatternExecutor]) -> None:
        self._make_executor = make_executor
        self._executor = make_executor()

    @property
    def needs(self) -> frozenset[str]:
        """The `needs` of the pattern and of its parts; empty without a pattern."""
        return self._executor.needs

    def send(self, command: host_messages.HostCommand) -> host_messages.HostEvent | None:
        """Carry the command out; returns the event that follows, None without an event."""
        if isinstance(command, host_messages.Step):  # the most frequent command first
            return self._executor.handle(command)
        if isinstance(command, host_messages.StartTrial):
            answer = self._make_executor().handle(command.load)
            return trial_done(command.load.generation, answer)
        if isinstance(command, host_messages.CancelTrial):
            return None
        if isinstance(command, host_messages.KillHost):
            self._executor = self._make_executor()
            return None
        if isinstance(command, host_messages.Load) and command.is_fresh:
            self._executor = self._make_executor()
        return self._executor.handle(command)


class ProcessRunner:
    """Keeps one pattern host (child process) started ahead, and sends commands to the host.

    - Must be made on the thread of the event loop, before Zenoh is opened.
    - `wake` is called when there are events.
    - A host that ends by itself is replaced after a delay. The delay doubles while hosts end before
      they have sent an event.
    - The prints of patterns are logged.
    - `overlay` adds the pushed patterns, which operators sent to the robot, to the patterns of
      packages and of `plugin_dir`. The code of pushed patterns lies in the folders `code`.
    - Plugin code can read `plugin_dir` and `code`, and nothing in `secret`.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        plugin_dir: Path | None,
        wake: Callable[[], None],
        overlay: Overlay = lambda own, load, is_trial: own,
        *,
        code: Sequence[Path] = (),
        secret: Sequence[Path] = (),
    ) -> None:
        """Start the first host."""
        self._installed = installed_patterns()  # of packages
        self._plugin_dir = plugin_dir
        self._overlay = overlay  # called for each load and each trial
        self._loop = loop
        self._wake = wake
        self._events: deque[host_messages.HostEvent] = deque()  # until the daemon takes them
        self._generation = 0  # of the last command
        self._respawn_delay = MIN_RESPAWN_DELAY  # s, before a new host starts
        self._respawn: asyncio.TimerHandle | None = None  # the planned start of a new host
        self._is_closed = False
        self._dying: list[HostProcess] = []  # killed hosts that have not ended
        self._trial: TrialProcess | None = None  # of new code
        self.dropped = 0  # commands for which the socket had no room
        self._printed = PrintPipe()  # takes what patterns print
        readable = (*code, *([] if plugin_dir is None else [plugin_dir]))
        self._settings = HostSettings(self._printed.write, readable, secret)
        self._sandbox: Sandbox | None = None  # of the last host that has reported its sandbox
        self._host: HostProcess | None = HostProcess(loop, self, self._settings)

    @property
    def pid(self) -> int | None:
        """The process id of the host in use; None between two hosts."""
        return None if self._host is None else self._host.process.pid

    @property
    def sandbox(self) -> Sandbox | None:
        """The sandbox of the host in use; until the host reports it, that of the host before."""
        if self._host is not None and self._host.sandbox is not None:
            self._sandbox = self._host.sandbox
        return self._sandbox

    def send(self, command: host_messages.HostCommand) -> None:
        """Send a command to the pattern host; never blocks.

        A command that cannot be encoded becomes an event: the load is refused, or the pattern has
        failed. A command for which the socket has no room is dropped and counted.
        """
        if isinstance(command, host_messages.StartTrial):
            self._end_trial()
            self._start_trial(command.load)
        elif isinstance(command, host_messages.CancelTrial):
            self._end_trial()
        elif isinstance(command, host_messages.KillHost):
            self._replace()
        else:
            self._send_to_host(command)

    def _send_to_host(self, command: host_messages.SentCommand) -> None:
        """Send a command to the host in use, or to a new host."""
        if isinstance(command, host_messages.Load):
            log.info("loading %s", command.pattern)
            if command.is_fresh:  # load in a new host: the present host hangs, ends or has old code
                self._replace()
        self._generation = command.generation
        try:
            frame = self._encoded(command)
        except (PluginError, CodecError) as error:
            self._events.append(_not_encoded(command, error))
            self._loop.call_soon(self._wake)
            return
        host = self._host or self._start()
        try:
            if isinstance(command, host_messages.Load):
                host.load(frame)
            else:
                host.socket.send(frame)
        except OSError:
            # The socket is full, and the command times out; or the host has ended, which the loop
            # sees by its pidfd (a file descriptor of the process).
            self.dropped += 1

    def _encoded(self, command: host_messages.SentCommand) -> bytes:
        """The frame of a command. A load gets the places of all patterns, which it may contain."""
        if isinstance(command, host_messages.Load):
            return encode_command(self._with_origins(command, is_trial=False))
        return encode_command(command)

    def events(self) -> Iterable[host_messages.HostEvent]:
        """The events since the last call, in order."""
        while self._events:
            yield self._events.popleft()

    def close(self) -> None:
        """End the hosts and wait for their processes."""
        self._is_closed = True
        if self._respawn is not None:
            self._respawn.cancel()
        self._end_trial()
        self._kill()
        for host in list(self._dying):
            host.reap()
        self._printed.close()

    def on_reaped(self, host: HostProcess) -> None:
        """Forget a host whose process has been waited for."""
        if host in self._dying:
            self._dying.remove(host)

    def on_frame(self, host: HostProcess, frame: bytes) -> None:
        """Decode a frame of the host in use, and queue its event."""
        if host is not self._host:
            return
        self._respawn_delay = MIN_RESPAWN_DELAY
        try:
            event = decode_event(frame)
        except CodecError as error:
            event = host_messages.PatternFailed(self._generation, str(error))
        is_answer = isinstance(event, host_messages.Loaded | host_messages.LoadRefused)
        if is_answer and event.generation == self._generation:  # not the answer to an earlier load
            host.end_load()
        self._events.append(event)
        self._wake()

    def on_end(self, host: HostProcess, code: int) -> None:
        """Queue HostDied, and start a new host after a delay, unless the runner is closed."""
        if host is not self._host:
            return
        self._host = None
        self._events.append(host_messages.HostDied(self._generation, why_it_ended(code)))
        if not self._is_closed:
            self._respawn = self._loop.call_later(self._respawn_delay, self._start_if_none)
            self._respawn_delay = min(2.0 * self._respawn_delay, MAX_RESPAWN_DELAY)
        self._wake()

    def own_patterns(self) -> Mapping[str, Origin]:
        """The patterns of packages and of `plugin_dir`, without pushed patterns."""
        return pattern_names(self._plugin_dir, self._installed)

    def _all_patterns(self, load: host_messages.Load, *, is_trial: bool) -> Mapping[str, Origin]:
        return self._overlay(self.own_patterns(), load, is_trial)

    def _with_origins(self, load: host_messages.Load, *, is_trial: bool) -> host_messages.Load:
        patterns = self._all_patterns(load, is_trial=is_trial)
        if load.pattern not in patterns:  # may be installed since; reading the list takes 2 ms
            self._installed = installed_patterns()
            patterns = self._all_patterns(load, is_trial=is_trial)
        if load.pattern not in patterns:
            raise UnknownPatternError(unknown("pattern", load.pattern, patterns))
        check_single(load.pattern, patterns[load.pattern])
        origins = places_of(patterns)
        # Options of drivers may contain secrets that plugin code must not get.
        platform = dataclasses.replace(load.platform, drivers={})
        digests = {name: origin.digest for name, origin in patterns.items() if origin.digest}
        return replace(load, origins=origins, platform=platform, digests=digests)

    def _start_trial(self, load: host_messages.Load) -> None:
        log.info("trying new code of %s", load.pattern)
        self._installed = installed_patterns()  # a new version may have moved the pattern
        number = load.generation
        try:
            frame = encode_command(self._with_origins(load, is_trial=True))
            self._trial = TrialProcess(
                self._loop, number, frame, self._on_trial_done, self.on_reaped, self._settings
            )
        except (PluginError, CodecError, OSError) as error:
            self._events.append(
                host_messages.TrialDone(number, str(error), host_messages.refusal_of(error))
            )
            self._loop.call_soon(self._wake)

    def _on_trial_done(self, result: host_messages.TrialDone) -> None:
        if result.text:
            self._end_trial()
        self._events.append(result)
        self._wake()

    def _end_trial(self) -> None:
        if self._trial is not None:
            host = self._trial.end()
            self._trial = None
            if host is not None:
                self._dying.append(host)

    def _replace(self) -> None:
        """Kill the host; the host of the trial takes its place, without a trial a new host."""
        self._kill()
        if self._trial is not None:  # the trial's host has already loaded the new code
            self._host = self._trial.hand_over(self)
        self._start_if_none()

    def _kill(self) -> None:
        if self._host is not None:
            self._host.kill()
            self._dying.append(self._host)
            self._host = None

    def _start_if_none(self) -> None:
        if self._host is None and not self._is_closed:
            self._start()

    def _start(self) -> HostProcess:
        if self._respawn is not None:
            self._respawn.cancel()
            self._respawn = None
        self._host = HostProcess(self._loop, self, self._settings)
        return self._host


class PrintedLines:
    """Splits the output of patterns into lines and limits their rate. Pure; times in s."""

    def __init__(self) -> None:
        self._budget = TokenBucket(PRINT_RATE, PRINT_BURST)
        self._rest = b""
        self._left_out = 0

    def take(self, data: bytes, now: float) -> list[str]:
        """The lines completed by `data` that may be logged, after a count of omitted lines."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[:MAX_LINE]
        to_log: list[str] = []
        for number, line in enumerate(lines):
            if not self._budget.take(1.0, now):
                self._left_out += len(lines) - number
                break
            if self._left_out:
                to_log.append(self._left_out_line())
            to_log.append(line[:MAX_LINE].decode(errors="replace").rstrip())
        return [text for text in to_log if text]

    def _left_out_line(self) -> str:
        count = self._left_out
        self._left_out = 0
        return f"[{count} lines left out]"


class PrintPipe:
    """The pipe for the output of hosts; a thread logs its lines until `close`."""

    def __init__(self) -> None:
        self._read, self.write = os.pipe2(os.O_CLOEXEC)
        threading.Thread(target=self._run, name="swarmd-printed", daemon=True).start()

    def close(self) -> None:
        """Close the own write end. The thread ends once all hosts have ended, too."""
        if self.write >= 0:
            os.close(self.write)
            self.write = -1

    def _run(self) -> None:
        lines = PrintedLines()
        while data := os.read(self._read, _READ):
            for line in lines.take(data, time.monotonic()):
                print_log.info("%s", line)
            if len(data) > _READ // 8:
                time.sleep(_PAUSE)
        os.close(self._read)


def _not_encoded(
    command: host_messages.SentCommand, error: PluginError | CodecError
) -> host_messages.HostEvent:
    """The event for a command that cannot be encoded."""
    if isinstance(command, host_messages.Load):
        refusal = host_messages.refusal_of(error)
        return host_messages.LoadRefused(command.generation, str(error), refusal)
    return host_messages.PatternFailed(command.generation, str(error))
