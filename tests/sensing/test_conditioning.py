from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from swarmd.core.messages import Reason
from swarmd.core.values import Array, Odometry, Pose, Scan, ScanSpec, Twist
from swarmd.sensing.conditioning import PACKET_RAYS, ScanConditioner

BEARINGS = np.radians(np.arange(0.0, 360.0, 1.0))
SPEC = ScanSpec(BEARINGS, 5.0, 0.12, 3.5, is_noisy=False)
NOISY = replace(SPEC, is_noisy=True)
DRIVING = Odometry(0.0, Pose(), Twist(0.2))


def sweep(ranges: Array | float, seq: int, bearings: Array = BEARINGS) -> Scan:
    filled = np.broadcast_to(np.asarray(ranges, dtype=np.float64), bearings.shape).copy()
    return Scan(seq, seq * 0.2, filled, bearings, 0.0, 100.0)


def conditioned(conditioner: ScanConditioner, ranges: Array | float, seq: int) -> Array:
    scan = conditioner.take(sweep(ranges, seq), DRIVING, seq * 0.2)
    assert isinstance(scan, Scan), scan
    return scan.ranges


def test_limits_come_from_the_platform_not_from_the_message() -> None:
    scan = ScanConditioner(SPEC).take(sweep(1.0, 1), None, 0.0)
    assert isinstance(scan, Scan)
    assert (scan.range_min, scan.range_max) == (0.12, 3.5)


def test_too_near_is_near_and_too_far_is_nothing() -> None:
    ranges = np.full(360, 1.0)
    ranges[:4] = [0.05, 9.0, np.inf, -np.inf]
    got = conditioned(ScanConditioner(SPEC), ranges, 1)
    assert got[:5].tolist() == [-np.inf, np.inf, np.inf, -np.inf, 1.0]


@pytest.mark.parametrize(
    ("zero", "meaning"), [("no_return", np.inf), ("too_close", -np.inf), ("unknown", 1.0)]
)
def test_zero_means_what_the_platform_says(zero: str, meaning: float) -> None:
    conditioner = ScanConditioner(replace(SPEC, zero=zero))
    ranges = np.full(360, 1.0)
    ranges[7] = 0.0
    assert conditioned(conditioner, ranges, 1)[7] == meaning


def test_an_lds_zero_is_too_close_where_something_was_near_just_before() -> None:
    conditioner = ScanConditioner(replace(SPEC, zero="lds"))
    before = np.full(360, 2.0)
    before[100] = 0.2
    conditioned(conditioner, before, 1)
    after = np.full(360, 2.0)
    after[97:104] = 0.0
    after[110] = 0.0
    got = conditioned(conditioner, after, 2)
    assert (got[97:104] == -np.inf).all()
    assert got[110] == 2.0  # a drop-out: the ray had a return, so it keeps its last range


@pytest.mark.parametrize(
    ("width", "is_lost"), [(1, True), (PACKET_RAYS, True), (PACKET_RAYS + 1, False)]
)
@pytest.mark.parametrize("first", [97, 357], ids=["anywhere", "across the first ray"])
def test_a_packet_that_an_lds_loses_beside_what_is_near_is_not_something_nearer(
    first: int, width: int, is_lost: bool
) -> None:
    conditioner = ScanConditioner(replace(SPEC, zero="lds"))
    rays = np.arange(first, first + width) % 360
    before = np.full(360, 2.0)
    before[(first + 3) % 360] = 0.2
    conditioned(conditioner, before, 1)
    after = before.copy()
    after[rays] = 0.0
    got = conditioned(conditioner, after, 2)
    assert got[rays].tolist() == (before[rays] if is_lost else np.full(width, -np.inf)).tolist()


def test_who_remembers_what_is_near_himself_has_no_zeros_guessed() -> None:
    conditioner = ScanConditioner(replace(SPEC, zero="lds"), guesses_near=False)
    before = np.full(360, 2.0)
    before[100] = 0.2
    conditioned(conditioner, before, 1)
    after = np.full(360, 2.0)
    after[97:104] = 0.0
    got = [conditioned(conditioner, after, seq)[97:104] for seq in range(2, 7)]
    assert not np.isneginf(got).any()
    assert np.isposinf(got[-1]).all()


def test_an_lds_zero_is_something_near_for_a_second_after_it_was_measured_near() -> None:
    conditioner = ScanConditioner(replace(SPEC, zero="lds"))
    before = np.full(360, 2.0)
    before[100] = 0.15
    conditioned(conditioner, before, 1)
    after = np.full(360, 2.0)
    after[95:106] = 0.0
    got = [conditioned(conditioner, after, seq) for seq in (2, 3, 4, 5, 7, 8)]
    assert [ranges[100] for ranges in got] == [-np.inf] * 4 + [np.inf] * 2
    # What zeros are said to mean is no measurement, from which the next ray's would follow.
    assert [np.isneginf(ranges).sum() for ranges in got] == [7] * 4 + [0] * 2


def test_an_lds_zero_is_no_return_where_nothing_was_seen_before() -> None:
    conditioner = ScanConditioner(replace(SPEC, zero="lds"))
    before = np.full(360, 2.0)
    before[50] = np.inf
    conditioned(conditioner, before, 1)
    after = np.full(360, 2.0)
    after[50] = 0.0
    assert conditioned(conditioner, after, 2)[50] == np.inf


def test_an_lds_zero_where_the_last_return_is_too_old_is_no_return() -> None:
    conditioner = ScanConditioner(replace(SPEC, zero="lds"))
    conditioned(conditioner, 2.0, 1)
    lost = np.full(360, 2.0)
    lost[50] = 0.0
    got = [conditioned(conditioner, lost, seq)[50] for seq in range(2, 7)]
    assert SPEC.stale_after == pytest.approx(0.7)
    assert got == [2.0, 2.0, 2.0, np.inf, np.inf]


def test_a_ray_far_from_all_that_is_remembered_has_no_memory() -> None:
    """Half a turn was known; of the other half nothing is made up."""
    conditioner = ScanConditioner(replace(SPEC, bearings=BEARINGS[:180]))
    front = sweep(1.0, 1, BEARINGS[:180])
    assert isinstance(conditioner.take(front, DRIVING, 0.2), Scan)
    ranges = np.full(360, 1.0)
    ranges[186:201] = np.nan
    assert conditioner.take(sweep(ranges, 2), DRIVING, 0.4) is Reason.INVALID_SCAN


def facing(yaw: float) -> Odometry:
    return Odometry(0.0, Pose(0.0, 0.0, yaw), Twist(0.0, 1.0))


def test_what_is_remembered_stays_where_it_was_while_the_sensor_turns() -> None:
    conditioner = ScanConditioner(replace(SPEC, zero="lds"))
    before = np.zeros(360)
    before[60:80] = 1.0
    before[200] = 0.15
    conditioner.take(sweep(before, 1), facing(3.0), 0.2)
    after = np.zeros(360)
    after[30:50] = 1.0
    after[35:41] = 0.0  # a drop-out
    scan = conditioner.take(sweep(after, 2), facing(3.0 + math.radians(30.0)), 0.4)
    assert isinstance(scan, Scan)
    assert np.flatnonzero(scan.ranges == 1.0).tolist() == list(range(30, 50))
    assert np.flatnonzero(np.isneginf(scan.ranges)).tolist() == list(range(167, 174))


def test_slow_turns_add_up() -> None:
    conditioner = ScanConditioner(replace(SPEC, zero="lds"))
    ranges = np.zeros(360)
    ranges[100] = 0.15
    conditioner.take(sweep(ranges, 0), facing(0.0), 0.0)
    for n in range(1, 10):
        scan = conditioner.take(sweep(np.zeros(360), n), facing(math.radians(0.3 * n)), 0.1 * n)
    assert isinstance(scan, Scan)
    assert abs(np.flatnonzero(np.isneginf(scan.ranges)).mean() - 97.3) <= 1.0


@pytest.mark.parametrize("odometry", [None, facing(math.nan)])
def test_without_a_heading_what_is_remembered_stays_by_the_ray(odometry: Odometry | None) -> None:
    conditioner = ScanConditioner(SPEC)
    conditioner.take(sweep(1.0, 1), facing(1.0), 0.2)
    for seq, told in ((2, odometry), (3, facing(2.0))):
        ranges = np.full(360, 2.0)
        ranges[5] = np.nan
        scan = conditioner.take(sweep(ranges, seq), told, 0.2 * seq)
        assert isinstance(scan, Scan)
        assert scan.ranges[5] == 1.0


def test_an_unknown_ray_keeps_its_last_range_for_stale_after_only() -> None:
    conditioner = ScanConditioner(SPEC)
    conditioned(conditioner, 1.0, 1)
    lost = np.full(360, 2.0)
    lost[5:40] = np.nan  # wider than may be bridged
    for seq in range(2, 5):
        assert (conditioned(conditioner, lost, seq)[5:40] == 1.0).all()
    assert conditioner.take(sweep(lost, 5), DRIVING, 1.0) is Reason.INVALID_SCAN


LOST, NARROW = slice(5, 40), slice(100, 110)


def ages(spec: ScanSpec, raws: list[Array]) -> list[float]:
    """How old each scan is as it arrives, one every 0.2 s."""
    conditioner, found = ScanConditioner(spec), []
    for seq, ranges in enumerate(raws):
        conditioned(conditioner, ranges, seq)
        found.append(round(seq * 0.2 - conditioner.known_at, 9))
    return found


def lacking(*sectors: slice, what: float = np.nan) -> Array:
    ranges = np.full(360, 2.0)
    for sector in sectors:
        ranges[sector] = what
    return ranges


def test_a_scan_that_lacks_a_wide_sector_is_as_old_as_what_is_remembered_of_it() -> None:
    raws = [lacking(), lacking(LOST), lacking(LOST), lacking(), lacking(LOST)]
    assert ages(SPEC, raws) == [0.0, 0.2, 0.4, 0.0, 0.2]


def test_what_is_seen_again_is_as_new_as_the_rest() -> None:
    assert ages(SPEC, [lacking(), lacking(LOST), lacking(slice(200, 240))]) == [0.0, 0.2, 0.2]


def test_single_rays_and_sectors_that_can_be_bridged_do_not_make_a_scan_older() -> None:
    scattered = lacking()
    scattered[::3] = np.nan
    assert ages(SPEC, [lacking(), lacking(NARROW), lacking(NARROW), scattered]) == [0.0] * 4


def test_a_lost_sector_is_as_new_as_its_rays_without_those_that_can_be_bridged() -> None:
    """Of the sector's rays a few were missing already the time before: that was no lost sector."""
    inside = slice(15, 20)
    assert ages(SPEC, [lacking(), lacking(inside), lacking(LOST)]) == [0.0, 0.0, 0.2]
    assert ages(SPEC, [lacking(), lacking(slice(0, 20)), lacking(LOST)]) == [0.0, 0.2, 0.4]


def test_a_lost_sector_across_the_first_ray_counts_too() -> None:
    around = [slice(0, 10), slice(350, 360)]
    assert ages(SPEC, [lacking(), lacking(*around)]) == [0.0, 0.2]
    clockwise = ScanConditioner(SPEC)
    for seq, ranges in enumerate([lacking(), lacking(*around)]):
        assert isinstance(clockwise.take(sweep(ranges, seq, -BEARINGS), DRIVING, seq * 0.2), Scan)
    assert clockwise.known_at == 0.0


def test_of_two_rays_one_is_a_lost_sector() -> None:
    pair = np.array([0.0, math.pi])
    conditioner = ScanConditioner(replace(SPEC, bearings=pair))
    for seq, ranges in enumerate((np.ones(2), np.array([1.0, np.nan]))):
        assert isinstance(conditioner.take(sweep(ranges, seq, pair), DRIVING, seq * 0.2), Scan)
    assert conditioner.known_at == 0.0


def test_zeros_of_an_lds_do_not_make_a_scan_older() -> None:
    """They say that nothing is there, as soon as they have lasted."""
    raws = [lacking(), *[lacking(LOST, what=0.0)] * 5]
    assert ages(replace(SPEC, zero="lds"), raws) == [0.0] * 6
    assert ages(replace(SPEC, zero="unknown"), raws[:4]) == [0.0, 0.2, 0.4, 0.6]


def test_a_narrow_unknown_sector_takes_the_nearer_of_its_edges() -> None:
    ranges = np.full(360, 3.0)
    ranges[20:31] = np.nan
    ranges[19] = 1.5
    got = conditioned(ScanConditioner(SPEC), ranges, 1)
    assert (got[20:31] == 1.5).all()


def test_an_unknown_sector_across_the_first_ray_is_bridged_too() -> None:
    ranges = np.full(360, 3.0)
    ranges[-5:] = np.nan
    ranges[:5] = np.nan
    ranges[5] = 0.7
    got = conditioned(ScanConditioner(SPEC), ranges, 1)
    assert (got[:5] == 0.7).all()
    assert (got[-5:] == 0.7).all()


@pytest.mark.parametrize("width", [12, 13])
def test_a_sector_wider_than_max_gap_makes_the_scan_invalid(width: int) -> None:
    ranges = np.full(360, 3.0)
    ranges[20 : 20 + width - 1] = np.nan  # the gap reaches from known ray to known ray
    got = ScanConditioner(SPEC).take(sweep(ranges, 1), None, 0.0)
    assert isinstance(got, Scan) == (width <= 12)


def test_fewer_than_half_known_rays_are_no_scan_even_with_a_memory() -> None:
    conditioner = ScanConditioner(SPEC)
    conditioned(conditioner, 1.0, 1)
    ranges = np.full(360, 1.0)
    ranges[:181] = np.nan
    assert conditioner.take(sweep(ranges, 2), DRIVING, 0.4) is Reason.INVALID_SCAN


def test_every_second_ray_unknown_is_still_a_scan() -> None:
    ranges = np.full(360, 1.0)
    ranges[::2] = np.nan
    assert (conditioned(ScanConditioner(SPEC), ranges, 1) == 1.0).all()


def test_the_number_of_rays_may_change_and_the_memory_follows_the_bearing() -> None:
    conditioner = ScanConditioner(SPEC)
    before = np.full(360, 2.0)
    before[90] = 0.5
    conditioned(conditioner, before, 1)
    bearings = np.linspace(0.0, 2.0 * math.pi, 355, endpoint=False)
    ranges = np.full(355, 2.0)
    lost = int(np.argmin(np.abs(bearings - math.pi / 2)))
    ranges[lost] = np.nan
    scan = conditioner.take(sweep(ranges, 2, bearings), DRIVING, 0.4)
    assert isinstance(scan, Scan)
    assert scan.ranges[lost] == 0.5


@pytest.mark.parametrize(("first", "last"), [(0, 90), (0, 1), (30, 347), (0, 345)])
def test_where_no_ray_goes_nothing_would_be_seen(first: int, last: int) -> None:
    """A sensor that looks all around has sent the beginning of a sweep, or some of it."""
    bearings = BEARINGS[first:last]
    got = ScanConditioner(SPEC).take(sweep(1.0, 1, bearings), None, 0.0)
    assert got is Reason.INVALID_SCAN
    few = replace(SPEC, bearings=bearings)
    assert isinstance(ScanConditioner(few).take(sweep(1.0, 1, bearings), None, 0.0), Scan)


def test_a_few_rays_less_are_none_the_worse() -> None:
    got = ScanConditioner(SPEC).take(sweep(1.0, 1, BEARINGS[5:355]), None, 0.0)
    assert isinstance(got, Scan)


@given(arrays(np.float64, st.integers(0, 40)), st.integers(0, 41))
def test_any_garbage_gives_a_clean_scan_or_a_reason(ranges: Array, n: int) -> None:
    bearings = np.linspace(-math.pi, math.pi, n)
    got = ScanConditioner(SPEC).take(Scan(1, 0.0, ranges, bearings, 0.0, 1.0), None, 0.0)
    if isinstance(got, Scan):
        known = np.isfinite(got.ranges)
        assert not np.isnan(got.ranges).any()
        assert ((got.ranges[known] >= 0.12) & (got.ranges[known] <= 3.5)).all()
    else:
        assert got is Reason.INVALID_SCAN
