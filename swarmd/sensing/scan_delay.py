"""How late scans arrive: measured by the stamps of one clock, and by turns. Pure.

The delay of a scan is the mean age of its rays when it arrives. Two methods measure it:

- Stamps. Where scan and odometry are stamped by one clock, the fastest odometry of the last second
  tells the time of that clock. The stamp of a scan is the time of its oldest ray, as in ROS. The
  delay of odometry itself goes unnoticed, and so does one that both have for more than a second.
- Turns. The turn between two scans, by circular correlation of their ranges, is compared with the
  turn by odometry at candidate delays, in least squares with a free scale of the odometry. It needs
  a rate of turn that changes: at a constant rate all delays explain the turns alike, and then there
  is no figure. After the temporal calibration of sensors by correlated rotations (Rehder, Siegwart
  and Furgale, IEEE T-RO 2016), with one axis and a grid.

`ScanDelay` is a class of the kernel of scans.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable

from swarmd.core.messages import DelayFigure
from swarmd.core.values import Scan, ScanSpec

TOLERANCE = 0.01
"""Seconds beyond the declared latency that count as none: the clocks of a tick resolve no less."""
LONGEST_SHARED = 5.0
"""Seconds: a scan with a greater age by its stamp counts as stamped by another clock."""
MAX_LEAD = -0.05
"""Seconds: a scan with a lower age by its stamp counts as stamped by another clock."""


def delay_by_stamps(
    scans: Iterable[tuple[float, float]],
    odometries: Iterable[tuple[float, float]],
    scan: Scan | None,
    spec: ScanSpec,
) -> DelayFigure:
    """The delay of a few scans, from arrivals and stamps; `scan` is one of them."""
    offset = min((at - stamp for at, stamp in odometries), default=math.inf)
    ages = [at - offset - stamp for at, stamp in scans]
    if not ages or scan is None or offset == math.inf:
        return DelayFigure(method="stamps", text="no scan, or no odometry")
    ahead = lead(scan, spec)
    ages = [age - ahead for age in ages]
    if not MAX_LEAD <= min(ages) <= max(ages) <= LONGEST_SHARED:
        return DelayFigure(method="stamps", text=wrong_stamps(ages[-1], ahead))
    return figure_of(ages, 0.0)


def lead(scan: Scan, spec: ScanSpec) -> float:
    """How much later than the stamp the mean ray was measured, in s."""
    if scan.ages is None or not len(scan.ages):
        return 0.0 if spec.sweep is None else 0.5 * spec.sweep.duration
    return float(scan.ages.max() - scan.ages.mean())


def wrong_stamps(age: float, ahead: float) -> str:
    """Why stamps tell no delay of a scan whose mean ray seems `age` s old; `ahead`: its `lead`."""
    if MAX_LEAD - ahead <= age < MAX_LEAD:
        return (
            f"scans are stamped {-age:.2g} s or more after their oldest ray, as at their"
            " publication, or their clock is ahead of that of odometry"
        )
    return f"scan and odometry have different clocks, {age:.3g} s apart"


def figure_of(ages: Collection[float], since: float) -> DelayFigure:
    """The mean delay by stamps, with its deviation; the last of `ages` is `since` s old."""
    mean = sum(ages) / len(ages)
    spread = math.sqrt(sum((age - mean) ** 2 for age in ages) / len(ages))
    mean = max(mean, 0.0)
    return DelayFigure(method="stamps", delay=mean, spread=spread, samples=len(ages), age=since)
