"""Part C: the figures of a calibration against what the platform file says."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from swarmd.acceptance.evidence import Evidence
from swarmd.acceptance.step import Judge
from swarmd.acceptance.stops import way_of
from swarmd.acceptance.verdict import Result, Verdict, failed, not_shown, passed
from swarmd.calibration.figures import DONE, NOT_FREE, Figure
from swarmd.calibration.report import usable_report
from swarmd.protection.assumption_monitor import SOUND

SCALE_ERROR = 0.05  # share: docs/safety.md, assumptions 7 and 13
_DEVIATIONS = 2.0
_ROUNDING = 1e-3  # m: figures have six digits
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


def low_speed(speed: float, seconds: float) -> Judge:
    """A judge of a drive at a low speed in m/s, for `seconds`: a base may have a dead zone."""

    def judge(evidence: Evidence) -> Verdict:
        least, way = _LEAST_SHARE * speed * seconds, way_of(evidence.samples)
        figure, bound = f"{way:.3f} m", f"at least {least:.3f} m"
        if way < least:
            cause = f"the base hardly moves at {speed:g} m/s: it has a dead zone, or sticks"
            return failed(cause, figure, bound)
        return passed(f"it drives at {speed:g} m/s", figure, bound)

    return judge


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
