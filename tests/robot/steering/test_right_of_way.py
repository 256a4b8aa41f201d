"""Openings and right of way: what is seen, who waits, who backs out, and what never changes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pytest

from swarmd.core.avoided import WayState
from swarmd.core.values import ZERO, Array, Limits, Odometry, Pose, Scan, Twist
from swarmd.robot.protection.decision import Clearance, DecisionContext
from swarmd.robot.steering.right_of_way import RightOfWay
from swarmd.robot.steering.tracks import Surroundings, Track

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
        self.depth = depth
        self.ages = ages
        self.way = RightOfWay(ROOM, BASE, "one")
        self.now = 0.0
        self.context = DecisionContext(0.0)
        self.asked = ZERO

    def state(self) -> WayState:
        state: WayState = self.way.state
        return state

    def at(
        self,
        pose: Pose,
        *tracks: Track,
        seconds: float = 1.0,
        requested: Twist = AHEAD,
        points: Array = NO_POINTS,
        turns: float = 0.0,
    ) -> Twist:
        """The request after some seconds at a place, among tracks in the base frame.

        `turns` in rad/s is the turn that odometry tells.
        """
        asked = requested
        for tick in range(round(seconds * 10)):
            self.now += 0.1
            odometry = Odometry(self.now, pose, Twist(0.0, turns))
            self.context = context = DecisionContext(self.now, 0.0, odometry, 0.0)
            if tick % 2 == 0:
                self.way.observe(scan(pose, self.depth, self.ages), (0.0, 0.0), context)
            around = Surroundings(tracks, np.empty((0, 2)))
            asked = self.way.command(
                requested, context, around, lambda twist: twist, lambda: points
            )
        return asked


def track(id: int, x: float, y: float = 0.0) -> Track:
    return Track(id, x, y, 0.0, 0.0, 0.1)


def near(x: float, y: float = 0.0) -> Pose:
    return Pose(x, y, 0.0)


ALONE: Mapping[int, tuple[float, float]] = {}


class Step(NamedTuple):
    """What a robot does next: where it stands and for how long, and what is there."""

    x: float  # m, the place; the opening begins at x = 0
    y: float = 0.0
    yaw: float = 0.0  # rad
    there: Mapping[int, tuple[float, float]] = ALONE  # the place of each track by its id, m
    seconds: float = 0.3
    requested: Twist = AHEAD
    pause: float = 0.0  # s before, without a decision
    turns: float = 0.0  # rad/s by odometry
    passed: float | None = None  # s before now: when the robot passed an opening among others


def ride_through(*steps: Step, depth: float = 0.0) -> Ride:
    """A robot after some steps."""
    ride = Ride(depth)
    for step in steps:
        if step.passed is not None:
            ride.way._passed_at = ride.now - step.passed
        ride.now += step.pause
        c, s = math.cos(step.yaw), math.sin(step.yaw)
        tracks = [
            track(id, c * (x - step.x) + s * (y - step.y), c * (y - step.y) - s * (x - step.x))
            for id, (x, y) in step.there.items()
        ]
        ride.asked = ride.at(
            Pose(step.x, step.y, step.yaw),
            *tracks,
            seconds=step.seconds,
            requested=step.requested,
            turns=step.turns,
        )
    return ride


SEEN = Step(-0.8, requested=ZERO)
"""The robot has seen the opening."""
CHOSEN = Step(-1.0)
LEFT = Twist(0.0, 2.84)
ASIDE = Step(-0.4, 0.5, -0.9)
LINED_UP = Step(-0.6)
OUT = {1: (0.0, 0.0)}  # comes out of the opening: new, and in the opening
COMES_OUT = Step(-1.0, there=OUT, seconds=1.5)
COMES = Step(-0.2, there={1: (0.3, 0.0)}, seconds=1.5)
TURNS = [Step(1.0, 0.0, 1.0), Step(1.0, 0.0, 2.0)]
PASSED = [CHOSEN, Step(0.0), Step(0.5, there={1: (1.5, 1.0)}, seconds=0.1), *TURNS]
WAITING = {1: (-0.7, -0.9)}
STATES: dict[str, tuple[list[Step], WayState]] = {
    "1.5 m before": ([Step(-1.5)], WayState.APPROACH),
    "1.7 m before": ([Step(-1.72)], WayState.NONE),
    "0.6 m before the wall": ([Step(-0.6, 0.8)], WayState.NONE),
    "0.1 rad along the wall": ([SEEN, Step(-0.2, -0.8, 1.47)], WayState.NONE),
    "0.3 rad along the wall": ([SEEN, Step(-0.3, -0.8, 1.27)], WayState.GO),
    "already beyond it": ([SEEN, Step(0.3)], WayState.NONE),
    "beside it in its plane": ([SEEN, Step(-0.02, 0.5)], WayState.NONE),
    "seen once": ([Step(-1.0, seconds=0.1)], WayState.NONE),
    "seen twice": ([Step(-1.0, seconds=0.3)], WayState.APPROACH),
    "seen during a fast turn": ([Step(-1.0, turns=0.7)], WayState.NONE),
    "seen during a slow turn": ([Step(-1.0, turns=0.5)], WayState.APPROACH),
    "0.25 m beyond": ([CHOSEN, Step(0.0), Step(0.25)], WayState.IN),
    "0.45 m beyond": ([CHOSEN, Step(0.0), Step(0.45)], WayState.NONE),
    "back to 1.9 m": ([CHOSEN, Step(-1.9)], WayState.APPROACH),
    "back to 2.1 m": ([CHOSEN, Step(-2.1)], WayState.NONE),
    "a request 80 deg off": ([CHOSEN, Step(-1.0, 0.0, 1.4)], WayState.APPROACH),
    "a request 115 deg off": ([CHOSEN, Step(-1.0, 0.0, 2.0)], WayState.NONE),
    "a turn to the request, past straight back": (
        [SEEN, ASIDE, Step(-0.4, 0.5, 2.68, requested=LEFT, pause=0.5)],
        WayState.GO,
    ),
    "a turn to the request, from straight back": (
        [SEEN, ASIDE, Step(-0.4, 0.5, 2.04, requested=LEFT, pause=0.5)],
        WayState.GO,
    ),
    "not passed for 230 s": ([CHOSEN, Step(-1.0, seconds=0.1, pause=230.0)], WayState.APPROACH),
    "not passed for 245 s": ([CHOSEN, Step(-1.0, seconds=0.1, pause=245.0)], WayState.NONE),
    "a request of zero": ([CHOSEN, Step(-1.0, requested=ZERO)], WayState.NONE),
    "at the place to line up": ([Step(-0.5, 0.055)], WayState.LINE),
    "beside the place to line up": ([Step(-0.5, 0.11)], WayState.GO),
    "on the axis": ([Step(-1.0, 0.01)], WayState.APPROACH),
    "off the axis": ([Step(-1.0, 0.08)], WayState.GO),
    "on the axis, too near": ([SEEN, Step(-0.32)], WayState.GO),
    "before the place to line up": ([Step(-0.7)], WayState.APPROACH),
    "0.2 m before, aligned": ([LINED_UP, Step(-0.2)], WayState.IN),
    "0.3 m before, aligned": ([LINED_UP, Step(-0.31)], WayState.LINE),
    "0.2 m before, turned": ([LINED_UP, Step(-0.2, 0.0, 0.7)], WayState.LINE),
    "in it, turned": ([LINED_UP, Step(0.0, 0.0, 0.7)], WayState.IN),
    "beside it": ([LINED_UP, Step(0.02, 0.3)], WayState.GO),
    "3 cm off the axis, near": ([LINED_UP, Step(-0.31, 0.025)], WayState.LINE),
    "6 cm off the axis, near": ([LINED_UP, Step(-0.31, 0.065)], WayState.GO),
    "6 cm off the axis, far": ([LINED_UP, Step(-0.42, 0.065)], WayState.LINE),
    "15 cm off the axis": ([LINED_UP, Step(-0.42, 0.15)], WayState.GO),
    "another nearer on its other side": (
        [CHOSEN, Step(-1.0, there={1: (0.4, 0.0)}, seconds=1.5)],
        WayState.ASIDE,
    ),
    "another farther on its other side": (
        [LINED_UP, Step(-0.3, there={1: (0.48, 0.0)}, seconds=1.5)],
        WayState.LINE,
    ),
    "another through it, as near as the robot": (
        [LINED_UP, Step(-0.1, 0, 0.7, {1: (0.2, 0.0)}, seconds=1.5)],
        WayState.ASIDE,
    ),
    "another 0.7 m beyond": (
        [CHOSEN, Step(-1.0, there={1: (0.7, 0.0)}, seconds=1.5)],
        WayState.APPROACH,
    ),
    "another 0.95 m before": (
        [CHOSEN, Step(-1.5, there={1: (-0.95, 0.0)}, seconds=1.5)],
        WayState.APPROACH,
    ),
    "a track that does not last": (
        [CHOSEN, Step(-1.0, there=OUT, seconds=0.7)],
        WayState.APPROACH,
    ),
    "0.6 m aside": ([CHOSEN, COMES_OUT, Step(-1.0, 0.6, there=OUT)], WayState.ASIDE),
    "0.8 m aside": ([CHOSEN, COMES_OUT, Step(-1.0, 0.8, there=OUT)], WayState.WAIT),
    "1.3 m back": ([CHOSEN, COMES_OUT, Step(-1.3, there=OUT)], WayState.ASIDE),
    "1.5 m back": ([CHOSEN, COMES_OUT, Step(-1.5, there=OUT)], WayState.WAIT),
    "0.3 s after the last came out": (
        [CHOSEN, COMES_OUT, Step(-1.0, 0.9, there={1: (-0.6, -1.1)})],
        WayState.WAIT,
    ),
    "2 s after the last came out": (
        [CHOSEN, COMES_OUT, Step(-1.0, 0.9, there={1: (-0.6, -1.1)}, seconds=2.0)],
        WayState.GO,
    ),
    "6 s after another was hidden": (
        [CHOSEN, COMES_OUT, Step(-1.0, 0.9, pause=6.0, seconds=0.1)],
        WayState.WAIT,
    ),
    "8 s after another was hidden": (
        [CHOSEN, COMES_OUT, Step(-1.0, 0.9, pause=8.0, seconds=0.1)],
        WayState.GO,
    ),
    "another that backs out again": (
        [
            LINED_UP,
            Step(-0.6, there={1: (-0.2, 0.0)}, seconds=1.5),
            Step(-0.6, there={1: (0.05, 0.0)}),
            Step(-0.6, there={1: (-0.15, 0.0)}),
        ],
        WayState.ASIDE,
    ),
    "another that has gone in": (
        [
            LINED_UP,
            Step(-0.55, there={1: (-0.2, 0.0)}, seconds=1.5),
            Step(-0.55, there={1: (0.2, 0.0)}),
        ],
        WayState.LINE,
    ),
    "another seen first 0.3 m before": (
        [LINED_UP, Step(-0.5, there={1: (-0.3, 0.0)}, seconds=1.5)],
        WayState.LINE,
    ),
    "another seen first 0.05 m before": (
        [LINED_UP, Step(-0.6, there={1: (-0.05, 0.0)}, seconds=1.5)],
        WayState.ASIDE,
    ),
    "another beside the axis before it": (
        [CHOSEN, Step(-1.0, there={1: (-0.6, 0.3)}, seconds=1.5)],
        WayState.ASIDE,
    ),
    "another behind the robot": (
        [CHOSEN, Step(-0.7, there={1: (-0.85, 0.3)}, seconds=1.5)],
        WayState.APPROACH,
    ),
    "another 5 cm nearer": (
        [CHOSEN, Step(-0.85, there={1: (-0.5, 0.3)}, seconds=1.5)],
        WayState.ASIDE,
    ),
    "another 5 cm farther": (
        [CHOSEN, Step(-0.85, there={1: (-0.8, 0.27)}, seconds=1.5)],
        WayState.APPROACH,
    ),
    "another 30 cm farther": (
        [CHOSEN, Step(-0.7, there={1: (-0.9, 0.3)}, seconds=1.5)],
        WayState.APPROACH,
    ),
    "another ahead that advances": (
        [
            LINED_UP,
            Step(-0.4, there={1: (-0.2, 0.0)}, seconds=6.0),
            Step(-0.34, there={1: (-0.14, 0.0)}, seconds=6.0),
        ],
        WayState.WAIT,
    ),
    "another comes that is 5 cm less deep": (
        [
            LINED_UP,
            Step(-0.05, there={1: (0.3, 0.0)}),
            Step(-0.05, there={1: (0.1, 0.0)}, seconds=1.5),
        ],
        WayState.IN,
    ),
    "another comes that is 5 cm deeper": (
        [
            LINED_UP,
            Step(-0.05, there={1: (0.3, 0.0)}),
            Step(-0.05, there={1: (0.0, 0.0)}, seconds=1.5),
        ],
        WayState.BACK,
    ),
    "another comes that is 25 cm deeper": (
        [
            LINED_UP,
            Step(-0.2, there={1: (0.3, 0.0)}),
            Step(-0.2, there={1: (-0.05, 0.0)}, seconds=1.5),
        ],
        WayState.BACK,
    ),
    "another has come that is no more there": (
        [LINED_UP, Step(-0.2, there={1: (0.1, 0.0)}, seconds=1.5), Step(-0.2, seconds=2.0)],
        WayState.BACK,
    ),
    "the robot backs out": (
        [LINED_UP, Step(-0.1, seconds=7.0), Step(-0.2, seconds=2.0)],
        WayState.BACK,
    ),
    "the robot has backed out": (
        [LINED_UP, Step(-0.1, seconds=7.0), Step(-0.5)],
        WayState.ASIDE,
    ),
    "the robot has backed out before another": (
        [
            LINED_UP,
            Step(-0.2, there={1: (0.1, 0.0)}, seconds=1.5),
            Step(-0.2, seconds=2.0),
            Step(-0.5),
        ],
        WayState.ASIDE,
    ),
    "no progress for 5 s": ([LINED_UP, Step(-0.1, seconds=5.0)], WayState.IN),
    "no progress for 7 s": ([LINED_UP, Step(-0.1, seconds=7.0)], WayState.BACK),
    "no progress for 13 s": ([LINED_UP, Step(-0.1, seconds=13.0)], WayState.IN),
    "progress of 5 cm": (
        [LINED_UP, Step(-0.1, seconds=4.0), Step(-0.05, seconds=4.0)],
        WayState.IN,
    ),
    "progress of 2 cm": (
        [LINED_UP, Step(-0.1, seconds=4.0), Step(-0.08, seconds=4.0)],
        WayState.BACK,
    ),
    "5 s after a passage among others": (
        [*PASSED, Step(1.0, 0.0, math.pi, seconds=5.0)],
        WayState.ASIDE,
    ),
    "11 s after a passage among others": (
        [*PASSED, Step(1.0, 0.0, math.pi), Step(1.0, 0.0, math.pi, pause=10.5)],
        WayState.APPROACH,
    ),
    "after a passage alone": (
        [CHOSEN, Step(0.0), Step(0.5, seconds=0.1), *TURNS, Step(1.0, 0.0, math.pi)],
        WayState.APPROACH,
    ),
    "110 s after a passage": ([Step(-1.0, passed=110.0)], WayState.ASIDE),
    "130 s after a passage": ([Step(-1.0, passed=130.0)], WayState.APPROACH),
    "85 s after a passage, another waits": (
        [CHOSEN, Step(-1.0, 0.9, there=WAITING, seconds=1.5, passed=85.0)],
        WayState.WAIT,
    ),
    "95 s after a passage, another waits": (
        [CHOSEN, Step(-1.0, 0.9, there=WAITING, seconds=1.5, passed=95.0)],
        WayState.GO,
    ),
    "after a passage, another is far away": (
        [CHOSEN, Step(-1.0, 0.9, there={1: (-1.0, -1.8)}, seconds=1.5, passed=20.0)],
        WayState.GO,
    ),
    "after a passage, another waits on its other side": (
        [CHOSEN, Step(-1.0, 0.9, there={1: (1.0, -0.9)}, seconds=1.5, passed=20.0)],
        WayState.GO,
    ),
}


@pytest.mark.parametrize("name", STATES)
def test_the_state_at_the_bounds_of_each_rule(name: str) -> None:
    steps, state = STATES[name]
    assert ride_through(*steps).state() is state


@pytest.mark.parametrize(
    ("place", "turns_left"),
    [(Pose(-0.5, -0.2, -2.1), True), (Pose(-1.0, 0.0, -0.2), False)],
    ids=["beside the axis", "on the axis"],
)
def test_the_place_to_wait(place: Pose, turns_left: bool) -> None:
    """The request keeps its direction, and the robot has 0.1 rad or more to turn.

    The place is 0.83 m beside the axis.
    """
    x, y, yaw = place.x, place.y, place.yaw
    ride = ride_through(
        Step(x, y),
        Step(x, y, max(yaw, -1.0), requested=LEFT),
        Step(x, y, yaw, OUT, seconds=1.5, requested=LEFT),
    )
    assert ride.state() is WayState.ASIDE
    assert (ride.asked.angular > 0.0) == turns_left


def test_a_robot_keeps_the_side_on_which_it_waits() -> None:
    ride = ride_through(
        CHOSEN, Step(-1.0, -0.2, there=OUT, seconds=1.5), Step(-1.0, 0.1, there=OUT)
    )
    assert ride.asked.angular < 0.0


def test_a_robot_turns_to_its_opening_among_several() -> None:
    """Of two openings, 1 m apart, the nearer one was seen first."""
    ride = Ride()
    for y in (1.0, 0.0):
        for _ in range(2):
            ride.now += 0.1
            odometry = Odometry(ride.now, Pose(-0.8, y), ZERO)
            context = DecisionContext(ride.now, 0.0, odometry, 0.0)
            ride.way.observe(scan(near(-0.8)), (0.0, 0.0), context)
    assert ride.at(near(-0.4, 0.7), seconds=0.1).angular > 0.0


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


def test_a_robot_in_an_opening_goes_on_while_another_is_before_its_other_side() -> None:
    ride = Ride()
    ride.at(near(-0.6))
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
    asked = ride.at(near(-0.3), points=posts * (1.0, -1.0), seconds=0.1)
    assert asked.angular * off > 0.0  # a single scan changes the middle little


def test_an_opening_whose_posts_are_elsewhere_is_looked_for_anew() -> None:
    ride = Ride()
    ride.at(near(-0.5))
    posts = np.array(((0.5, 0.08 + HALF), (0.5, 0.08 - HALF)))
    ride.at(near(-0.5), points=posts, seconds=0.1)
    assert ride.state() is WayState.LINE
    ride.at(near(-0.5), track(1, 0.5, 0.15), points=posts, seconds=1.5)  # between these posts
    assert ride.state() is WayState.ASIDE
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


def test_a_robot_in_a_door_keeps_away_from_no_side() -> None:
    ride = Ride(0.0, np.where(BEARINGS < 0.0, 0.2, 0.0))
    for x in (-0.8, -0.3):
        ride.at(near(x))
    assert abs(ride.at(near(-0.05)).angular) < 0.2


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_robot_in_a_corridor_keeps_away_from_the_side_that_was_seen_earlier(side: float) -> None:
    ride = Ride(1.0, np.where(side * BEARINGS < 0.0, 0.2, 0.0))
    ride.at(near(-0.8))
    ride.at(near(-0.3))
    asked = ride.at(near(0.2))
    assert ride.state() is WayState.IN
    assert asked.angular * side > 0.0


@pytest.mark.parametrize("turns", [1.0, -1.0])
def test_a_side_is_the_same_for_bearings_of_a_whole_turn(
    turns: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A driver may give 0 to 2 pi, or -2 pi to 0, in place of -pi to pi."""
    is_right = BEARINGS < 0.0
    whole = np.where(turns * BEARINGS < 0.0, BEARINGS + turns * math.tau, BEARINGS)
    monkeypatch.setitem(globals(), "BEARINGS", whole)
    ride = Ride(1.0, np.where(is_right, 0.2, 0.0))
    ride.at(near(-0.8))
    ride.at(near(-0.3))
    assert ride.at(near(0.2)).angular > 0.2


def test_a_robot_in_a_corridor_keeps_to_its_axis_once_rays_have_no_ages() -> None:
    ride = Ride(1.0, np.where(BEARINGS < 0.0, 0.2, 0.0))
    ride.at(near(-0.8))
    ride.at(near(-0.3))
    assert ride.at(near(0.2)).angular > 0.2
    ride.ages = None
    assert ride.at(near(0.25)).angular == pytest.approx(0.0, abs=1e-6)


def test_a_robot_in_a_corridor_drives_on_however_old_the_rays_of_a_wall_are() -> None:
    ride = Ride(1.0, np.where(BEARINGS < 0.0, 9.0, 0.0))
    ride.at(near(-0.8))
    ride.at(near(-0.3))
    asked = ride.at(near(0.2))
    assert ride.state() is WayState.IN
    assert asked.linear > 0.15


@pytest.mark.parametrize("yaw", [1.8, 2.4, -2.4, 3.0])
def test_a_robot_that_faces_the_way_out_drives_out_ahead(yaw: float) -> None:
    """Its pattern turns it on the spot, so that the direction of the request stays ahead."""
    ride = Ride(1.0)
    for x in (-0.8, -0.3, 0.2):
        ride.at(near(x))
    for share in np.linspace(0.0, 1.0, 11):
        heading = share * yaw
        comes = track(1, 0.35 * math.cos(heading), -0.35 * math.sin(heading))
        turn_back = Twist(0.0, -math.copysign(1.0, yaw))
        asked = ride.at(Pose(0.2, 0.0, heading), comes, seconds=0.5, requested=turn_back)
    assert ride.state() is WayState.BACK
    assert asked.linear > 0.0
    assert asked.linear * math.cos(yaw) < 0.0, "towards the robot that it has met"
    assert asked.angular * yaw > 0.0, "on to the way out"


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
    for k in range(1, 12):  # each at another place, by a step of odometry that is no jump
        ride.now += 0.3
        odometry = Odometry(ride.now, Pose(-1.0, 3.0 * k, 0.0), ZERO)
        context = DecisionContext(ride.now, 0.0, odometry, 0.0)
        ride.way.observe(scan(near(-1.0)), (0.0, 0.0), context)
    ride.now += 4.0
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


def test_the_pose_at_a_scan_is_between_the_readings_around_it() -> None:
    """The base has just stopped: at the scan, 0.2 s before the newest reading, it was 4 cm back."""
    ride = Ride()
    for back in (0.08, 0.06, 0.04, 0.02, 0.0):
        ride.now += 0.1
        speed = Twist(0.2 if back else 0.0)
        ride.way.on_odometry(Odometry(ride.now, near(-1.0 - back), speed))
        context = DecisionContext(ride.now, 0.0, Odometry(ride.now, near(-1.0), ZERO), 0.0, 0.2)
    for _ in range(2):
        ride.way.observe(scan(near(-1.04)), (0.0, 0.0), context)
    ride.way.command(
        AHEAD, context, Surroundings((), NO_POINTS), lambda twist: twist, lambda: NO_POINTS
    )
    avoided = ride.way.passed(context)
    assert avoided is not None
    assert avoided.distance == pytest.approx(1.0, abs=0.01)
