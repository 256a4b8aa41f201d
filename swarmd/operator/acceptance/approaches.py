"""Part D: how near a robot comes to what stands in its way, and how fast it is there."""

from __future__ import annotations

import math

import numpy as np

from swarmd.operator.acceptance.evidence import Evidence
from swarmd.operator.acceptance.step import Judge
from swarmd.operator.acceptance.stops import way_of
from swarmd.operator.acceptance.verdict import Result, Verdict, failed, not_shown, passed

_TOUCH_SPEED = 0.02
"""m/s at which the outline may approach what it touches (docs/safety.md, the claim)."""
_TOUCH_GAP = 0.02  # m: less may be a touch; ranges scatter as much
_NEAR = 0.5  # m: a robot that stays farther away was not tested
_SCATTER = 0.02  # m, of the gap to what rests
_WATCHED = 1.0  # s for which the speed of a box is measured
_LEAST_SHARE = 0.7  # of the way that a robot must make along a wall or through a door


def distance_left(evidence: Evidence) -> Verdict:
    """The least gap from the outline, and the speed there."""
    decisions = [one for one in evidence.samples.decisions if not math.isnan(one.gap)]
    if not decisions:
        reach = evidence.platform.scan.range_max
        return not_shown(f"the scan showed no obstacle within its {reach:.2f} m: put it nearer")
    nearest = min(decisions, key=lambda one: one.gap)
    if nearest.gap < _TOUCH_GAP and evidence.platform.protection["mode"] != "barrier":
        # A gap is 0 for all that is too near to be measured.
        return not_shown(
            "it came nearer than its sensors tell, and without a barrier no distance is promised:"
            " look whether it touched"
        )
    # What is pushed arrives between two scans, a scan is as old as its period, and later ranges
    # scatter: the speed is the greatest since the last scan in which it was farther.
    arrived = next(one.at for one in decisions if one.gap <= nearest.gap + _SCATTER)
    before = max((one.at for one in decisions if one.at < arrived), default=arrived)
    speed = _speed_in(evidence, before - 1.0 / evidence.platform.scan.rate, arrived)
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


def pushed(evidence: Evidence) -> Verdict:
    """As `distance_left`, with a box that is pushed: it may be faster than protection assumes."""
    verdict = distance_left(evidence)
    barrier = evidence.platform.protection["barrier"]
    if verdict.result is not Result.FAIL or barrier is None:
        return verdict
    speed = _speed_of_box(evidence)
    bound = float(barrier["others_speed"])
    if speed <= bound:
        return verdict
    return not_shown(f"the box came at {speed:.1f} m/s, and {bound:g} m/s are assumed: push slower")


def passage(way: float) -> Judge:
    """A judge of a drive of `way` m along a wall or through a door, without a touch."""

    def judge(evidence: Evidence) -> Verdict:
        made = way_of(evidence.samples)
        least = _LEAST_SHARE * way
        if made < least:
            reason = "protection did not let it pass: see the widths in swarmctl describe"
            return failed(reason, f"{made:.2f} m", f"{least:.2f} m")
        return distance_left(evidence)

    return judge


def _speed_of_box(evidence: Evidence) -> float:
    """The speed in m/s of what came nearest, in the last second before; 0 if it was not seen."""
    decisions = [one for one in evidence.samples.decisions if not math.isnan(one.gap)]
    least = min(one.gap for one in decisions)
    nearest = next(one for one in decisions if one.gap <= least + _SCATTER)
    before = [one for one in decisions if one.at <= nearest.at - _WATCHED]
    if not before:
        return 0.0
    first = before[-1]
    seconds = nearest.at - first.at
    return (first.gap - nearest.gap) / seconds - _speed_in(evidence, first.at, nearest.at)


def _speed_in(evidence: Evidence, since: float, until: float) -> float:
    """The greatest speed in m/s by odometry from `since` to `until` s; 0 without odometry."""
    readings = evidence.samples.odometry
    if not readings:
        return 0.0
    times = [time for time, _ in readings]
    speeds = [math.hypot(one.twist.linear, one.twist.lateral) for _, one in readings]
    within = [speed for time, speed in zip(times, speeds, strict=True) if since <= time <= until]
    return max(float(np.interp(until, times, speeds)), *within, 0.0)
