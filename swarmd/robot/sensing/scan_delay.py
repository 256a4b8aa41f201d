"""Measures how late scans arrive, by stamps of one clock and by turns of the robot.

The delay of a scan is the mean age of its rays when it arrives. `delay_by_stamps.py` and
`delay_by_turns.py` have the two methods.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.core import cython_shadow as cython
from swarmd.core.cython_shadow import INFINITY
from swarmd.core.messages import ScanDelaySummary
from swarmd.core.values import Scan, ScanSpec
from swarmd.robot.sensing.delay_by_stamps import DelayByStamps
from swarmd.robot.sensing.delay_by_turns import DelayByTurns

if TYPE_CHECKING:
    from swarmd.core.values import Pose

TOLERANCE = 0.01
"""Seconds: a smaller delay beyond the declared latency counts as 0, as clocks resolve no less."""

# Share of the bound below which a late scan is in time.
_CLEARS = 0.8
# Spreads (standard deviations) by which the delay by turns must exceed latency and stamps.
_CERTAIN = 2.5
# s after which a delay by turns no longer makes scans late.
_EXPIRES = 60.0
_TOLERANCE = TOLERANCE


@cython.cclass
class ScanDelay:
    """Measures the delay of one sensor's scans. Times in s of the robot."""

    # The delay beyond the declared latency that protection counts. An upper estimate, at least that
    # of the last scan by its stamp; 0 if it is within TOLERANCE.
    added: float
    # True once `added` exceeds the platform's `max_scan_delay`, until it falls below 0.8 of that.
    is_late: bool
    # How often stamps jumped, as when the clock of odometry or scan is set. The measurement by
    # stamps then begins anew, and `added` does not fall until stamps give the delay again.
    restarts: int
    # True if scans are late now, and were in time when stamps jumped last.
    is_clock_set: bool
    _latency: float
    _bound: float
    _added_before: float
    _stamps: DelayByStamps
    _turns: DelayByTurns

    def __init__(self, spec: ScanSpec) -> None:
        self._latency = spec.latency
        self._bound = spec.max_scan_delay
        self._stamps = DelayByStamps(spec)
        self._turns = DelayByTurns()

    def read(self, stamp: float, yaw: float, rate: float, pose: Pose, now: float) -> None:
        """Take in a reading of odometry."""
        if self._stamps.read(stamp, now):
            self._restart()
        self._turns.read(stamp, yaw, rate, pose)

    def on_scan(self, scan: Scan, now: float) -> None:
        """Take in a raw scan that arrived at `now` and is valid."""
        offset = self._stamps.offset
        if self._stamps.goes_back(scan.stamp, now):
            self._restart()
        stamps = self._stamps.take(scan, now)
        turns: DelayByTurns = self._turns
        if offset < INFINITY:
            turns.compare(scan, now - offset, now)
        added = stamps - self._latency
        if self._stamps.is_restarting:
            added = max(added, self._added_before)
        known = max(self._latency, stamps) + _TOLERANCE
        if turns.delay - _CERTAIN * turns.spread > known:  # false of NaN: there is no figure
            upper = turns.delay + turns.spread - self._latency
            if upper > self._bound and now - turns.at > _EXPIRES:
                turns.forget()  # a robot that is held cannot turn to measure anew
            else:
                added = max(added, upper)
        self.added = added if added > _TOLERANCE else 0.0
        self.is_late = self.added > (_CLEARS * self._bound if self.is_late else self._bound)
        self.is_clock_set = self.is_clock_set and (self.is_late or self._stamps.is_restarting)

    def _restart(self) -> None:
        self.restarts += 1
        self._added_before = self.added
        self.is_clock_set = self.is_clock_set or not self.is_late
        self._turns.forget_headings()

    def summary(self, now: float) -> ScanDelaySummary:
        """The figures of both methods, for the status."""
        return ScanDelaySummary(
            declared=self._latency,
            added=self.added,
            bound=self._bound,
            figures=(self._stamps.figure(now), self._turns.figure(now)),
        )
