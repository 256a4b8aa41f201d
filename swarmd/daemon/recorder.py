"""Records a robot: its inputs, decisions and events, for a recording and for the black box.

What is recorded goes to a process that writes a file (`recorder_process.py`), and to the ring of
the black box (`ring_writer.py`). Neither delays a command.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from swarmd.core.clock import boottime
from swarmd.core.errors import CodecError
from swarmd.core.events import (
    DriverInput,
    HazardsInput,
    Input,
    NeighborsInput,
    OdometryInput,
    PeerFaultsInput,
    PeersInput,
    ProvisionalInput,
    RangesInput,
    ReadingsInput,
    ScanInput,
    TickInput,
    tag_of,
)
from swarmd.core.messages import Status
from swarmd.core.values import Scan
from swarmd.daemon.recorder_process import RecorderProcess
from swarmd.daemon.recording import frames
from swarmd.daemon.ring_writer import RingWriter
from swarmd.robot.actions import Actions
from swarmd.robot.memory import remember
from swarmd.robot.robot import Robot
from swarmd.settings.file_limits import FileLimits

MAX_PART = 60_000
"""The most bytes of a part of the robot's memory."""
MAX_MEMORY = 10 * MAX_PART
"""The most bytes of a robot's memory that is recorded."""

_LASTING = frozenset(
    {
        DriverInput,
        HazardsInput,
        NeighborsInput,
        PeerFaultsInput,
        PeersInput,
        ProvisionalInput,
        ReadingsInput,
    }
)
"""Kinds of input that hold until the next one: a recording begins with the last of each."""
_PERIODIC = frozenset({OdometryInput, NeighborsInput, PeersInput})
"""Kinds of input that come again and again: without a decision the ring gets them with the next
tick. To write each of them takes as many system calls as all else that a robot at rest does."""
log = logging.getLogger(__name__)


class _Step(NamedTuple):
    """A step of the robot that has no entries so far; `state`: after it."""

    input: Input
    now: float
    actions: Actions | None
    state: str = ""


class Recorder:
    """Records one robot. `on_event` takes a line for the robot's log.

    `process`: writes a recording between `start` and `stop`. `black_box`: writes the ring, while
    there is one. `on_status` takes each status that was recorded.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, on_event: Callable[[str], None]) -> None:
        self._on_event = on_event
        self.process = RecorderProcess(loop, on_event, self._on_gap, self._on_new_file)
        self.black_box = RingWriter(on_event)
        self.on_status: Callable[[Status], object] = lambda status: None
        self.began = 0.0  # s; start of the present or last recording
        self._steps: list[_Step] = []  # without entries so far
        # The last input of each lasting kind; a recording begins with these inputs.
        self._lasting: dict[type[Input], Input] = {}
        self._scans: dict[type[Input], Scan] = {}  # the last scan of each kind
        self._is_memory_due = False  # record the robot's memory before the next input
        self._logged_to = -1.0  # s since the start of the daemon: time of the last recorded event

    @property
    def is_on(self) -> bool:
        """True while a recording is written."""
        return self.process.is_on

    def start(self, folder: Path, name: str, about: Mapping[str, str], limits: FileLimits) -> None:
        """Start a recording in files in `folder`; call it while `is_on` is False.

        `name`: the begin of the file names. `about`: texts on the robot, for the head of each file.
        `limits`: the greatest size and duration of a file, and the greatest size of all files.
        OSError if the process cannot be started.
        """
        self.process.start()
        self._scans = {}
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
            self.process.put(frames.encode(frames.input_entry(lasting, began)))
        self._is_memory_due = True

    def _on_gap(self) -> None:
        """Record after a gap what a replay needs to continue.

        The memory (whole state) of the robot is recorded before the next input. The next scan is
        recorded with its geometry (bearings), since the scan with the last geometry may be among
        the dropped entries.
        """
        self._scans = {}
        self._is_memory_due = True

    def _on_new_file(self) -> None:
        """Record the memory in a new file, since the files before may be removed."""
        self._is_memory_due = True

    def step(self, robot: Robot, input: Input, now: float) -> Actions | None:
        """Step `robot`; `settle` records the input and the decision that follows from it."""
        if type(input) in _LASTING:
            self._lasting[type(input)] = input
        if not self.is_on and self.black_box.ring is None:
            return robot.step(input, now)
        if self._is_memory_due and self.is_on:
            self.settle(robot)
            self._memory(robot, now)
        try:
            actions = robot.step(input, now)
        except Exception:  # the daemon ends: the black box keeps what ended it
            self._steps.append(_Step(input, now, None))
            self.settle(robot)
            self.black_box.write()
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
            self.black_box.end(repr(error))

    def _settle(self, robot: Robot) -> None:
        steps = self._steps
        self._steps = []
        if self.black_box.ring is not None:
            self.black_box.ring.revision = robot.epoch.revision
        statuses: list[Status] = []
        for input, now, actions, state in steps:
            self.input(input, now)
            if actions is not None:
                self._decided(input, actions, now, state)
                if actions.has_status:
                    statuses.append(robot.status(now))
                    self._status(statuses[-1], now)
            if type(input) is TickInput:
                self.process.flush_if_due(now)
            is_quiet = actions.is_quiet if actions is not None else type(input) in _PERIODIC
            if type(input) is TickInput or not is_quiet:
                self.black_box.write()
        for status in statuses:
            self.on_status(status)

    def input(self, input: Input, now: float) -> None:
        """Record an input; a scan whose geometry equals that of the last scan omits it."""
        if isinstance(input, ScanInput | RangesInput):
            scan = input.scan
            last = self._scans.get(type(input))
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
        parts = [data[at : at + MAX_PART] for at in range(0, len(data), MAX_PART)]
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
        """Add an entry to the recording and to the ring; ignored while there is neither."""
        if not self.process.is_on and self.black_box.ring is None:
            return
        encoded = frames.encode(entry)
        self.black_box.put(encoded)
        if self.process.is_on:
            self.process.put(encoded)

    def remember(self, robot: Robot, now: float, time_left: float) -> None:
        """Begin a segment of the ring with the memory of the robot if one is due.

        Call it after a decision. `time_left`: s until the next input that may change the command;
        0: a scan may come at any time.
        """
        black_box = self.black_box
        if not black_box.is_segment_due(now, time_left):
            return
        self.settle(robot)
        black_box.write()
        if black_box.ring is None:  # the entries before could not be written
            return
        began = boottime()
        try:
            data = remember(robot, MAX_MEMORY)
        except CodecError as error:
            black_box.postpone_segment(now)
            self._on_event(f"black box: {error}")
            return
        self._scans = {}  # the first scan of the segment has its geometry
        black_box.begin_segment(data, now, boot=boottime(), wall=time.time())
        black_box.memory_cost.note(boottime() - began)
