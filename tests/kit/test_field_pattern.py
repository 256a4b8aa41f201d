"""Law "paper" of the patterns that follow a potential field."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.values import Inputs, Twist
from swarmd.kit.field_pattern import FieldPattern
from swarmd.patterns.attraction.pattern import Attraction
from swarmd.patterns.dispersion.pattern import Dispersion
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import Subject
from swarmd.testing.scans import scan_from

WAFFLE = load_platform("waffle_pi")


def requested(kind: type[FieldPattern[Any]], ranges: list[float], bearings: list[float]) -> Twist:
    """The first command on a scan with these rays."""
    scan = scan_from(WAFFLE, np.array(ranges), np.array(bearings))
    twist = Subject(kind, WAFFLE, {"law": "paper"}).make().step(Inputs(0.0, 0.0, scan)).twist
    assert twist is not None
    return twist


@pytest.mark.parametrize(
    ("ranges", "bearings"),
    [
        ([1.0, 1.0, 1.0], [0.5, 0.4, 0.3]),
        ([1.5, 0.5, 1.9], [3.0, -1.0, 0.2]),
        ([1.5, 1.5], [math.pi / 2, math.pi / 2]),
        ([0.2, 0.3], [3.0, -3.0]),
    ],
)
@pytest.mark.parametrize("kind", [Attraction, Dispersion])
def test_the_law_of_the_paper_is_its_equations(
    kind: type[FieldPattern[Any]], ranges: list[float], bearings: list[float]
) -> None:
    # Attraction: weights r / 2 m, a bias of -1 along x. Dispersion: 1 - r / 3.5 m, away, and 1.
    way = np.exp(1j * np.array(bearings))
    r = np.array(ranges)
    total = (r / 2.0 @ way - 1.0) if kind is Attraction else 1.0 - (1.0 - r / 3.5) @ way
    twist = requested(kind, ranges, bearings)
    assert twist.linear == pytest.approx(0.26 * total.real / abs(total))
    assert twist.angular == pytest.approx(1.82 * math.asin(total.imag / abs(total)))


@pytest.mark.parametrize(
    ("kind", "alone"), [(Attraction, Twist(angular=1.0)), (Dispersion, Twist())]
)
def test_too_near_and_single_returns_count_as_alone(
    kind: type[FieldPattern[Any]], alone: Twist
) -> None:
    assert requested(kind, [-math.inf] * 3, [0.1, 0.2, 0.3]) == alone
    assert requested(kind, [1.0, math.inf], [0.0, 1.0]) == alone


def test_a_new_scan_and_new_parameters_change_the_command() -> None:
    pattern = Subject(Attraction, WAFFLE, {"law": "paper"}).make()
    ahead, aside = (
        scan_from(WAFFLE, np.full(3, 1.0), np.array([0.4, 0.5, 0.6]) + turn) for turn in (0.0, 1.0)
    )
    first, second = (pattern.step(Inputs(0.0, 0.0, scan)).twist for scan in (ahead, aside))
    pattern.update(replace(pattern.params, bias=1.0))
    third = pattern.step(Inputs(0.1, 0.1, aside)).twist
    assert len({first, second, third}) == 3
