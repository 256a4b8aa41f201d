"""The choice among commands: what is passed, on which side, and what never happens."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from swarmd.core.avoided import WayState
from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Array, Limits, Odometry, Platform, Pose, Scan, Twist
from swarmd.robot.protection.decision import Clearance, DecisionContext, Permit
from swarmd.robot.steering.avoidance import Avoidance
from swarmd.robot.steering.tracks import Surroundings, Track
from swarmd.robot.steering.velocity_obstacles import Line, excess, most_violated, nearest
from swarmd.settings.settings import load_platform
from tests.support.examples import examples
from tests.support.filter_sim import FilterSim, box, pole, under_barrier
from tests.support.kernel_forms import both_forms, compares_forms, long_run
from tests.support.protection import Commander
from tests.support.tracks import numbers_of

AVOIDING = under_barrier(load_platform("burger"))
BURGER = replace(AVOIDING, protection={**AVOIDING.protection, "avoidance": "none"})
BASE, HOLONOMIC = Limits(0.22, 2.84), Limits(0.22, 2.84, 0.22)
AHEAD = Twist(0.22)
NO_WALLS = np.empty((0, 2))
UNIT = st.floats(-1.0, 1.0)


def made(limits: Limits = BASE) -> Avoidance:
    return Avoidance(Clearance(0.5, 0.18, 0.09), limits)


def clear_scan() -> Scan:
    spec = AVOIDING.scan
    ranges = np.full(len(spec.bearings), np.inf)
    return Scan(1, 0.0, ranges, spec.bearings, spec.range_min, spec.range_max)


def track(x: float, y: float, vx: float = 0.0, vy: float = 0.0) -> Track:
    return Track(7, x, y, vx, vy, 0.1)


def command(*tracks: Track, requested: Twist = AHEAD, limits: Limits = BASE) -> Twist:
    around = Surroundings(tracks, NO_WALLS)
    asked: Twist = made(limits).command(requested, requested, 0.0, around)
    return asked


@pytest.mark.parametrize(
    "found", [(), (track(-0.6, 0.0),), (track(2.0, 1.0),), (track(0.8, 0.0, 0.4),)]
)
def test_a_request_without_anything_in_its_way_passes_unchanged(found: tuple[Track, ...]) -> None:
    assert command(*found) is AHEAD


@pytest.mark.parametrize("limits", [BASE, HOLONOMIC], ids=["differential", "holonomic"])
def test_of_two_that_meet_each_goes_to_its_right(limits: Limits) -> None:
    chosen = command(track(0.9, 0.0, -0.22), limits=limits)
    aside = chosen.lateral if limits.lateral else chosen.angular
    assert aside < 0.0
    assert chosen.linear > 0.0


def test_an_object_that_crosses_behind_is_passed_before_it() -> None:
    assert command(track(0.8, -0.9, 0.0, -0.2)) is AHEAD


@pytest.mark.parametrize("requested", [ZERO, Twist(0.0, 2.0), Twist(0.01, 1.0)])
def test_what_does_not_drive_is_not_changed(requested: Twist) -> None:
    assert command(track(0.5, 0.0, -0.2), requested=requested) is requested


def test_a_command_that_avoids_names_the_track() -> None:
    avoidance = made()
    avoidance.command(AHEAD, AHEAD, 0.0, Surroundings((track(0.9, 0.0, -0.22),), NO_WALLS))
    assert avoidance.avoiding is not None
    assert avoidance.avoiding.id == 7
    avoidance.command(AHEAD, AHEAD, 0.1, Surroundings((), NO_WALLS))
    assert avoidance.avoiding is None


def test_a_robot_that_is_held_up_looks_farther_to_the_right() -> None:
    avoidance, found = made(), Surroundings((track(0.42, 0.0), track(0.42, 0.4)), NO_WALLS)
    chosen = [avoidance.command(AHEAD, ZERO, 0.05 * tick, found) for tick in range(200)]
    assert chosen[-1].angular < chosen[0].angular < 0.0


def test_a_robot_beside_a_wall_goes_aside_less() -> None:
    walls = np.stack((np.linspace(-0.5, 1.5, 40), np.full(40, -0.14)), axis=1)
    found = Surroundings((track(0.9, 0.0, -0.22),), walls)
    chosen = made().command(AHEAD, AHEAD, 0.0, found)
    assert command(track(0.9, 0.0, -0.22)).angular < chosen.angular


def test_a_robot_drives_along_a_wall_at_the_gap_that_protection_allows() -> None:
    walls = np.stack((np.linspace(-0.5, 1.5, 40), np.full(40, -0.125)), axis=1)
    assert made().command(AHEAD, AHEAD, 0.0, Surroundings((track(2.0, 1.0),), walls)) is AHEAD


def test_a_wall_ahead_slows_a_robot_that_is_not_alone() -> None:
    walls = np.stack((np.full(40, 0.25), np.linspace(-1.0, 1.0, 40)), axis=1)
    chosen = made().command(AHEAD, AHEAD, 0.0, Surroundings((track(2.0, 1.0),), walls))
    assert chosen.linear < 0.15
    assert made().command(AHEAD, AHEAD, 0.0, Surroundings((), walls)) is AHEAD


def test_between_walls_nothing_is_led_past() -> None:
    along = np.linspace(-0.5, 1.5, 40)
    walls = np.concatenate([np.stack((along, np.full(40, y)), axis=1) for y in (-0.2, 0.2)])
    avoidance, found = made(), track(0.7, 0.0, -0.2)
    assert avoidance.command(AHEAD, AHEAD, 0.0, Surroundings((found,), walls)) is AHEAD
    assert not avoidance.are_near
    assert avoidance.command(AHEAD, AHEAD, 0.1, Surroundings((found,), walls[:40])) is not AHEAD
    assert avoidance.are_near


@settings(max_examples=examples(200))
@given(st.tuples(UNIT, UNIT), st.lists(st.tuples(UNIT, UNIT, UNIT, UNIT), max_size=5))
def test_no_command_is_faster_than_the_request(
    asked: tuple[float, float], given: list[tuple[float, float, float, float]]
) -> None:
    requested = Twist(0.22 * asked[0], 2.84 * asked[1])
    tracks = [track(1.5 * x, 1.5 * y, 0.3 * vx, 0.3 * vy) for x, y, vx, vy in given]
    chosen = command(*tracks, requested=requested)
    speed, most = (math.hypot(one.linear, 0.22 / 2.84 * one.angular) for one in (chosen, requested))
    assert chosen.is_finite
    assert speed <= most + 1e-9


def kept(lines: list[Line], velocities: Array) -> NDArray[np.bool_]:
    """Which velocities (k, 2) keep all lines."""
    found = [[excess(line, x, y) <= 1e-9 for line in lines] for x, y in velocities.tolist()]
    shaped = np.array(found, dtype=np.bool_).reshape(len(velocities), -1)
    return np.asarray(shaped.all(axis=1), np.bool_)


@example([(0.0, 5.55e-131), (2.2e-308, 0.0)], (1.0, 0.0))  # equal lines but for rounding
@example([(0.0, 2e-8), (1e-17, 0.0)], (1.0, 0.0))
@settings(max_examples=examples(100))
@given(
    st.lists(st.tuples(st.floats(0.0, 1.0), st.floats(-math.pi, math.pi)), max_size=6),
    st.tuples(UNIT, UNIT),
)
def test_the_velocity_is_the_nearest_that_keeps_all_lines(
    given: list[tuple[float, float]], wanted: tuple[float, float]
) -> None:
    # Zero keeps each of these lines.
    lines = [Line(a * math.cos(b), a * math.sin(b), -math.sin(b), math.cos(b)) for a, b in given]
    x, y = nearest(lines, 0, *wanted, 1.0)
    assert kept(lines, np.array([(x, y)])).all() or max(excess(one, x, y) for one in lines) < 1e-6
    assert math.hypot(x, y) <= 1.0 + 1e-9
    radii, angles = np.meshgrid(np.linspace(0.0, 1.0, 11), np.linspace(-np.pi, np.pi, 25))
    grid = np.stack((radii * np.cos(angles), radii * np.sin(angles)), axis=-1).reshape(-1, 2)
    allowed = grid[kept(lines, grid)]
    best = np.hypot(*(allowed - wanted).T).min(initial=math.inf)
    assert math.hypot(x - wanted[0], y - wanted[1]) <= best + 1e-6


@compares_forms
@settings(max_examples=examples(200))
@given(
    st.lists(st.tuples(UNIT, UNIT, UNIT, UNIT, st.floats(0.05, 0.6)), max_size=8),
    st.lists(st.tuples(UNIT, UNIT), max_size=8),
    st.tuples(UNIT, UNIT),
)
def test_compiled_and_interpreted_code_give_the_same_lines_and_velocities(
    discs: list[tuple[float, float, float, float, float]],
    places: list[tuple[float, float]],
    wanted: tuple[float, float],
) -> None:
    walls, found = np.array(places).reshape(-1, 2), []
    for module in both_forms("swarmd.robot.steering.velocity_obstacles"):
        lines = module.wall_lines(walls, 0.1, *wanted, 0.12, 0.5, 0.8)
        fixed = len(lines)
        tracks = tuple(module.Track(7, *disc) for disc in discs)
        lines += module.track_lines(tracks, 0.1, *wanted, 0.12, 0.5, 0.04, 1.8)
        rows = [(one.x, one.y, one.dx, one.dy) for one in lines]
        velocity = module.nearest(lines, fixed, *wanted, 0.22)
        worst = module.most_violated(lines, fixed, *wanted)
        found.append((rows, velocity, worst, module.passage_between(walls, -0.2, 0.35, 0.3)))
    assert found[0] == found[1]


def test_the_line_that_a_velocity_violates_most_is_found() -> None:
    lines = [Line(x, 0.0, 0.0, 1.0) for x in (0.0, 0.4, 0.2)]  # each: at most x
    assert [most_violated(lines, first, 0.5, 0.0) for first in range(3)] == [0, 2, 2]
    assert most_violated(lines, 0, 0.0, 1.0) == -1


def test_where_no_velocity_keeps_all_lines_walls_go_first() -> None:
    wall = Line(0.0, 0.0, 0.0, 1.0)  # x <= 0
    other = Line(0.5, 0.0, 0.0, -1.0)  # x >= 0.5
    x, _ = nearest([wall, other], 1, 1.0, 0.0, 1.0)
    assert x == pytest.approx(0.0, abs=1e-9)


def test_a_pattern_without_recovery_is_not_led_past_anything() -> None:
    rides = [FilterSim(one, [pole(0.1, Pose(1.0))]).run(AHEAD, 4.0) for one in (BURGER, AVOIDING)]
    assert rides[0].twists == rides[1].twists
    assert all(decision.avoided is None for _, decision in rides[1].decisions)


def test_a_decision_says_what_is_avoided_and_keeps_the_margin() -> None:
    ride = FilterSim(AVOIDING, [pole(0.1, Pose(1.0))]).run(AHEAD, 6.0, Permit(may_recover=True))
    avoided = [decision.avoided for _, decision in ride.decisions if decision.avoided is not None]
    assert avoided[0].bearing == pytest.approx(0.0, abs=0.05)
    assert avoided[0].distance == pytest.approx(0.9, abs=0.2)
    assert not any(decision.is_recovering for _, decision in ride.decisions)
    assert ride.min_gap > 0.05


@long_run
def test_a_decision_says_that_the_robot_drives_to_an_opening_and_passes_it() -> None:
    walls = [box(0.1, 2.0, Pose(0.8, side * 1.18)) for side in (1.0, -1.0)]
    walls.append(box(0.1, 6.0, Pose(3.0)))  # what is seen through the door
    ride = FilterSim(AVOIDING, walls).run(AHEAD, 30.0, Permit(may_recover=True))
    avoided = [decision.avoided for _, decision in ride.decisions if decision.avoided is not None]
    assert {one.way for one in avoided} >= {WayState.GO, WayState.IN}
    assert avoided[0].text.startswith("drives to an opening, 0.")


@long_run
@pytest.mark.parametrize(("is_alone", "least", "most"), [(True, 0.0, 0.1), (False, 4.0, 5.0)])
def test_a_robot_beside_an_object_recovers_later(is_alone: bool, least: float, most: float) -> None:
    begin = []
    for platform in (BURGER, AVOIDING):
        shapes = [box(0.1, 4.0, Pose(0.6)), *([] if is_alone else [pole(0.1, Pose(0.0, 0.7))])]
        ride = FilterSim(platform, shapes).run(AHEAD, 8.0, Permit(may_recover=True))
        begin.append(next(time for time, decision in ride.decisions if decision.is_recovering))
    assert least <= begin[1] - begin[0] <= most


@pytest.mark.parametrize("platform", [BURGER, AVOIDING], ids=["none", "orca"])
@pytest.mark.parametrize("avoids", [True, False])
def test_the_permit_of_a_run_comes_before_the_platform(platform: Platform, avoids: bool) -> None:
    sim = FilterSim(platform, [pole(0.1, Pose(1.0))])
    permit = Permit(may_recover=True, avoids=avoids)
    decisions = [decision for _, decision in sim.run(AHEAD, 3.0, permit).decisions]
    assert any(decision.avoided is not None for decision in decisions) is avoids


def test_a_hold_ends_no_tracks_of_a_run_that_avoids() -> None:
    """In a hold a robot has no permit, and its run goes on afterwards."""
    sim = FilterSim(BURGER, [pole(0.1, Pose(1.0))])
    sim.run(AHEAD, 2.0, Permit(may_recover=True, avoids=True))
    context = sim.sensors.context(sim.time)
    before = numbers_of(sim.commander.steering.tracks(context) or ())
    assert before
    sim.commander.decide(AHEAD, context, True, Reason.STALE_SCAN)
    assert numbers_of(sim.commander.steering.tracks(context) or ()) == before
    sim.commander.decide(AHEAD, context, True, None, Permit(may_recover=False, avoids=True))
    assert sim.commander.steering.tracks(context) is None


def test_a_robot_that_does_not_run_keeps_no_tracks() -> None:
    sim = FilterSim(AVOIDING, [pole(0.1, Pose(1.0))])
    context = sim.sensors.context(sim.time)
    assert sim.commander.steering.tracks(context) is None
    sim.run(AHEAD, 2.0, Permit(may_recover=True))
    context = sim.sensors.context(sim.time)
    assert sim.commander.steering.tracks(context)
    sim.commander.decide(AHEAD, context, False, None, Permit(may_recover=True))
    assert sim.commander.steering.tracks(context) is None


class Blocked:
    """A tracker of two robots that stand in the way of a Burger."""

    found = Surroundings((track(0.42, 0.0), track(0.42, 0.4)), NO_WALLS)

    def __getattr__(self, name: str) -> Any:
        return lambda *_: self.found


@pytest.mark.parametrize("ends_with", [Reason.STALE_SCAN, None])
def test_a_hold_ends_how_long_a_robot_was_held_up(ends_with: Reason | None) -> None:
    """A robot turns farther to the right the longer it is delayed (docs/evidence/avoidance.md).

    A hold ends the delay: the robot then chooses as one that meets the two for the first time.
    """
    commander = Commander(AVOIDING)
    steering: Any = commander.steering
    steering._tracker = Blocked()
    permit, now = Permit(may_recover=True), 10.0
    commander.observe(clear_scan(), DecisionContext(now, 0.0))

    def chosen(hold: Reason | None = None) -> float:
        nonlocal now
        now += 0.05
        context = DecisionContext(now, 0.0, Odometry(now, Pose(), ZERO), 0.0)
        return commander.decide(AHEAD, context, True, hold, permit).safe.angular

    first = chosen()
    later = [chosen() for _ in range(100)][-1]
    assert later < first < 0.0
    if ends_with is not None:
        chosen(ends_with)
    assert (chosen() == pytest.approx(first)) is (ends_with is not None)


@long_run
def test_a_run_that_loses_its_permit_in_a_recovery_recovers_no_more() -> None:
    """`is_recovering`: the judged command came from recovery (core/messages.py)."""
    sim = FilterSim(BURGER, [box(0.1, 4.0, Pose(0.6))])
    ride = sim.run(AHEAD, 2.0, Permit(may_recover=True))
    assert ride.decisions[-1][1].is_recovering
    context = sim.sensors.context(sim.time)
    decision = sim.commander.decide(AHEAD, context, True, None, Permit(may_recover=False))
    assert not decision.is_recovering
    assert decision.safe.angular == 0.0
