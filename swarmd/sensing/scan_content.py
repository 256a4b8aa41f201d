"""What the scans of a sensor show, for `swarmd --check`: returns and repeats. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array, Scan, ScanSpec
from swarmd.sensing.scan_pipeline import COMPARED_SCANS, MAX_REPEATS, MIN_DISTINCT_RETURNS
from swarmd.sensing.sector_history import SECTORS

ENOUGH_SCANS = MAX_REPEATS + 1
"""Scans after which a frozen sensor shows."""

_WIDE_SECTOR = 30.0  # deg without a return that a note names
# A sensor with less range in m, or with fewer rays, often has no return in an ordinary room.
_FAR_SENSOR, _MANY_RAYS = 1.0, 8
_DEGREES = 360
_LEAST_OWN = 2  # degrees with returns inside the outline; a single ray may be noise


class ScanContent:
    """The last scan of a sensor, and the number of scans in a row that repeated earlier scans.

    A scan repeats if its ranges equal the ranges of one of the last COMPARED_SCANS different scans.
    `last`: None before the first scan. `count`: the number of scans. `has_measured`: False as long
    as all ranges have been 0, since the motor of the sensor may not turn yet. For a sensor that may
    have no return in an ordinary room, `has_measured` is True from the first scan on.
    """

    def __init__(
        self,
        spec: ScanSpec,
        section: str = "scan",
        gaps: Callable[[Array], Array] | None = None,
    ) -> None:
        """No scan yet.

        `section`: of the platform's file, which describes the sensor. `gaps`: the distances (k,) in
        m of points (k, 2) from the outline, 0 for points inside, where no return of another object
        can lie (`Footprint.gaps`); None: the outline is not known.
        """
        self.spec, self.section = spec, section
        self._gaps = gaps
        self._own_degrees = np.ones(_DEGREES, np.bool_)  # see `_degrees_inside`, in each scan
        self._recent: deque[bytes] = deque(maxlen=COMPARED_SCANS)
        self._repeats = 0
        self.last: Scan | None = None
        self.count = 0
        self.has_measured = False

    def take(self, scan: Scan) -> None:
        """Take in a scan as the driver reads it."""
        self.last, self.count = scan, self.count + 1
        self.has_measured |= bool(scan.ranges.any()) or not self._expects_return(scan)
        self._own_degrees &= self._degrees_inside(scan)
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
            parts += self._empty_sector(scan)
        if self.count > 1:
            are_identical = self._repeats >= min(MAX_REPEATS, self.count - 1)
            parts.append("scans are identical" if are_identical else "scans differ")
        return ", ".join(parts)

    @property
    def fault(self) -> str:
        """Why the scans cannot be right, and the next step; empty without a fault.

        The first fault that applies: all ranges of the last scan are 0, no ray has a return (a
        fault only of a sensor that has returns in every ordinary room), rays end inside the outline
        of the robot in each scan, or the last scans repeat earlier scans. With noise an exact
        repeat of several returns is implausible, so repeats mean that the sensor's driver sends the
        same scan again and again.
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
        if not returns and self._expects_return(scan):
            return (
                f"none of {len(scan.ranges)} rays has a return within {spec.range_max:g} m; hold"
                " something in front of the sensor and check again: if there is still no return,"
                f" look at the sensor, or correct the platform's {self.section}.range_max"
            )
        own = self._own_degrees
        if np.count_nonzero(own) >= _LEAST_OWN:
            widened = own | np.roll(own, 1) | np.roll(own, -1)
            return (
                f"rays at {_sectors(own)} deg end inside the robot's outline in each"
                " scan; free the sensor, or if these are parts of the robot, set the platform's"
                f" {self.section}.mask to {_sectors(widened)}"
            )
        is_frozen = spec.is_noisy and self._repeats >= MAX_REPEATS
        if is_frozen and returns >= MIN_DISTINCT_RETURNS:
            return (
                f"{self.text}, which holds the robot (frozen_scan); start the sensor's driver"
                f" again, or set the platform's {self.section}.noisy to false for a sensor"
                " without noise, such as a simulated one"
            )
        return ""

    def _degrees_inside(self, scan: Scan) -> NDArray[np.bool_]:
        """(360,) True for each degree with a ray that is not masked and ends inside the outline.

        A return that is too close to measure counts as one at the sensor. A sensor without returns
        in an ordinary room gives none: it may stand at the rim of the robot.
        """
        degrees = np.zeros(_DEGREES, np.bool_)
        is_return = self._is_return(scan) & ~self.spec.masked(scan.bearings)
        if self._gaps is not None and self._expects_return(scan) and is_return.any():
            bearings = scan.bearings[is_return]
            directions = np.stack((np.cos(bearings), np.sin(bearings)), axis=1)
            ranges = scan.ranges[is_return]
            ranges = np.where(ranges < self.spec.range_min, 0.0, ranges)
            places = self.spec.offset + ranges[:, None] * directions
            inside = bearings[self._gaps(places) == 0.0]
            degrees[np.floor(np.degrees(inside) + 1e-6).astype(np.intp) % _DEGREES] = True
        return degrees

    def _is_too_close(self, scan: Scan) -> NDArray[np.bool_]:
        """(n,) True for each ray whose object is too close to measure."""
        is_close: NDArray[np.bool_] = scan.ranges == -np.inf
        return is_close | (scan.ranges == 0.0) if self.spec.zero == "too_close" else is_close

    def _expects_return(self, scan: Scan) -> bool:
        """True if the sensor has range and rays enough to have a return in an ordinary room."""
        return self.spec.range_max >= _FAR_SENSOR and len(scan.ranges) >= _MANY_RAYS

    def _empty_sector(self, scan: Scan) -> list[str]:
        """The widest sector between two returns; nothing if it is narrow, or of a coarse sensor.

        A covered sensor and an open field look alike, so this is no fault.
        """
        degrees = np.sort(np.degrees(scan.bearings[self._is_return(scan)]) % 360.0)
        widths = np.diff(degrees, append=degrees[0] + 360.0)
        k = int(widths.argmax())
        if len(scan.ranges) < SECTORS or widths[k] < _WIDE_SECTOR:
            return []
        return [f"no return between {degrees[k]:.0f} and {(degrees[k] + widths[k]) % 360:.0f} deg"]

    def _distances(self, scan: Scan) -> Array:
        """(k,) m of the returns that have a distance."""
        ranges: Array = scan.ranges
        return ranges[(ranges > 0.0) & (ranges <= self.spec.range_max)]

    def _returns(self, scan: Scan) -> int:
        """The number of rays with a return, measured or too close to measure."""
        return int(np.count_nonzero(self._is_return(scan)))

    def _is_return(self, scan: Scan) -> NDArray[np.bool_]:
        """(n,) True for each ray with a return, measured or too close to measure."""
        is_measured: NDArray[np.bool_] = (scan.ranges > 0.0) & (scan.ranges <= self.spec.range_max)
        return is_measured | self._is_too_close(scan)


def _sectors(degrees: NDArray[np.bool_]) -> str:
    """The runs of degrees, each from its begin to its end, such as `[[55, 61], [112, 118]]`."""
    begins = np.flatnonzero(degrees & ~np.roll(degrees, 1))
    ends = np.flatnonzero(degrees & ~np.roll(degrees, -1)) + 1
    ends = np.roll(ends, -int(np.count_nonzero(ends[:1] <= begins[:1])))
    runs = [[first, last] for first, last in zip(begins.tolist(), ends.tolist(), strict=True)]
    return str(runs or [[0, _DEGREES]])
