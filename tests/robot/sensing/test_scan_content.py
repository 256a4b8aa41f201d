"""What a check tells of the scans of a sensor."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from swarmd.core.values import Scan, ScanSpec
from swarmd.robot.protection.footprint import Footprint
from swarmd.robot.sensing.scan_content import ENOUGH_SCANS, ScanContent
from swarmd.settings.platforms import load_platform

SPEC = load_platform("burger").scan
NEAR = load_platform("thymio").scan
RAYS = 8
BEARINGS = np.linspace(-math.pi, math.pi, RAYS, endpoint=False)


def content(
    *scans: list[float], spec: ScanSpec = SPEC, repeated: int = ENOUGH_SCANS
) -> ScanContent:
    """Scans of `RAYS` rays, one after the other, as often as that."""
    made = ScanContent(spec)
    for seq in range(repeated * len(scans)):
        ranges = np.array(scans[seq % len(scans)], np.float64)
        made.take(Scan(seq, 0.2 * seq, ranges, BEARINGS, spec.range_min, spec.range_max))
    return made


def test_tells_returns_the_nearest_and_whether_scans_differ() -> None:
    half = [1.0, 0.5, 3.0, 3.4, math.inf, 0.0, 9.0, math.nan]
    differ = content(*([(1.0 + 0.01 * k) * one for one in half] for k in range(5)), repeated=1)
    assert differ.text == "8 rays, 38 % with a return, the nearest at 0.52 m, scans differ"
    same = content(half)
    assert same.text == "8 rays, 50 % with a return, the nearest at 0.50 m, scans are identical"
    assert "scans" not in content(half, repeated=1).text, "of one scan"
    assert "too close to measure" in content([-math.inf] * RAYS).text
    assert ScanContent(SPEC).text == ""


@pytest.mark.parametrize(
    ("near", "zero", "has_mask"),
    [(0.09, "lds", True), (-math.inf, "lds", False), (0.0, "too_close", False)],
)
def test_rays_that_end_inside_the_outline_propose_a_mask_if_they_are_measured(
    near: float, zero: str, has_mask: bool
) -> None:
    """A Burger whose lidar sees a post 0.09 m to its left, and another one behind, across 180.

    A value that means too close may be a driver's "no return", in sectors that are free.
    """
    burger = load_platform("burger")
    spec = replace(SPEC, zero=zero)
    bearings = np.radians(np.arange(360.0))
    post = np.array([*range(88, 93), *range(358, 360), 0, 1])
    made = ScanContent(spec, gaps=Footprint(burger.footprint).gaps)
    masked = ScanContent(
        replace(spec, mask=((math.radians(87), math.radians(94)), (math.radians(357), 0.05))),
        gaps=Footprint(burger.footprint).gaps,
    )
    rng = np.random.default_rng(1)
    for seq in range(ENOUGH_SCANS):
        ranges = rng.uniform(0.5, 2.0, 360)
        ranges[post] = near
        ranges[120 + seq] = near  # a hand, not in each scan
        for content in (made, masked):
            content.take(Scan(seq, 0.2 * seq, ranges, bearings, 0.0, 3.5))
    assert "rays at [[88, 93], [358, 2]] deg" in made.fault
    assert made.fault.endswith("scan.mask to [[87, 94], [357, 3]]") is has_mask
    assert ("mask" in made.fault) is has_mask
    assert ("REP 117" in made.fault) is not has_mask
    assert masked.fault == ""
    assert ScanContent(spec).fault == ""


def test_a_mask_keeps_its_other_sectors_and_leaves_the_robot_its_sight() -> None:
    """A post 0.09 m away: a few degrees wide, so wide as no mask may be, and all round."""
    gaps = Footprint(load_platform("burger").footprint).gaps
    spec = replace(SPEC, mask=((math.radians(200), math.radians(205)),))
    for width, part in ((3, "to [[200.0, 205.0], [9, 14]]"), (20, ""), (360, "")):
        made, rng = ScanContent(spec, gaps=gaps), np.random.default_rng(1)
        for seq in range(ENOUGH_SCANS):
            ranges = rng.uniform(0.5, 2.0, 360)
            ranges[10 : 10 + width] = rng.uniform(0.07, 0.09, len(ranges[10 : 10 + width]))
            made.take(Scan(seq, 0.2 * seq, ranges, np.radians(np.arange(360.0)), 0.0, 3.5))
        assert "inside the robot's outline" in made.fault
        assert ("scan.mask" in made.fault) is bool(part)
        assert part in made.fault


MEASURED = [1.0, 1.25, 1.5, 1.75] * 8


@pytest.mark.parametrize(
    ("code", "told"),
    [
        (-math.inf, "-inf 60 % (too close, by REP 117)"),
        (math.inf, "inf 60 % (no return)"),
        (math.nan, "nan 60 % (unknown)"),
        (0.0, "0 60 % (lds, by the platform's scan.zero)"),
        (-1.0, "-1 60 % (unknown"),
        (2.0, "2 60 % (the message's own range_max"),
        (3.5, "3.5 60 % (one value"),
        (0.001, "0.001 60 % (one value"),
        (3.6, "3.6 60 % (no return: over"),
        (65.535, "65.535 60 % (no return: over"),
        (1e30, "1e+30 60 % (no return: over"),
    ],
)
def test_each_code_of_a_ray_without_a_distance_is_named_first_and_no_guard_is_given_away(
    code: float, told: str
) -> None:
    """Of 80 rays 48 have a code, and the scan repeats, which is a fault of its own."""
    ranges = np.array([*MEASURED, *[code] * 48])
    bearings = np.linspace(-math.pi, math.pi, 80, endpoint=False)
    made = ScanContent(SPEC, gaps=Footprint(load_platform("burger").footprint).gaps)
    for seq in range(ENOUGH_SCANS):
        made.take(Scan(seq, 0.2 * seq, ranges, bearings, 0.12, 3.5), 2.0)
    assert made.encoding.startswith(told)
    assert made.fault.startswith(told)
    for removed in ("noisy", "mask", "max_gap", "scan.rate", "correct"):
        assert removed not in made.fault


def test_few_rays_of_the_greatest_distance_are_named() -> None:
    """Of 88 rays 10 have the range_max of the message, and no other distance is as frequent."""
    ranges = np.array([*np.linspace(0.5, 1.9, 78), *[2.0] * 10])
    made = ScanContent(SPEC)
    made.take(Scan(0, 0.0, ranges, np.linspace(-3.0, 3.0, 88), 0.12, 3.5), 2.0)
    assert made.encoding.startswith("2 11 % (the message's own range_max")
    made.take(Scan(0, 0.0, ranges, np.linspace(-3.0, 3.0, 88), 0.12, 3.5), 100.0)
    assert made.encoding == ""


def test_measured_distances_are_no_code() -> None:
    assert content([1.0, 2.0, 3.0, 1.1, 1.2, 1.3, 0.5, 0.4]).encoding == ""
    assert ScanContent(SPEC).encoding == ""
    millimetres = content([1000.0 + k for k in range(RAYS)])
    assert millimetres.encoding.startswith("1000 to 1007 100 %")
    assert "scan.range_max" not in millimetres.fault.partition(";")[2]


@pytest.mark.parametrize(
    ("first", "last", "note"),
    [
        (-72, 72, "no return between 287 and 73 deg"),
        (100, 260, "no return between 99 and 261 deg"),
        (10, 30, ""),  # narrow
    ],
)
def test_a_wide_sector_without_a_return_is_a_note_and_no_fault(
    first: int, last: int, note: str
) -> None:
    made = ScanContent(SPEC)
    degrees = np.rint(np.degrees(SPEC.bearings))
    is_dead = (degrees - first) % 360 <= last - first
    for seq in range(ENOUGH_SCANS):
        ranges = np.where(is_dead, math.inf, 1.0 + 0.01 * seq)
        made.take(Scan(seq, 0.2 * seq, ranges, SPEC.bearings, SPEC.range_min, SPEC.range_max))
    assert made.fault == ""
    assert note in made.text
    assert ("no return" in made.text) == bool(note)


@pytest.mark.parametrize(
    ("ranges", "changes", "fault"),
    [
        ([0.0] * RAYS, {}, "are 0"),
        ([0.0] * RAYS, {"is_noisy": False}, "are 0"),
        ([math.inf] * RAYS, {}, "within 3.5 m"),
        ([math.nan, 0.0] * (RAYS // 2), {}, "within 3.5 m"),
        ([math.inf] * RAYS, {"range_max": 0.2}, ""),
        ([-math.inf] * RAYS, {"is_noisy": False}, ""),
        ([1.0] * RAYS, {}, "frozen_scan"),
        ([1.0] * RAYS, {"is_noisy": False}, ""),
        ([1.0] + [math.inf] * (RAYS - 1), {}, ""),
    ],
)
def test_what_no_sensor_measures_is_a_fault(
    ranges: list[float], changes: dict[str, object], fault: str
) -> None:
    found = content(ranges, spec=replace(SPEC, **changes)).fault  # type: ignore[arg-type]
    assert bool(found) == bool(fault)
    assert fault in found


def test_a_sensor_that_repeats_an_earlier_scan_is_frozen_as_conditioning_says() -> None:
    one, two = [1.0] * RAYS, [1.1] * RAYS
    assert content(one, two, repeated=3).fault
    assert not content(one, repeated=ENOUGH_SCANS - 1).fault, "two of a kind come of some drivers"
    assert not content(one, one, two, two, *([0.1 * k] * RAYS for k in range(12, 20))).fault


def test_a_near_sensor_needs_no_return() -> None:
    assert not content([math.inf] * RAYS, spec=NEAR).fault
    assert content([0.0] * RAYS, spec=NEAR).fault
