"""What the scans of a sensor show, for `swarmd --check`: returns and repeats. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array, Scan, ScanSpec
from swarmd.robot.sensing.conditioning import COMPARED_SCANS, MAX_REPEATS, MIN_DISTINCT_RETURNS
from swarmd.robot.sensing.sector_history import SECTORS

ENOUGH_SCANS = MAX_REPEATS + 1
"""Scans after which a frozen sensor shows."""

_WIDE_SECTOR = 30.0  # deg without a return that a note names
# A sensor with less range in m, or with fewer rays, often has no return in an ordinary room.
_FAR_SENSOR = 1.0
_MANY_RAYS = 8
_DEGREES = 360
_LEAST_OWN = 2  # degrees with returns inside the outline; a single ray may be noise
# So many rays with one value are no measurement, for lack of noise, if they are this share of all
# rays, or if the value is the greatest one.
_LEAST_EQUAL = 8
_EQUAL_SHARE = 0.2


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
        self.spec = spec
        self.section = section
        self._gaps = gaps
        self._own_degrees = np.ones(_DEGREES, np.bool_)  # see `_take_inside`, in each scan
        self._coded_degrees = np.ones(_DEGREES, np.bool_)  # without such a range in any scan
        self._stated_max = np.float32(np.nan)
        self._recent: deque[bytes] = deque(maxlen=COMPARED_SCANS)
        self._repeats = 0
        self.last: Scan | None = None
        self.count = 0
        self.has_measured = False

    def take(self, scan: Scan, stated_max: float = np.nan) -> None:
        """Take in a scan as the driver reads it.

        `stated_max`: the greatest range in m by the message itself, which some drivers send for no
        return.
        """
        self.last = scan
        self.count = self.count + 1
        self._stated_max = np.float32(stated_max)
        self.has_measured |= bool(scan.ranges.any()) or not self._expects_return(scan)
        self._take_inside(scan)
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
        distances = self._distances(scan.ranges)
        returns = self._returns(scan)
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
    def encoding(self) -> str:
        """The values of the last scan that are no measured distance, their shares and meanings.

        Such as `-inf 55 % (too close, by REP 117)`. Empty if each ray has a distance.
        """
        if self.last is None:
            return ""
        ranges = self.last.ranges
        is_finite = np.isfinite(ranges)
        zero = self.spec.zero
        groups = (
            (ranges == -np.inf, "too close, by REP 117"),
            (ranges == np.inf, "no return"),
            (np.isnan(ranges), "unknown"),
            (ranges == 0.0, f"{zero.replace('_', ' ')}, by the platform's {self.section}.zero"),
            (is_finite & (ranges < 0.0), "unknown: no distance"),
            (
                is_finite & (ranges > self.spec.range_max),
                f"no return: over the platform's {self.section}.range_max",
            ),
            (self._is_equal(ranges), self._equal_meaning(ranges)),
        )
        parts = []
        for is_member, meaning in groups:
            values = ranges[is_member]
            if len(values):
                least = values.min()
                most = values.max()
                name = f"{most:g}" if least == most or np.isnan(most) else f"{least:g} to {most:g}"
                parts.append(f"{name} {100.0 * len(values) / len(ranges):.0f} % ({meaning})")
        return ", ".join(parts)

    @property
    def fault(self) -> str:
        """Why the scans cannot be right, and the next step; empty without a fault.

        The first fault that applies: all ranges of the last scan are 0, no ray has a return (a
        fault only of a sensor that has returns in every ordinary room), rays end inside the outline
        of the robot in each scan, or the last scans repeat earlier scans. With noise an exact
        repeat of several returns is implausible, so repeats mean that the sensor's driver sends the
        same scan again and again. No next step takes a guard away: none declares a sensor free of
        noise, and a mask is proposed only for measured distances, in sectors that a platform may
        mask. The text begins with `encoding`.
        """
        return "; ".join(filter(None, (self.encoding, text))) if (text := self._fault()) else ""

    def _fault(self) -> str:
        scan = self.last
        spec = self.spec
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
                " look at the sensor and at what its driver sends: m, and inf for no return"
                " (REP 117)"
            )
        if np.count_nonzero(self._own_degrees) >= _LEAST_OWN:
            return self._fault_inside(scan)
        if spec.is_noisy and self._repeats >= MAX_REPEATS and returns >= MIN_DISTINCT_RETURNS:
            return (
                f"{self.text}, which holds the robot (frozen_scan); start the sensor's driver"
                " again; let it send inf for no return (REP 117), and a simulated sensor add noise"
            )
        return ""

    def _fault_inside(self, scan: Scan) -> str:
        """The text for rays that end inside the outline in each scan."""
        own = self._own_degrees
        spec = self.spec
        begin = f"rays at {_runs(own)} deg"
        equal = _degrees_of(scan.bearings[self._is_equal(scan.ranges)])
        if (own & self._coded_degrees).any() or own[equal].any():
            return (
                f"{begin} are too close to measure in each scan, which holds the robot; if nothing"
                " is that near, the driver means no return: let it send inf (REP 117); if the same"
                " bearings stay too close while you turn the robot by hand, its own parts are"
                " there: free the sensor"
            )
        widened = own | np.roll(own, 1) | np.roll(own, -1)
        given = np.radians(_runs(widened))
        mask = (*spec.mask, *((float(first), float(last)) for first, last in given))
        text = f"{begin} end inside the robot's outline in each scan; free the sensor"
        if replace(spec, mask=mask).mask_fault():
            return f"{text}: too much for a mask, which would blind the robot"
        shown = [[round(float(edge), 1) for edge in np.degrees(pair)] for pair in spec.mask]
        return (
            f"{text}, or if these are parts of the robot, set the platform's"
            f" {self.section}.mask to {[*shown, *_runs(widened)]}"
        )

    def _is_equal(self, ranges: Array) -> NDArray[np.bool_]:
        """(n,) True for the rays with the most frequent distance, if it is no measurement."""
        values, counts = np.unique(self._distances(ranges), return_counts=True)
        if counts.max(initial=0) < _LEAST_EQUAL:
            return np.zeros(len(ranges), np.bool_)
        value = values[counts.argmax()]
        count = counts.max()
        is_greatest = np.float32(value) in (self._stated_max, np.float32(self.spec.range_max))
        is_code: NDArray[np.bool_] = ranges == value
        return is_code & (is_greatest or count >= _EQUAL_SHARE * len(ranges))

    def _equal_meaning(self, ranges: Array) -> str:
        """What a distance that many rays have in common may mean."""
        is_stated = np.float32(ranges[self._is_equal(ranges)]) == self._stated_max
        source = "the message's own range_max" if is_stated.any() else "one value"
        return f"{source}: no return, or walls as far away all round"

    def _take_inside(self, scan: Scan) -> None:
        """Keep the degrees with a ray that is not masked and ends inside the outline, in each scan.

        A return that is too close to measure counts as one at the sensor. A sensor without returns
        in an ordinary room gives none: it may stand at the rim of the robot.
        """
        degrees = np.zeros(_DEGREES, np.bool_)
        is_return = self._is_return(scan) & ~self.spec.masked(scan.bearings)
        if self._gaps is not None and self._expects_return(scan) and is_return.any():
            bearings = scan.bearings[is_return]
            directions = np.stack((np.cos(bearings), np.sin(bearings)), axis=1)
            raw = scan.ranges[is_return]
            ranges = np.where(raw < self.spec.range_min, 0.0, raw)
            places = self.spec.offset + ranges[:, None] * directions
            is_inside = self._gaps(places) == 0.0
            inside = _degrees_of(bearings[is_inside])
            raw = raw[is_inside]
            degrees[inside] = True
            is_measured = (raw > 0.0) & (raw < np.inf)
            self._coded_degrees[inside[is_measured]] = False
        self._own_degrees &= degrees

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

    def _distances(self, ranges: Array) -> Array:
        """(k,) m of the returns that have a distance."""
        return ranges[(ranges > 0.0) & (ranges <= self.spec.range_max)]

    def _returns(self, scan: Scan) -> int:
        """The number of rays with a return, measured or too close to measure."""
        return int(np.count_nonzero(self._is_return(scan)))

    def _is_return(self, scan: Scan) -> NDArray[np.bool_]:
        """(n,) True for each ray with a return, measured or too close to measure."""
        is_measured: NDArray[np.bool_] = (scan.ranges > 0.0) & (scan.ranges <= self.spec.range_max)
        return is_measured | self._is_too_close(scan)


def _degrees_of(bearings: Array) -> NDArray[np.intp]:
    """(n,) whole degrees, 0 to 359."""
    return np.floor(np.degrees(bearings) + 1e-6).astype(np.intp) % _DEGREES


def _runs(degrees: NDArray[np.bool_]) -> list[list[int]]:
    """The runs of degrees, each from its begin to its end, such as `[[55, 61], [112, 118]]`."""
    begins = np.flatnonzero(degrees & ~np.roll(degrees, 1))
    ends = np.flatnonzero(degrees & ~np.roll(degrees, -1)) + 1
    ends = np.roll(ends, -int(np.count_nonzero(ends[:1] <= begins[:1])))
    runs = [[first, last] for first, last in zip(begins.tolist(), ends.tolist(), strict=True)]
    return runs or [[0, _DEGREES]]
