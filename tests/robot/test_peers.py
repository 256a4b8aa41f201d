"""Peers that a robot does not see, or that are faster than it assumes: holds, grants, places."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from msgspec import structs

from swarmd.core.events import NeighborsInput, NoteInput, PeersInput
from swarmd.core.messages import Body, Reason, State
from swarmd.core.values import (
    MAX_TOLD_DISTANCE,
    Limits,
    Neighbor,
    PeerPlace,
    Platform,
    Pose,
    SharedPose,
    Twist,
)
from swarmd.robot.message_limits import EVENT_BURST, EVENT_PERIOD
from swarmd.robot.own_pose import OwnPose
from swarmd.robot.peers import (
    ANGLE_ERROR,
    DISTANCE_ERROR,
    DISTANCE_SHARE,
    TOLD_TIMEOUT,
    Peers,
)
from swarmd.robot.protection.compatibility import ACCEPTS_NONE, Accepts, body_of
from swarmd.robot.timeouts import MAX_HOLD_TIME
from swarmd.settings.platforms import load_platform
from tests.support.filter_sim import under_barrier
from tests.support.platforms import with_mode
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS

BURGER, WAFFLE, JACKAL = (body_of(load_platform(n)) for n in ("burger", "waffle_pi", "jackal"))
ERROR = math.hypot(DISTANCE_ERROR + DISTANCE_SHARE * 2.0, ANGLE_ERROR * 2.0)  # at 2 m


def peers_of(platform: Platform, accepts: Accepts = ACCEPTS_NONE) -> Peers:
    return Peers(platform, accepts, OwnPose(platform.limits))


def peers(name: str, bodies: dict[str, Body | None], accepts: Accepts = ACCEPTS_NONE) -> Peers:
    made = peers_of(load_platform(name), accepts)
    made.on_peers(bodies)
    return made


def test_a_peer_holds_until_it_is_forgotten() -> None:
    robot = peers_of(load_platform("jackal"))
    assert not robot.holds(0.0)
    assert [found.robot for found in robot.on_peers({"b": BURGER, "j": JACKAL})] == ["b"]
    assert robot.holds(0.0)
    assert robot.on_peers({"b": BURGER, "j": JACKAL, "w": WAFFLE})[0].robot == "w"
    robot.on_peers({"j": JACKAL, "w": WAFFLE})
    assert robot.holds(1e6)
    assert robot.on_peers({"j": JACKAL}) == []
    assert not robot.holds(1e6)
    assert robot.hold_due_at() == math.inf


def test_a_told_peer_holds_once_its_place_is_too_old() -> None:
    robot = peers("jackal", {"b": BURGER})
    assert robot.on_neighbors((Neighbor("b", 0.25, 2.0, math.pi / 2),), 10.0)
    assert robot.hold_due_at() == 9.75 + TOLD_TIMEOUT
    assert not robot.holds(9.75 + TOLD_TIMEOUT)
    assert robot.holds(9.76 + TOLD_TIMEOUT)
    (told,) = robot.told(10.1)
    assert (told.x, told.y, told.age) == pytest.approx((0.0, 2.0, 0.35))
    assert told.radius == pytest.approx(BURGER.radius + ERROR)
    assert not any(found.holds for found in robot.findings(10.1))
    assert robot.told(9.76 + TOLD_TIMEOUT) == ()
    assert [found.holds for found in robot.findings(9.76 + TOLD_TIMEOUT)] == [True]
    assert not robot.on_neighbors((), 10.2) or robot.told(10.2)  # it is no neighbour any more
    assert robot.told(10.2)[0].age == pytest.approx(0.45)  # and its last place still counts
    robot.on_peers({})
    assert robot.told(10.2) == ()


def test_each_unseen_peer_must_be_told() -> None:
    robot = peers("jackal", {"b": BURGER, "c": BURGER})
    robot.on_neighbors((Neighbor("b", 0.0, 2.0, 0.0), Neighbor("c", 0.0)), 0.0)
    assert robot.holds(0.0)
    robot.on_neighbors((Neighbor("c", 0.0, 2.0, 0.0),), 0.5)
    assert not robot.holds(0.5)
    assert robot.hold_due_at() == TOLD_TIMEOUT


def test_places_that_are_not_finite_tell_nothing() -> None:
    robot = peers("jackal", {"b": BURGER})
    for distance, bearing in ((math.nan, 0.0), (1.0, math.inf), (None, 0.0), (1.0, None)):
        robot.on_neighbors((Neighbor("b", 0.0, distance, bearing),), 0.0)
        assert robot.holds(0.0)
    robot.on_neighbors((Neighbor("b", math.nan, 1.0, 0.0),), 0.0)
    assert robot.holds(0.0)


def test_what_is_seen_or_far_is_not_told() -> None:
    robot = peers("jackal", {"b": BURGER, "j": JACKAL})
    seen, far = Neighbor("j", 0.0, 2.0, 0.0), Neighbor("b", 0.0, 10.0, 0.0)
    robot.on_neighbors((seen, far), 0.0)
    assert robot.told(0.0) == ()
    assert not robot.holds(0.0)  # its place is known all the same


@pytest.mark.parametrize("source", ["sensed", "located"])
def test_a_peer_farther_away_than_any_is_not_told(source: str) -> None:
    robot = peers("jackal", {"b": BURGER})
    for number in range(9):
        robot.own_pose.take(SharedPose(0.1 * number, Pose(), 0.0, 0.0, "map"), None, 0.1 * number)

    def tell(distance: float) -> None:
        if source == "sensed":
            robot.on_neighbors((Neighbor("b", 0.0, distance, 0.0),), 1.0)
        else:
            robot.on_place(PeerPlace("b", "map", distance, 0.0, 0.0, 0.1), 1.0)

    for distance in (1e9, 1.001 * MAX_TOLD_DISTANCE, -1.001 * MAX_TOLD_DISTANCE):
        tell(distance)
        assert robot.holds(1.0)
        assert robot.told(1.0) == ()
    tell(0.999 * MAX_TOLD_DISTANCE)
    assert not robot.holds(1.0)


def located(robot: Peers, now: float, *, x: float, age: float) -> bool:
    """Tell the place of peer b ahead in a shared frame; the own pose is at its origin."""
    for number in range(9):
        at = now - 0.02 * (8 - number)
        robot.own_pose.take(SharedPose(at, Pose(), 0.0, 0.0, "map"), Twist(), at)
    return robot.on_place(PeerPlace("b", "map", x, 0.0, 0.0, age), now)


@pytest.mark.parametrize("is_sensed_first", [True, False])
@pytest.mark.parametrize("age", [0.0, 0.4])
def test_a_place_of_one_source_replaces_none_of_the_other(
    age: float, is_sensed_first: bool
) -> None:
    robot = peers("jackal", {"b": BURGER})
    if is_sensed_first:
        robot.on_neighbors((Neighbor("b", 0.0, 1.0, 0.0),), 10.0)
    assert located(robot, 10.0, x=-1.0, age=age)
    if not is_sensed_first:
        robot.on_neighbors((Neighbor("b", age, 1.0, 0.0),), 10.0)
    assert sorted(told.x for told in robot.told(10.0)) == [-1.0, 1.0]


def test_the_newer_place_of_one_source_counts() -> None:
    robot = peers("jackal", {"b": BURGER})
    for age, distance in ((0.1, 1.0), (0.5, 2.0)):
        robot.on_neighbors((Neighbor("b", age, distance, 0.0),), 10.0)
        located(robot, 10.0, x=-distance, age=age)
    assert sorted(told.x for told in robot.told(10.0)) == [-1.0, 1.0]
    assert robot.hold_due_at() == 9.9 + TOLD_TIMEOUT
    robot.on_neighbors((Neighbor("b", 0.0, 1.2, 0.0),), 10.1)
    located(robot, 10.1, x=-1.2, age=0.0)
    assert sorted(told.x for told in robot.told(10.1)) == [-1.2, 1.2]


def test_a_place_of_either_source_ends_the_hold() -> None:
    robot = peers("jackal", {"b": BURGER})
    robot.on_neighbors((Neighbor("b", 0.6, 1.0, 0.0),), 10.0)
    located(robot, 10.0, x=1.0, age=0.1)
    assert robot.hold_due_at() == pytest.approx(9.9 + TOLD_TIMEOUT)
    assert [found.holds for found in robot.findings(10.5)] == [False]
    assert len(robot.told(10.5)) == 1


def test_the_distance_of_told_places_follows_from_the_speeds() -> None:
    """As far as the barrier can need it, and no farther than that by more than the robot."""
    slow = under_barrier(load_platform("jackal"), others_speed=0.2)
    fast = replace(slow, limits=Limits(2.0, 2.0))
    crowd = under_barrier(fast, others_speed=1.2)
    seen = []
    for platform in (slow, fast, crowd):
        robot = peers_of(platform)
        robot.on_peers({"b": BURGER})
        within = 0.0
        for step in range(1, 400):
            robot.on_neighbors((Neighbor("b", 0.0, 0.05 * step, 0.0),), float(step))
            within = 0.05 * step if robot.told(float(step)) else within
        seen.append(within)
    assert seen == sorted(seen)
    assert seen[0] < 3.0 < seen[1] < seen[2] - 2.0


def test_which_peers_may_miss_a_robot() -> None:
    """By the heights of the platforms: a Burger's lidar is above a Waffle Pi, a Jackal's too."""
    unknown = structs.replace(WAFFLE, scan_plane=None)
    bodies = {"b": BURGER, "j": JACKAL, "w": WAFFLE, "u": unknown, "n": None}
    assert peers("waffle_pi", bodies).missed_by == {"b", "j", "u"}
    assert peers("burger", bodies).missed_by == {"j", "u"}


def test_no_place_is_told_in_a_mode_that_uses_none() -> None:
    robot = peers_of(with_mode(load_platform("jackal"), "stop_zone"))
    robot.on_peers({"b": BURGER})
    robot.on_neighbors((Neighbor("b", 0.0, 0.5, 0.0),), 0.0)
    assert robot.told(0.0) == ()


def test_a_peer_that_the_lidar_sees_is_told_within_its_blind_zone() -> None:
    robot = peers("jackal", {"j": JACKAL})
    robot.on_neighbors((Neighbor("j", 0.0, 1.0, 0.0),), 0.0)
    assert [told.x for told in robot.told(0.1)] == [1.0]
    robot.on_neighbors((Neighbor("j", 0.0, 2.0, 0.0),), 1.0)
    assert robot.told(1.1) == ()
    burger = peers("burger", {"b": BURGER})  # nothing fits into its blind zone
    burger.on_neighbors((Neighbor("b", 0.0, 0.3, 0.0),), 0.0)
    assert burger.told(0.1) == ()


def test_an_accepted_peer_is_avoided_where_it_is_told() -> None:
    robot = peers("jackal", {"b": BURGER}, Accepts.of(["burger"], []))
    assert not robot.holds(0.0)
    robot.on_neighbors((Neighbor("b", 0.0, 1.0, 0.0),), 0.0)
    assert len(robot.told(0.0)) == 1


def test_a_faster_peer_holds_although_it_is_told() -> None:
    robot = peers("burger", {"j": JACKAL})
    robot.on_neighbors((Neighbor("j", 0.0, 2.0, 0.0),), 0.0)
    assert robot.holds(0.0)
    assert robot.told(0.0) == ()  # it is seen
    assert not peers("burger", {"j": JACKAL}, Accepts.of([], ["jackal"])).holds(0.0)


def test_mode_off_promises_nothing_and_holds_for_nobody() -> None:
    robot = peers_of(with_mode(load_platform("jackal"), "off"))
    robot.on_peers({"b": BURGER})
    assert not robot.holds(0.0)
    assert [found.kind for found in robot.findings(0.0)] == ["unseen"]


def running_jackal() -> RobotHarness:
    harness = RobotHarness("jackal", PATTERNS)
    harness.advance(1.0)
    harness.applied("run", pattern="forward")
    harness.advance(0.5)
    return harness


def test_a_run_beside_an_unseen_peer_is_held_and_ends() -> None:
    robot = running_jackal()
    assert robot.twist.linear > 0.0
    robot.step(PeersInput({"b": BURGER}))
    robot.advance(0.2)
    status = robot.status
    assert (status.state, status.reason) == (State.RUNNING, Reason.INCOMPATIBLE_PEER)
    assert robot.twist.is_zero
    assert status.body == JACKAL
    assert [(found.robot, found.kind, found.holds) for found in status.peers] == [
        ("b", "unseen", True)
    ]
    assert "peer b" in status.events[-1].text
    robot.advance(MAX_HOLD_TIME)
    assert (robot.status.state, robot.status.reason) == (State.STOPPED, Reason.INCOMPATIBLE_PEER)


def test_a_peer_whose_body_flaps_leaves_room_for_other_events() -> None:
    robot = running_jackal()
    robot.step(NoteInput("the driver was replaced"))
    for turn in range(40):
        faster = structs.replace(JACKAL, surface_speed=2.0 + turn % 2)
        robot.step(PeersInput({"j": faster}))
        robot.advance(0.5)
    texts = [event.text for event in robot.status.events]
    assert "the driver was replaced" in texts
    assert sum("is faster than assumed" in text for text in texts) == EVENT_BURST
    robot.advance(EVENT_PERIOD)
    robot.step(PeersInput({"j": faster}))
    assert robot.status.events[-1].text == "peers faster: 37 more events"


def test_many_false_names_are_few_events() -> None:
    robot = running_jackal()
    bodies: dict[str, Body | None] = {"b0": BURGER}
    before = len(robot.status.events)
    for number in range(1, 30):
        bodies = {**bodies, f"b{number}": BURGER}
        robot.step(PeersInput(bodies))
    assert len(robot.status.events) <= before + EVENT_BURST


def test_a_robot_whose_peer_is_no_longer_told_stops_in_that_tick() -> None:
    robot = running_jackal()
    robot.step(PeersInput({"b": BURGER}))
    robot.step(NeighborsInput((Neighbor("b", 0.0, 2.5, math.pi),)))
    told_until = robot.now + TOLD_TIMEOUT
    robot.advance(TOLD_TIMEOUT + 0.2)
    moving = [at for at, twist in robot.commands if not twist.is_zero]
    standing = [at for at, twist in robot.commands if twist.is_zero and at > moving[0]]
    assert told_until - 0.1 < max(moving) <= told_until
    assert told_until < min(standing) <= told_until + 0.051


PHASES = (0.05, 0.1, 0.15, 0.2)  # of ticks, steps and scans at which something changes


@pytest.mark.parametrize("phase", PHASES)
def test_a_robot_whose_peer_is_told_with_an_older_place_goes_on(phase: float) -> None:
    robot = running_jackal()
    robot.step(PeersInput({"b": BURGER}))
    robot.step(NeighborsInput((Neighbor("b", 0.0, 2.5, math.pi),)))
    robot.advance(phase)
    assert not robot.twist.is_zero
    robot.step(NeighborsInput((Neighbor("b", 5.0, 2.5, math.pi),)))
    robot.scans = lambda seq, now: None  # a scan looks at holds, too
    robot.advance(0.05)
    assert not robot.twist.is_zero


@pytest.mark.parametrize("phase", PHASES)
def test_a_robot_that_hears_of_a_faster_peer_stops_in_that_tick(phase: float) -> None:
    robot = running_jackal()
    robot.advance(phase)
    faster = structs.replace(JACKAL, surface_speed=3.0)
    robot.step(PeersInput({"j": faster}))
    robot.scans = lambda seq, now: None
    robot.advance(0.05)
    assert robot.status.reason is Reason.INCOMPATIBLE_PEER
    assert robot.twist.is_zero
