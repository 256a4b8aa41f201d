"""Openings and right of way: what is seen, who waits, who backs out, and what never changes."""

from __future__ import annotations

import numpy as np
import pytest

from swarmd.core.values import ZERO, Array, Limits, Odometry, Pose, Scan, Twist
from swarmd.protection.decision import DecisionContext, WayState
from swarmd.protection.recovery import Clearance
from swarmd.protection.right_of_way import RightOfWay
from swarmd.protection.tracks import Surroundings, Track

BASE, ROOM = Limits(0.22, 2.84), Clearance(0.5, 0.18, 0.09)
AHEAD = Twist(0.22)
BEARINGS = np.radians(np.arange(-180.0, 180.0))
HALF = 0.18  # m, of a door at x = 0; the wall reaches 2 m to each side
FAR = 3.0  # m to whatever is behind
NO_POINTS = np.empty((0, 2))


def scan(pose: Pose, depth: float = 0.0, ages: Array | None = None) -> Scan:
    """What a lidar sees of a wall at x = 0 with a door, or a corridor, in its middle."""
    angles = BEARINGS + pose.yaw
    with np.errstate(divide="ignore"):
        ranges = -pose.x / np.cos(angles)
        beside = (np.copysign(HALF, np.sin(angles)) - pose.y) / np.sin(angles)
    y = pose.y + ranges * np.sin(angles)
    x = pose.x + beside * np.cos(angles)
    is_wall = (ranges > 0.0) & (np.abs(y) > HALF) & (np.abs(y) < 2.0)
    seen = np.where(is_wall, np.minimum(ranges, FAR), FAR)
    is_side = (x > 0.0) & (x < depth)
    seen = np.where(is_side, np.minimum(beside, seen), seen)
    return Scan(0, 0.0, seen, BEARINGS, 0.1, 3.5, ages=ages)


class Ride:
    """A robot that stands at places one after the other, each for two scans."""

    def __init__(self, depth: float = 0.0, ages: Array | None = None) -> None:
        self.depth, self.ages = depth, ages
        self.way = RightOfWay(ROOM, BASE, "one")
        self.now = 0.0
        self.context = DecisionContext(0.0)

    def state(self) -> WayState:
        return self.way.state

    def at(
        self,
        pose: Pose,
        *tracks: Track,
        seconds: float = 1.0,
        requested: Twist = AHEAD,
        points: Array = NO_POINTS,
    ) -> Twist:
        """The request after some seconds at a place, among tracks in the base frame."""
        asked = requested
        for tick in range(round(seconds * 10)):
            self.now += 0.1
            odometry = Odometry(self.now, pose, ZERO)
            self.context = context = DecisionContext(self.now, 0.0, odometry, 0.0)
            if tick % 2 == 0:
                self.way.observe(scan(pose, self.depth, self.ages), (0.0, 0.0), context)
            around = Surroundings(tracks, np.empty((0, 2)))
            asked = self.way.command(
                requested, context, around, lambda twist: twist, lambda: points
            )
        return asked


def track(id: int, x: float, y: float = 0.0) -> Track:
    return Track(id, x, y, 0.0, 0.0, 0.1, 0.05)


def near(x: float, y: float = 0.0) -> Pose:
    return Pose(x, y, 0.0)


def test_without_an_opening_on_the_way_a_request_passes_unchanged() -> None:
    ride = Ride()
    away = Pose(-0.8, 0.0, np.pi)
    assert ride.at(away) is AHEAD
    assert ride.state() is WayState.NONE
    assert ride.way.passed(ride.context) is None


def test_a_free_opening_is_driven_through() -> None:
    ride = Ride()
    ride.at(near(-1.0))
    assert ride.state() is WayState.APPROACH
    asked = ride.at(near(-0.1))
    assert ride.state() is WayState.IN
    assert asked.linear == pytest.approx(0.22)


def test_a_robot_that_comes_upon_an_opening_while_in_it_drives_on() -> None:
    ride = Ride()
    asked = ride.at(near(-0.1))
    assert ride.state() is WayState.IN
    assert asked.linear == pytest.approx(0.22)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_request_into_a_wall_leads_to_the_opening_beside(side: float) -> None:
    ride = Ride()
    asked = ride.at(near(-0.4, side * 0.8))
    assert ride.state() is WayState.GO
    assert asked.angular * side < 0.0


def test_a_robot_goes_aside_and_waits_while_another_comes_out() -> None:
    ride = Ride()
    ride.at(near(-1.0))
    ride.at(near(-1.0), track(1, 1.0), seconds=2.0)
    assert ride.state() is WayState.ASIDE
    asked = ride.at(near(-1.0, 0.9), track(1, 1.0, -0.9))
    assert (asked.linear, asked.angular < 0.0) == (0.0, True)  # turns to where it will line up
    assert ride.at(Pose(-1.0, 0.9, -1.0), track(1, 1.2, 0.5)) is ZERO
    passed = ride.way.passed(ride.context)
    assert passed is not None
    assert passed.text == "gives way at an opening, 1.3 m"
    ride.at(near(-1.0, 0.9), seconds=9.0)
    assert ride.state() is WayState.GO


@pytest.mark.parametrize(
    ("there", "state", "text"),
    [
        (0.15, WayState.BACK, "backs out of an opening"),
        (0.9, WayState.IN, "passes an opening"),
    ],
)
def test_of_two_that_meet_the_deeper_one_goes_on(there: float, state: WayState, text: str) -> None:
    ride = Ride()
    ride.at(near(-0.6))
    own = 0.1 if state is WayState.IN else -0.2
    asked = ride.at(near(own), track(1, there - own), seconds=4.0)
    assert ride.state() is state
    assert (asked.linear < 0.0) == (state is WayState.BACK)
    passed = ride.way.passed(ride.context)
    assert passed is not None
    assert passed.text == text


def test_a_robot_follows_another_that_goes_in_at_a_distance() -> None:
    ride = Ride()
    ride.at(near(-0.5), track(1, 0.0), seconds=2.0)
    assert ride.at(near(-0.3), track(1, 0.2), seconds=1.0) is ZERO
    assert ride.at(near(-0.3), track(1, 0.35), seconds=1.0).linear > 0.0


def test_the_end_of_a_wall_that_counts_as_a_track_is_no_traffic() -> None:
    ride = Ride()
    ride.at(near(-1.0))
    ride.at(near(-1.0), track(1, 0.97, 0.33), seconds=4.0)
    assert ride.state() is WayState.APPROACH


@pytest.mark.parametrize(
    ("seen", "state"), [((), WayState.WAIT), ((track(1, 0.4, -2.0),), WayState.GO)]
)
def test_a_robot_enters_sooner_if_it_sees_that_the_last_robot_has_come_out(
    seen: tuple[Track, ...], state: WayState
) -> None:
    ride = Ride()
    ride.at(near(-1.0))
    ride.at(near(-1.0), track(1, 1.0), seconds=2.0)
    ride.at(near(-1.0, 0.9), track(1, 1.0, -0.9))
    ride.at(near(-1.0, 0.9), *seen, seconds=4.0)
    assert ride.state() is state


@pytest.mark.parametrize(("comes_out", "state"), [(False, WayState.WAIT), (True, WayState.GO)])
def test_a_robot_that_has_passed_lets_those_pass_that_wait_on_its_side(
    comes_out: bool, state: WayState
) -> None:
    ride, place = Ride(), near(-1.0, 0.9)
    ride.at(near(-1.0))
    ride.way._passed_at = ride.now
    if comes_out:
        ride.at(place, track(1, 1.0, -0.9), seconds=2.0)
    waiting = track(1, 0.3, -1.8)
    ride.at(place, waiting, seconds=30.0)
    assert ride.state() is state
    ride.at(place, waiting, seconds=65.0)
    assert ride.state() is WayState.GO


def test_a_robot_waits_where_no_other_robot_waits() -> None:
    ride = Ride()
    turned, turns = Pose(-0.5, -0.2, -2.1), Twist(0.0, 2.84)
    for pose in (near(-0.5), Pose(-0.5, -0.2, -1.0)):
        ride.at(pose, requested=turns if pose.yaw else AHEAD)
    comes_out, waits = track(1, -0.43, 0.33), track(2, 0.59, 0.23)  # the second in the first place
    asked = [
        ride.at(turned, comes_out, *waiting, seconds=2.0, requested=turns)
        for waiting in ((), (waits,))
    ]
    assert ride.state() is WayState.ASIDE
    assert asked[0].angular > 0.0 > asked[1].angular


def test_a_robot_clears_the_way_of_another_that_does_not_go_on() -> None:
    ride = Ride()
    ride.at(near(-0.5), track(1, 0.0), seconds=2.0)
    assert ride.at(near(-0.3), track(1, 0.2), seconds=8.0) is ZERO
    ride.at(near(-0.3), track(1, 0.2), seconds=4.0)
    assert ride.state() is WayState.ASIDE


def test_a_robot_in_an_opening_goes_on_while_another_is_before_its_other_side() -> None:
    ride = Ride()
    ride.at(near(-0.6))
    ride.way._has_priority, ride.way._drawn_until = False, np.inf  # chance is against the robot
    ride.at(near(-0.2), track(1, 0.5), seconds=4.0)
    assert ride.state() is WayState.IN


def test_a_robot_asks_for_a_speed_at_which_protection_does_not_turn_it_aside() -> None:
    def allows(asked: Twist) -> Twist:
        return asked if asked.linear < 0.15 else Twist(asked.linear, -1.0)

    asked = Ride().way._fastest(AHEAD, allows)
    assert asked.linear == pytest.approx(0.14)


def test_a_robot_beside_the_middle_of_an_opening_lines_up_again() -> None:
    ride = Ride()
    ride.at(near(-0.5))
    asked = ride.at(near(-0.2, 0.08))
    assert ride.state() is WayState.GO
    assert asked.linear < 0.0  # backs out as it has come


@pytest.mark.parametrize("off", [0.03, -0.03])
def test_a_robot_steers_to_the_middle_that_the_posts_show(off: float) -> None:
    ride = Ride()
    ride.at(near(-0.5))
    posts = np.array(((0.3, off + HALF), (0.3, off - HALF)))
    asked = ride.at(near(-0.3), points=posts)
    assert asked.angular * off > 0.0


def test_an_opening_whose_posts_are_elsewhere_is_looked_for_anew() -> None:
    ride = Ride()
    ride.at(near(-0.5))
    posts = np.array(((0.5, 0.15 + HALF), (0.5, 0.15 - HALF)))
    assert ride.at(near(-0.5), points=posts, seconds=0.1) is ZERO
    assert ride.state() is WayState.NONE
    ride.at(near(-0.5))
    assert ride.state() is WayState.LINE


def test_a_robot_that_has_passed_lets_others_go_first() -> None:
    ride = Ride()
    ride.at(near(-1.0))
    ride.way._passed_at = ride.now - 20.0
    ride.at(near(-1.0), track(1, 1.0), seconds=2.0)
    ride.at(near(-1.0, 0.9), track(1, 1.0, -0.9))
    ride.at(near(-1.0, 0.9), seconds=9.0)
    assert ride.state() is WayState.WAIT
    ride.at(near(-1.0, 0.9), seconds=9.0)
    assert ride.state() is WayState.GO


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_robot_in_a_corridor_keeps_away_from_the_side_that_was_seen_earlier(side: float) -> None:
    ride = Ride(1.0, np.where(side * BEARINGS < 0.0, 0.2, 0.0))
    ride.at(near(-0.8))
    ride.at(near(-0.3))
    asked = ride.at(near(0.2))
    assert ride.state() is WayState.IN
    assert asked.angular * side > 0.0


def test_a_robot_whose_request_leads_away_is_free_again() -> None:
    ride = Ride()
    ride.at(near(-1.0))
    ride.at(near(-1.0), track(1, 1.0), seconds=2.0)
    back = Twist(0.0, 2.84)
    for yaw in (0.0, 1.5, 3.0):
        ride.at(Pose(-1.0, 0.0, yaw), requested=back)
    assert ride.at(Pose(-1.0, 0.0, 3.1)) is AHEAD


def test_a_jump_of_odometry_forgets_all_openings() -> None:
    ride = Ride()
    ride.at(near(-1.0))
    assert ride.at(near(40.0), seconds=0.1) is AHEAD
    assert ride.at(near(-1.0), seconds=0.1) is AHEAD


def test_equal_inputs_give_equal_requests() -> None:
    rides = [Ride(), Ride()]
    asked = [
        [ride.at(near(-1.0 + 0.1 * i), track(1, 0.7), seconds=1.0) for i in range(8)]
        for ride in rides
    ]
    assert asked[0] == asked[1]


def test_a_jump_that_nothing_asked_through_forgets_all_openings() -> None:
    ride = Ride()
    ride.at(near(-1.0))
    for seconds, place in ((0.1, -1.0), (0.1, -4.0), (60.0, -4.0)):  # the base starts anew
        ride.now += seconds
        ride.way.on_odometry(Odometry(ride.now, near(place), ZERO))
    ride.now += 0.1
    odometry = Odometry(ride.now, near(-1.0), ZERO)
    around = Surroundings((), np.empty((0, 2)))
    context = DecisionContext(ride.now, 0.0, odometry, 0.0)
    asked = ride.way.command(AHEAD, context, around, lambda twist: twist, lambda: np.empty((0, 2)))
    assert asked is AHEAD
    assert ride.state() is WayState.NONE


def test_openings_that_were_seen_once_do_not_push_out_a_known_one() -> None:
    ride = Ride()
    ride.at(near(-1.0))
    ride.way.reset()
    for k in range(1, 12):  # each at another place, by a step of odometry
        ride.way.observe(
            scan(near(-1.0)),
            (0.0, 0.0),
            DecisionContext(ride.now, 0.0, Odometry(ride.now, Pose(-1.0, 3.0 * k, 0.0), ZERO), 0.0),
        )
    ride.at(near(-1.0), seconds=0.1)
    assert ride.state() is WayState.APPROACH


def test_a_door_is_found_beside_many_ends_of_walls() -> None:
    ride, pose = Ride(), near(-0.6)
    seen = scan(pose)
    behind = np.abs(BEARINGS) > 1.7
    seen.ranges[behind] = np.where(np.arange(behind.sum()) % 2, 2.4, 1.9)
    for _ in range(2):
        odometry = Odometry(ride.now, pose, ZERO)
        ride.way.observe(seen, (0.0, 0.0), DecisionContext(ride.now, 0.0, odometry, 0.0))
    around = Surroundings((), np.empty((0, 2)))
    context = DecisionContext(ride.now, 0.0, Odometry(ride.now, pose, ZERO), 0.0)
    ride.way.command(AHEAD, context, around, lambda twist: twist, lambda: np.empty((0, 2)))
    assert ride.state() is WayState.APPROACH


def test_tracks_that_have_ended_are_forgotten_at_a_door() -> None:
    ride = Ride()
    ride.at(near(-1.0))
    for id in range(1, 40):
        ride.at(near(-1.0), track(id, 1.6), seconds=3.5)
    assert len(ride.way._sides) <= 1
