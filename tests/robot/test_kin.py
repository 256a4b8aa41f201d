"""A robot tells its motion, and names its peers, while a pattern needs their places."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from dataclasses import replace as changed

import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.events import (
    Input,
    KinInput,
    NeighborsInput,
    PeersInput,
    PlaceInput,
    PoseInput,
    decode_input,
    encode_input,
)
from swarmd.core.kin_message import KinMessage
from swarmd.core.values import Inputs, Neighbor, Outputs, PeerPlace, Pose, SharedPose, Twist
from swarmd.kit.behavior import Pattern
from swarmd.kit.params import Params
from swarmd.robot import memory
from swarmd.robot.actions import Actions
from swarmd.robot.protection.compatibility import body_of
from swarmd.robot.robot import Robot
from swarmd.robot.sensors import _is_partial
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import Disc, scan_of
from tests.support.robot_harness import RobotHarness


class _Params(Params, frozen=True):
    """None."""


class Turns(Pattern[_Params]):
    """Drives a circle of 0.5 m."""

    params_type = _Params

    def step(self, inputs: Inputs) -> Outputs:
        return Outputs(Twist(0.15, 0.3))


class Seeks(Turns):
    """The same, with the places of peers."""

    needs = frozenset({"scan", "neighbors.bearing"})


def asks_for(twist: Twist) -> type[Pattern[_Params]]:
    """A pattern that needs the places of peers and asks for one motion alone."""

    class Asks(Seeks):
        def step(self, inputs: Inputs) -> Outputs:
            return Outputs(twist)

    return Asks


@dataclass
class Story:
    """A Waffle Pi among a peer that drives a circle, too, and one pillar.

    `told`, `inputs`: the messages of the robot, and the bytes of its inputs, with their times.
    """

    platform: str = "waffle_pi"
    is_seen: bool = True  # the peer tells to see the robot
    patterns: Mapping[str, type[Pattern[_Params]]] = field(
        default_factory=lambda: {"turns": Turns, "seeks": Seeks}
    )
    told: list[tuple[float, KinMessage]] = field(default_factory=list)
    inputs: list[tuple[float, bytes]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.harness = RobotHarness(self.platform, self.patterns, take=self._take)
        noise = np.random.default_rng(1)
        self.harness.scans = lambda seq, now: replace(
            scan_of(self.harness.platform, self.discs(now), seq=seq, noise=0.005, rng=noise),
            stamp=now,
        )

    def _take(self, robot: Robot, input: Input, now: float) -> Actions | None:
        self.inputs.append((now, encode_input(input)))
        actions = robot.step(input, now)
        if actions is not None and actions.kin_message is not None:
            self.told.append((now, actions.kin_message))
        return actions

    def discs(self, now: float) -> list[Disc]:
        """The peer's middle and the pillar, in the base frame."""
        pose = self.harness.pose
        seen = [(*self.peer(now)[:2], 0.15), (1.6, -0.9, 0.15)]
        c, s = math.cos(pose.yaw), math.sin(pose.yaw)
        return [
            Disc(c * (x - pose.x) + s * (y - pose.y), c * (y - pose.y) - s * (x - pose.x), radius)
            for x, y, radius in seen
        ]

    def peer(self, now: float) -> tuple[float, float, float]:
        """The pose of the peer in the odometry's frame of the robot."""
        angle = 0.4 * (now - 1000.0)
        return 1.2 + 0.4 * math.cos(angle), 1.2 + 0.4 * math.sin(angle), angle + math.pi / 2

    def run(self, seconds: float, *, asks: bool = False) -> None:
        """Let time pass, in which the peer tells its motion by a clock of its own."""
        harness = self.harness
        for _ in range(round(seconds / 0.2)):
            harness.step(NeighborsInput((Neighbor("b", 0.0), Neighbor("c", 0.0))))
            harness.odometry = harness.twist
            harness.advance(0.2)
            x, y, yaw = self.peer(harness.now)
            own = harness.pose  # its middle is 5.5 cm behind the axle
            ox = own.x - 0.0555 * math.cos(own.yaw) - x
            oy = own.y - 0.0555 * math.sin(own.yaw) - y
            bearing = math.remainder(math.atan2(oy, ox) - yaw, math.tau)
            objects = struct.pack(">Hh", round(1000 * math.hypot(ox, oy)), round(1000 * bearing))
            if not self.is_seen:
                objects = b""
            turn = round(1000 * math.remainder(yaw, math.tau))
            stamp = round(1000 * harness.now) - 900_000
            told = KinMessage(1, stamp, round(1000 * x), round(1000 * y), turn, objects, asks)
            harness.step(KinInput("b", told))

    def neighbors(self) -> dict[str, Neighbor]:
        """What the pattern gets."""
        sensors = self.harness.robot._sensors
        return {one.id: one for one in sensors.neighbors(self.harness.now)}


def test_a_robot_whose_pattern_needs_no_places_tells_and_names_nothing() -> None:
    story = Story()
    story.harness.advance(1.0)
    story.harness.applied("run", pattern="turns")
    story.run(12.0)
    assert story.told == []
    assert story.neighbors()["b"].distance is None


@pytest.mark.parametrize(
    ("platform", "twist"),
    [
        ("waffle_pi", Twist(0.1)),
        ("waffle_pi", Twist(0.0, 0.3)),
        ("rosbot_xl", Twist(0.0, 0.0, 0.1)),
    ],
    ids=["straight on", "turning in place", "sideways"],
)
def test_a_message_tells_for_how_long_the_base_has_had_the_command_zero(
    platform: str, twist: Twist
) -> None:
    story = Story(platform, patterns={"asks": asks_for(twist), "stands": asks_for(Twist())})
    story.harness.advance(1.0)
    story.harness.applied("run", pattern="stands")
    story.run(4.0)
    assert 3000 <= story.told[-1][1].stood <= 4200  # ms; the first scan comes 0.2 s later at most
    story.harness.applied("run", pattern="asks")
    story.run(3.0)
    assert story.told[-1][1].stood == 0
    story.harness.applied("run", pattern="stands")
    story.run(4.0)
    assert 1000 <= story.told[-1][1].stood <= 4000


def test_a_pattern_that_needs_places_gets_them_of_the_peer_that_is_named() -> None:
    story = Story()
    story.harness.advance(1.0)
    story.harness.applied("run", pattern="seeks")
    story.run(20.0)
    assert all(told.asks for _, told in story.told)
    gaps = np.diff([now for now, _ in story.told])  # it stands until the first command
    assert np.median(gaps) == pytest.approx(0.2)
    found, pose = story.neighbors(), story.harness.pose
    x, y, yaw = story.peer(story.harness.now)
    peer = found["b"]
    assert peer.distance == pytest.approx(math.hypot(x - pose.x, y - pose.y), abs=0.1)
    assert peer.bearing == pytest.approx(
        math.remainder(math.atan2(y - pose.y, x - pose.x) - pose.yaw, math.tau), abs=0.1
    )
    assert peer.heading == pytest.approx(math.remainder(yaw - pose.yaw, math.tau), abs=0.2)
    assert peer.error is not None
    assert 0.0 < peer.error < 0.2
    assert peer.age < 0.4
    assert found["c"].distance is None
    status, tracks = story.harness.status, story.harness.robot.tracks(story.harness.now)
    assert [line.partition(" ")[0] for line in status.places] == ["b"]
    assert tracks is not None
    near = {name for name in (track.name for track in tracks.tracks) if name is not None}
    assert near == {"b", ""}  # the pillar is no robot


@pytest.mark.parametrize(("scan_plane", "faults"), [(0.131, [("b", "doubted")]), (0.3, [])])
def test_a_peer_whose_lidar_looks_over_a_robot_is_not_doubted(
    scan_plane: float, faults: list[tuple[str, str]]
) -> None:
    """The top of a Waffle Pi is at 0.141 m."""
    story = Story(is_seen=False)
    body = replace(body_of(story.harness.platform), scan_plane=scan_plane)
    story.harness.advance(1.0)
    story.harness.step(PeersInput({"b": body}))
    story.run(60.0, asks=True)
    assert [(one.robot, one.kind) for one in story.harness.status.peer_faults] == faults


def test_a_robot_tells_whether_its_lidar_leaves_out_directions() -> None:
    spec = load_platform("waffle_pi").scan
    assert not _is_partial(spec)
    assert not _is_partial(changed(spec, mask=((-0.1, 0.1),)))
    assert _is_partial(changed(spec, mask=((-0.3, 0.3),)))
    assert _is_partial(changed(spec, bearings=np.radians(np.arange(-120.0, 121.0))))
    assert _is_partial(changed(spec, range_max=1.5))
    story = Story()
    story.harness.advance(1.0)
    story.run(2.0, asks=True)
    assert [told.is_partial for _, told in story.told] == [False] * len(story.told) != []


def test_a_robot_tells_while_a_peer_asks_and_for_five_seconds_after() -> None:
    story = Story()
    story.harness.advance(1.0)
    story.run(2.0)
    assert story.told == []
    story.run(4.0, asks=True)
    assert len(story.told) >= 3  # at rest once a second
    assert not any(told.asks for _, told in story.told)
    ended = story.harness.now
    story.run(8.0)
    assert ended + 4.0 <= story.told[-1][0] <= ended + 5.5
    assert story.harness.robot._sensors.kin is None


def test_a_shared_frame_and_hardware_precede_kin() -> None:
    story = Story()
    story.harness.advance(1.0)
    story.harness.applied("run", pattern="seeks")
    story.run(20.0)
    harness = story.harness
    assert story.neighbors()["b"].distance is not None
    harness.odometry = Twist(0.0, 0.0)
    for _ in range(5):
        harness.step(PoseInput(SharedPose(harness.now, Pose(), 0.01, 0.01, "hall")))
        harness.step(PlaceInput(PeerPlace("b", "hall", 3.0, 0.0, 0.02, 0.0, 1.0)))
        harness.advance(0.05)
    shared = story.neighbors()["b"]
    assert (shared.distance, shared.bearing, shared.heading) == (3.0, 0.0, 1.0)
    harness.step(NeighborsInput((Neighbor("b", 0.0, 2.0, 0.5),)))
    measured = story.neighbors()["b"]
    assert (measured.distance, measured.bearing, measured.heading) == (2.0, 0.5, 1.0)
    harness.advance(1.5)  # the shared frame is too old
    harness.step(NeighborsInput((Neighbor("b", 0.0, 2.0, 0.5),)))
    measured = story.neighbors()["b"]
    assert (measured.distance, measured.bearing) == (2.0, 0.5)
    assert measured.heading != 1.0


def test_a_robot_whose_sensors_show_no_robot_runs_no_kin() -> None:
    story = Story("thymio")
    story.harness.advance(1.0)
    story.run(2.0, asks=True)
    assert story.harness.robot._sensors.kin is None


def test_a_recalled_robot_goes_on_with_its_names() -> None:
    story = Story()
    story.harness.advance(1.0)
    story.harness.applied("run", pattern="seeks")
    story.run(20.0)
    robot, now = story.harness.robot, story.harness.now
    assert story.neighbors()["b"].distance is not None
    other = memory.recall(memory.remember(robot), robot.identity.setup)
    assert other._sensors.neighbors(now) == robot._sensors.neighbors(now)
    told = KinInput("b", KinMessage(1, round(1000 * now) - 899_800, 0, 0, 0))
    for one in (robot, other):
        one.step(told, now + 0.2)
    assert other._sensors.neighbors(now + 0.3) == robot._sensors.neighbors(now + 0.3)


def test_a_robot_that_gets_a_recording_names_the_same_peers() -> None:
    story = Story()
    story.harness.advance(1.0)
    story.harness.applied("run", pattern="seeks")
    story.run(15.0)
    other = RobotHarness("waffle_pi").robot
    for now, data in story.inputs:
        other.step(decode_input(data), now)
    known = story.neighbors()
    assert known["b"].distance is not None
    assert {one.id: one for one in other._sensors.neighbors(story.harness.now)} == known
