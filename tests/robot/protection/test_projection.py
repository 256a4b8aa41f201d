"""Clipping and projection, compared with a QP solver and checked against first principles."""

from __future__ import annotations

import numpy as np
import pytest
import quadprog
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.values import Array
from tests.support.barrier_parts import Point, clipped, nearest_feasible

BOX = ((1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0))
COMPONENT = st.floats(-1, 1)
REQUESTED = st.tuples(COMPONENT, COMPONENT)
ANGLE = st.floats(-4, 4)
CLEAR_ANGLE = st.integers(-400, 400).map(lambda n: 0.01 * n)
CAP = st.one_of(st.just(0.0), st.floats(1e-3, 1.5))
LENGTH = st.floats(0.05, 3.0)
ROWS = st.lists(st.tuples(ANGLE, LENGTH, CAP), max_size=10)
CLEAR_ROWS = st.lists(st.tuples(CLEAR_ANGLE, LENGTH, CAP), max_size=10)

HalfPlanes = list[tuple[float, float, float]]


def half_planes(rows: HalfPlanes) -> tuple[Array, Array]:
    """Normals (k, 2) and caps (k,) of (angle, length, cap)."""
    angles, lengths, caps = np.array(rows).reshape(-1, 3).T
    normals = lengths[:, None] * np.stack((np.cos(angles), np.sin(angles)), axis=1)
    return normals, caps


def solver(requested: Point, normals: Array, caps: Array) -> Array:
    """The solution of quadprog, an independent active-set method.

    quadprog reports rounding as a contradiction where only one point is feasible, so the bounds
    are relaxed by 1e-12.
    """
    corners = np.array(BOX)
    edges = np.roll(corners, -1, axis=0) - corners
    outward = np.stack((edges[:, 1], -edges[:, 0]), axis=1)
    rows = np.concatenate((outward, normals))
    bounds = np.concatenate(((outward * corners).sum(axis=1), caps))
    point: Array = quadprog.solve_qp(np.eye(2), np.array(requested), -rows.T, -bounds - 1e-12)[0]
    return point


@given(REQUESTED, CLEAR_ROWS)
def test_agrees_with_a_qp_solver(requested: Point, rows: HalfPlanes) -> None:
    normals, caps = half_planes(rows)
    point, _ = nearest_feasible(requested, normals, caps)
    assert point == pytest.approx(solver(requested, normals, caps), abs=1e-8)


def test_almost_parallel_constraints_meet_within_rounding() -> None:
    """Any point within rounding is right; QP solvers fail there."""
    normals, caps = half_planes([(0.0, 1.0, 0.0), (1e-6, 2.0, 0.0)])
    point, _ = nearest_feasible((0.5, 0.0), normals, caps)
    assert point == pytest.approx((0.0, 0.0), abs=1e-6)


@given(REQUESTED, ROWS)
def test_result_satisfies_all_constraints(requested: Point, rows: HalfPlanes) -> None:
    normals, caps = half_planes(rows)
    point, _ = nearest_feasible(requested, normals, caps)
    assert (normals @ point <= caps + 1e-9).all()
    assert max(map(abs, point)) <= 1.0 + 1e-12


@given(REQUESTED, ROWS)
def test_feasible_request_is_returned_unchanged(requested: Point, rows: HalfPlanes) -> None:
    normals, caps = half_planes(rows)
    inside = 0.9 * requested[0], 0.9 * requested[1]
    roomy = np.maximum(caps, normals @ np.array(inside))
    assert nearest_feasible(inside, normals, roomy)[0] == inside


def test_tight_constraints_are_those_that_bind() -> None:
    normals, caps = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]]), np.array([0.25, 0.5, 0.0])
    point, tight = nearest_feasible((1.0, 0.2), normals, caps)
    assert point == pytest.approx((0.25, 0.2), abs=1e-12)
    assert tight == [0]


def test_turning_stays_free_between_two_opposite_constraints() -> None:
    normals = np.array([[1.0, 0.0], [-1.0, 0.0]])
    point, _ = nearest_feasible((0.7, 0.4), normals, np.zeros(2))
    assert point == pytest.approx((0.0, 0.4), abs=1e-12)


def test_clipping_halves_a_polygon() -> None:
    half = clipped(BOX, 1.0, 0.0, 0.0)
    assert sorted(half) == [(-1.0, -1.0), (-1.0, 1.0), (0.0, -1.0), (0.0, 1.0)]
    quarter = clipped(half, -1.0, 0.0, 0.5)
    assert sorted(quarter) == [(-0.5, -1.0), (-0.5, 1.0), (0.0, -1.0), (0.0, 1.0)]


def test_polygon_clipped_to_nothing_becomes_the_origin() -> None:
    assert clipped([(1e-18, 0.0), (0.0, 1e-18)], 1.0, 1.0, -1.0) == [(0.0, 0.0)]
