"""The finding on the delay of scans, of `swarmd --check` and of the acceptance test."""

from __future__ import annotations

from collections.abc import Iterable

from swarmd.core.finding import Finding
from swarmd.core.values import Scan, ScanSpec
from swarmd.robot.sensing.delay_by_stamps import delay_by_stamps
from swarmd.robot.sensing.scan_delay import TOLERANCE


def scan_delay_finding(
    scans: Iterable[tuple[float, float]],
    odometries: Iterable[tuple[float, float]],
    scan: Scan | None,
    spec: ScanSpec,
) -> Finding:
    """The finding that compares the measured delay of scans with the platform's `scan.latency`.

    `scans`, `odometries`: pairs of arrival and stamp in s. `scan`: one of the scans.
    """
    figure = delay_by_stamps(scans, odometries, scan, spec)
    if figure.delay is None:
        text = f"not measured: {figure.text}; declared {spec.latency:.3f} s"
        return Finding("scan delay", True, text, is_measured=False)
    text = f"declared {spec.latency:.3f} s, {figure.line}; by turns: only while it drives"
    late = figure.delay - spec.latency
    if late - figure.spread > spec.max_scan_delay:  # not by a single scan
        text += (
            f"; more than {spec.latency + spec.max_scan_delay:.3f} s holds the robot (late_scan)"
        )
        text += ": look at the load and the network; if the sensor itself is that late, correct the"
        return Finding("scan delay", False, f"{text} platform's scan.latency")
    if late + figure.spread > TOLERANCE:
        text += "; protection uses what is measured"
    return Finding("scan delay", True, text)
