"""The colour of each robot at each instant of a run, and the key to these colours.

The palette is that of the page: M. Okabe and K. Ito, "Color Universal Design", 2008.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.values import Array
from swarmd.sim.plots.scene import robot_colour
from swarmd.sim.trace import Trace, patterns_of

PALETTE = (
    *("#0072b2", "#e69f00", "#009e73", "#cc79a7"),
    *("#56b4e9", "#d55e00", "#f0e442", "#999999"),
)
STATES = MappingProxyType(
    {
        "running": "#009e73",
        "idle": "#56b4e9",
        "stopped": "#e69f00",
        "estopped": "#d55e00",
        "faulted": "#cc79a7",
    }
)
UNKNOWN = "#999999"
_LOW, _HIGH = np.array([33.0, 62.0, 160.0]), np.array([240.0, 220.0, 60.0])
_MAX_CLASSES = 8
_OWN = ("state", "pattern", "platform", "robot")

Rgb = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Colouring:
    """`rgb` (T, n, 3) uint8: the colour of each robot at each instant; `key`: its legend."""

    rgb: NDArray[np.uint8]
    key: Sequence[tuple[Rgb, str]]


def colouring_of(trace: Trace, by: str) -> Colouring:
    """The colours of all robots of a run by `by`: state, pattern, platform, robot or a report.

    A report is a value that patterns report, as KEY or `report:KEY`. So `state` is the state of the
    robot, and `report:state` is a reported value with the name `state`. ConfigError with the
    nearest name if no robot reports such a value.
    """
    shape = trace.pose.shape[:2]  # (instants, robots)
    name = by.removeprefix("report:")
    if by == "state":
        # A trace without states: all robots count as running.
        words = np.full(shape, "running") if trace.state is None else trace.state
        return _by_word(words, STATES)
    if by == "pattern":
        names, indices = patterns_of(trace)
        return _by_word(np.array(names)[indices])
    if by == "platform":
        return _by_word(np.broadcast_to(np.array(trace.platforms), shape))
    if by == "robot":
        rgb = np.array([rgb_of(robot_colour(i)) for i in range(shape[1])], dtype=np.uint8)
        key = [(_plain(colour), robot) for colour, robot in zip(rgb, trace.ids, strict=True)]
        return Colouring(np.broadcast_to(rgb, (*shape, 3)), key)
    if name in trace.words:
        return _by_word(trace.words[name])
    if name in trace.report:
        return _by_number(trace.report[name], name)
    known = (*_OWN, *trace.report, *trace.words)
    raise ConfigError(unknown("colour", by, known))


def rgb_of(colour: str) -> Rgb:
    """Red, green and blue, 0 to 255, of #rrggbb."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue


def _by_word(words: NDArray[np.str_], fixed: Mapping[str, str] = MappingProxyType({})) -> Colouring:
    """Colours by a text (T, n): the colours of `fixed`; if empty, those of PALETTE in turn."""
    rgb = np.empty((*words.shape, 3), dtype=np.uint8)
    rgb[:] = rgb_of(UNKNOWN)
    key: list[tuple[Rgb, str]] = []
    for word in sorted({str(w) for w in np.unique(words)} - {""}):
        free_colour = UNKNOWN if fixed else PALETTE[len(key) % len(PALETTE)]
        colour = rgb_of(fixed.get(word, free_colour))
        rgb[words == word] = colour
        key.append((colour, word))
    return Colouring(rgb, key)


def _by_number(values: Array, name: str) -> Colouring:
    """Colours by a number: up to _MAX_CLASSES whole numbers have a colour each.

    Other numbers have a colour on a scale from blue to yellow.
    """
    is_known = np.isfinite(values)
    rgb = np.empty((*values.shape, 3), dtype=np.uint8)
    rgb[:] = rgb_of(UNKNOWN)
    known = np.unique(values[is_known])
    if not len(known):
        return Colouring(rgb, [(rgb_of(UNKNOWN), f"no {name}")])
    label = name.replace("_", " ")
    if len(known) <= _MAX_CLASSES and (known == np.round(known)).all():
        key: list[tuple[Rgb, str]] = []
        for index, value in enumerate(known.tolist()):
            colour = rgb_of(PALETTE[index])
            rgb[values == value] = colour
            key.append((colour, f"{value:g}" if key else f"{label} {value:g}"))
        return Colouring(rgb, key)
    low, high = float(known[0]), float(known[-1])
    share = ((values[is_known] - low) / max(high - low, 1e-9))[:, None]
    rgb[is_known] = np.round((1.0 - share) * _LOW + share * _HIGH)
    return Colouring(rgb, [(_plain(_LOW), f"{label} {low:.3g}"), (_plain(_HIGH), f"{high:.3g}")])


def _plain(colour: NDArray[np.generic] | Array) -> Rgb:
    red, green, blue = (int(part) for part in colour)
    return red, green, blue
