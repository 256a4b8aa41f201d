"""How late messages of another clock are, against the fastest of them."""

from __future__ import annotations

import math

import pytest

from swarmd.core.arrival_delay import ArrivalDelay

OFFSET = 1e6  # s between the two clocks


def fed(lags: list[float], *, period: float = 0.1, drift: float = 0.0) -> list[float | None]:
    """What is measured of messages that take so long."""
    delay, taken = ArrivalDelay(), []
    for number, lag in enumerate(lags):
        sent = number * period
        taken.append(delay.take(OFFSET + sent * (1.0 + drift), sent + lag))
    return taken


def test_a_delay_is_measured_against_the_fastest_once_five_have_arrived() -> None:
    lates = fed([0.3, 0.02, 0.05, 0.02, 0.12, 0.02, 0.5])
    assert lates[:4] == [None] * 4
    assert lates[4:] == pytest.approx([0.1, 0.0, 0.48], abs=1e-3)


def test_clocks_that_drift_apart_add_no_delay() -> None:
    for drift in (-6e-4, 0.0, 6e-4):
        assert fed([0.02] * 10_000, drift=drift)[-1] == pytest.approx(0.0, abs=1e-3)


def test_a_delay_of_all_is_seen_for_minutes() -> None:
    lates = fed([0.02] * 10 + [0.32] * 1000)
    assert lates[10] == pytest.approx(0.3, abs=1e-3)
    assert lates[-1] == pytest.approx(0.2, abs=0.01)


def test_what_does_not_advance_tells_nothing() -> None:
    delay = ArrivalDelay()
    for number in range(5):
        delay.take(number * 0.1, number * 0.1)
    for stamp in (0.4, 0.35, math.nan, math.inf):
        assert delay.take(stamp, 0.5) is None
    assert delay.take(0.5, 0.5) == pytest.approx(0.0, abs=1e-3)


def test_a_clock_that_is_set_back_begins_again() -> None:
    delay = ArrivalDelay()
    for number in range(10):
        delay.take(1000.0 + number * 0.1, number * 0.1)
    lates = [delay.take(number * 0.1, 1.0 + number * 0.1) for number in range(6)]
    assert lates[:4] == [None] * 4
    assert lates[5] == pytest.approx(0.0, abs=1e-3)
