"""Attraction: one step at a time, and robots in lockstep."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import groupby
from types import MappingProxyType
from typing import cast

import numpy as np
import pytest

from swarmd.core.values import Inputs, Neighbor, Scalar, Scan, Twist, Value
from swarmd.kit.steering import RobotsInSight
from swarmd.patterns.attraction.pattern import Attraction
from swarmd.settings.settings import load_platform
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.metrics.catalog import measure
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.trace import Trace
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import Disc, scan_of

WAFFLE = load_platform("waffle_pi")
BESIDE = Disc(0.66, 0.0)
"""A robot 0.56 m from the axle: nearer than `spacing`, by less than `slack`."""


class TestAttraction(PatternContract):
    pattern = Attraction


class TestAttractionOfThePaper(PatternContract):
    pattern = Attraction
    # Alone it spins to one side, which no mirror would.
    params = {"law": "paper", "angular_if_alone": 0.0}  # noqa: RUF012 - read only


def steps(
    *scans: Scan, seed: int = 0, heard: int = 0, params: Mapping[str, Value] = MappingProxyType({})
) -> Iterator[tuple[Twist, Scalar]]:
    """Requested command and state at 10 Hz, one step a scan, with `heard` neighbours."""
    pattern = Subject(Attraction, WAFFLE, params).make(seed)
    neighbors = tuple(Neighbor(f"robot-{i + 2}", 0.1) for i in range(heard))
    for index, scan in enumerate(scans):
        outputs = pattern.step(Inputs(0.1 * index, 0.1, scan, neighbors=neighbors))
        assert outputs.twist is not None
        yield outputs.twist, outputs.report["state"]


def requested(scan: Scan, *, count: int = 2, seed: int = 0, **params: Value) -> Twist:
    """The requested command after so many steps on one scan."""
    return list(steps(*[scan] * count, seed=seed, params=params))[-1][0]


def state(scan: Scan, *, count: int = 2, heard: int = 0) -> Scalar:
    """The state after so many steps on one scan."""
    return list(steps(*[scan] * count, heard=heard))[-1][1]


def states_on(scan: Scan, seconds: float, *, heard: int = 0) -> list[Scalar]:
    """The states that follow each other on one scan."""
    states = [state for _, state in steps(*[scan] * round(10 * seconds), heard=heard)]
    return [state for state, _ in groupby(states)]


def test_drives_towards_a_robot_ahead() -> None:
    twist = requested(scan_of(WAFFLE, [Disc(2.0, 0.0)]))
    assert twist.linear > 0.25
    assert abs(twist.angular) < 0.1


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_turns_towards_a_robot_at_its_side_without_driving(side: float) -> None:
    twist = requested(scan_of(WAFFLE, [Disc(0.0, 2.0 * side)]))
    assert twist.linear == pytest.approx(0.0, abs=0.01)
    assert twist.angular * side > 1.0


def test_slows_down_as_it_comes_near() -> None:
    speeds = [requested(scan_of(WAFFLE, [Disc(x, 0.0)])).linear for x in (2.0, 0.9, 0.85)]
    assert speeds[0] > speeds[1] > speeds[2] > 0.0


def test_comes_to_rest_at_its_spacing() -> None:
    scan = scan_of(WAFFLE, [BESIDE])
    assert requested(scan) == Twist()
    assert state(scan) == "settled"


def test_reverses_from_an_obstacle_that_comes_too_near() -> None:
    twist = requested(scan_of(WAFFLE, [Disc(0.6, 0.0), Disc(-2.5, 0.0)]))
    # Half of 0.26 m/s at most.
    assert -0.131 <= twist.linear < -0.05


def test_starts_at_a_stronger_pull_than_it_stops_at() -> None:
    # The pull of a robot whose near side is 0.67 m from the axle: 0.19, between the two.
    far, between = scan_of(WAFFLE, [Disc(2.0, 0.0)]), scan_of(WAFFLE, [Disc(0.77, 0.0)])
    assert state(between) == "settled"
    assert list(steps(far, between))[-1][1] == "gather"


def test_rests_between_two_robots_at_equal_distance() -> None:
    assert requested(scan_of(WAFFLE, [Disc(1.5, 0.0), Disc(-1.5, 0.0)], noise=0.01)) == Twist()


@pytest.mark.parametrize("room", [3.0, 4.0, 5.0])
def test_walls_do_not_attract(room: float) -> None:
    """One robot far to the left outweighs four walls, wherever those are."""
    pose = scan_of(WAFFLE, room=room)
    assert state(pose) == "search"
    twist = requested(scan_of(WAFFLE, [Disc(0.0, 0.5 * room - 0.25, 0.06)], room=room))
    assert twist.angular > 0.5


def test_does_not_press_against_the_wall_while_it_searches() -> None:
    near = scan_of(WAFFLE, room=1.3)
    assert all(requested(near, count=n).linear < 0.05 for n in range(1, 20))


def test_keeps_away_from_a_wall_beside_it_while_it_searches() -> None:
    left = scan_of(WAFFLE, [Disc(0.0, 50.5, 50.0)])
    assert all(requested(left, count=1, seed=seed).angular < 0.0 for seed in range(10))


def test_a_wall_segment_between_two_robots_is_not_a_robot() -> None:
    gate = [Disc(0.63, 0.2, 0.1), Disc(0.63, -0.2, 0.1)]
    behind = scan_of(WAFFLE, gate, room=4.0)
    assert requested(behind) == requested(scan_of(WAFFLE, gate)) == Twist()


def test_a_wall_segment_within_range_is_not_a_robot() -> None:
    # The wall's foot is 10 mm nearer than the reach, so that only 0.5 m of it are seen.
    wall = [Disc(1002.43, 0.0, 1000.0)]
    scan = scan_of(WAFFLE, wall)
    assert state(scan_of(WAFFLE, [Disc(2.43, 0.0, 0.1)])) == "gather"
    assert [s for _, s in steps(scan, scan, params={"range": 2.5})] == ["search", "search"]


def test_with_few_in_sight_it_rolls_then_leads_then_rests() -> None:
    beside = scan_of(WAFFLE, [BESIDE])
    looks = ["roll", "settled"] * 5 + ["lead", "settled"] * 2
    assert states_on(beside, 300.0) == ["settled", *looks]


def test_its_rest_time_doubles_with_each_try() -> None:
    beside = scan_of(WAFFLE, [BESIDE])
    states = [state for _, state in steps(*[beside] * 1200)]
    rests = [len(list(run)) for state, run in groupby(states) if state == "settled"]
    np.testing.assert_allclose(rests[:4], [5, 10, 20, 40], atol=3)


def test_a_robot_that_sees_all_others_does_not_search() -> None:
    beside = scan_of(WAFFLE, [BESIDE])
    assert states_on(beside, 60.0, heard=1) == ["settled"]
    assert "lead" in states_on(beside, 90.0, heard=2)


def test_it_leads_away_from_the_others() -> None:
    beside = scan_of(WAFFLE, [BESIDE])
    leading = [twist for twist, state in steps(*[beside] * 900) if state == "lead"]
    assert len(leading) > 50
    # It faces the other one and turns round before it drives.
    assert np.mean([abs(twist.angular) for twist in leading]) > 1.0
    assert max(twist.linear for twist in leading) < 0.02


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_rolls_around_the_nearest_and_away_from_the_second(side: float) -> None:
    second = Disc(0.7 * math.cos(1.0), side * 0.7 * math.sin(1.0))
    far = Disc(1.9 * math.cos(0.5), side * 1.9 * math.sin(0.5))
    scan = scan_of(WAFFLE, [BESIDE, second, far])
    rolling = [twist for twist, state in steps(*[scan] * 40) if state == "roll"]
    assert len(rolling) > 20
    assert all(side * twist.angular < -0.5 for twist in rolling)


def test_three_adjacent_robots_are_enough() -> None:
    # One far off draws it between two of them.
    angles = (-1.0, 0.0, 1.0)
    rim = [Disc(0.66 * math.cos(a), 0.66 * math.sin(a)) for a in angles]
    far = Disc(1.9 * math.cos(0.5), 1.9 * math.sin(0.5))
    assert "roll" not in states_on(scan_of(WAFFLE, [*rim, far]), 60.0, heard=6)
    assert "roll" in states_on(scan_of(WAFFLE, [rim[1], rim[2], far]), 60.0, heard=6)


def test_leaves_a_line_early_if_messages_come_from_more_robots() -> None:
    line = scan_of(WAFFLE, [Disc(0.0, 1.2), Disc(0.0, -1.0)])
    assert "roll" in states_on(line, 1.0, heard=6)
    assert "roll" not in states_on(line, 1.0, heard=2)
    corner = scan_of(WAFFLE, [Disc(0.0, 1.2), Disc(1.0, 0.0)])
    assert "roll" not in states_on(corner, 1.0, heard=6)


def test_a_robot_between_two_keeps_the_farther_one_in_sight() -> None:
    """With a range of 0.8 m a pull of 0.17 m outweighs one of 0.11 m by more than their ratio."""
    far, near = Disc(0.0, 0.77, 0.1), Disc(0.0, -0.71, 0.1)
    pattern = cast("Attraction", Subject(Attraction, WAFFLE, {"range": 0.8}).make())
    pattern.step(Inputs(0.0, 0.0, scan_of(WAFFLE, [far, near])))
    view = pattern._view
    assert view is not None
    # (0.67 - 0.5) / (1 - 0.67 / 0.8) - (0.61 - 0.5) / (1 - 0.61 / 0.8) = 0.58, over 0.3 m of brake:
    # full speed. The nearer one then limits the speed: (0.8 - 0.61) / 0.3.
    assert view.pull[1] == pytest.approx(0.633, abs=0.005)


@pytest.mark.parametrize("distance", [0.55, 0.7, 0.79])
def test_it_leaves_no_robot_that_it_sees(distance: float) -> None:
    pattern = cast("Attraction", Subject(Attraction, WAFFLE, {"range": 0.8}).make())
    robots = RobotsInSight([(distance, 0.0, 0.1, 9, True)], 0.3, 3.0, (0.0, 0.0))
    x, y = pattern._in_sight(robots, (-1.0, 0.5))
    # The brake is 0.3 m: full speed away from a robot at 0.5 m, none at 0.8 m.
    assert x == pytest.approx(-(0.8 - distance) / 0.3)
    assert y == 0.5


def test_a_short_range_is_wider_than_the_spacing() -> None:
    """A robot at 0.55 m, nearer than `spacing`, still pulls where the range is only 0.8 m."""
    scan = scan_of(WAFFLE, [Disc(0.75, 0.0)])
    twist = requested(scan, range=0.8)
    assert twist.linear > requested(scan).linear


def test_changed_parameters_apply_to_the_present_scan() -> None:
    scan = scan_of(WAFFLE, [Disc(1.0, 0.0)])
    pattern = Subject(Attraction, WAFFLE, {}).make()
    first = pattern.step(Inputs(0.0, 0.0, scan)).report["state"]
    pattern.update(Subject(Attraction, WAFFLE, {"object_width": 0.05}).make().params)
    assert [first, pattern.step(Inputs(0.1, 0.1, scan)).report["state"]] == ["gather", "search"]


def run(count: int, size: float, *, seed: int) -> Trace:
    """A minute of Waffle Pis that start anywhere in a square room."""
    group = {"platform": "waffle_pi", "count": count, "pattern": "attraction"}
    start = {"layout": "random", "clearance": 0.3}
    data = {"duration": 60, "arena": {"size": [size, size]}, "groups": {"all": group}}
    return simulate_run(scenario_of({**data, "start": start}), seed)


def test_seven_scattered_robots_gather_and_come_to_rest() -> None:
    found = measure(run(7, 6.0, seed=0))
    assert found["one_cluster_at_end"] == 1.0
    start, end = (found[f"mean_distance_to_centroid_{when}"] for when in ("start", "end"))
    assert start is not None
    assert end is not None
    assert end < 0.6 * start
    assert (found["mean_speed_late_share"] or 0.0) <= 0.2
    assert found["robot_contacts"] == 0.0


def test_a_single_robot_keeps_clear_of_the_walls() -> None:
    trace = run(1, 4.0, seed=1)
    assert np.abs(trace.pose[..., :2]).max() < 1.5
    assert (measure(trace)["mean_speed"] or 0.0) > 0.1
