"""The greatest age of a request that arrives: probes of the hub, and the caller's stamp."""

from __future__ import annotations

import pytest

from swarmd.drivers.ros2.request_age import (
    MAX_AGE,
    MAX_STAMP_AGE,
    PROBE_PERIOD,
    SETTLE_TIME,
    RequestAge,
    by_stamp,
)

TRIP = 0.02


def steady(age: RequestAge, since: float, until: float) -> float:
    """Answer each probe after TRIP; the time of the last answer."""
    now = since
    while now < until:
        if age.probes(now):
            age.answered(now, now + TRIP)
        now += 0.1
    return now


def test_the_age_is_bounded_by_the_last_answered_probe() -> None:
    age = RequestAge()
    now = steady(age, 10.0, 10.0 + SETTLE_TIME + 0.5)
    bound = age.bound(now)
    assert bound is not None
    assert TRIP <= bound <= 2 * PROBE_PERIOD + TRIP


@pytest.mark.parametrize("silence", [MAX_AGE + 0.2, 60.0])
def test_no_age_is_known_in_a_freeze_and_for_a_while_after_it(silence: float) -> None:
    age = RequestAge()
    frozen_at = steady(age, 0.0, SETTLE_TIME + 0.5)
    # Probes leave while the hub is frozen, and all are answered when it continues.
    sent = [frozen_at + 0.2 * n for n in range(int(silence / 0.2))]
    thawed_at = frozen_at + silence
    assert age.bound(thawed_at) is None
    for at in sent:
        age.answered(at, thawed_at)
    assert age.bound(thawed_at + 0.01) is None
    now = steady(age, thawed_at, thawed_at + 0.8 * SETTLE_TIME)
    assert age.bound(now) is None
    assert age.bound(steady(age, now, thawed_at + SETTLE_TIME + 0.3)) is not None


def test_after_a_short_freeze_a_request_may_be_as_old_as_the_freeze() -> None:
    """Such a request waited in front of the hub, which answers the probes first."""
    age, freeze = RequestAge(), 0.8 * MAX_AGE
    frozen_at = steady(age, 0.0, SETTLE_TIME + 0.5)
    thawed_at = frozen_at + freeze
    for n in range(8):
        age.answered(frozen_at + n * freeze / 8, thawed_at)
    now = thawed_at
    for later in (0.8 * SETTLE_TIME, SETTLE_TIME + 0.3):
        bound = age.bound(now)
        assert bound is not None
        assert freeze <= bound <= freeze + 2 * PROBE_PERIOD + TRIP
        now = steady(age, now, thawed_at + later)
    bound = age.bound(now)
    assert bound is not None
    assert bound <= 2 * PROBE_PERIOD + 2 * TRIP


def test_no_age_is_known_after_this_process_was_frozen() -> None:
    age = RequestAge()
    now = steady(age, 0.0, SETTLE_TIME + 0.5)
    assert age.bound(now) is not None
    thawed_at = now + 5.0
    assert age.probes(thawed_at)
    assert age.bound(thawed_at) is None
    age.answered(thawed_at, thawed_at + TRIP)
    assert age.bound(thawed_at + 2 * TRIP) is None


def test_no_age_is_known_before_the_first_answer() -> None:
    assert RequestAge().bound(100.0) is None


@pytest.mark.parametrize(
    ("stamp", "age"),
    [
        (999.5, 0.5),
        (1000.4, 0.0),
        (1000.0 - MAX_STAMP_AGE - 0.1, None),
        (1000.0 + MAX_STAMP_AGE + 0.1, None),
        (0.0, None),
    ],
)
def test_a_stamp_counts_near_the_own_clock(stamp: float, age: float | None) -> None:
    assert by_stamp(stamp, 1000.0) == (None if age is None else pytest.approx(age))
