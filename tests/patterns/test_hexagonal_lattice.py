"""Hexagonal lattice: one robot and the forces of those around it."""

from __future__ import annotations

import math

import pytest

from swarmd.core.values import Inputs, Neighbor, Twist, Value
from swarmd.patterns.hexagonal_lattice.pattern import HexagonalLattice
from swarmd.testing.pattern_contract import PatternContract, Subject


class TestHexagonalLattice(PatternContract):
    pattern = HexagonalLattice


PLATFORM = TestHexagonalLattice.subject("burger").platform


def requested(*others: tuple[float, float], **params: Value) -> tuple[Twist, float]:
    """The command with others at range, in multiples of 0.7 m, and bearing; the neighbours felt."""
    pattern = Subject(HexagonalLattice, PLATFORM, {"distance": 0.7, **params}).make()
    near = tuple(Neighbor(f"b{k}", 0.0, 0.7 * r, b, 0.0) for k, (r, b) in enumerate(others))
    found = pattern.step(Inputs(0.0, 0.0, neighbors=near))
    assert found.twist is not None
    return found.twist, float(found.report["near"])


@pytest.mark.parametrize("bearing", [0.0, 1.0, math.pi])
def test_rests_where_neighbours_are_at_the_distance(bearing: float) -> None:
    assert requested((1.0, bearing), (1.0, bearing + math.pi / 3.0)) == (Twist(), 2)


@pytest.mark.parametrize(("share", "side"), [(0.7, -1.0), (0.85, -1.0), (1.15, 1.0), (1.4, 1.0)])
def test_is_repelled_nearer_and_attracted_farther(share: float, side: float) -> None:
    twist, _ = requested((share, 0.0))
    # 0.2 m/s at the distance, and the square law
    assert twist.linear == pytest.approx(side * min(0.2 / share**2, 0.22))
    assert twist.angular == pytest.approx(0.0)


def test_robots_behind_the_first_neighbours_are_not_felt() -> None:
    assert requested((math.sqrt(3.0), 0.0)) == (Twist(), 0)


def test_no_force_is_stronger_than_strongest() -> None:
    near, _ = requested((0.1, 0.0), force=0.02, strongest=4.0)
    assert near.linear == pytest.approx(-0.08)


@pytest.mark.parametrize("bearing", [0.7, 2.5, -2.5, -0.7])
def test_drives_along_the_force_forward_or_backward(bearing: float) -> None:
    twist, _ = requested((1.3, bearing))
    assert twist.linear * math.cos(bearing) > 0.0
    assert twist.angular * math.tan(bearing) > 0.0


def test_a_force_within_the_band_is_a_share_of_it() -> None:
    twist, _ = requested((1.05, 0.0))
    assert twist.linear == pytest.approx(0.5 * 0.2 / 1.05**2)
