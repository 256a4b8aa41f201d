"""Errors of lines and circles: 0 for perfect ones, as computed by hand for others."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.core.values import Array
from swarmd.sim.metrics import formation
from swarmd.sim.metrics.catalog import measure
from tests.sim.metrics.runs import run


def poses(*places: tuple[float, float]) -> Array:
    """(1, n, 3) turned by 0.7 rad and moved, which must change nothing."""
    x, y = np.array(places).T
    cos, sin = math.cos(0.7), math.sin(0.7)
    return np.stack((cos * x - sin * y + 2.0, sin * x + cos * y - 1.0, 0.0 * x), axis=-1)[None]


def ring(count: int, radius: float, *, first: float = 0.3) -> list[tuple[float, float]]:
    angles = first + 2.0 * math.pi / count * np.arange(count)
    return [(radius * math.cos(angle), radius * math.sin(angle)) for angle in angles.tolist()]


def test_a_perfect_line_has_no_error() -> None:
    trace = run(poses((3.0, 0.0), (0.0, 0.0), (1.0, 0.0), (2.0, 0.0)))
    assert formation.line_offsets(trace)[0] == pytest.approx(0.0, abs=1e-12)
    assert formation.line_errors(trace, 1.0)[0] == pytest.approx(0.0, abs=1e-12)
    assert formation.line_errors(trace, 2.0)[0] == pytest.approx(0.5)


def test_distances_are_orthogonal_to_the_line() -> None:
    trace = run(poses((0.0, 0.1), (1.0, -0.1), (2.0, -0.1), (3.0, 0.1)))
    assert formation.line_offsets(trace)[0] == pytest.approx(0.1)
    assert formation.line_errors(trace, 1.0)[0] == pytest.approx(0.1)


def test_gaps_count_along_the_line() -> None:
    trace = run(poses((0.0, 0.0), (1.2, 0.0), (2.0, 0.0)))
    assert formation.line_unevenness(trace)[0] == pytest.approx(0.2)
    wanted = math.sqrt((0.8**2 + 0.4**2) / 2.0) / 0.4
    assert formation.line_unevenness(trace, 0.4)[0] == pytest.approx(wanted)


@pytest.mark.parametrize("count", [3, 5, 8])
def test_a_regular_polygon_has_no_error(count: int) -> None:
    trace = run(poses(*ring(count, 1.5)))
    assert formation.circle_offsets(trace)[0] == pytest.approx(0.0, abs=1e-9)
    spacing = 2.0 * 1.5 * math.sin(math.pi / count)
    assert formation.circle_errors(trace, spacing)[0] == pytest.approx(0.0, abs=1e-9)
    half = (1.5 - 0.75) / (0.5 * spacing)
    assert formation.circle_errors(trace, 0.5 * spacing)[0] == pytest.approx(half)


def test_distances_are_from_the_circle() -> None:
    places = ring(8, 1.0)
    outer = [(1.1 * x, 1.1 * y) for x, y in places[::2]]
    trace = run(poses(*outer, *((0.9 * x, 0.9 * y) for x, y in places[1::2])))
    assert formation.circle_offsets(trace)[0] == pytest.approx(0.1, abs=0.01)
    assert formation.circle_unevenness(trace)[0] == pytest.approx(0.0, abs=1e-9)


def test_angular_gaps_are_held_against_equal_ones() -> None:
    trace = run(poses(*(ring(6, 1.0)[:5])))
    # Four gaps of 60 degrees and one of 120, where 72 are wanted.
    wanted = math.sqrt((4 * 12.0**2 + 48.0**2) / 5.0) / 72.0
    assert formation.circle_unevenness(trace)[0] == pytest.approx(wanted)
    assert formation.circle_offsets(trace)[0] == pytest.approx(0.0, abs=1e-9)


def test_an_absent_robot_does_not_count() -> None:
    pose = poses((0.0, 0.0), (1.0, 0.0), (1.5, 7.0), (2.0, 0.0))
    trace = run(pose, present=np.array([[True, True, False, True]]))
    assert formation.line_errors(trace, 1.0)[0] == pytest.approx(0.0, abs=1e-9)
    pose[0, 2] = np.nan
    trace = run(pose, present=np.array([[True, True, False, True]]))
    assert formation.line_errors(trace, 1.0)[0] == pytest.approx(0.0, abs=1e-9)


def test_too_few_form_nothing() -> None:
    one, two = run(poses((0.0, 0.0))), run(poses((0.0, 0.0), (1.0, 0.0)))
    assert np.isnan(formation.line_errors(one, 1.0)).all()
    assert formation.line_errors(two, 1.0)[0] == pytest.approx(0.0, abs=1e-12)
    assert np.isnan(formation.circle_errors(two, 1.0)).all()
    assert measure(one, ["line_offset", "circle_offset"]) == {
        "line_offset": None,
        "circle_offset": None,
    }


def test_robots_in_one_place_or_in_a_row_do_no_harm() -> None:
    trace = run(poses((0.0, 0.0), (0.0, 0.0), (0.0, 0.0)))
    assert np.isnan(formation.line_unevenness(trace)).all()
    row = run(poses((0.0, 0.0), (1.0, 0.0), (2.0, 0.0)))
    assert np.isfinite(formation.circle_offsets(row)).all()
