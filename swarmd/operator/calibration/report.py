"""The results of a calibration, as a platform file. No numpy."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from swarmd.core.messages import DecisionSummary
from swarmd.operator.calibration.figures import AXES, NAMES, SWEEP, Figure, SweepFigure, names_of
from swarmd.settings.platforms import platform_names

# A limit is lowered if the base drives slower than commanded by more than this share.
_SLOWER = 0.03
_DEVIATIONS = 2.0


class Setting(NamedTuple):
    """A value for a key of a platform file that follows from a calibration."""

    key: str  # such as `scan.latency`
    value: float | str
    assumed: float | str  # the value in the present file
    text: str  # how `value` was derived
    is_safe: bool  # `value` makes the robot at least as careful as `assumed`


def figures_of(report: Mapping[str, object]) -> dict[str, Figure]:
    """The figures in a pattern's report; ValueError if a figure is missing.

    The figures of `lateral` are required only if any of them is present (the base moves sideways).
    """
    names = (*names_of(any(name.endswith(AXES[2]) for name in report)), "margin")
    missing = [name for name in names if not isinstance(report.get(name), str)]
    if missing:
        raise ValueError(f"the report has no {missing[0]}")
    return {name: Figure.parse(str(report[name])) for name in names}


def sweep_of(report: Mapping[str, object]) -> SweepFigure | None:
    """The order of the rays in a pattern's report; None if the platform declares it."""
    return SweepFigure.parse(str(report[SWEEP])) if SWEEP in report else None


def usable_report(
    report: Mapping[str, object], decision: DecisionSummary
) -> Mapping[str, object] | None:
    """The report, in which the speeds of a robot that is slowed down are not measured.

    `decision`: the last decision of protection. None if protection limited commands, so that the
    figures are not those of the base.
    """
    if decision.speed_share < 1.0:  # it scales commands, a stop not: brakes and delays are right
        why = f"the assumption monitor slows the robot to {decision.speed_share:.0%}"
        speeds = (name for name in report if name.startswith("speed_"))
        return {**report, **dict.fromkeys(speeds, Figure(assumed=1.0, why=why).text)}
    return None if decision.duty > 0.0 else report


def settings(
    figures: Mapping[str, Figure], drove: Sequence[float], sweep: SweepFigure | None = None
) -> list[Setting]:
    """The settings of a platform file that follow from the figures of a calibration.

    Values lie two standard deviations to the safe side. `drove`: the fastest commanded speeds in
    m/s and rad/s, in the order of AXES; lateral only for a base that moves sideways. `sweep`: the
    measured order of the rays; None if the present file declares the sweep.
    """
    chosen = []

    # 1. Decelerations and speed limits.
    top_speeds = dict(zip(AXES, drove, strict=False))
    for axis, speed in top_speeds.items():
        if axis == "linear":  # `braking_linear` must hold on the lateral axis, too
            braked_axes = [name for name in ("linear", "lateral") if name in top_speeds]
            chosen += _braking(axis, {name: figures[f"braking_{name}"] for name in braked_axes})
        elif axis == "angular":
            chosen += _braking(axis, {axis: figures["braking_angular"]})
        speed_ratio = figures[f"speed_{axis}"]  # measured over commanded
        if speed_ratio.is_measured and speed_ratio.value < 1.0 - _SLOWER:
            text = f"{_text(speed_ratio)} of the {speed:.3g} commanded"
            value = _down(speed_ratio.value * speed)
            chosen.append(_lower(f"limits.{axis}", value, speed, text))

    # 2. The scan.
    scan_delay = figures["scan_delay"]
    margin = figures["margin"]
    if scan_delay.is_measured:
        value = _up(scan_delay.value + _DEVIATIONS * scan_delay.spread)
        text = f"{_text(scan_delay)}, and 2 sd"
        is_safe = value >= scan_delay.assumed  # a longer latency makes the robot more careful
        chosen.append(Setting("scan.latency", value, scan_delay.assumed, text, is_safe))
    if sweep is not None and sweep.value:
        text = f"measured in {sweep.samples} scans"
        chosen.append(Setting("scan.sweep", sweep.value, "unknown", text, True))

    # 3. The margin of protection.
    if margin.is_measured and margin.value > margin.assumed:
        # 0.05 s is REACTION_TIME of binding_range.py, which imports numpy, unlike this module.
        text = "for a response after more than 0.05 s: see the reaction delays"
        chosen.append(
            Setting("protection.barrier.margin", _up(margin.value), margin.assumed, text, True)
        )
    return chosen


def _braking(word: str, brakes: Mapping[str, Figure]) -> list[Setting]:
    """The setting `braking_<word>` as a list, which is empty if the setting is not to change.

    `brakes`: by axis, the decelerations of the axes for which the setting holds. The value is the
    weakest of these. The list is empty if no axis was measured, and also if the value is stronger
    than assumed while an axis was not measured.
    """
    candidates = []
    for axis, brake in brakes.items():
        if brake.is_measured and not math.isnan(brake.assumed):
            # A spread of half the value or more must not give a deceleration of 0 or less.
            value = _down(max(brake.value - _DEVIATIONS * brake.spread, 0.01 * brake.value))
            text = f"{_text(brake)}{'' if axis == word else f' {axis}'}, less 2 sd"
            key = f"protection.barrier.braking_{word}"
            candidates.append(_lower(key, value, brake.assumed, text))
    candidates.sort(key=lambda setting: setting.value)
    has_all_axes = len(candidates) == len(brakes)
    return [setting for setting in candidates[:1] if setting.is_safe or has_all_axes]


def measured_file(robot: str, platform: str, day: str, report: Mapping[str, object]) -> str:
    """A platform file with the figures of a report, which extends the present file of the robot.

    `platform`: the name of the present file. ValueError if another version made the report.
    """
    figures = figures_of(report)
    drove = tuple(map(float, str(report.get("drove")).split()))  # m/s, rad/s
    sweep = sweep_of(report)
    chosen = settings(figures, drove, sweep)
    extends = platform if platform in platform_names() else f"./{platform}.yaml"
    return platform_file(robot, extends, day, figures, chosen, sweep)


def platform_file(
    robot: str,
    extends: str,
    day: str,
    figures: Mapping[str, Figure],
    chosen: list[Setting],
    sweep: SweepFigure | None = None,
) -> str:
    """A platform file that extends the present file; less careful settings are commented out."""
    lines = [
        f"description: {extends.rsplit('/', 1)[-1].removesuffix('.yaml')}, calibrated as {robot}",
        f"extends: {extends}",
        "",
        f"# Measured by `swarmctl calibrate {robot}` on {day}: mean +- sd (samples).",
    ]
    lines += [f"#   {_line(name, figures[name])}" for name in NAMES if name in figures]
    if sweep is not None and not sweep.value:
        lines.append(f"#   scan.sweep: not measured: {sweep.why}")
    unsafe = [setting for setting in chosen if not setting.is_safe]
    if unsafe:
        lines += [
            "# A commented key is less careful than the file that this one extends. Check what was",
            "# measured, and uncomment it yourself.",
        ]
    lines += ["", *_nested([(setting.key.split("."), setting) for setting in chosen], 0)]
    return "\n".join(lines).rstrip() + "\n"


def _nested(keys: list[tuple[list[str], Setting]], depth: int) -> list[str]:
    """YAML lines of the settings; a section with only comments is commented out, too."""
    lines: list[str] = []
    indent = "  " * depth
    for name in dict.fromkeys(path[0] for path, _ in keys):
        within = [(path[1:], setting) for path, setting in keys if path[0] == name]
        mark = "" if any(setting.is_safe for _, setting in within) else "# "
        if within[0][0]:
            lines += [f"{mark}{indent}{name}:", *_nested(within, depth + 1)]
        else:
            setting = within[0][1]
            text = f"{setting.text}; the file has {_number(setting.assumed)}"
            lines.append(f"{mark}{indent}{name}: {_number(setting.value)}  # {text}")
    return lines


def _lower(key: str, value: float, assumed: float, text: str) -> Setting:
    return Setting(key, value, assumed, text, value <= assumed)


def _line(name: str, figure: Figure) -> str:
    title, unit = NAMES[name]
    if not figure.is_measured:
        return f"{title}: not measured: {figure.why}"
    assumed = "" if math.isnan(figure.assumed) else f"; assumed {figure.assumed:.4g}"
    return f"{title}: {_text(figure)} {unit}".rstrip() + assumed


def _text(figure: Figure) -> str:
    return f"{_number(figure.value)} +- {_number(figure.spread)} ({figure.samples})"


def _number(value: float | str) -> str:
    if isinstance(value, str):
        return value
    return f"{value + 0.0:.3g}" if abs(value) >= 0.0005 else "0"


def _down(value: float) -> float:
    """The value with three digits, rounded down."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return float(f"{math.floor(value / digit + 1e-9) * digit:.6g}")


def _up(value: float) -> float:
    """The value in whole milli-units, rounded up."""
    return math.ceil(value * 1000.0 - 1e-9) / 1000.0
