"""The process that writes the recording of a robot, and the entries on their way to it.

Entries are sent by a socket, and never block the loop. They are sent in batches, twice a second. A
process that wakes at each tick costs twice as much, since the code of the process has then left the
CPU's caches. If the disk is slower than the robot, the socket fills; then a batch is dropped and
counted. If the process ends, an event reports the end, and the robot continues.
"""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import sys
from collections.abc import Callable

from swarmd.core.clock import boottime
from swarmd.core.errors import CodecError
from swarmd.core.processes import how_it_ended
from swarmd.daemon.recording import frames

MAX_BATCH = 60_000
"""The most bytes of a batch with several entries."""
MAX_ENTRIES = 500
"""Entries that are sent at once, before BATCH_PERIOD is over."""
BATCH_PERIOD = 0.5
"""Seconds between two batches: a daemon that is killed loses the entries of that time."""
DROPS_PERIOD = 10.0
"""Seconds between two events that count dropped entries."""
BUFFER = 1 << 20
"""Bytes that the socket is asked to hold while the disk is slow."""


class _Process:
    """One recorder process and the daemon's end of its socket.

    `has_failed`: the process has reported the fault that ends the recording.
    """

    has_failed = False

    def __init__(self) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
        command = [
            sys.executable,
            "-P",
            "-m",
            "swarmd.daemon.recording.process",
            str(theirs.fileno()),
        ]
        try:
            with theirs:
                self.process = subprocess.Popen(
                    command,
                    pass_fds=(theirs.fileno(),),
                    start_new_session=True,
                    stdin=subprocess.DEVNULL,
                    env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
                )
        except OSError:
            ours.close()
            raise
        self.socket = ours
        self.pidfd = os.pidfd_open(self.process.pid)


class RecorderProcess:
    """Sends the entries of a recording to a process of its own, between `start` and `stop`.

    `on_event` takes a line for the robot's log. `on_gap` is called after entries were dropped, and
    `on_new_file` when another file begins: what follows must not depend on earlier entries.
    `dropped`: the count of entries that are missing in the recording. `fault`: why the recording
    ended by itself; empty after `stop`.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[str], None],
        on_gap: Callable[[], None],
        on_new_file: Callable[[], None],
    ) -> None:
        self._loop = loop
        self._on_event = on_event
        self._on_gap = on_gap
        self._on_new_file = on_new_file
        self._open: _Process | None = None
        self._ending: list[_Process] = []
        self._entries: list[bytes] = []  # encoded
        self._flush_at = 0.0
        self._reported_at = -DROPS_PERIOD
        self._forget_recording()

    @property
    def is_on(self) -> bool:
        """True while entries are taken."""
        return self._open is not None

    def start(self) -> None:
        """Start a process; call it while `is_on` is False. OSError if it cannot be started."""
        recorder = self._open = _Process()
        self._loop.add_reader(recorder.socket, self._on_report, recorder)
        self._loop.add_reader(recorder.pidfd, self._on_end, recorder)
        self._entries = []
        self._forget_recording()

    def _forget_recording(self) -> None:
        """Clear the fault, the report and the counts of the recording before."""
        self.fault = ""
        self.report = frames.RecorderReport("", 0)
        self.dropped = 0  # entries dropped in all
        self._unreported = 0  # of these, entries that no event has told so far
        self._unrecorded = 0  # of these, entries whose gap is not in the recording so far

    def stop(self) -> None:
        """Send the remaining entries; the process finishes its file and ends."""
        self.flush()
        self._disconnect()

    def close(self, timeout: float = 2.0) -> None:
        """Stop, and wait for the processes; kill a process that takes longer than `timeout` s."""
        self.stop()
        for recorder in list(self._ending):
            try:
                recorder.process.wait(timeout)
            except subprocess.TimeoutExpired:
                recorder.process.kill()
            self._on_end(recorder)

    def put(self, encoded: bytes) -> None:
        """Add an encoded entry to the next batch; call it while `is_on`."""
        self._entries.append(encoded)
        if len(self._entries) >= MAX_ENTRIES:
            self.flush()

    def flush_if_due(self, now: float) -> None:
        """Send the entries if the last batch is BATCH_PERIOD old."""
        if self._entries and now >= self._flush_at:
            self._flush_at = now + BATCH_PERIOD
            self.flush()

    def flush(self) -> None:
        """Send the entries since the last call; drop them if the socket has no room."""
        if self._open is None or not self._entries:
            return
        entries = self._entries
        self._entries = []
        part: list[bytes] = []
        size = 0
        for number, encoded in enumerate(entries):
            if size + len(encoded) > MAX_BATCH and part:
                if not self._send(part):
                    # Later entries may depend on the dropped part (scans without geometry).
                    self._drop(len(entries) - number)
                    return
                part = []
                size = 0
            if len(encoded) > frames.MAX_ENTRY:
                self._drop(1)
                continue
            part.append(encoded)
            size += len(encoded)
        if part:
            self._send(part)

    def _send(self, part: list[bytes]) -> bool:
        """Send encoded entries; False if they were dropped."""
        assert self._open is not None
        gap = frames.DroppedEntry(boottime(), self._unrecorded)
        lost = [frames.encode(gap)] if self._unrecorded else []
        try:
            self._open.socket.send(frames.batch([*lost, *part]))
        except OSError:  # full, or just ended: the pidfd is watched
            self._drop(len(part))
            return False
        self._unrecorded = 0
        return True

    def _drop(self, count: int) -> None:
        """Count dropped entries."""
        self._on_gap()
        self.dropped += count
        self._unreported += count
        self._unrecorded += count
        now = boottime()
        if now - self._reported_at >= DROPS_PERIOD:
            self._reported_at = now
            count = self._unreported
            self._unreported = 0
            self._on_event(f"recording: {count} entries dropped: the disk is slow")

    def _on_report(self, recorder: _Process) -> None:
        try:
            frame = recorder.socket.recv(1 << 16)
            report = frames.decode_report(frame) if frame else None
        except (BlockingIOError, CodecError):
            return
        except OSError:
            report = None
        if report is None:  # the socket is closed; `_on_end` follows by the pidfd
            self._loop.remove_reader(recorder.socket)
            return
        if self.report.path and report.path != self.report.path:
            self._on_new_file()
        self.report = report
        if report.fault:
            recorder.has_failed = True
            self._fail(f"{report.path or 'no file'}: {report.fault}")

    def _on_end(self, recorder: _Process) -> None:
        if recorder.pidfd < 0:
            return
        self._loop.remove_reader(recorder.pidfd)
        os.close(recorder.pidfd)
        recorder.pidfd = -1
        code = recorder.process.wait()
        if recorder is self._open:  # `_on_report` may call `_fail`, which disconnects
            self._on_report(recorder)
        if recorder is self._open:
            self._fail(f"its process {how_it_ended(code)}")
        elif code and not recorder.has_failed:  # failed after `stop`, for instance on a full disk
            self._tell_fault(f"its file is not whole: its process {how_it_ended(code)}")
        self._ending.remove(recorder)

    def _fail(self, fault: str) -> None:
        self._disconnect()
        self._tell_fault(fault)

    def _tell_fault(self, fault: str) -> None:
        self.fault = fault
        self._on_event(f"recording ends: {fault}")

    def _disconnect(self) -> None:
        recorder = self._open
        self._open = None
        if recorder is not None:
            self._loop.remove_reader(recorder.socket)
            recorder.socket.close()
            self._ending.append(recorder)
        self._entries = []
