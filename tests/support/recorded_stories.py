"""Stories of a robot in simulated time, recorded in this process."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from mcap.writer import Writer
from msgspec import structs

from swarmd.core.events import Input, RangesInput
from swarmd.core.low_battery import LowBatterySettings
from swarmd.core.messages import Latch, State
from swarmd.core.values import Platform, Scan, Twist
from swarmd.daemon.recorder import Recorder
from swarmd.daemon.recording import frames
from swarmd.daemon.recording.head import RecordingHead
from swarmd.daemon.recording.process import Converter
from swarmd.daemon.recording.reader import RecordedFile, read_file
from swarmd.daemon.recording.writer import Channels
from swarmd.daemon.robot_setup import recording_head
from swarmd.kit.behavior import Pattern
from swarmd.operator.replay.replay import Parity, prepare
from swarmd.operator.replay.swarm import repeat_together
from swarmd.patterns.drive.pattern import Drive
from swarmd.patterns.random_walk.pattern import RandomWalk
from swarmd.plugins import pattern_names
from swarmd.robot.actions import Actions
from swarmd.robot.latches import LatchRecord
from swarmd.robot.protection.fence.fence_settings import FenceSettings
from swarmd.robot.robot import Robot
from swarmd.settings.file_limits import FileLimits
from swarmd.testing.scans import empty_scan
from tests.support.range_ring import ring_scan, with_ring
from tests.support.robot_harness import RobotHarness

PATTERNS: Mapping[str, type[Pattern[Any]]] = {"drive": Drive, "random_walk": RandomWalk}
Extra = Callable[[Writer, IO[bytes]], None]
"""Writes something more to a file."""
ORIGINS = {name: (one.value, one.is_file) for name, one in pattern_names(None).items()}


class FileRecorder(Recorder):
    """A recorder that writes in this process, at the times that the robot is given."""

    def __init__(self, folder: Path) -> None:
        super().__init__(cast("object", None), lambda text: None)  # type: ignore[arg-type]
        self._folder = folder
        self._converter: Converter | None = None
        self.entries: list[bytes] = []  # encoded, as the black box gets them

    @property
    def is_on(self) -> bool:
        return self._converter is not None

    def step(self, robot: Robot, input: Input, now: float) -> Actions | None:
        actions = super().step(robot, input, now)
        self.settle(robot)
        return actions

    def add(self, entry: frames.Entry) -> None:
        if self._converter is not None:
            self.entries.append(frames.encode(entry))
            (copy,) = frames.decode_batch(frames.batch(self.entries[-1:]))
            self._converter.add(copy)

    def begin(self, robot: RobotHarness) -> None:
        head = head_at(robot)
        self.began = robot.now
        begin = frames.Begin(
            robot.now, str(self._folder), robot.robot.id, head.texts(), 1.7e9, FileLimits()
        )
        self._converter = Converter(begin)
        for input in list(self._lasting.values()):
            self.input(input, robot.now)
        self._is_memory_due = True

    def finish(self) -> RecordedFile:
        assert self._converter is not None
        self._converter.writer.close()
        assert self._converter.writer.path is not None
        return read_file(self._converter.writer.path)


def head_at(robot: RobotHarness) -> RecordingHead:
    return structs.replace(recording_head(robot.robot, "s", robot.now), clock="c")


class Story:
    """A robot between obstacles that come nearer, and its recorder."""

    def __init__(
        self,
        folder: Path,
        latches: Mapping[str, Latch] | None = None,
        *,
        has_ring: bool = False,
        fence: FenceSettings | None = None,
        on_low_battery: LowBatterySettings | None = None,
        patterns: Mapping[str, type[Pattern[Any]]] = PATTERNS,
        robot: str = "tb3-01",
    ) -> None:
        self.recorder = FileRecorder(folder)
        record = LatchRecord(held=dict(latches or {}))
        make = partial(_made, robot, has_ring=has_ring)
        self.provisional: set[int] = set()
        self.robot = RobotHarness(
            patterns=patterns,
            make=make,
            take=self.recorder.step,
            latches=record,
            fence=fence,
            on_low_battery=on_low_battery,
            is_provisional=lambda generation: generation in self.provisional,
        )
        self.robot.scans = self._scan

    def _scan(self, seq: int, now: float) -> Scan:
        scan = empty_scan(self.robot.platform, seq, now)
        ahead = np.abs(np.angle(np.exp(1j * scan.bearings))) < 0.4
        distance = 0.4 + 0.3 * np.cos(now)
        robot = self.robot.robot
        if robot.platform.ranges is not None:
            near = float(np.float32(0.3 + 0.2 * np.cos(3.0 * now)))
            ring = ring_scan(seq, now, {0.0: near, 60.0: 0.125})
            self.robot.step(RangesInput(ring))
        return structs.replace(scan, ranges=np.where(ahead, np.float32(distance), scan.ranges))

    def run(self, pattern: str, seconds: float = 3.0, **params: float) -> None:
        self.robot.ask("run", pattern=pattern, params=params)
        self.robot.advance(seconds)
        assert self.robot.robot.state is State.RUNNING

    def replayed(self, origins: Mapping[str, tuple[str, bool]] = ORIGINS) -> Parity:
        return repeat([self.recorder.finish()], origins)[1]


def _made(
    name: str, id: str, platform: Platform, *args: Any, has_ring: bool, **kwargs: Any
) -> Robot:
    return Robot(name, with_ring(platform) if has_ring else platform, *args, **kwargs)


def repeat(
    files: list[RecordedFile],
    origins: Mapping[str, tuple[str, bool]],
    platform: Platform | None = None,
) -> tuple[RecordingHead, Parity]:
    """Replay the files of one recording."""
    life = prepare(files, origins, platform)
    repeat_together([life])
    return life.head, life.parity()


class Busy:
    """A story of a robot that learns: it turns, its scans come late, and things hide behind others.

    Its sensors and its pauses follow from `seed`.
    """

    def __init__(self, folder: Path, seed: int, *, has_ring: bool = False) -> None:
        self.story = Story(folder, has_ring=has_ring)
        self.random = np.random.default_rng(seed)
        self.robot = self.story.robot
        self.robot.scans = self._scan
        self._late = float(self.random.uniform(0.0, 0.25))

    def _scan(self, seq: int, now: float) -> Scan:
        turn = float(0.4 * np.sin(0.7 * now))
        self.robot.odometry = Twist(float(0.05 * (1.0 + np.cos(now))), turn)
        scan = self.story._scan(seq, now)
        noisy = scan.ranges + self.random.normal(0.0, 0.01, scan.ranges.shape)
        near = np.abs(np.angle(np.exp(1j * (scan.bearings - now)))) < 0.2
        gap = near & (self.random.random() < 0.5)
        ranges = np.where(near, 0.13 + 0.1 * np.cos(3.0 * now) ** 2, noisy)
        ranges = np.where(gap, np.inf, ranges)
        return structs.replace(scan, ranges=ranges, stamp=scan.stamp - self._late)

    def wander(self, seconds: float) -> None:
        """Runs, stops and rests at random times for so long."""
        end = self.robot.now + seconds
        while self.robot.now < end:
            self.robot.ask("run", pattern="random_walk")
            self.robot.advance(float(self.random.uniform(0.1, 4.0)))
            self.robot.ask("stop")
            self.robot.advance(float(self.random.choice([0.1, 1.0])))


def rewritten(
    recorded: RecordedFile, path: Path, extra: Extra | None = None, **options: Any
) -> Path:
    """The messages in a file of the library, with something more in the middle."""
    with path.open("wb") as file:
        writer = Writer(file, **{"chunk_size": 20_000, **options})
        writer.start("", "another writer")
        writer.add_metadata("swarmd", dict(recorded.about))
        channels = Channels(writer)
        for number, one in enumerate(recorded.messages):
            if extra is not None and number == 100:
                extra(writer, file)
            channel = channels.id_of(one.topic, one.kind)
            writer.add_message(channel, one.at, one.payload, one.at, one.sequence)
        writer.finish()  # type: ignore[no-untyped-call]
    return path
