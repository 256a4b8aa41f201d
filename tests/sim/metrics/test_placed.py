"""Metrics with a place or a number in their names: values by hand, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array
from swarmd.sim.metrics.catalog import measure, metric_of, series
from swarmd.sim.trace import Trace
from tests.sim.metrics.runs import full_run, run


def at(*instants: list[tuple[float, float]]) -> Array:
    """Poses (T, n, 3) of the places of each instant."""
    places = np.array(instants)
    return np.concatenate([places, np.zeros((*places.shape[:2], 1))], axis=2)


def placed(pose: Array, arena: str = "20x20", **meta: object) -> Trace:
    """A run whose meta names an arena and what else is given."""
    return run(pose, meta={"arena": arena, **meta})


def value(trace: Trace, name: str) -> float | None:
    return measure(trace, [name])[name]


def test_the_share_in_an_area_is_that_of_the_late_part() -> None:
    outside, inside = (2.0, 0.0), (1.0, 0.4)
    trace = run(
        at([outside] * 2, [outside] * 2, [inside, outside], [inside, outside], [inside] * 2)
    )
    assert series(trace, "share_in:disc:1:0:0.5") is not None
    np.testing.assert_array_equal(series(trace, "share_in:disc:1:0:0.5"), [0.0, 0.0, 0.5, 0.5, 1.0])
    assert value(trace, "share_in:disc:1:0:0.5") == pytest.approx(2.0 / 3.0)


@pytest.mark.parametrize(
    ("area", "shares"),
    [
        ("disc:0:0:1", [True, True, False, False]),
        ("box:0:0:2:1", [True, False, True, False]),
        ("box:0:0:2:1:disc:0:2:0.1", [True, False, True, True]),
    ],
)
def test_discs_boxes_and_several_areas(area: str, shares: list[bool]) -> None:
    places = [(0.0, 0.4), (0.0, 0.9), (0.95, 0.45), (0.0, 2.05)]
    found = [value(run(at([place])), f"share_in:{area}") for place in places]
    assert found == [float(one) for one in shares]


def test_an_absent_robot_is_in_no_area() -> None:
    trace = run(at([(0.0, 0.0), (5.0, 0.0)]), present=np.array([[False, True]]))
    assert value(trace, "share_in:disc:0:0:1") == 0.0
    assert value(trace, "share_reached:disc:0:0:1") == 0.0


def test_who_has_reached_an_area_stays_counted() -> None:
    there, away = (1.0, 0.0), (0.0, 0.0)
    trace = run(at([away, away], [there, away], [away, away], [away, there]))
    np.testing.assert_array_equal(series(trace, "share_reached:disc:1:0:0.2"), [0.0, 0.5, 0.5, 1.0])
    assert value(trace, "share_reached:disc:1:0:0.2") == 0.5


def test_a_swap_ends_at_the_place_opposite_the_start() -> None:
    trace = run(at([(1.0, 0.5), (-1.0, 0.0)], [(-0.9, -0.5), (0.5, 0.0)]))
    np.testing.assert_array_equal(series(trace, "share_swapped:0.2"), [0.0, 0.5])


def test_another_groups_robot_catches_and_its_own_does_not() -> None:
    pose = at([(0.0, 0.0), (2.0, 0.0), (2.1, 0.0)], [(1.5, 0.0), (2.0, 0.0), (2.1, 0.0)])
    hunter, *prey = run(pose).ids
    trace = placed(pose, groups={"hunter": [hunter], "prey": prey})
    np.testing.assert_array_equal(series(trace, "share_caught:prey:0.55"), [0.0, 0.5])
    assert value(trace, "share_caught:prey:0.55") == 0.25
    assert value(trace, "share_caught:sheep:0.55") is None


def test_a_report_counts_by_its_number() -> None:
    said = np.array([[1.0, 0.0, np.nan], [1.0, 1.0, np.nan]])
    trace = run(at([(0.0, 0.0)] * 3, [(0.0, 0.0)] * 3), report={"opinion": said})
    assert value(trace, "share_reporting:opinion:1") == pytest.approx(2.0 / 3.0)
    assert value(trace, "share_reporting:state:1") is None


def test_the_way_of_a_box_is_a_share_of_its_way_to_the_place() -> None:
    box = np.array([[[0.0, 0.0, 0.0]], [[1.5, 0.0, 0.0]], [[-1.0, 0.0, 0.0]]])
    shape = np.array([[[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]])
    trace = run(at(*[[(0.0, 1.0)]] * 3), box_pose=box, box_shapes=shape, movable_boxes=("crate",))
    found = series(trace, "box_progress:2:0")
    assert found is not None
    np.testing.assert_allclose(found, [0.0, 0.75, -0.5])
    assert value(trace, "box_progress:2:0") == pytest.approx(-0.5)
    assert value(run(at([(0.0, 0.0)])), "box_progress:2:0") is None


def test_the_distance_of_the_floor_counts_robots_outside_the_area() -> None:
    middle = value(placed(at([(0.0, 0.0), (1.0, 0.0)]), "4x4"), "coverage_distance:disc:1:0:0.5")
    alone = placed(at([(0.0, 0.0)]), "4x4")
    # Of a square of side a, the mean distance from the middle is a (sqrt 2 + asinh 1) / 6.
    of_square = 4.0 * (math.sqrt(2.0) + math.asinh(1.0)) / 6.0
    assert value(alone, "coverage_distance") == pytest.approx(of_square, abs=0.005)
    assert middle == value(alone, "coverage_distance:disc:1:0:0.5") != of_square
    inside = placed(at([(1.0, 0.0)]), "4x4")
    assert value(inside, "coverage_distance:disc:1:0:0.5") == pytest.approx(math.hypot(4.0, 4.0))


def test_the_largest_network_covers_its_discs_once() -> None:
    disc = math.pi * 0.5**2
    pose = at([(0.0, 0.0), (5.0, 0.0), (5.0, 0.9)])
    lone_and_pair = placed(pose)
    found = value(lone_and_pair, "network_area:1:0.5")
    overlap = 2.0 * 0.25 * math.acos(0.9) - 0.45 * math.sqrt(1.0 - 0.81)  # of two discs
    assert found == pytest.approx(2.0 * disc - overlap, abs=0.04)
    assert value(lone_and_pair, "network_area:0.8:0.5") == pytest.approx(disc, abs=0.03)
    absent = run(pose, meta={"arena": "20x20"}, present=np.zeros((1, 3), dtype=bool))
    assert value(absent, "network_area:1:0.5") == 0.0
    assert found is not None
    walled = placed(pose, "10x20")  # a wall through the middles of the pair
    assert value(walled, "network_area:1:0.5") == pytest.approx(found / 2.0, abs=0.03)


@pytest.mark.parametrize("name", ["share_in:disc:0:0:1", "coverage_distance", "network_area:1:0.5"])
@pytest.mark.parametrize("instants", [1, 12])
def test_any_run_has_a_value_and_one_for_each_instant(name: str, instants: int) -> None:
    trace = placed(full_run(3, instants=instants).pose, "6x6")
    found = series(trace, name)
    assert found is not None
    assert found.shape == (instants,)
    assert value(trace, name) is not None


@pytest.mark.parametrize(
    ("name", "subject"),
    [
        ("share_in", "no area"),
        ("share_in:disc:0:0", "2 values, not 3"),
        ("share_in:ring:0:0:1", "'ring'"),
        ("share_in:disc:0:0:-1", "not positive"),
        ("share_in:disc:0:zero:1", "'zero'"),
        ("share_in:disc:0:inf:1", "no number"),
        ("share_caught:prey", "0 values, not 1"),
        ("share_caught", "no group"),
        ("network_area:1", "1 values, not 2"),
        ("box_progress:1:2:3", "3 values, not 2"),
        ("share_reporting::1", "no key"),
        ("share_inn:disc:0:0:1", "share_in"),
    ],
)
def test_a_wrong_name_is_one_line(name: str, subject: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        metric_of(name)
    assert subject in str(refusal.value)
    assert "\n" not in str(refusal.value)
