"""Part C: the figures of a calibration against what the platform file says."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from swarmd.core.messages import Reason
from swarmd.core.values import Array
from swarmd.operator.acceptance.evidence import Evidence
from swarmd.operator.acceptance.step import Judge
from swarmd.operator.acceptance.stops import way_of
from swarmd.operator.acceptance.verdict import Result, Verdict, failed, not_shown, passed
from swarmd.operator.calibration.figures import DONE, NOT_FREE, Figure
from swarmd.operator.calibration.report import usable_report
from swarmd.robot.protection.assumption_monitor import SOUND

SCALE_ERROR = 0.05  # share: docs/safety.md, assumptions 7 and 13
_DEVIATIONS = 2.0
_ROUNDING = 1e-3  # m: figures have six digits
_TILT = 5.0  # deg
_AGE_SHARE = 0.2  # of the period of scans: half a scan that is half a period old gives 0.25
_MANY_RAYS = 90
_HEADING = math.radians(10.0)  # rad between two headings
_FAR_QUANTILE = 0.9  # of the headings; what is seen in a corner of a room varies
# of the distance of other rays, and rays that see no farther
_NEAR_SHARE = 0.85
_LEAST_NEAR = 5
_LEAST_SHARE = 0.5  # of the commanded way that a base must drive at a low speed


def calibration(evidence: Evidence) -> Verdict:
    """Whether the calibration ended with figures, which the verdict keeps."""
    status = evidence.status
    if status is None:
        return not_shown("the robot did not answer after its drives")
    if status.report.get("state") != DONE:
        why = str(status.report.get("why") or status.detail or "it did not finish")
        return (not_shown if NOT_FREE in why else failed)(f"no figures: {why}")
    report = usable_report(status.report, status.decision)
    if report is None:
        return not_shown("protection limited the drives: repeat it on a larger floor")
    loads = {one.subject: one.text for one in evidence.findings}
    values = {name: str(text) for name, text in report.items()}
    return passed("all drives are done", **values, **loads)


def brakes(calibrated: str, *names: str) -> Judge:
    """A judge of decelerations: at least SOUND of those of the platform file."""

    def result(figure: Figure) -> Result:
        least = SOUND * figure.assumed
        if figure.value < least:
            return Result.FAIL
        return _sure(figure.value - _DEVIATIONS * figure.spread >= least)

    cause = "the brakes are weaker than the platform file says: use the measured file"
    return _figures(calibrated, names, result, cause, f"{SOUND:.0%} of the file's")


def margin(calibrated: str) -> Judge:
    """A judge of the reaction delay, by the margin that it needs."""

    def result(figure: Figure) -> Result:
        return Result.FAIL if figure.value > figure.assumed + _ROUNDING else Result.PASS

    cause = "the base responds later than its margin covers: use the measured file"
    return _figures(calibrated, ("margin",), result, cause, "the file's margin")


def scales(calibrated: str, *names: str, cause: str) -> Judge:
    """A judge of ratios that should be 1."""

    def result(figure: Figure) -> Result:
        error = abs(figure.value - 1.0)
        if error - _DEVIATIONS * figure.spread > SCALE_ERROR:
            return Result.FAIL
        return _sure(error <= SCALE_ERROR)

    return _figures(calibrated, names, result, cause, f"1 +- {SCALE_ERROR:g}")


def scan_delay(calibrated: str) -> Judge:
    """A judge of the delay of scans by turns, which must not hold the robot."""

    def judge(evidence: Evidence) -> Verdict:
        spec = evidence.platform.scan
        bound = spec.latency + spec.max_scan_delay

        def result(figure: Figure) -> Result:
            if figure.value - _DEVIATIONS * figure.spread > bound:
                return Result.FAIL
            return _sure(figure.value <= bound)

        cause = "scans come later than declared, which holds the robot"
        return _figures(calibrated, ("scan_delay",), result, cause, f"{bound:.3f} s")(evidence)

    return judge


def ages(calibrated: str) -> Judge:
    """A judge of the stamps of scans: rays are as old as the turns of a calibration show."""

    def judge(evidence: Evidence) -> Verdict:
        bound = _AGE_SHARE / evidence.platform.scan.rate
        summary = None if evidence.status is None else evidence.status.scan_delay
        figures = () if summary is None else summary.figures
        by_stamps = next((one for one in figures if one.method == "stamps"), None)
        if by_stamps is None or by_stamps.delay is None:
            why = "no figure" if by_stamps is None else by_stamps.text
            return not_shown(f"stamps give no delay: {why}")
        stamped = by_stamps.delay

        def result(figure: Figure) -> Result:
            apart = abs(figure.value - stamped)
            return Result.FAIL if apart > bound else Result.PASS

        cause = (
            "rays are not as old as their stamp says: two lidars are joined into one scan of parts"
            " that differ in age, or the stamp is not that of the oldest ray"
        )
        text = f"{stamped:.3f} s by stamps, +- {bound:.3f} s"
        return _figures(calibrated, ("scan_delay",), result, cause, text)(evidence)

    return judge


def low_speed(speed: float, seconds: float) -> Judge:
    """A judge of a drive at a low speed in m/s, for `seconds`: a base may have a dead zone."""

    def judge(evidence: Evidence) -> Verdict:
        least = _LEAST_SHARE * speed * seconds
        way = way_of(evidence.samples)
        figure = f"{way:.3f} m"
        bound = f"at least {least:.3f} m"
        if way < least:
            cause = f"the base hardly moves at {speed:g} m/s: it has a dead zone, or sticks"
            return failed(cause, figure, bound)
        return passed(f"it drives at {speed:g} m/s", figure, bound)

    return judge


def level(evidence: Evidence) -> Verdict:
    """Whether the lidar is level: a tilted one sees the floor, at a distance that turns with it.

    In a whole turn on the spot each ray of a level lidar sees the same distances.
    """
    platform = evidence.platform
    heights = evidence.platform.heights
    far = _far_ranges(evidence)
    status = evidence.status
    if far is None and status is not None and status.reason is Reason.INVALID_SCAN:
        return failed(f"{status.detail}; or the lidar is tilted, and sees the floor there")
    if heights is None or far is None:
        return not_shown(
            "it needs a lidar of 90 rays, heights.scan_plane and a whole turn: use a spirit level"
        )
    usual = float(np.median(far))
    is_near = far < _NEAR_SHARE * usual
    if np.count_nonzero(is_near) >= _LEAST_NEAR:
        at = float(far.min())
        tilt = math.degrees(math.atan2(heights.scan_plane, at))
        towards = math.degrees(platform.scan.bearings[int(far.argmin())])
        return failed(
            f"its lidar sees no farther at {towards:.0f} deg, wherever it turns: it is tilted and"
            " sees the floor, or a part of the robot is there. What is low on the other side is"
            " overlooked: level it",
            f"{tilt:.1f} deg, or a part at {at:.2f} m",
            f"{_TILT:g} deg",
        )
    hidden = math.degrees(math.atan2(heights.scan_plane, _NEAR_SHARE * usual))
    if hidden > _TILT:
        free = heights.scan_plane / math.tan(math.radians(_TILT)) / _NEAR_SHARE
        return not_shown(
            f"a tilt of up to {hidden:.0f} deg does not show between walls so near: repeat it where"
            f" {free:.1f} m are free on one side, or use a spirit level"
        )
    return passed("no floor is seen", f"tilt below {hidden:.1f} deg", f"{_TILT:g} deg")


def _far_ranges(evidence: Evidence) -> Array | None:
    """(n,) m: what each ray sees at most, but for a tenth of the headings; None without a turn.

    Masked rays, and rays without a return, count as range_max.
    """
    spec = evidence.platform.scan
    odometry = evidence.samples.odometry
    count = len(spec.bearings)
    scans = [pair for pair in evidence.samples.scans if len(pair[1].ranges) == count]
    if not scans or not odometry or count < _MANY_RAYS:
        return None
    yaws = np.unwrap([one.pose.yaw for _, one in odometry])
    at = np.interp([at for at, _ in scans], [at for at, _ in odometry], yaws)
    bins = np.rint(at / _HEADING)
    headings = np.unique(bins)
    if len(headings) < math.tau / _HEADING:
        return None
    ranges = np.array([np.where(one.ranges > 0.0, one.ranges, math.inf) for _, one in scans])
    ranges = np.minimum(np.nan_to_num(ranges, nan=spec.range_max), spec.range_max)
    ranges[:, spec.masked(spec.bearings)] = spec.range_max
    seen = np.array([np.median(ranges[bins == one], axis=0) for one in headings])
    return np.asarray(np.quantile(seen, _FAR_QUANTILE, axis=0))


def _sure(is_within: bool) -> Result:
    """A pass, unless the scatter of the figure reaches beyond its bound."""
    return Result.PASS if is_within else Result.NOT_SHOWN


def _figures(
    calibrated: str,
    names: Sequence[str],
    result_of: Callable[[Figure], Result],
    cause: str,
    bound: str,
) -> Judge:
    """A judge of the figures `names` of the step `calibrated`; a figure may be absent.

    A value, deviation or assumed value that is no finite number counts as not measured.
    """

    def judge(evidence: Evidence) -> Verdict:
        values = evidence.earlier[calibrated].values
        figures = {name: Figure.parse(str(values[name])) for name in names if name in values}
        measured = {
            name: one
            for name, one in figures.items()
            if one.is_measured and all(map(math.isfinite, (one.value, one.spread, one.assumed)))
        }
        if not measured:
            whys = (
                one.why or f"{name} has no number, or none to compare with"
                for name, one in figures.items()
            )
            return not_shown("; ".join(whys) or f"{calibrated} has no such figure")
        texts = {
            name: f"{name} {one.value:.3g} +- {one.spread:.2g}" for name, one in measured.items()
        }
        results = {name: result_of(one) for name, one in measured.items()}
        wrong = [texts[name] for name, one in results.items() if one is Result.FAIL]
        unsure = [texts[name] for name, one in results.items() if one is Result.NOT_SHOWN]
        if wrong:
            return failed(cause, ", ".join(wrong), bound)
        if unsure:
            why = (
                f"it scatters too much ({values.get('load', 'load not known')}): end what takes the"
                f" robot's time, put walls nearer, and repeat by --only {calibrated}"
            )
            return not_shown(f"{', '.join(unsure)}: {why}")
        return passed("as the file says", ", ".join(texts.values()), bound)

    return judge
