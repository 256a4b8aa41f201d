"""Estimates from synthetic samples."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from swarmd.core.values import Array
from swarmd.operator.calibration.estimators import (
    Braking,
    is_steady,
    mean_of,
    scale_of,
    stop_of,
    stopping,
    turn_delay,
)
from swarmd.operator.calibration.figures import Figure


def driven(
    speed: float, brake: float, delay: float, at: float, *, rate: float, phase: float
) -> tuple[Array, Array]:
    """Times and way of a drive at `speed` that gets the command zero at `at`."""
    times = np.arange(phase / rate, at + delay + speed / brake + 1.0, 1.0 / rate)
    braked = np.clip(times - at - delay, 0.0, speed / brake)
    return times, speed * np.minimum(times, at + delay) + speed * braked - 0.5 * brake * braked**2


@pytest.mark.parametrize("rate", [10.0, 20.0, 30.0])
@pytest.mark.parametrize(("brake", "delay"), [(0.4, 0.05), (1.0, 0.12), (3.0, 0.3)])
def test_stops_give_brake_and_delay_however_slow_odometry_is(
    rate: float, brake: float, delay: float
) -> None:
    stops = []
    for index, speed in enumerate((0.22, 0.08) * 4):
        times, way = driven(speed, brake, delay, 1.5, rate=rate, phase=index / 8.0)
        assert is_steady(times[times <= 1.5], way[times <= 1.5])
        stop = stop_of(times, way, 1.5)
        assert stop is not None
        assert stop.speed == pytest.approx(speed)
        stops.append(stop)
    braking, reaction = stopping(stops)
    assert braking.value == pytest.approx(brake, rel=1e-6)
    assert reaction.value == pytest.approx(delay, rel=1e-6)
    assert (braking.samples, reaction.samples) == (4, 8)


def test_the_spread_of_a_brake_is_that_of_its_stops() -> None:
    rng = np.random.default_rng(1)
    brakes = 1.0 + 0.05 * rng.standard_normal(400)
    stops = [
        Braking(v, 0.1 + v / (2.0 * b)) for v, b in zip((0.22, 0.08) * 200, brakes, strict=True)
    ]
    braking, _ = stopping(stops)
    assert braking.value == pytest.approx(1.0, rel=0.02)
    assert braking.spread == pytest.approx(0.05, rel=0.25)


def test_a_brake_within_the_scatter_of_odometry_is_not_measured() -> None:
    rng = np.random.default_rng(2)
    stops = [
        Braking(v, 0.1 + 0.02 * e) for v, e in zip((0.2, 0.1) * 6, rng.random(12), strict=True)
    ]
    braking, reaction = stopping(stops)
    assert not braking.is_measured
    assert reaction.value == pytest.approx(0.11, abs=0.02)


def test_a_base_that_still_gains_speed_is_not_steady() -> None:
    times = np.arange(0.0, 1.0, 0.05)
    assert not is_steady(times, 0.5 * times**2)
    assert not is_steady(times[:5], times[:5])
    assert is_steady(times, times)


@pytest.mark.parametrize("delay", [0.0, 0.07, 0.1, 0.6])
def test_turns_give_the_delay_of_scans_and_the_scale_of_odometry(delay: float) -> None:
    def yaw(t: Array) -> Array:
        return -0.5 * np.cos(2.0 * np.pi * t / 3.0)

    times = np.arange(0.0, 12.0, 0.05)
    arrivals = np.arange(2.0, 11.0, 0.2)
    noise = 0.003 * np.random.default_rng(3).standard_normal(len(arrivals))
    late, scale = turn_delay(arrivals, yaw(arrivals - delay) + noise, times, 1.06 * yaw(times))
    assert late.value == pytest.approx(delay, rel=0.05, abs=0.002)
    assert scale.value == pytest.approx(1.06, rel=0.01)
    assert late.spread < 0.01


def test_turns_in_the_other_direction_have_a_negative_scale_at_the_same_delay() -> None:
    times, arrivals = np.arange(0.0, 12.0, 0.05), np.arange(2.0, 11.0, 0.2)
    late, scale = turn_delay(arrivals, -np.sin(2.0 * (arrivals - 0.1)), times, np.sin(2.0 * times))
    assert late.value == pytest.approx(0.1, rel=0.05)
    assert scale.value == pytest.approx(-1.0, rel=0.01)


def test_a_robot_that_does_not_turn_shows_no_delay() -> None:
    times, arrivals = np.arange(0.0, 9.0, 0.05), np.arange(2.0, 8.0, 0.2)
    late, scale = turn_delay(arrivals, 0.0 * arrivals, times, 1e-4 * np.sin(times))
    assert not late.is_measured
    assert not scale.is_measured


def test_a_short_way_counts_less_in_a_scale() -> None:
    found = scale_of([(0.22, 0.2), (0.2, 0.2), (0.21, 0.2), (0.02, 0.04)], "")
    assert found.value == pytest.approx(sum((0.044, 0.04, 0.042, 0.0008)) / 0.1216)
    assert 0.04 < found.spread < 0.15
    assert found.samples == 4
    assert scale_of([], "none").why == "none"


def test_a_figure_over_a_scale_has_the_deviation_of_both() -> None:
    found = Figure(2.0, 0.06, 8, 1.5).over(Figure(0.5, 0.02, 4))
    assert found.value == pytest.approx(4.0)
    assert found.spread == pytest.approx(4.0 * 0.05)
    assert (found.samples, found.assumed) == (8, 1.5)


ODD_TIMES: dict[str, list[float]] = {
    "none": [],
    "one": [1.0],
    "equal": [1.0] * 40,
    "each twice": [0.1 * (n // 2) for n in range(40)],
    "backward": [2.0 - 0.05 * n for n in range(40)],
    "one back": [0.05 * n if n != 20 else 0.0 for n in range(40)],
    "nan": [math.nan] * 40,
    "one nan": [0.05 * n if n != 20 else math.nan for n in range(40)],
}
ODD_WAYS: dict[str, Callable[[int], Array]] = {
    "standing": lambda count: np.zeros(count),
    "ahead": lambda count: np.array([0.1 * n for n in range(count)]),
    "nan": lambda count: np.full(count, math.nan),
    "inf": lambda count: np.full(count, math.inf),
}


@pytest.mark.parametrize("times", ODD_TIMES)
@pytest.mark.parametrize("ways", ODD_WAYS)
@pytest.mark.filterwarnings("ignore:invalid value")  # inf less inf
def test_a_stop_of_odd_samples_is_none_or_a_number(times: str, ways: str) -> None:
    rows = np.array(ODD_TIMES[times])
    way = ODD_WAYS[ways](len(rows))
    assert is_steady(rows, way) in (True, False)
    for at in (0.0, 1.0, 1.5, math.nan):
        stop = stop_of(rows, way, at)
        assert stop is None or (math.isfinite(stop.speed) and math.isfinite(stop.seconds))
    if times in ("none", "one", "equal", "nan") or ways != "ahead":
        assert stop_of(rows, way, 1.0) is None


@pytest.mark.parametrize("speeds", [[0.2] * 8, [0.2, 0.2001] * 4, [0.0] * 8, [0.1 + 0.2, 0.3] * 4])
def test_stops_from_one_speed_give_no_brake_and_say_so(speeds: list[float]) -> None:
    for figure in stopping([Braking(speed, 0.1 + 0.01 * n) for n, speed in enumerate(speeds)]):
        assert not figure.is_measured
        assert "one speed" in figure.why


def test_distances_of_zero_give_no_scale() -> None:
    assert not scale_of([(0.1, 0.0), (0.0, 0.0)], "none").is_measured
    assert scale_of([(0.1, 0.0), (0.21, 0.2)], "none").value == pytest.approx(1.05)
    assert not mean_of([], "none").is_measured


@pytest.mark.parametrize(("value", "scale"), [(0.0, 1.0), (1.0, 0.0), (0.0, 0.0)])
def test_a_figure_over_a_scale_of_zero_is_not_measured(value: float, scale: float) -> None:
    over = Figure(value, 0.1, 8, 1.0).over(Figure(scale, 0.1, 8))
    assert over.is_measured is (scale != 0.0)
    assert over.assumed == 1.0


@pytest.mark.parametrize("name", ["standing", "nan", "one nan", "one time", "none", "no odometry"])
def test_turns_that_one_side_does_not_show_give_no_delay(name: str) -> None:
    times = np.arange(0.0, 12.0, 0.05)
    headings = np.sin(2.0 * times)
    arrivals = np.arange(2.0, 11.0, 0.2)
    seen = np.zeros(len(arrivals)) if name == "standing" else np.sin(2.0 * (arrivals - 0.1))
    if name == "nan":
        seen = np.full(len(arrivals), math.nan)
    elif name == "one nan":
        headings[100] = math.nan
    elif name == "one time":
        times = np.full(len(times), 1.0)
    elif name == "none":
        arrivals, seen = arrivals[:0], seen[:0]
    elif name == "no odometry":
        times, headings = times[:0], headings[:0]
    for figure in turn_delay(arrivals, seen, times, headings):
        assert not figure.is_measured, figure
