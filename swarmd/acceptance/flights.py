"""Flights of a drone: whether it lands, how it hovers, and how fast and far it flies."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from swarmd.acceptance.calibrated import SCALE_ERROR
from swarmd.acceptance.evidence import Evidence, Samples
from swarmd.acceptance.step import Judge
from swarmd.acceptance.stops import HOVER_DRIFT, track_of
from swarmd.acceptance.verdict import Result, Verdict, failed, not_shown, passed

_LANDED = 0.12  # m: as the driver of a Crazyflie
_HEIGHT_ERROR = 0.1  # m; our guess
_UP_SHARE = 0.8  # of its height at which a take-off is over
_SWAY_TIME = 1.0  # s after the take-off, and before the landing, that do not count
_LEAST_HOVER, _LEAST_WAY = 2.0, 0.3  # s, m
_HALF = 0.2  # s before and after, over which a speed is measured
_WHOLE = 0.99  # share of the commanded speed
_CRUISE_SHARES = (0.2, 0.8)  # of the way: the speed is steady between


def lands(judge: Judge) -> Judge:
    """`judge`, and whether the drone stands on the floor at the end of the recording."""

    def judge_both(evidence: Evidence) -> Verdict:
        verdict = judge(evidence)
        if verdict.result is not Result.PASS:
            return verdict
        heights = evidence.samples.heights
        if not heights:
            return not_shown("the recording has no height")
        if (height := heights[-1][1]) > _LANDED:
            reason = "it is still in the air: look at land_after and land_rate of its driver"
            return failed(reason, f"{height:.2f} m", f"{_LANDED} m")
        return replace(verdict, reason=f"{verdict.reason}, and lands")

    return judge_both


def hovers(evidence: Evidence) -> Verdict:
    """Height and drift of a drone that hovers."""
    samples, heights = evidence.samples, evidence.platform.heights
    if heights is None or not samples.heights:
        return not_shown("the recording, or the platform file, has no height")
    times, up = np.array(samples.heights).T
    aloft = times[up >= _UP_SHARE * heights.scan_plane]
    if not len(aloft):
        reason = "it did not reach its height: the line `driver` of swarmctl describe says why"
        return failed(reason, f"{up.max():.2f} m", f"{heights.scan_plane:.2f} m")
    begin, end = float(aloft[0]) + _SWAY_TIME, float(aloft[-1]) - _SWAY_TIME
    seconds = end - begin
    if seconds < _LEAST_HOVER:
        return not_shown(f"it hovered for {max(seconds, 0.0):.1f} s only")
    error = float(np.abs(up[(times >= begin) & (times <= end)] - heights.scan_plane).max())
    track = track_of(samples)
    places = [np.interp((begin, end), track[:, 0], track[:, axis]) for axis in (1, 2)]
    drift = float(np.hypot(*np.diff(places)[:, 0])) / seconds
    figure = f"{error:.2f} m off its height, {drift:.3f} m/s"
    bound = f"{_HEIGHT_ERROR} m, {HOVER_DRIFT} m/s"
    if error > _HEIGHT_ERROR:
        reason = "another height: others count on heights.scan_plane; correct it, or `height`"
        return failed(reason, figure, bound)
    if drift > HOVER_DRIFT:
        return failed("it drifts: look at the floor's texture, trim and rotors", figure, bound)
    return passed("it takes off, hovers", figure, bound)


def speed(wanted: float) -> Judge:
    """A judge of the speed of a flight ahead that was commanded with `wanted` m/s."""

    def judge(evidence: Evidence) -> Verdict:
        cruise = _cruise(evidence.samples)
        if cruise is None:
            return failed("it hardly flew: the line `driver` of swarmctl describe says why")
        begin, end, _ = cruise
        decisions = [one for one in evidence.samples.decisions if begin <= one.at <= end]
        if np.median([one.safe.linear for one in decisions] or [0.0]) < _WHOLE * wanted:
            return not_shown("protection limited the flight: begin farther from walls")
        times, x, y = track_of(evidence.samples).T
        inside = times[(times >= begin) & (times <= end)]
        moved = [
            np.interp(inside + _HALF, times, place) - np.interp(inside - _HALF, times, place)
            for place in (x, y)
        ]
        # The median: a drone that waits for a late scan hovers for a moment.
        ratio = float(np.median(np.hypot(*moved))) / (2.0 * _HALF * wanted)
        cause = "it flies slower or faster than commanded, by its state estimate"
        return _scale(ratio, "speed", cause)

    return judge


def scale(evidence: Evidence) -> Verdict:
    """The way by the state estimate over the way by the range to the wall ahead."""
    samples = evidence.samples
    cruise = _cruise(samples)
    if cruise is None:
        return not_shown("it hardly flew")
    begin, end, way = cruise
    ahead = int(np.abs(evidence.platform.scan.bearings).argmin())
    seen = np.array([(at, scan.ranges[ahead]) for at, scan in samples.scans]).reshape(-1, 2)
    inside = seen[(seen[:, 0] >= begin) & (seen[:, 0] <= end)]
    if len(inside) < 2 or not np.isfinite(inside).all():
        return not_shown("the range ahead did not show the wall all the time: begin nearer")
    nearer = float(-np.diff(np.interp((begin, end), *seen.T))[0])
    cause = "the scale of the state estimate is wrong: look at the height by the Flow deck"
    return _scale(way / max(nearer, 1e-3), "way by estimate over way by range", cause)


def _scale(value: float, what: str, cause: str) -> Verdict:
    """The verdict on a ratio that should be 1."""
    figure, bound = f"{what} {value:.3f}", f"1 +- {SCALE_ERROR:g}"
    is_right = abs(value - 1.0) <= SCALE_ERROR
    return passed("as it should be", figure, bound) if is_right else failed(cause, figure, bound)


def _cruise(samples: Samples) -> tuple[float, float, float] | None:
    """Begin and end in s of the steady part of a flight ahead, and its way in m; None without."""
    track = track_of(samples)
    ways = np.hypot(*(track[:, 1:3] - track[:1, 1:3]).T)
    if not len(ways) or ways[-1] < _LEAST_WAY:
        return None
    first, last = (int(np.flatnonzero(ways >= share * ways[-1])[0]) for share in _CRUISE_SHARES)
    return float(track[first, 0]), float(track[last, 0]), float(ways[last] - ways[first])
