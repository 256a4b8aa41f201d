"""Conditioned scans: the meaning of each range, the memory of each ray, and rejected scans."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from msgspec import structs
from numpy.typing import NDArray

from swarmd.core.messages import Reason
from swarmd.core.values import Array, Odometry, Pose, Scan, ScanSpec, Twist
from swarmd.robot.sensing.conditioning import ScanConditioner
from swarmd.robot.sensing.ray_memory import PACKET_RAYS
from tests.support.kernel_forms import both_forms

FORMS = both_forms("swarmd.robot.sensing.conditioning")
BEARINGS = np.radians(np.arange(0.0, 360.0, 1.0))
SPEC = ScanSpec(BEARINGS, 5.0, 0.12, 3.5, is_noisy=False)
NOISY = replace(SPEC, is_noisy=True)
DRIVING = Odometry(0.0, Pose(), Twist(0.2))
STANDING = Odometry(0.0, Pose(), Twist())


LDS = replace(SPEC, zero="lds")
LOST, NARROW = slice(5, 40), slice(100, 110)  # wider than may be bridged, and narrower
Rays = int | slice | list[int] | NDArray[np.int_]


def raw(fill: float, *changes: tuple[Rays, float]) -> Array:
    """360 ranges, one a degree, that are `fill` but for some rays."""
    ranges = np.full(360, fill)
    for rays, value in changes:
        ranges[rays] = value
    return ranges


def raw_scan(ranges: Array | float, seq: int, bearings: Array = BEARINGS) -> Scan:
    filled = np.broadcast_to(np.asarray(ranges, dtype=np.float64), bearings.shape).copy()
    return Scan(seq, seq * 0.2, filled, bearings, 0.0, 100.0)


def conditioned(conditioner: ScanConditioner, ranges: Array | float, seq: int) -> Array:
    scan = conditioner.take(raw_scan(ranges, seq), DRIVING, seq * 0.2)
    assert isinstance(scan, Scan), scan
    return scan.ranges


def test_ranges_beyond_the_limits_become_infinite() -> None:
    ranges = raw(1.0, (0, 0.05), (1, 9.0), (2, np.inf), (3, -np.inf))
    got = conditioned(ScanConditioner(SPEC), ranges, 1)
    assert got[:5].tolist() == [-np.inf, np.inf, np.inf, -np.inf, 1.0]


@pytest.mark.parametrize(
    ("zero", "meaning"), [("too_close", -np.inf), ("no_return", np.inf), ("unknown", 1.0)]
)
def test_meaning_of_zero_comes_from_the_platform(zero: str, meaning: float) -> None:
    conditioner = ScanConditioner(replace(SPEC, zero=zero))
    assert conditioned(conditioner, raw(1.0, (7, 0.0)), 1)[7] == meaning


def test_lds_zero_after_a_near_return_is_too_close() -> None:
    conditioner = ScanConditioner(LDS)
    conditioned(conditioner, raw(2.0, (100, 0.2)), 1)
    got = conditioned(conditioner, raw(2.0, (slice(97, 104), 0.0), (110, 0.0)), 2)
    assert (got[97:104] == -np.inf).all()
    assert got[110] == 2.0  # a drop-out: the ray had a return, so it keeps its last range


@pytest.mark.parametrize(
    ("width", "is_lost"), [(1, True), (PACKET_RAYS, True), (PACKET_RAYS + 1, False)]
)
@pytest.mark.parametrize("first", [97, 357], ids=["anywhere", "across the first ray"])
def test_lost_lds_packet_beside_a_near_return_is_a_drop_out(
    first: int, width: int, is_lost: bool
) -> None:
    conditioner = ScanConditioner(LDS)
    rays = np.arange(first, first + width) % 360
    near = (first + 3) % 360, 0.2
    before = conditioned(conditioner, raw(2.0, near), 1)
    got = conditioned(conditioner, raw(2.0, near, (rays, 0.0)), 2)
    assert got[rays].tolist() == (before[rays] if is_lost else np.full(width, -np.inf)).tolist()


def test_near_return_explains_lds_zeros_for_1_s() -> None:
    conditioner = ScanConditioner(LDS)
    conditioned(conditioner, raw(2.0, (100, 0.15)), 1)
    zeros = raw(2.0, (slice(95, 106), 0.0))
    got = [conditioned(conditioner, zeros, seq) for seq in (2, 3, 4, 5, 7, 8)]
    assert [ranges[100] for ranges in got] == [-np.inf] * 4 + [np.inf] * 2
    # A zero that counts as near does not make the zeros beside it near.
    assert [np.isneginf(ranges).sum() for ranges in got] == [7] * 4 + [0] * 2


def test_lds_zero_without_a_recent_return_is_no_return() -> None:
    conditioner = ScanConditioner(LDS)
    conditioned(conditioner, raw(2.0, (60, np.inf)), 1)
    lost = raw(2.0, ([50, 60], 0.0))
    got = [conditioned(conditioner, lost, seq) for seq in range(2, 7)]
    assert SPEC.stale_after == pytest.approx(0.7)
    assert [ranges[50] for ranges in got] == [2.0, 2.0, 2.0, np.inf, np.inf]
    assert [ranges[60] for ranges in got] == [np.inf] * 5


def test_ray_far_from_remembered_rays_has_no_memory() -> None:
    """Only half a turn is remembered."""
    conditioner = ScanConditioner(replace(SPEC, bearings=BEARINGS[:180]))
    front = raw_scan(1.0, 1, BEARINGS[:180])
    assert isinstance(conditioner.take(front, DRIVING, 0.2), Scan)
    lost = raw(1.0, (slice(186, 201), np.nan))
    assert conditioner.take(raw_scan(lost, 2), DRIVING, 0.4) is Reason.INVALID_SCAN


def facing(yaw: float) -> Odometry:
    return Odometry(0.0, Pose(0.0, 0.0, yaw), Twist(0.0, 1.0))


def test_memory_is_rotated_by_the_turn_of_the_robot() -> None:
    conditioner = ScanConditioner(LDS)
    before = raw(0.0, (slice(60, 80), 1.0), (200, 0.15))
    conditioner.take(raw_scan(before, 1), facing(3.0), 0.2)
    after = raw(0.0, (slice(30, 50), 1.0), (slice(35, 41), 0.0))  # a drop-out
    scan = conditioner.take(raw_scan(after, 2), facing(3.0 + math.radians(30.0)), 0.4)
    assert isinstance(scan, Scan)
    assert np.flatnonzero(scan.ranges == 1.0).tolist() == list(range(30, 50))
    assert np.flatnonzero(np.isneginf(scan.ranges)).tolist() == list(range(167, 174))


def test_memory_is_rotated_by_turns_of_less_than_a_ray() -> None:
    conditioner = ScanConditioner(LDS)
    conditioner.take(raw_scan(raw(0.0, (100, 0.15)), 0), facing(0.0), 0.0)
    for n in range(1, 10):
        scan = conditioner.take(raw_scan(np.zeros(360), n), facing(math.radians(0.3 * n)), 0.1 * n)
    assert isinstance(scan, Scan)
    assert abs(np.flatnonzero(np.isneginf(scan.ranges)).mean() - 97.3) <= 1.0


@pytest.mark.parametrize("odometry", [None, facing(math.nan)])
def test_memory_stays_at_its_ray_without_a_heading(odometry: Odometry | None) -> None:
    conditioner = ScanConditioner(SPEC)
    conditioner.take(raw_scan(1.0, 1), facing(1.0), 0.2)
    for seq, measured in ((2, odometry), (3, facing(2.0))):
        scan = conditioner.take(raw_scan(raw(2.0, (5, np.nan)), seq), measured, 0.2 * seq)
        assert isinstance(scan, Scan)
        assert scan.ranges[5] == 1.0


def test_unknown_ray_keeps_its_range_for_stale_after() -> None:
    conditioner = ScanConditioner(SPEC)
    conditioned(conditioner, 1.0, 1)
    lost = raw(2.0, (LOST, np.nan))
    for seq in range(2, 5):
        assert (conditioned(conditioner, lost, seq)[LOST] == 1.0).all()
    assert conditioner.take(raw_scan(lost, 5), DRIVING, 1.0) is Reason.INVALID_SCAN


def ages(spec: ScanSpec, raws: list[Array]) -> list[float]:
    """The age of each scan on arrival, one every 0.2 s."""
    conditioner, found = ScanConditioner(spec), []
    for seq, ranges in enumerate(raws):
        conditioned(conditioner, ranges, seq)
        found.append(round(seq * 0.2 - conditioner.known_at, 9))
    return found


def lacking(*sectors: slice, lost: float = np.nan) -> Array:
    return raw(2.0, *((sector, lost) for sector in sectors))


@pytest.mark.parametrize(
    ("raws", "expected"),
    [
        ([(), (LOST,), (LOST,), (), (LOST,)], [0.0, 0.2, 0.4, 0.0, 0.2]),
        ([(), (LOST,), (slice(200, 240),)], [0.0, 0.2, 0.2]),
        # Bridged rays neither age a scan, nor count for the age of a sector lost later.
        ([(), (NARROW,), (NARROW,), (slice(None, None, 3),)], [0.0] * 4),
        ([(), (slice(15, 20),), (LOST,)], [0.0, 0.0, 0.2]),
        ([(), (slice(0, 20),), (LOST,)], [0.0, 0.2, 0.4]),
    ],
)
def test_scan_is_as_old_as_the_memory_of_its_lost_sector(
    raws: list[tuple[slice, ...]], expected: list[float]
) -> None:
    assert ages(SPEC, [lacking(*sectors) for sectors in raws]) == expected


def test_lds_zeros_do_not_age_a_scan() -> None:
    """A zero that lasts means no return."""
    raws = [lacking(), *[lacking(LOST, lost=0.0)] * 5]
    assert ages(LDS, raws) == [0.0] * 6
    assert ages(replace(SPEC, zero="unknown"), raws[:4]) == [0.0, 0.2, 0.4, 0.6]


def test_lost_sector_across_the_first_ray_ages_a_scan() -> None:
    raws = [lacking(), lacking(slice(0, 10), slice(350, 360))]
    assert ages(SPEC, raws) == [0.0, 0.2]
    clockwise = ScanConditioner(SPEC)
    for seq, ranges in enumerate(raws):
        got = clockwise.take(raw_scan(ranges, seq, -BEARINGS), DRIVING, seq * 0.2)
        assert isinstance(got, Scan)
    assert clockwise.known_at == 0.0


def test_one_of_two_rays_is_a_lost_sector() -> None:
    pair = np.array([0.0, math.pi])
    conditioner = ScanConditioner(replace(SPEC, bearings=pair))
    for seq, ranges in enumerate((np.ones(2), np.array([1.0, np.nan]))):
        assert isinstance(conditioner.take(raw_scan(ranges, seq, pair), DRIVING, seq * 0.2), Scan)
    assert conditioner.known_at == 0.0


@pytest.mark.parametrize("first", [20, 355], ids=["anywhere", "across the first ray"])
@pytest.mark.parametrize("edge", [-1, 11])
def test_narrow_unknown_sector_takes_the_nearer_edge(first: int, edge: int) -> None:
    rays = np.arange(first, first + 11) % 360
    ranges = raw(3.0, (rays, np.nan), ((first + edge) % 360, 1.5))
    assert (conditioned(ScanConditioner(SPEC), ranges, 1)[rays] == 1.5).all()


def test_at_least_half_of_the_rays_must_be_known() -> None:
    ranges = raw(1.0, (slice(None, None, 2), np.nan))
    conditioner = ScanConditioner(SPEC)
    assert (conditioned(conditioner, ranges, 1) == 1.0).all()
    ranges[1] = np.nan
    assert conditioner.take(raw_scan(ranges, 2), DRIVING, 0.4) is Reason.INVALID_SCAN


@pytest.mark.parametrize("width", [12, 13])
def test_sector_wider_than_max_gap_is_invalid(width: int) -> None:
    ranges = raw(3.0, (slice(20, 20 + width - 1), np.nan))  # from known ray to known ray
    got = ScanConditioner(SPEC).take(raw_scan(ranges, 1), None, 0.0)
    assert isinstance(got, Scan) == (width <= 12)


@pytest.mark.parametrize("scans", FORMS)
def test_masked_rays_are_unknown_and_filled_by_the_nearer_edge(scans: Any) -> None:
    """Sectors are from a bearing counter-clockwise to another one, here also across 0."""
    spec = replace(SPEC, mask=((math.radians(55), math.radians(61)), (math.radians(358), 0.0)))
    posts = [*range(55, 62), 358, 359, 0]
    ranges = raw(2.0, (posts, 0.05), (62, 1.0))
    assert (conditioned(scans.ScanConditioner(SPEC), ranges, 1)[posts] == -np.inf).all()
    got = conditioned(scans.ScanConditioner(spec), ranges, 1)
    assert got[54:64].tolist() == [2.0, *[1.0] * 8, 2.0]
    assert got[[357, 358, 359, 0, 1]].tolist() == [2.0] * 5


@pytest.mark.parametrize("scans", FORMS, ids=["text", "used"])
def test_a_scan_names_the_rays_that_it_did_not_measure(scans: Any) -> None:
    """Lost packets of an LDS, unknown rays and masks, but no ray that passed through."""
    mask = (math.radians(55), math.radians(61))
    conditioner = scans.ScanConditioner(replace(LDS, mask=(mask,)), guesses_near=False)
    first = conditioner.take(raw_scan(raw(2.0, (5, np.inf)), 1), DRIVING, 0.2)
    assert np.flatnonzero(first.filled).tolist() == [*range(55, 62)]
    ranges = raw(2.0, ([100, 101], 0.0), (200, np.nan), (5, np.inf))
    second = conditioner.take(raw_scan(ranges, 2), DRIVING, 0.4)
    assert np.flatnonzero(second.filled).tolist() == [*range(55, 62), 100, 101, 200]
    assert (second.ranges[second.filled == 1.0] == 2.0).all()
    plain = scans.ScanConditioner(LDS)
    assert plain.take(raw_scan(raw(2.0), 1), DRIVING, 0.2).filled is None


def test_memory_follows_the_bearing_when_the_rays_change() -> None:
    conditioner = ScanConditioner(SPEC)
    conditioned(conditioner, raw(2.0, (90, 0.5)), 1)
    bearings = np.linspace(0.0, 2.0 * math.pi, 355, endpoint=False)
    ranges = np.full(355, 2.0)
    lost = int(np.argmin(np.abs(bearings - math.pi / 2)))
    ranges[lost] = np.nan
    scan = conditioner.take(raw_scan(ranges, 2, bearings), DRIVING, 0.4)
    assert isinstance(scan, Scan)
    assert scan.ranges[lost] == 0.5


@pytest.mark.parametrize(("first", "last"), [(0, 90), (0, 1), (30, 347), (0, 345)])
def test_scan_without_rays_in_a_sector_is_invalid(first: int, last: int) -> None:
    """An incomplete revolution, unless the sensor never has rays there."""
    bearings = BEARINGS[first:last]
    got = ScanConditioner(SPEC).take(raw_scan(1.0, 1, bearings), None, 0.0)
    assert got is Reason.INVALID_SCAN
    assert isinstance(
        ScanConditioner(SPEC).take(raw_scan(1.0, 1, BEARINGS[5:355]), None, 0.0), Scan
    )
    few = replace(SPEC, bearings=bearings)
    assert isinstance(ScanConditioner(few).take(raw_scan(1.0, 1, bearings), None, 0.0), Scan)


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


@pytest.mark.parametrize(
    ("change", "is_noisy", "reason"),
    [
        ({"stamp": 0.4}, False, Reason.FROZEN_SCAN),
        ({"seq": 2}, True, Reason.FROZEN_SCAN),  # the last message again
        ({"seq": 2}, False, Reason.FROZEN_SCAN),
        ({"seq": 2, "ranges": raw_scan(1.1, 1).ranges}, True, Reason.FROZEN_STAMP),
        ({"seq": 2, "stamp": 0.0, "ranges": raw_scan(1.1, 1).ranges}, True, Reason.CLOCK_SET),
    ],
)
def test_same_sequence_or_stamp_holds(
    change: dict[str, Any], is_noisy: bool, reason: Reason
) -> None:
    conditioner = ScanConditioner(NOISY if is_noisy else SPEC)
    first = raw_scan(1.0, 1)
    conditioner.take(first, None, 0.0)
    assert conditioner.take(structs.replace(first, **change), None, 0.2) is reason


def test_stamps_of_zero_have_a_reason_of_their_own() -> None:
    conditioner = ScanConditioner(NOISY)
    scans = [structs.replace(raw_scan(1.0 + 0.1 * n, n), stamp=0.0) for n in range(1, 6)]
    found = [conditioner.take(scan, None, 0.2 * n) for n, scan in enumerate(scans)]
    assert found[1:] == [Reason.FROZEN_STAMP] * 4


@pytest.mark.parametrize("scans", FORMS)
@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize(
    ("stamps", "wanted"),
    [
        ([1.0, 1.0, 1.0, 1.0], [None, *[Reason.FROZEN_STAMP] * 3]),
        ([0.0, 0.0, 1.0, 0.0, 0.0],
         [None, Reason.FROZEN_STAMP, None, Reason.CLOCK_SET, Reason.FROZEN_STAMP]),
        ([9.0, 4.0, 4.2, 4.4, 4.6], [None, *[Reason.CLOCK_SET] * 3, None]),
    ],
    ids=["standing", "zeros", "set back"],
)  # fmt: skip
def test_scans_that_differ_are_rejected_for_their_stamps(
    stamps: list[float], wanted: list[Reason | None], noisy: bool, scans: Any
) -> None:
    conditioner = scans.ScanConditioner(NOISY if noisy else SPEC)
    found = []
    for n, stamp in enumerate(stamps):
        scan = structs.replace(raw_scan(1.0 + 0.01 * n, n), stamp=stamp)
        taken = conditioner.take(scan, DRIVING, 0.2 * n)
        found.append(None if isinstance(taken, Scan) else taken)
    assert found == wanted


def test_repeated_scan_keeps_the_age_of_the_first() -> None:
    conditioner = ScanConditioner(NOISY)
    for n in range(6):
        got = conditioner.take(raw_scan(1.0, n), DRIVING, 7.0 + n * 0.2)
        assert got is Reason.FROZEN_SCAN if n >= 3 else isinstance(got, Scan)
        assert conditioner.known_at == 7.0
    assert isinstance(conditioner.take(raw_scan(1.1, 6), DRIVING, 8.2), Scan)
    assert conditioner.known_at == 8.2


@pytest.mark.parametrize("odometry", [STANDING, None], ids=["standing", "unknown"])
def test_repeats_before_a_standing_robot_are_frozen(odometry: Odometry | None) -> None:
    """Otherwise a robot that starts would rely on an old scan."""
    conditioner = ScanConditioner(NOISY)
    got = [conditioner.take(raw_scan(1.0, n), odometry, 7.0 + n * 0.2) for n in range(9)]
    assert got[3:] == [Reason.FROZEN_SCAN] * 6
    assert conditioner.known_at == 7.0


def test_few_equal_returns_are_valid_while_standing() -> None:
    ranges = raw(np.inf, (slice(7), 1.0))
    conditioner = ScanConditioner(NOISY)
    for n in range(9):
        assert isinstance(conditioner.take(raw_scan(ranges, n), STANDING, n * 0.2), Scan)
    got = [conditioner.take(raw_scan(ranges, n), DRIVING, n * 0.2) for n in range(9, 15)]
    assert got[-1] is Reason.FROZEN_SCAN


@pytest.mark.parametrize("buffers", [2, 3, 4])
def test_old_scans_in_turn_are_repeats(buffers: int) -> None:
    conditioner = ScanConditioner(NOISY)
    got = [
        conditioner.take(raw_scan(1.0 + 0.1 * (n % buffers), n), DRIVING, n * 0.2)
        for n in range(12)
    ]
    assert all(isinstance(scan, Scan) for scan in got[:buffers])
    assert got[buffers + 2 :] == [Reason.FROZEN_SCAN] * (10 - buffers)
    assert conditioner.known_at == pytest.approx(0.2 * (buffers - 1))


def test_old_scans_with_old_sequences_are_frozen() -> None:
    conditioner = ScanConditioner(SPEC)
    got = [conditioner.take(raw_scan(1.0, 10 + n % 2), DRIVING, n * 0.2) for n in range(12)]
    assert got[2:] == [Reason.FROZEN_SCAN] * 10


def test_restarted_sensor_is_accepted_after_3_scans() -> None:
    conditioner = ScanConditioner(SPEC)
    got = [conditioner.take(raw_scan(1.0, n % 50), DRIVING, n * 0.2) for n in range(40, 60)]
    assert [isinstance(scan, Scan) for scan in got] == [*[True] * 10, *[False] * 3, *[True] * 7]


@pytest.mark.parametrize("nothing", [np.inf, 0.0])
def test_sudden_loss_of_all_returns_is_invalid(nothing: float) -> None:
    conditioner = ScanConditioner(replace(SPEC, zero="no_return"))
    some = raw(np.inf, (slice(36), 2.0))
    assert isinstance(conditioner.take(raw_scan(some, 1), DRIVING, 0.2), Scan)
    got = [conditioner.take(raw_scan(nothing, n), DRIVING, n * 0.2) for n in range(2, 30)]
    assert got == [Reason.INVALID_SCAN] * 28
    assert isinstance(conditioner.take(raw_scan(some, 30), DRIVING, 6.0), Scan)


@pytest.mark.parametrize(("rays", "distance"), [(35, 2.0), (360, 3.2), (360, 0.2)])
def test_few_or_near_returns_may_vanish_at_once(rays: int, distance: float) -> None:
    conditioner = ScanConditioner(SPEC)
    some = raw(np.inf, (slice(rays), distance))
    assert isinstance(conditioner.take(raw_scan(some, 1), DRIVING, 0.2), Scan)
    assert isinstance(conditioner.take(raw_scan(np.inf, 2), DRIVING, 0.4), Scan)


@pytest.mark.parametrize("why", ["exact_sensor", "empty_arena"])
def test_identical_scans_of_exact_sensors_are_valid(why: str) -> None:
    spec = SPEC if why == "exact_sensor" else NOISY
    seen = np.inf if why == "empty_arena" else 1.0
    conditioner = ScanConditioner(spec)
    for n in range(30):
        assert isinstance(conditioner.take(raw_scan(seen, n), DRIVING, n * 0.2), Scan)


def test_bearings_that_a_driver_changes_in_place_are_looked_at_again() -> None:
    bearings, conditioner = BEARINGS.copy(), ScanConditioner(SPEC)
    first = conditioner.take(raw_scan(1.0, 1, bearings), None, 0.0)
    bearings += 0.1
    second = conditioner.take(raw_scan(1.1, 2, bearings), None, 0.2)
    assert isinstance(first, Scan)
    assert isinstance(second, Scan)
    assert second.bearings is not first.bearings
    assert first.bearings == pytest.approx(BEARINGS)
    assert second.bearings == pytest.approx(BEARINGS + 0.1)
    bearings[:] = 0.0
    assert conditioner.take(raw_scan(1.2, 3, bearings), None, 0.4) is Reason.INVALID_SCAN


def test_bearings_that_stay_are_one_object() -> None:
    conditioner = ScanConditioner(SPEC)
    kept = [conditioner.take(raw_scan(1.0 + seq, seq), None, 0.2 * seq) for seq in (1, 2)]
    assert isinstance(kept[0], Scan)
    assert isinstance(kept[1], Scan)
    assert kept[0].bearings is kept[1].bearings


@pytest.mark.parametrize(
    ("kind", "expected"), [(np.float16, float(np.float16(0.3))), (np.float32, -math.inf)]
)
def test_range_of_low_precision_is_compared_with_the_limit_as_it_is(
    kind: type, expected: float
) -> None:
    spec = replace(SPEC, range_min=0.3 if kind is np.float16 else 0.12)
    ranges: Array = np.full(len(BEARINGS), 2.0, kind)
    ranges[3] = spec.range_min  # rounded
    scan = Scan(1, 0.2, ranges, BEARINGS, spec.range_min, spec.range_max)
    taken = ScanConditioner(spec).take(scan, None, 0.0)
    assert isinstance(taken, Scan)
    assert taken.ranges[3] == expected


@pytest.mark.parametrize("stamp", [math.nan, math.inf, -math.inf])
def test_a_stamp_that_is_not_finite_is_refused(stamp: float) -> None:
    conditioner = ScanConditioner(SPEC)
    scan = structs.replace(raw_scan(1.0, 1), stamp=stamp)
    assert conditioner.take(scan, None, 0.2) is Reason.INVALID_SCAN
    assert isinstance(conditioner.take(raw_scan(1.0, 2), None, 0.4), Scan)
