"""A live world with an emulated driver, a manual clock and a fake emulator."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pytest

from swarmd.core.values import Odometry, Platform, Scan, Twist, Value
from swarmd.driver_api.emulator import OnCommand
from swarmd.settings.platforms import load_platform
from swarmd.sim.live.body_transport import EmulatorTransport
from swarmd.sim.live.link import WorldLink
from swarmd.sim.live.realtime import RealTimeWorld
from swarmd.sim.live.recording import LiveRecorder, RecorderSettings
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.realism import IDEAL
from swarmd.sim.world.world import World

IDS = ("a", "b")
PLATFORM = load_platform("burger")


class Side:
    """A fake emulator that records what it publishes and sends given commands."""

    def __init__(
        self, *, robots: Mapping[str, Platform], endpoint: str, on_command: OnCommand
    ) -> None:
        self.driver_options: Mapping[str, Value] = {"endpoint": endpoint}
        self.dropped = 3
        self.command = on_command
        self.scans: list[tuple[str, Scan]] = []
        self.poses: list[tuple[str, Odometry]] = []

    def scan(self, robot: str, scan: Scan) -> None:
        self.scans.append((robot, scan))

    def odometry(self, robot: str, odometry: Odometry) -> None:
        self.poses.append((robot, odometry))

    def close(self) -> None:
        pass


class Stage:
    """A live world of two emulated Burgers with a manual clock."""

    def __init__(self, command_timeouts: Sequence[float]) -> None:
        self.now = 100.0
        robots = dict.fromkeys(IDS, PLATFORM)
        starts = np.array([[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
        self.world = World(robots, Arena(6.0, 6.0, ()), starts, realism=IDEAL)
        self.link = WorldLink("s", IDS, "tcp/127.0.0.1:0", clock=lambda: self.now)
        transport = EmulatorTransport(Side, robots, "here", clock=lambda: self.now)
        assert isinstance(transport.side, Side)
        self.side: Side = transport.side
        self.server = RealTimeWorld(
            self.world,
            self.link,
            LiveRecorder(self.world, RecorderSettings()),
            emulated=transport,
            command_timeouts=command_timeouts,
            clock=lambda: self.now,
        )

    def pass_time(self, seconds: float) -> None:
        for _ in range(round(seconds / self.world.dt)):
            self.now += self.world.dt
            self.server.run_due()

    def speeds(self) -> list[float]:
        return [float(speed) for speed in self.world.twists()[:, 0]]


@pytest.fixture
def stage() -> Iterator[Stage]:
    one = Stage((0.5, math.inf))
    yield one
    one.link.close()


def test_every_robot_publishes_its_sensors_at_their_rates(stage: Stage) -> None:
    stage.pass_time(2.0)
    for robot in IDS:
        assert len([r for r, _ in stage.side.scans if r == robot]) in (9, 10)
        assert len([r for r, _ in stage.side.poses if r == robot]) in (39, 40)
    assert all(len(scan.ranges) == 360 for _, scan in stage.side.scans)


def test_an_emulated_base_stops_by_its_own_timeout_or_never(stage: Stage) -> None:
    for robot in IDS:
        stage.side.command(robot, Twist(0.2))
    stage.pass_time(0.45)
    assert stage.speeds() == pytest.approx([0.2, 0.2])
    stage.pass_time(1.0)
    assert stage.speeds() == pytest.approx([0.0, 0.2], abs=1e-6)
    stage.side.command("b", Twist())
    stage.pass_time(0.5)
    assert stage.speeds() == pytest.approx([0.0, 0.0], abs=1e-6)


def test_no_command_is_in_force_before_the_first(stage: Stage) -> None:
    stage.pass_time(0.2)
    assert stage.server._state().commanded == (False, False)
    stage.side.command("b", Twist(0.1))
    stage.pass_time(3.0)
    assert stage.server._state().commanded == (False, True)
    assert stage.server._state().dropped == 3


def test_only_the_newest_command_counts(stage: Stage) -> None:
    for speed in (0.1, 0.05, 0.2):
        stage.side.command("a", Twist(speed))
    stage.pass_time(0.3)
    assert stage.speeds() == pytest.approx([0.2, 0.0], abs=1e-6)
