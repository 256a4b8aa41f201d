"""Sweeps that say nothing new: repeated ones, old ones, and those of a sensor gone blind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swarmd.core.messages import Reason
from swarmd.core.values import Array, Odometry, Pose, Scan, ScanSpec, Twist
from swarmd.sensing.conditioning import ScanConditioner

BEARINGS = np.radians(np.arange(0.0, 360.0, 1.0))
SPEC = ScanSpec(BEARINGS, 5.0, 0.12, 3.5, is_noisy=False)
NOISY = replace(SPEC, is_noisy=True)
DRIVING = Odometry(0.0, Pose(), Twist(0.2))
STANDING = Odometry(0.0, Pose(), Twist())


def sweep(ranges: Array | float, seq: int) -> Scan:
    filled = np.broadcast_to(np.asarray(ranges, dtype=np.float64), BEARINGS.shape).copy()
    return Scan(seq, seq * 0.2, filled, BEARINGS, 0.0, 100.0)


@pytest.mark.parametrize("same", ["seq", "stamp"])
def test_a_sequence_or_stamp_that_stands_still_is_frozen(same: str) -> None:
    conditioner = ScanConditioner(SPEC)
    first = sweep(1.0, 1)
    conditioner.take(first, None, 0.0)
    again = replace(first, stamp=0.4) if same == "seq" else replace(first, seq=2)
    assert conditioner.take(again, None, 0.2) is Reason.FROZEN_SCAN


def test_a_noisy_sensor_that_repeats_itself_while_driving_is_as_old_as_what_it_repeats() -> None:
    conditioner = ScanConditioner(NOISY)
    for n in range(6):
        got = conditioner.take(sweep(1.0, n), DRIVING, 7.0 + n * 0.2)
        assert got is Reason.FROZEN_SCAN if n >= 3 else isinstance(got, Scan)
        assert conditioner.known_at == 7.0
    assert isinstance(conditioner.take(sweep(1.1, 6), DRIVING, 8.2), Scan)
    assert conditioner.known_at == 8.2


@pytest.mark.parametrize("odometry", [STANDING, None], ids=["standing", "unknown"])
def test_a_noisy_sensor_does_not_repeat_itself_of_a_scene_that_stands_either(
    odometry: Odometry | None,
) -> None:
    """Else a robot that is set going would rest on a sweep from long ago."""
    conditioner = ScanConditioner(NOISY)
    got = [conditioner.take(sweep(1.0, n), odometry, 7.0 + n * 0.2) for n in range(9)]
    assert got[3:] == [Reason.FROZEN_SCAN] * 6
    assert conditioner.known_at == 7.0


def test_a_few_returns_may_be_the_same_while_it_stands() -> None:
    ranges = np.full(360, np.inf)
    ranges[:7] = 1.0
    conditioner = ScanConditioner(NOISY)
    for n in range(9):
        assert isinstance(conditioner.take(sweep(ranges, n), STANDING, n * 0.2), Scan)
    got = [conditioner.take(sweep(ranges, n), DRIVING, n * 0.2) for n in range(9, 15)]
    assert got[-1] is Reason.FROZEN_SCAN


@pytest.mark.parametrize("buffers", [2, 3, 4])
def test_old_sweeps_in_turn_are_repeats_too(buffers: int) -> None:
    conditioner = ScanConditioner(NOISY)
    got = [
        conditioner.take(sweep(1.0 + 0.1 * (n % buffers), n), DRIVING, n * 0.2) for n in range(12)
    ]
    assert all(isinstance(scan, Scan) for scan in got[:buffers])
    assert got[buffers + 2 :] == [Reason.FROZEN_SCAN] * (10 - buffers)
    assert conditioner.known_at == pytest.approx(0.2 * (buffers - 1))


def test_old_sweeps_with_their_own_numbers_are_none() -> None:
    conditioner = ScanConditioner(SPEC)
    got = [conditioner.take(sweep(1.0, 10 + n % 2), DRIVING, n * 0.2) for n in range(12)]
    assert got[2:] == [Reason.FROZEN_SCAN] * 10


def test_a_sensor_that_starts_anew_is_believed_after_a_few_sweeps() -> None:
    conditioner = ScanConditioner(SPEC)
    got = [conditioner.take(sweep(1.0, n % 50), DRIVING, n * 0.2) for n in range(40, 60)]
    assert [isinstance(scan, Scan) for scan in got] == [*[True] * 10, *[False] * 3, *[True] * 7]


@pytest.mark.parametrize("nothing", [np.inf, 0.0])
def test_a_sensor_that_sees_nothing_at_once_is_blind_until_it_sees_something(
    nothing: float,
) -> None:
    spec = replace(SPEC, zero="no_return")
    conditioner, dark = ScanConditioner(spec), np.full(360, nothing)
    some = np.where(np.arange(360) < 36, 2.0, np.inf)
    assert isinstance(conditioner.take(sweep(some, 1), DRIVING, 0.2), Scan)
    got = [conditioner.take(sweep(dark, n), DRIVING, n * 0.2) for n in range(2, 30)]
    assert got == [Reason.INVALID_SCAN] * 28
    assert isinstance(conditioner.take(sweep(some, 30), DRIVING, 6.0), Scan)


@pytest.mark.parametrize(("rays", "distance"), [(35, 2.0), (360, 3.2), (360, 0.2)])
def test_little_that_is_far_or_near_may_be_gone_at_once(rays: int, distance: float) -> None:
    conditioner = ScanConditioner(SPEC)
    some = np.where(np.arange(360) < rays, distance, np.inf)
    assert isinstance(conditioner.take(sweep(some, 1), DRIVING, 0.2), Scan)
    assert isinstance(conditioner.take(sweep(np.inf, 2), DRIVING, 0.4), Scan)


@pytest.mark.parametrize("why", ["exact_sensor", "empty_arena"])
def test_identical_scans_are_no_fault_where_they_are_to_be_expected(why: str) -> None:
    spec = SPEC if why == "exact_sensor" else NOISY
    seen = np.inf if why == "empty_arena" else 1.0
    conditioner = ScanConditioner(spec)
    for n in range(30):
        assert isinstance(conditioner.take(sweep(seen, n), DRIVING, n * 0.2), Scan)
