"""A crowd in lockstep, each robot recorded to a folder of its own, in this process."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from msgspec import structs

from swarmd.core.events import Input, NeighborsInput
from swarmd.core.kernels import describe_kernels
from swarmd.daemon.recording import frames
from swarmd.daemon.recording.head import RecordingHead
from swarmd.daemon.recording.process import Converter
from swarmd.robot.actions import Actions
from swarmd.robot.robot import Robot
from swarmd.settings.file_limits import FileLimits
from swarmd.sim.scenarios.scenariofile import scenario_of
from tests.support.clocked_crowd import clocked_crowd
from tests.support.recorded_stories import FileRecorder, head_at
from tests.support.robot_harness import RobotHarness

WALL = 1.7e9  # s since 1970 when a robot's clock shows 0
ROUND_TRIP = 0.004  # s, of an exchange with the clock of tb3-01


class RecordedCrowd:
    """Records each life of each robot from its first input on: `folder/tb3-01/tb3-01-00001.mcap`.

    `active`: by robot, the count of inputs after which protection was active. `lives`: by robot.
    """

    def __init__(self, folder: Path, apart: float) -> None:
        self.active: dict[str, int] = {}
        self.lives: dict[str, int] = {}
        self._folder, self._apart = folder, apart
        self.recorders: dict[tuple[str, str], FileRecorder] = {}  # by robot and instance

    def take(self, robot: Robot, input: Input, now: float) -> Actions | None:
        """Record an input of a robot, and step the robot."""
        instance = robot._lifecycle.identity.instance
        if (robot.id, instance) not in self.recorders:
            self._begin(robot, instance, now)
        recorder = self.recorders[robot.id, instance]
        actions = recorder.step(robot, input, now)
        self.active[robot.id] += robot.decision.is_active
        if type(input) is NeighborsInput and robot.id != "tb3-01":  # some times a second
            answered = now - 0.001 - self._apart * (int(robot.id[-2:]) - 1)
            pair = "tb3-01", clock_of("tb3-01"), now - ROUND_TRIP, answered, now
            recorder.add(frames.ClockEntry(now, *pair))
        return actions

    def _begin(self, robot: Robot, instance: str, now: float) -> None:
        recorder = FileRecorder(self._folder / robot.id)
        about = self._head(robot, now).texts()
        folder = str(self._folder / robot.id)
        begin = frames.Begin(now, folder, robot.id, about, WALL + now, FileLimits())
        recorder._converter, recorder.began, recorder._is_memory_due = Converter(begin), now, True
        self.recorders[robot.id, instance] = recorder
        self.lives[robot.id] = self.lives.get(robot.id, 0) + 1
        self.active.setdefault(robot.id, 0)

    def _head(self, robot: Robot, now: float) -> RecordingHead:
        head = head_at(cast("RobotHarness", SimpleNamespace(robot=robot, now=now)))
        facts = {"version": version("swarmd"), "kernels": describe_kernels()}
        setup = structs.replace(head.identity.setup, **facts)  # a robot in lockstep has none
        identity = structs.replace(head.identity, setup=setup)
        return structs.replace(head, clock=clock_of(robot.id), identity=identity)

    def finish(self) -> None:
        """Finish all files."""
        for recorder in self.recorders.values():
            recorder.finish()


def clock_of(robot: str) -> str:
    """The id of a robot's clock."""
    return f"clock of {robot}"


def recorded_crowd(
    folder: Path,
    scenario: dict[str, Any],
    seed: int,
    seconds: float,
    *,
    uptime: float,
    apart: float = 0.0,
) -> RecordedCrowd:
    """Run and record a crowd; `uptime` and `apart` as in `clocked_crowd`."""
    recorded = RecordedCrowd(folder, apart)
    take, whole = recorded.take, scenario_of(scenario)
    with clocked_crowd(whole, seed, take, uptime=uptime, apart=apart) as run:
        run.advance(seconds)
    recorded.finish()
    return recorded
