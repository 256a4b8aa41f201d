"""What the scans of a sensor show, for `swarmd --check`: returns and repeats. Pure."""

from __future__ import annotations

from collections import deque

import numpy as np

from swarmd.core.values import Array, Scan, ScanSpec
from swarmd.sensing.scan_pipeline import COMPARED_SCANS, MAX_REPEATS, MIN_DISTINCT_RETURNS

ENOUGH_SCANS = MAX_REPEATS + 1
"""Scans after which a frozen sensor shows."""

# A sensor with less range in m, or with fewer rays, often has no return in an ordinary room.
_FAR_SENSOR, _MANY_RAYS = 1.0, 8


class ScanContent:
    """The last scan of a sensor, and the number of scans in a row that repeated earlier scans.

    A scan repeats if its ranges equal the ranges of one of the last COMPARED_SCANS different scans.
    `last`: None before the first scan. `count`: the number of scans. `has_measured`: False as long
    as all ranges have been 0, since the motor of the sensor may not turn yet. This does not hold
    for a sensor with a short range or few rays: in an ordinary room it may have no return.
    """

    def __init__(self, spec: ScanSpec, section: str = "scan") -> None:
        """No scan yet. `section`: of the platform's file, which describes the sensor."""
        self.spec, self.section = spec, section
        self._recent: deque[bytes] = deque(maxlen=COMPARED_SCANS)
        self._repeats = 0
        self.last: Scan | None = None
        self.count = 0
        self.has_measured = False

    def take(self, scan: Scan) -> None:
        """Take in a scan as the driver reads it."""
        self.last, self.count = scan, self.count + 1
        self.has_measured |= bool(scan.ranges.any()) or not self._sees_much(scan)
        ranges = scan.ranges.tobytes()
        if ranges in self._recent:
            self._repeats += 1
        else:
            self._repeats = 0
            self._recent.append(ranges)

    @property
    def text(self) -> str:
        """Rays, returns, the nearest one, and whether scans differ; empty without a scan."""
        scan = self.last
        if scan is None:
            return ""
        distances, returns = self._distances(scan), self._returns(scan)
        rays = len(scan.ranges)
        parts = [f"{rays} rays, {100.0 * returns / max(rays, 1):.0f} % with a return"]
        if returns:
            nearest = float(distances.min(initial=np.inf))
            place = f"at {nearest:.2f} m" if nearest < np.inf else "too close to measure"
            parts.append(f"the nearest {place}")
        if self.count > 1:
            are_identical = self._repeats >= min(MAX_REPEATS, self.count - 1)
            parts.append("scans are identical" if are_identical else "scans differ")
        return ", ".join(parts)

    @property
    def fault(self) -> str:
        """Why the scans cannot be right, and the next step; empty without a fault.

        The first fault that applies: all ranges of the last scan are 0, no ray has a return, or the
        last scans repeat earlier scans. With noise an exact repeat of several returns is
        implausible, so repeats mean that the sensor's driver sends the same scan again and again.
        """
        scan, spec = self.last, self.spec
        if scan is None or not len(scan.ranges):
            return ""
        if not scan.ranges.any():
            return (
                f"all {len(scan.ranges)} ranges are 0; look at the sensor: its motor stands still,"
                " or it is covered"
            )
        returns = self._returns(scan)
        if not returns and self._sees_much(scan):
            return (
                f"none of {len(scan.ranges)} rays has a return within {spec.range_max:g} m; hold"
                " something in front of the sensor and check again: if there is still no return,"
                f" look at the sensor, or correct the platform's {self.section}.range_max"
            )
        is_frozen = spec.is_noisy and self._repeats >= MAX_REPEATS
        if is_frozen and returns >= MIN_DISTINCT_RETURNS:
            return (
                f"{self.text}, which holds the robot (frozen_scan); start the sensor's driver"
                f" again, or set the platform's {self.section}.noisy to false for a sensor"
                " without noise, such as a simulated one"
            )
        return ""

    def _sees_much(self, scan: Scan) -> bool:
        """True if the sensor would have a return in an ordinary room."""
        return self.spec.range_max >= _FAR_SENSOR and len(scan.ranges) >= _MANY_RAYS

    def _distances(self, scan: Scan) -> Array:
        """(k,) m of the returns that have a distance."""
        ranges: Array = scan.ranges
        return ranges[(ranges > 0.0) & (ranges <= self.spec.range_max)]

    def _returns(self, scan: Scan) -> int:
        """The number of rays with a return, measured or too close to measure."""
        is_close = scan.ranges == -np.inf
        if self.spec.zero == "too_close":
            is_close |= scan.ranges == 0.0
        return len(self._distances(scan)) + int(np.count_nonzero(is_close))
