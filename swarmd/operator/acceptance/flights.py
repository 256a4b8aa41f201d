"""Flights of a drone: whether it lands, how it hovers, and how fast and far it flies."""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from swarmd.core.values import Array
from swarmd.operator.acceptance.calibrated import SCALE_ERROR
from swarmd.operator.acceptance.evidence import Evidence, Samples
from swarmd.operator.acceptance.step import Judge
from swarmd.operator.acceptance.stops import HOVER_DRIFT, track_of
from swarmd.operator.acceptance.verdict import Result, Verdict, failed, not_shown, passed

_LANDED = 0.12  # m: as the driver of a Crazyflie
_HEIGHT_ERROR = 0.1  # m; our guess
_UP_SHARE = 0.8  # of its height at which a take-off is over
_SWAY_TIME = 1.0  # s after the take-off, and before the landing, that do not count
_LEAST_HOVER = 4.0  # s
_CRUISE_SHARES = (0.2, 0.8)  # of the way: the speed is steady between
_LEAST_WAY = 0.2  # m of it


def lands(judge: Judge) -> Judge:
    """`judge`, and whether the drone stands on the floor at the end of the recording."""

    def judge_both(evidence: Evidence) -> Verdict:
        verdict = judge(evidence)
        heights = evidence.samples.heights
        if verdict.result is not Result.PASS:
            return verdict
        height = heights[-1][1] if heights else math.inf
        if height > _LANDED:
            reason = "it is still in the air: look at land_after and land_rate of its driver"
            return failed(reason, f"{height:.2f} m", f"{_LANDED} m")
        return replace(verdict, reason=f"{verdict.reason}, and lands")

    return judge_both


def hovers(evidence: Evidence) -> Verdict:
    """Height and drift of a drone that hovers."""
    heights = evidence.platform.heights
    wanted = math.nan if heights is None else heights.scan_plane
    rows = np.array(evidence.samples.heights).reshape(-1, 2)
    aloft = rows[rows[:, 1] >= _UP_SHARE * wanted, 0]
    if not len(aloft) or aloft[-1] - aloft[0] < _LEAST_HOVER:
        reason = "it did not stay at its height: the line `driver` of swarmctl describe says why"
        return failed(reason, bound=f"{wanted:.2f} m for {_LEAST_HOVER:g} s")
    begin = float(aloft[0]) + _SWAY_TIME
    end = float(aloft[-1]) - _SWAY_TIME
    error = float(np.abs(_between(rows, begin, end)[:, 1] - wanted).max())
    track = _between(track_of(evidence.samples), begin, end)
    if len(track) < 2 or not track[-1, 0] > track[0, 0]:
        return failed("no odometry came while it hovered: look at its state estimate")
    seconds, *moved = np.ptp(track[[0, -1]], axis=0)
    drift = float(np.hypot(*moved) / seconds)
    figure = f"{error:.2f} m off its height, {drift:.3f} m/s"
    bound = f"{_HEIGHT_ERROR} m, {HOVER_DRIFT} m/s"
    if error > _HEIGHT_ERROR:
        reason = "another height: others count on heights.scan_plane; correct it, or `height`"
        return failed(reason, figure, bound)
    if drift > HOVER_DRIFT:
        return failed("it drifts: look at the floor's texture, trim and rotors", figure, bound)
    return passed("it takes off, hovers", figure, bound)


def scale(evidence: Evidence) -> Verdict:
    """The way by the state estimate over the way by the range to the wall ahead."""
    cruise = _cruise(evidence.samples)
    ahead = int(np.abs(evidence.platform.scan.bearings).argmin())
    scans = evidence.samples.scans
    seen = np.array([(at, one.ranges[ahead]) for at, one in scans if len(one.ranges) > ahead])
    if (
        not len(cruise)
        or not len(seen)
        or not np.isfinite(_between(seen, *cruise[[0, -1], 0])).all()
    ):
        return not_shown("the range ahead did not show the wall all the time: begin nearer")
    far, near = np.interp(cruise[[0, -1], 0], *seen.T)
    way = float(np.hypot(*(cruise[-1, 1:] - cruise[0, 1:])))
    ratio = way / max(far - near, 1e-3)
    figure = f"way by estimate over way by range {ratio:.3f}"
    bound = f"1 +- {SCALE_ERROR:g}"
    if abs(ratio - 1.0) > SCALE_ERROR:
        cause = "the scale of the state estimate is wrong: look at the height by the Flow deck"
        return failed(cause, figure, bound)
    return passed("the state estimate and the range ahead agree", figure, bound)


def _cruise(samples: Samples) -> Array:
    """(n, 3) s, m, m: the steady part of the track of a flight ahead; empty without one."""
    track = track_of(samples)
    ways = np.hypot(*(track[:, 1:] - track[:1, 1:]).T)
    least, most = (share * ways.max(initial=0.0) for share in _CRUISE_SHARES)
    is_steady = (ways >= least) & (ways <= most) & (most - least >= _LEAST_WAY)
    return np.asarray(track[is_steady])


def _between(rows: Array, begin: float, end: float) -> Array:
    """The rows whose time is within `begin` and `end` s."""
    return np.asarray(rows[(rows[:, 0] >= begin) & (rows[:, 0] <= end)])
