"""The results of a calibration, as a table and as a platform file. No numpy."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from swarmd.calibration.figures import AXES, NAMES, Figure, names_of
from swarmd.core.messages import SweepFigure

# A limit is lowered if the base drives slower than commanded by more than this share.
_SLOWER = 0.03
_DEVIATIONS = 2.0


class Setting(NamedTuple):
    """A value for a key of a platform file, such as `scan.latency`; `text`: its derivation.

    `assumed`: the value in the present file. `is_safe`: `value` makes the robot at least as careful
    as `assumed`.
    """

    key: str
    value: float | str
    assumed: float | str
    text: str
    is_safe: bool


def figures_of(report: Mapping[str, object]) -> dict[str, Figure]:
    """The figures in a pattern's report; ValueError if a figure is missing.

    The figures of `lateral` are required only if any of them is present (the base moves sideways).
    """
    names = (*names_of(any(name.endswith(AXES[2]) for name in report)), "margin")
    missing = [name for name in names if not isinstance(report.get(name), str)]
    if missing:
        raise ValueError(f"the report has no {missing[0]}")
    return {name: Figure.parse(str(report[name])) for name in names}


def rows(figures: Mapping[str, Figure]) -> list[tuple[str, str, str, str, str]]:
    """Title, value, deviation, number of samples and assumed value of each figure."""
    return [_row(*NAMES[name], figures[name]) for name in NAMES if name in figures]


def settings(
    figures: Mapping[str, Figure], drove: Sequence[float], sweep: SweepFigure | None = None
) -> list[Setting]:
    """The settings that follow from figures, two standard deviations to the safe side.

    `drove`: the fastest commanded speeds in m/s and rad/s, in the order of AXES. `sweep`: the
    measured sweep; None if the present file declares the sweep.
    """
    chosen = []
    for word, speed in zip(AXES, drove, strict=False):
        share = figures[f"speed_{word}"]
        if word != "lateral":
            axes = [word, "lateral"] if word == "linear" and len(drove) > 2 else [word]
            chosen += _braking(word, {axis: figures[f"braking_{axis}"] for axis in axes})
        if share.is_measured and share.value < 1.0 - _SLOWER:
            text = f"{_text(share)} of the {speed:.3g} commanded"
            chosen.append(_lower(f"limits.{word}", _down(share.value * speed), speed, text))
    late, margin = figures["scan_delay"], figures["margin"]
    if late.is_measured:
        value = _up(late.value + _DEVIATIONS * late.spread)
        text = f"{_text(late)}, and 2 sd"
        is_safe = value >= late.assumed
        chosen.append(Setting("scan.latency", value, late.assumed, text, is_safe))
    if sweep is not None and sweep.direction:
        way = f"{{start_deg: {sweep.start_deg:g}, direction: {sweep.direction}"
        value_of = f"{way}, duration: {sweep.duration:.3g}}}" if sweep.duration else "null"
        text = f"measured in {sweep.samples} pairs of scans"
        chosen.append(Setting("scan.sweep", value_of, "measured", text, True))
    if margin.is_measured and margin.value > margin.assumed:
        text = "for a response after more than 0.05 s: see the reaction delays"
        chosen.append(
            Setting("protection.barrier.margin", _up(margin.value), margin.assumed, text, True)
        )
    return chosen


def _braking(word: str, brakes: Mapping[str, Figure]) -> list[Setting]:
    """The setting of a deceleration that must hold on each axis of `brakes`: the weakest.

    Empty if nothing was measured. A stronger deceleration than assumed is set only if each axis was
    measured.
    """
    candidates = []
    for axis, brake in brakes.items():
        if brake.is_measured and not math.isnan(brake.assumed):
            value = _down(max(brake.value - _DEVIATIONS * brake.spread, 0.01 * brake.value))
            text = f"{_text(brake)}{'' if axis == word else f' {axis}'}, less 2 sd"
            key = f"protection.barrier.braking_{word}"
            candidates.append(_lower(key, value, brake.assumed, text))
    candidates.sort(key=lambda setting: setting.value)
    return (
        candidates[:1]
        if candidates[:1] and (candidates[0].is_safe or len(candidates) == len(brakes))
        else []
    )


def platform_file(
    robot: str, extends: str, day: str, figures: Mapping[str, Figure], chosen: list[Setting]
) -> str:
    """A platform file that extends the present file; less careful settings are commented out."""
    lines = [
        f"description: {extends.rsplit('/', 1)[-1].removesuffix('.yaml')}, calibrated as {robot}",
        f"extends: {extends}",
        "",
        f"# Measured by `swarmctl calibrate {robot}` on {day}: mean +- sd (samples).",
    ]
    lines += [f"#   {_line(name, figures[name])}" for name in NAMES if name in figures]
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


def _row(title: str, unit: str, figure: Figure) -> tuple[str, str, str, str, str]:
    assumed = "-" if math.isnan(figure.assumed) else f"{figure.assumed:.4g} {unit}".rstrip()
    if not figure.is_measured:
        return title, "not measured", "-", "-", assumed
    value = f"{_number(figure.value)} {unit}".rstrip()
    return title, value, _number(figure.spread), str(figure.samples), assumed


def _line(name: str, figure: Figure) -> str:
    title, unit = NAMES[name]
    if not figure.is_measured:
        return f"{title}: not measured: {figure.why}"
    return f"{title}: {_text(figure)} {unit}".rstrip()


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
