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
_SHADES = 64  # of the scale of numbers
_MAX_CLASSES = 8
_OWN = ("state", "pattern", "platform", "robot")


@dataclass(frozen=True, slots=True)
class Colouring:
    """`colours` (T, n): of each robot at each instant, as #rrggbb; `key`: colour and meaning."""

    colours: NDArray[np.str_]
    key: Sequence[tuple[str, str]]


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
        own = np.array([robot_colour(i) for i in range(shape[1])])
        return Colouring(np.broadcast_to(own, shape), ())  # pictures name the robots
    if name in trace.words:
        return _by_word(trace.words[name])
    if name in trace.report:
        return _by_number(trace.report[name], name)
    known = (*_OWN, *trace.report, *trace.words)
    raise ConfigError(unknown("colour", by, known))


def _by_word(words: NDArray[np.str_], fixed: Mapping[str, str] = MappingProxyType({})) -> Colouring:
    """Colours by a text (T, n): the colours of `fixed`; if empty, those of PALETTE in turn."""
    colours = np.full(words.shape, UNKNOWN)
    key: list[tuple[str, str]] = []
    for word in sorted({str(w) for w in np.unique(words)} - {""}):
        free_colour = UNKNOWN if fixed else PALETTE[len(key) % len(PALETTE)]
        colour = fixed.get(word, free_colour)
        colours[words == word] = colour
        key.append((colour, word))
    return Colouring(colours, key)


def _by_number(values: Array, name: str) -> Colouring:
    """Colours by a number: up to _MAX_CLASSES whole numbers have a colour each.

    Other numbers have a colour on a scale from dark blue to yellow.
    """
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    colours = np.full(values.shape, UNKNOWN)
    is_known = np.isfinite(values)
    known = np.unique(values[is_known]).tolist()
    label = name.replace("_", " ")
    if not known:
        return Colouring(colours, [(UNKNOWN, f"no {label}")])
    if len(known) <= _MAX_CLASSES and known == [round(value) for value in known]:
        for colour, value in zip(PALETTE, known, strict=False):
            colours[values == value] = colour
        words = [f"{label} {known[0]:g}", *(f"{value:g}" for value in known[1:])]
        return Colouring(colours, list(zip(PALETTE, words, strict=False)))
    low = known[0]
    high = known[-1]
    shades = np.array([to_hex(shade) for shade in colormaps["cividis"](np.linspace(0, 1, _SHADES))])
    share = (values[is_known] - low) / max(high - low, 1e-9)
    colours[is_known] = shades[np.round((_SHADES - 1) * share).astype(int)]
    return Colouring(colours, [(shades[0], f"{label} {low:.3g}"), (shades[-1], f"{high:.3g}")])
