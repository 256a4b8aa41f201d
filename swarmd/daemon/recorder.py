"""Records a robot by a process of its own and in the ring of the black box; hands out recordings.

The recorder sends entries (inputs, decisions, events) to that process by a socket, and never blocks
the loop. Entries are sent in batches, twice a second. A process that wakes at each tick costs twice
as much, since the code of the process has then left the CPU's caches. If the disk is slower than
the robot, the socket fills; then a batch is dropped and counted. If the process ends, an event
reports the end, and the robot continues.

The ring gets the entries of each tick at its end, after the command has gone to the base. So a
daemon that is killed loses the entries of one tick, and no command is later than without the ring.
"""

from __future__ import annotations

import asyncio
import json
import logging
import math
import os
import socket
import subprocess
import sys
import time
import zlib
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from swarmd.core import verbs
from swarmd.core.bounds import FileName
from swarmd.core.clock import boottime, clock_id
from swarmd.core.errors import CodecError, ConfigError, PluginError
from swarmd.core.events import (
    DriverInput,
    HazardsInput,
    Input,
    NeighborsInput,
    OdometryInput,
    PeersInput,
    ProvisionalInput,
    RangesInput,
    ReadingsInput,
    ScanInput,
    TickInput,
    tag_of,
)
from swarmd.core.files import open_regular, read_regular, write_fault
from swarmd.core.messages import Code, RecordingSummary, Reply, Status
from swarmd.core.processes import how_it_ended
from swarmd.core.refusal import Refusal
from swarmd.core.values import Scan
from swarmd.daemon.requests import SendReply
from swarmd.plugins import need
from swarmd.recording import frames
from swarmd.recording.head import RecordingHead
from swarmd.recording.reader import clock_of
from swarmd.recording.ring import Ring
from swarmd.robot.actions import Actions
from swarmd.robot.memory import remember
from swarmd.robot.robot import Robot
from swarmd.settings.file_limits import FileLimits
from swarmd.settings.swarmfile import RecordingSection

MAX_BATCH = 60_000
"""The most bytes of a batch with several entries, and of a part of the robot's memory."""
MAX_MEMORY = 10 * MAX_BATCH
"""The most bytes of a robot's memory that is recorded."""
MAX_ENTRIES = 500
"""Entries that are sent at once, before BATCH_PERIOD is over."""
BATCH_PERIOD = 0.5
"""Seconds between two batches: a daemon that is killed loses the entries of that time."""
SEGMENT_TIME = 30.0
"""Seconds after which a segment of the ring is followed by another one."""
FIRST_COST = 0.01
"""Seconds that a memory is expected to take before one was taken."""
COSTS = 3  # memories whose shortest time counts
HEADROOM = 1.5
"""The time left for a memory, to the time that the last one took."""
DROPS_PERIOD = 10.0
"""Seconds between two events that count dropped entries."""
BUFFER = 1 << 20
"""Bytes that the socket is asked to hold while the disk is slow."""

_LASTING = frozenset(
    {DriverInput, HazardsInput, NeighborsInput, PeersInput, ProvisionalInput, ReadingsInput}
)
"""Kinds of input that hold until the next one: a recording begins with the last of each."""
_PERIODIC = frozenset({OdometryInput, NeighborsInput, PeersInput})
"""Kinds of input that come again and again: without a decision the ring gets them with the next
tick. To write each of them takes as many system calls as all else that a robot at rest does."""
log = logging.getLogger(__name__)

MAX_FILES = 500  # the newest files, which the answer to an operator lists


class _Process:
    """One recorder process and the daemon's end of its socket.

    `has_failed`: the process has reported the fault that ends the recording.
    """

    has_failed = False

    def __init__(self) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
        command = [sys.executable, "-P", "-m", "swarmd.recording.process", str(theirs.fileno())]
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


class _Step(NamedTuple):
    """A step of the robot that has no entries so far; `state`: after it."""

    input: Input
    now: float
    actions: Actions | None
    state: str = ""


class Recorder:
    """Records one robot between `start` and `stop`.

    `on_event` takes a line for the robot's log. `dropped`: the count of entries that are missing in
    the recording. `fault`: why the recording ended by itself; empty after `stop`.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, on_event: Callable[[str], None]) -> None:
        self._loop = loop
        self._on_event = on_event
        self.began = 0.0  # s; start of the present or last recording
        self._open: _Process | None = None
        self._ending: list[_Process] = []
        self._steps: list[_Step] = []  # without entries so far
        self._entries: list[bytes] = []  # encoded, for the process
        self.ring: Ring | None = None
        self.ring_fault = ""  # why the ring ended by itself
        self.on_status: Callable[[Status], object] = lambda status: None
        self._ring_entries: list[bytes] = []
        self._segment_at = -math.inf  # s; the begin of the present segment of the ring
        # s that the last memories took; a busy machine makes some of them slow.
        self._memory_costs = deque([FIRST_COST], maxlen=COSTS)
        # The last input of each lasting kind; a recording begins with these inputs.
        self._lasting: dict[type[Input], Input] = {}
        self._scans: dict[type[Input], Scan] = {}  # the last scan of each kind
        self._is_memory_due = False  # record the robot's memory before the next input
        self._logged_to = -1.0  # s since the start of the daemon: time of the last recorded event
        self._flush_at = 0.0
        self._reported_at = -DROPS_PERIOD
        self._forget_recording()

    @property
    def is_on(self) -> bool:
        """True while entries are taken."""
        return self._open is not None

    def start(self, folder: Path, name: str, about: Mapping[str, str], limits: FileLimits) -> None:
        """Start a process that writes entries to files in `folder`; call it while `is_on` is False.

        `name`: the begin of the file names. `about`: texts on the robot, for the head of each file.
        `limits`: the greatest size and duration of a file, and the greatest size of all files.
        OSError if the process cannot be started.
        """
        recorder = self._open = _Process()
        self._loop.add_reader(recorder.socket, self._on_report, recorder)
        self._loop.add_reader(recorder.pidfd, self._on_end, recorder)
        self._scans, self._entries = {}, []
        self._forget_recording()
        began = self.began = boottime()
        self.add(
            frames.Begin(
                at=began,
                folder=str(folder),
                name=name,
                about=dict(about),
                wall=time.time() - (boottime() - began),  # the time of day at `began`
                limits=limits,
            )
        )
        # A replay begins with the inputs that still hold, such as the neighbors. Then follows the
        # robot's memory, which is recorded at the next step.
        for lasting in self._lasting.values():
            self._entries.append(frames.encode(frames.input_entry(lasting, began)))
        self._is_memory_due = True

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

    def step(self, robot: Robot, input: Input, now: float) -> Actions | None:
        """Step `robot`; `settle` records the input and the decision that follows from it."""
        if type(input) in _LASTING:
            self._lasting[type(input)] = input
        if not self.is_on and self.ring is None:
            return robot.step(input, now)
        if self._is_memory_due and self.is_on:
            self.settle(robot)
            self._memory(robot, now)
        try:
            actions = robot.step(input, now)
        except Exception:  # the daemon ends: the black box keeps what ended it
            self._steps.append(_Step(input, now, None))
            self.settle(robot)
            self.write_ring()
            raise
        self._steps.append(_Step(input, now, actions, robot.state))
        return actions

    def settle(self, robot: Robot) -> None:
        """Record the steps since the last call; call it once their actions are carried out.

        An error ends the black box, and not the daemon.
        """
        if not self._steps:
            return
        try:
            self._settle(robot)
        except Exception as error:
            log.exception("the black box ends")
            self.end_ring(repr(error))

    def _settle(self, robot: Robot) -> None:
        steps, self._steps = self._steps, []
        if self.ring is not None:
            self.ring.revision = robot.epoch.revision
        statuses: list[Status] = []
        for input, now, actions, state in steps:
            self.input(input, now)
            if actions is not None:
                self._decided(input, actions, now, state)
                if actions.has_status:
                    statuses.append(robot.status(now))
                    self._status(statuses[-1], now)
            if type(input) is TickInput:
                self.flush_if_due(now)
            is_quiet = actions.is_quiet if actions is not None else type(input) in _PERIODIC
            if type(input) is TickInput or not is_quiet:
                self.write_ring()
        for status in statuses:
            self.on_status(status)

    def input(self, input: Input, now: float) -> None:
        """Record an input; a scan whose geometry equals that of the last scan omits it."""
        if isinstance(input, ScanInput | RangesInput):
            scan, last = input.scan, self._scans.get(type(input))
            self._scans[type(input)] = scan
            if last is not None and frames.has_geometry_of(scan, last):
                input = type(input)(frames.without_geometry(scan))
        self.add(frames.input_entry(input, now))

    def _memory(self, robot: Robot, now: float) -> None:
        """Record the memory of the robot before the present input; takes 4 ms of CPU."""
        self._is_memory_due = False
        try:
            data = remember(robot, MAX_MEMORY)
        except CodecError as error:  # the robot continues; a replay reports the missing memory
            self._on_event(f"recording: {error}")
            return
        parts = [data[at : at + MAX_BATCH] for at in range(0, len(data), MAX_BATCH)]
        for number, part in enumerate(parts):
            self.add(frames.MemoryEntry(now, part, number, len(parts)))

    def _decided(self, input: Input, actions: Actions, now: float, state: str) -> None:
        decision = actions.decision
        self.add(frames.DecisionEntry(now, tag_of(input), state, decision.reason or "", decision))
        for channel, value in actions.messages.items():
            self.add(frames.SentEntry(now, channel, value))

    def _status(self, status: Status, now: float) -> None:
        self.add(frames.TextEntry(now, "/status", frames.as_json(status)))
        for event in status.events:
            if event.at > self._logged_to:
                self._logged_to = event.at
                at = now - status.uptime + event.at
                if at >= self.began:  # an older event would give the file an empty beginning
                    self.add(frames.EventEntry(at, event.text))

    def add(self, entry: frames.Entry) -> None:
        """Add an entry to the next batch; ignored while nothing is recorded."""
        if self._open is None and self.ring is None:
            return
        encoded = frames.encode(entry)
        if self.ring is not None:
            self._ring_entries.append(encoded)
        if self._open is not None:
            self._entries.append(encoded)
            if len(self._entries) >= MAX_ENTRIES:
                self.flush()

    # The ring

    def remember(self, robot: Robot, now: float, time_left: float) -> None:
        """Begin a segment of the ring with the memory of the robot if one is due.

        Call it after a decision. `time_left`: s until the next input that may change the command;
        0: a scan may come at any time. The memory waits for time enough, for SEGMENT_TIME at most.
        """
        ring, age = self.ring, now - self._segment_at
        if ring is None or not time_left or (age < SEGMENT_TIME and not ring.is_long):
            return
        if time_left < HEADROOM * min(self._memory_costs) and age < 2.0 * SEGMENT_TIME:
            return
        self.settle(robot)
        self.write_ring()
        began = boottime()
        try:
            data = remember(robot, MAX_MEMORY)
        except CodecError as error:  # tried again after SEGMENT_TIME
            self._segment_at = now
            self._on_event(f"black box: {error}")
            return
        self._scans = {}  # the first scan of the segment has its geometry
        ring.begin_segment(now)
        ring.set_clock(boottime(), time.time())  # a robot without a battery clock starts in 1970
        self._segment_at = now
        self._ring_entries.append(frames.encode(frames.MemoryEntry(now, data)))
        self.write_ring()
        self._memory_costs.append(boottime() - began)

    def write_ring(self) -> None:
        """Write the entries so far to the ring."""
        entries, self._ring_entries = self._ring_entries, []
        if self.ring is None or not entries:
            return
        try:
            self.ring.write(frames.batch(entries[-frames.MAX_BATCH :]))
        except OSError as error:
            self.end_ring(error.strerror or str(error))

    def end_ring(self, fault: str) -> None:
        """End the black box, and say why."""
        if self.ring is not None:  # its file would tell the next daemon of a crash
            self.ring.close(keeps_file=False)
        self.ring, self.ring_fault = None, f"off: {fault}"
        self._on_event(f"black box ends: {fault}")

    def flush_if_due(self, now: float) -> None:
        """Send the entries if the last batch is BATCH_PERIOD old."""
        if self._entries and now >= self._flush_at:
            self._flush_at = now + BATCH_PERIOD
            self.flush()

    def flush(self) -> None:
        """Send the entries since the last call; drop them if the socket has no room."""
        if self._open is None or not self._entries:
            return
        entries, self._entries = self._entries, []
        part: list[bytes] = []
        size = 0
        for number, encoded in enumerate(entries):
            if size + len(encoded) > MAX_BATCH and part:
                if not self._send(part):
                    # Later entries may depend on the dropped part (scans without geometry).
                    self._drop(len(entries) - number)
                    return
                part, size = [], 0
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
        """Count dropped entries, and record after the gap what a replay needs to continue.

        The memory (whole state) of the robot is recorded before the next input. The next scan is
        recorded with its geometry (bearings), since the scan with the last geometry may be among
        the dropped entries.
        """
        self._scans = {}
        self._is_memory_due = True
        self.dropped += count
        self._unreported += count
        self._unrecorded += count
        now = boottime()
        if now - self._reported_at >= DROPS_PERIOD:
            self._reported_at = now
            count, self._unreported = self._unreported, 0
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
        # A new file gets the memory, since the files before may be removed.
        self._is_memory_due |= report.path != self.report.path and bool(self.report.path)
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
        recorder, self._open = self._open, None
        if recorder is not None:
            self._loop.remove_reader(recorder.socket)
            recorder.socket.close()
            self._ending.append(recorder)
        self._entries = []


class RecordingService:
    """Answers the requests on recordings of one robot. `on_event` takes a line for its log."""

    def __init__(
        self,
        robot: str,
        section: RecordingSection,
        head: Callable[[], RecordingHead],
        on_event: Callable[[str], None],
    ) -> None:
        self._robot, self._section, self._head = robot, section, head
        self._folder = Path(section.folder or "recordings")
        self._on_event = on_event
        self.recorder = Recorder(asyncio.get_running_loop(), on_event)
        self._is_closed = False

    @property
    def summary(self) -> RecordingSummary | None:
        """The present recording; None while nothing is recorded."""
        recorder = self.recorder
        if not recorder.is_on:
            return None
        report = recorder.report
        return RecordingSummary(
            file=report.path[-1000:], size=report.bytes, dropped=recorder.dropped
        )

    def on_record(self, request: verbs.RecordRequest, answer: SendReply) -> None:
        """Start or stop the recording; the reply to a start follows once its folder was tried."""
        if request.action == "start":  # the disk may be slow, and must not delay the daemon
            tried = asyncio.get_running_loop().run_in_executor(None, write_fault, self._folder)
            tried.add_done_callback(lambda done: self._carry_out(request, done.result(), answer))
        else:
            self._carry_out(request, "", answer)

    def _carry_out(self, request: verbs.RecordRequest, fault: str, answer: SendReply) -> None:
        """Start or stop the recording; `fault`: why no file can be written to its folder."""
        if self._is_closed:
            return
        recorder, is_on = self.recorder, self.recorder.is_on
        code, refusal = Code.APPLIED, None
        if request.action == "start" and is_on:
            text = "records already"
        elif request.action == "start":
            try:
                if fault:
                    raise OSError(f"{self._folder}: {fault}")
                self._start()
                text = f"records to {self._folder}"
            except (OSError, PluginError) as error:
                code, refusal = Code.FAILED, Refusal.INVALID_REQUEST
                text = f"cannot record: {error}"
        elif is_on:
            recorder.stop()
            text = f"recorded {recorder.report.path or 'nothing yet'}"
            if recorder.dropped:
                text += f"; {recorder.dropped} entries were dropped: the disk is slow"
        else:
            text = "did not record"
        answer(Reply(id=request.id, robot=self._robot, code=code, refusal=refusal, text=text[:300]))

    def start_if_wanted(self) -> None:
        """Start to record if the settings say so; a failure is logged as an event."""
        if self._section.from_start:
            try:
                self._start()
            except (OSError, PluginError) as error:
                self._on_event(f"cannot record: {error}")

    def _start(self) -> None:
        need("mcap", "rosbags", extra="record")
        self.recorder.start(self._folder, self._robot, self._head().texts(), self._section)

    # Recordings for operators

    def on_recordings(self, _: verbs.Nothing) -> Callable[[], verbs.RecordingsReply]:
        """List the recordings on disk; the returned function runs in a thread."""
        return self._list

    def on_fetch(self, query: verbs.FetchQuery) -> Callable[[], verbs.FetchReply]:
        """Bytes of a recording file; the returned function runs in a thread."""
        return partial(piece_of, self._robot, self._folder, ".mcap", query)

    def close(self) -> None:
        """Finish the recording."""
        self._is_closed = True
        self.recorder.close()

    def _list(self) -> verbs.RecordingsReply:
        try:
            found = (path for path in self._folder.glob("*.mcap") if _is_told(path.name))
            paths = sorted(found)[-MAX_FILES:]
        except OSError:
            paths = []
        open_now = Path(self.recorder.report.path).name if self.recorder.is_on else ""
        files = [
            _described(path, is_open=path.name == open_now, dropped=self.recorder.dropped)
            for path in paths
        ]
        return verbs.RecordingsReply(
            robot=self._robot,
            now=boottime(),
            clock=clock_id(),
            files=tuple(one for one in files if one is not None),
            fault=self.recorder.fault[:1000],
        )


def piece_of(robot: str, folder: Path, suffix: str, query: verbs.FetchQuery) -> verbs.FetchReply:
    """Bytes of a file in `folder` whose name ends in `suffix`, for an operator."""
    data, size, text = b"", 0, ""
    try:
        if not query.file.endswith(suffix):
            raise FileNotFoundError
        with open_regular(folder / query.file) as file:
            size = file.seek(0, 2)
            file.seek(query.offset)
            data = file.read(query.length)
    except FileNotFoundError:
        text = "there is no such recording"
    except OSError as error:
        text = error.strerror or "cannot be read"
    return verbs.FetchReply(
        robot=robot,
        file=query.file,
        offset=query.offset,
        size=size,
        data=data,
        crc=zlib.crc32(data),
        text=text,
    )


def _is_told(name: str) -> bool:
    """True if operators may ask for a file of this name."""
    with suppress(msgspec.ValidationError):
        return msgspec.convert(name, FileName).isprintable()
    return False


def _described(path: Path, *, is_open: bool, dropped: int) -> verbs.RecordingFile | None:
    """The entry of a recording in the reply to an operator; None if the file was removed.

    `path`: the .mcap file. `is_open`: the file is being written. `dropped`: the count of entries
    that an open file lacks.
    """
    try:
        size = path.stat().st_size
    except OSError:  # the file was removed meanwhile
        return None
    return _finished(path, size) or verbs.RecordingFile(
        name=path.name, size=size, is_open=is_open, dropped=dropped if is_open else 0
    )


def _finished(path: Path, size: int) -> verbs.RecordingFile | None:
    """The entry of a finished recording, from the index beside the file.

    None without a valid index: the file is being written, or was cut off.
    """
    try:
        index: dict[str, Any] = json.loads(read_regular(path.with_suffix(".index.json")))
        return verbs.RecordingFile(
            name=path.name,
            size=size,
            is_open=False,
            crc=index["crc32"],
            dropped=index["dropped"],
            begin=clock_of(index["about"], int(index["begin_ns"])),
            end=clock_of(index["about"], int(index["end_ns"])),
        )
    except (OSError, ValueError, KeyError, ConfigError):
        return None
