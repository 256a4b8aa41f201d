"""Dispersion: one step at a time, and a room that is too small."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Inputs, Scan, Twist, Value
from swarmd.patterns.dispersion.pattern import Dispersion
from swarmd.settings.settings import load_platform
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.metrics.catalog import measure
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import Disc, scan_from, scan_of

WAFFLE = load_platform("waffle_pi")


class TestDispersion(PatternContract):
    pattern = Dispersion


class TestDispersionOfThePaper(PatternContract):
    pattern = Dispersion
    params = {"law": "paper"}  # noqa: RUF012 - read only


def requested(scan: Scan, **params: Value) -> Twist:
    """The first requested command on a scan."""
    pattern = Subject(Dispersion, WAFFLE, params).make()
    twist = pattern.step(Inputs(now=0.0, dt=0.0, scan=scan)).twist
    assert twist is not None
    return twist


def test_rests_where_nothing_is_near() -> None:
    assert requested(scan_of(WAFFLE, [Disc(1.3, 0.0)], room=3.0)) == Twist()


def test_reverses_slowly_from_an_obstacle_ahead() -> None:
    twist = requested(scan_of(WAFFLE, [Disc(0.8, 0.0)]))
    assert -0.131 <= twist.linear < -0.05


def test_changed_distance_counts_for_the_scan_at_hand() -> None:
    pattern, scan = Subject(Dispersion, WAFFLE, {}).make(), scan_of(WAFFLE, [Disc(1.3, 0.0)])
    assert pattern.step(Inputs(now=0.0, dt=0.0, scan=scan)).twist == Twist()
    pattern.update(msgspec.structs.replace(pattern.params, distance=2.0))
    assert pattern.step(Inputs(now=0.1, dt=0.1, scan=scan)).twist != Twist()


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_turns_its_back_or_front_to_the_side_that_is_free(side: float) -> None:
    ahead = requested(scan_of(WAFFLE, [Disc(-0.3, 0.7 * side)]))
    assert ahead.angular * side < 0.0
    assert ahead.linear >= 0.0


def test_a_wall_pushes_like_a_robot_at_the_same_range() -> None:
    wall = scan_of(WAFFLE, room=1.5)
    single = np.where(np.abs(wall.bearings - math.pi) < math.pi / 4, wall.ranges, math.inf)
    from_wall = requested(scan_from(WAFFLE, single, wall.bearings))
    from_robot = requested(scan_of(WAFFLE, [Disc(-0.8, 0.0, 0.05)]))
    assert from_wall.linear == pytest.approx(from_robot.linear, abs=0.02)


def test_the_push_falls_with_the_range() -> None:
    speeds = [requested(scan_of(WAFFLE, [Disc(-x, 0.0)])).linear for x in (0.9, 1.0, 1.1)]
    assert speeds[0] > speeds[1] > speeds[2] > 0.0


@pytest.mark.parametrize("distance", [0.4, 0.5])
def test_a_distance_within_protection_is_refused(distance: float) -> None:
    with pytest.raises(ConfigError, match=f"distance is {distance:g} m"):
        Subject(Dispersion, WAFFLE, {"distance": distance}).make()


def test_a_refused_change_of_distance_keeps_the_old_one() -> None:
    pattern = Subject(Dispersion, WAFFLE, {}).make()
    good = pattern.params
    bad = msgspec.structs.replace(good, distance=0.3)
    with pytest.raises(ConfigError, match=r"distance is 0\.3 m"):
        pattern.update(bad)
    assert pattern.params is good


def test_robots_come_to_rest_also_without_enough_room() -> None:
    """Seven cannot stand 2 m apart in 4 by 4 m. Outcomes with enough room are in studies/."""
    group = {
        "platform": "waffle_pi",
        "count": 7,
        "pattern": "dispersion",
        "parameters": {"distance": 2.0},
        "start": {"layout": "grid", "spacing": 0.7},
    }
    data = {"duration": 50, "arena": {"size": [4.0, 4.0]}, "groups": {"all": group}}
    found = measure(simulate_run(scenario_of(data), 0))
    assert (found["mean_speed_late_share"] or 0.0) < 0.1
    assert (found["nearest_neighbor_median_late"] or 0.0) > 1.0
    assert found["robot_contacts"] == 0.0
