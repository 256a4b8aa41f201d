"""Part D: how near a robot comes to what stands in its way, and how fast it is there."""

from __future__ import annotations

import math

import numpy as np

from swarmd.acceptance.evidence import Evidence
from swarmd.acceptance.step import Judge
from swarmd.acceptance.stops import way_of
from swarmd.acceptance.verdict import Verdict, failed, not_shown, passed

_TOUCH_SPEED = 0.02
"""m/s at which the outline may approach what it touches (docs/safety.md, the claim)."""
_TOUCH_GAP = 0.005  # m: less counts as a touch; the noise of a range is as large
_NEAR = 0.5  # m: a robot that stays farther away was not tested
_LEAST_SHARE = 0.7  # of the way that a robot must make along a wall or through a door


def distance_left(evidence: Evidence) -> Verdict:
    """The least gap from the outline, and the speed there."""
    decisions = [one for one in evidence.samples.decisions if not math.isnan(one.gap)]
    if not decisions:
        return not_shown("the scan showed no obstacle")
    nearest = min(decisions, key=lambda one: one.gap)
    speed = _speed_at(evidence, nearest.at)
    figure = f"{nearest.gap:.2f} m left, {speed:.2f} m/s there"
    bound = f"more than 0 m, or {_TOUCH_SPEED} m/s"
    values = {"gap": nearest.gap, "speed": speed}
    if nearest.gap < _TOUCH_GAP and speed > _TOUCH_SPEED:
        reason = "it touched at speed: look at brakes, delay, odometry and outline"
        return failed(reason, figure, bound, **values)
    status = evidence.status
    if status is not None and status.findings:
        reason = f"the assumption monitor spoke: {'; '.join(status.findings)}"
        return failed(reason, figure, bound, **values)
    if nearest.gap > _NEAR:
        return not_shown(f"it stayed {nearest.gap:.2f} m away: put the box nearer")
    return passed("it did not touch; the assumption monitor was silent", figure, bound, **values)


def passage(way: float) -> Judge:
    """A judge of a drive of `way` m along a wall or through a door, without a touch."""

    def judge(evidence: Evidence) -> Verdict:
        made, least = way_of(evidence.samples), _LEAST_SHARE * way
        if made < least:
            reason = "protection did not let it pass: see the widths in swarmctl describe"
            return failed(reason, f"{made:.2f} m", f"{least:.2f} m")
        return distance_left(evidence)

    return judge


def _speed_at(evidence: Evidence, at: float) -> float:
    """The speed in m/s by odometry at `at` s; 0 without odometry."""
    readings = evidence.samples.odometry
    if not readings:
        return 0.0
    times = [time for time, _ in readings]
    speeds = [math.hypot(one.twist.linear, one.twist.lateral) for _, one in readings]
    return float(np.interp(at, times, speeds))
