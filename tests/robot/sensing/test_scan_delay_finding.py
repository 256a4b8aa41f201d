"""The line of a check that tells how late scans arrive."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.robot.sensing.delay_by_stamps import delay_by_stamps
from swarmd.robot.sensing.scan_delay_finding import scan_delay_finding
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import empty_scan

THYMIO = load_platform("thymio")  # measures all at once
SPEC = THYMIO.scan
SCAN = empty_scan(THYMIO, 0, 10.0)
ODOMETRY = [(5.05, 10.04), (5.1, 10.1), (5.25, 10.2)]  # the fastest: 5 s behind


@pytest.mark.parametrize(
    ("late", "is_well", "text"),
    [
        (0.0, True, "0.050 s +- 0.000 s"),
        (0.1, True, "uses what is measured"),
        (SPEC.max_scan_delay + 0.1, False, "late_scan"),
    ],
)
def test_tells_what_is_declared_and_measured(late: float, is_well: bool, text: str) -> None:
    scans = [(5.0 + SPEC.latency + late + 0.1 * k, 10.0 + 0.1 * k) for k in range(5)]
    finding = scan_delay_finding(scans, ODOMETRY, SCAN, SPEC)
    assert (finding.is_well, finding.is_measured) == (is_well, True)
    assert text in finding.text
    assert f"declared {SPEC.latency:.3f} s" in finding.text
    delay = delay_by_stamps(scans, ODOMETRY, SCAN, SPEC).delay
    assert delay == pytest.approx(SPEC.latency + late)


@pytest.mark.parametrize("stamp", [0.0, 12.0, 1e6])
def test_other_clock_is_named_and_no_fault(stamp: float) -> None:
    finding = scan_delay_finding([(5.2, stamp)], ODOMETRY, SCAN, SPEC)
    assert (finding.is_well, finding.is_measured) == (True, False)
    assert "different clocks" in finding.text


@pytest.mark.parametrize(
    ("stamp", "words"),
    [
        (10.22, "0.08 s or more after their oldest ray"),  # arrives at 10.24 by that clock
        (10.24, "0.1 s or more after their oldest ray"),
        (10.4, "different clocks"),
    ],
)
def test_scans_stamped_at_their_publication_are_told_from_another_clock(
    stamp: float, words: str
) -> None:
    spec, scan = load_platform("burger").scan, replace(SCAN, ages=np.linspace(0.0, 0.2, 7))
    finding = scan_delay_finding([(5.24, stamp)], ODOMETRY, scan, spec)
    assert (finding.is_well, finding.is_measured) == (True, False)
    assert words in finding.text


def test_robot_without_odometry_has_no_figure() -> None:
    finding = scan_delay_finding([(5.2, 10.0)], [], SCAN, SPEC)
    assert (finding.is_well, finding.is_measured) == (True, False)
    assert finding.text == (f"not measured: no scan, or no odometry; declared {SPEC.latency:.3f} s")
