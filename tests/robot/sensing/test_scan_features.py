"""Features of scans: as recorded, and malformed scans are refused."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest

from swarmd.core.values import Array, Scan
from swarmd.robot.sensing.scan_layout import ScanLayout, ScanLayouts
from tests.support.recorded_scans import KERNEL, SPECS, assert_same, recorded


def test_features_are_as_recorded() -> None:
    for case in recorded("features"):
        ranges, bearings = case["scan"].astype(np.float64)
        range_min, range_max, within, count = case["how"].tolist()
        scan = Scan(0, 0.0, ranges, bearings, range_min, range_max)
        found = [KERNEL.nearest(scan, 0.0, math.pi), KERNEL.nearest(scan, 0.5, 1.0)]
        assert_same([case["nearest"]], [np.array([one or (math.nan,) * 2 for one in found])])
        assert_same([case["closest"]], [KERNEL.closest_points(scan, within, int(count))])
        objects = KERNEL.clusters(scan, within, 0.06, math.radians(10.0))
        assert_same(case["clusters"], np.array(objects, np.float64).reshape(-1, 5).T)


def test_malformed_scan_or_count_is_refused_and_ends_no_process() -> None:
    bearings = SPECS[0].bearings
    n = len(bearings)

    def scan(ranges: Array, bearings: Array) -> Scan:
        return Scan(1, 1.0, ranges, bearings, 0.1, 3.5)

    odd = np.array(bearings)
    odd[n // 2] = math.nan
    malformed = {
        "both \\(n,\\)": [
            scan(np.ones(n), bearings[:0]),
            scan(np.ones(n), bearings[:3]),
            scan(np.ones(n - 1), bearings),
            scan(np.ones((2, n)), np.stack((bearings, bearings))),
        ],
        "a finite angle": [scan(np.ones(n), odd)],
    }
    for text, scans in malformed.items():
        for one in scans:
            with pytest.raises(ValueError, match=text):
                KERNEL.nearest(one, 0.0, math.pi)
            with pytest.raises(ValueError, match=text):
                KERNEL.clusters(one, 2.0, 0.06, 0.2)
            with pytest.raises(ValueError, match=text):
                KERNEL.closest_points(one, 2.0, 24)
    for count in (0, -1):
        with pytest.raises(ValueError, match="at least 1 sector"):
            KERNEL.closest_points(scan(np.ones(n), bearings), 2.0, count)


def test_a_layout_takes_no_more_bearings_than_it_has_room_for() -> None:
    layout = ScanLayout(3)
    layout.set_bearings(np.array([0.0, 1.0, 2.0]))
    with pytest.raises(IndexError, match="expected 4"):
        layout.set_bearings(np.zeros(4))


@pytest.mark.parametrize("is_served", [False, True])
def test_features_do_not_depend_on_the_scans_before(is_served: bool) -> None:
    """What is kept of the last bearings of a robot must change no feature of a later scan."""
    random = np.random.default_rng(5)
    scans: list[Scan] = []
    for n in (24, 360, 24, 90, 360, 91, 7, 180, 181, 182, 183, 184):
        bearings = np.sort(random.uniform(-math.pi, math.pi, n))
        scans.append(Scan(len(scans), 0.0, random.uniform(0.2, 4.0, n), bearings, 0.1, 3.5))

    layouts = ScanLayouts()
    for one in scans if is_served else ():
        layouts.serve(one)

    def features(scan: Scan) -> tuple[object, ...]:
        return (
            KERNEL.nearest(scan, 0.3, 1.0),
            KERNEL.closest_points(scan, 3.0, 24).tolist(),
            KERNEL.clusters(scan, 3.0, 0.06, 0.2),
        )

    in_order = [features(one) for one in scans]
    assert [features(one) for one in reversed(scans)] == in_order[::-1]
    for one, wanted in zip(scans, in_order, strict=True):
        for other in scans:
            KERNEL.clusters(other, 2.0, 0.06, 0.3)
        assert features(one) == wanted


def test_robots_share_nothing_that_is_kept_of_scans() -> None:
    ranges = np.ones(3)
    one, other = (Scan(1, 0.0, ranges, np.arange(3.0), 0.1, 3.5) for _ in range(2))
    layouts = ScanLayouts()
    layouts.serve(one)
    for scan in (one, other):
        KERNEL.clusters(scan, 3.0, 0.06, 0.2)
    assert one.__dict__ == {"layouts": layouts}
    assert other.__dict__["layouts"] is not layouts


def test_a_scan_is_freed_with_its_robot() -> None:
    """The collector of garbage does not see a scan, so that a circle would stay for ever."""
    layouts = ScanLayouts()
    ranges = np.ones(3)
    ranges.flags.writeable = False
    scan = Scan(1, 0.0, ranges, ranges, 0.1, 3.5)
    layouts.serve(scan)
    KERNEL.clusters(scan, 3.0, 0.06, 0.2)
    before = sys.getrefcount(layouts)
    del scan
    assert sys.getrefcount(layouts) == before - 1
