"""Vicsek alignment: one robot and the headings around it."""

from __future__ import annotations

import math

import pytest

from swarmd.core.values import Inputs, Neighbor, Value
from swarmd.patterns.vicsek_alignment.pattern import VicsekAlignment
from swarmd.testing.pattern_contract import PatternContract, Subject


class TestVicsekAlignment(PatternContract):
    pattern = VicsekAlignment


PLATFORM = TestVicsekAlignment.subject("burger").platform


def turned(*headings: float, seed: int = 0, distance: float = 0.5, **params: Value) -> float:
    """The turn in rad over one update, of a robot that does what it requests."""
    given = {"noise": 0.0, "update_period": 2.0, **params}
    pattern = Subject(VicsekAlignment, PLATFORM, given).make(seed)
    others = tuple(Neighbor(f"b{k}", 0.0, distance, 0.0, one) for k, one in enumerate(headings))
    angle = 0.0
    for k in range(39):  # the first update is within 2 s, and each turn takes less
        found = pattern.step(Inputs(0.1 * k, 0.1 if k else 0.0, neighbors=others))
        assert found.twist is not None
        assert found.twist.linear == pytest.approx(0.22)
        angle += 0.1 * found.twist.angular
        if angle and not found.twist.angular:
            break
    return angle


@pytest.mark.parametrize(
    ("headings", "mean"),
    [((1.0,), 0.5), ((-1.0,), -0.5), ((math.pi / 2, -math.pi / 2), 0.0), ((1.2, 1.2, 1.2), None)],
)
def test_turns_to_the_mean_heading_with_its_own(
    headings: tuple[float, ...], mean: float | None
) -> None:
    x = 1.0 + sum(math.cos(one) for one in headings)
    expected = math.atan2(sum(math.sin(one) for one in headings), x)
    assert turned(*headings) == pytest.approx(expected, abs=0.01)
    assert mean is None or expected == pytest.approx(mean)


def test_headings_beyond_the_radius_do_not_count() -> None:
    assert turned(1.0, distance=1.1) == 0.0
    assert turned(1.0, distance=1.1, radius=1.2) == pytest.approx(0.5, abs=0.01)


def test_the_noise_is_evenly_spread_over_its_width() -> None:
    angles = [turned(seed=seed, noise=2.0) for seed in range(200)]
    assert max(map(abs, angles)) <= 1.0
    # Of an even spread: 0 +- 0.04 and 1/3; four standard deviations.
    assert sum(angles) / 200 == pytest.approx(0.0, abs=0.17)
    assert sum(angle**2 for angle in angles) / 200 == pytest.approx(1.0 / 3.0, abs=0.09)
