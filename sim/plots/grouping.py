"""How pictures tell the robots of an instant apart: by their opinions, or by cluster."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from swarmd.sim.metrics.aggregation import clusters
from swarmd.sim.metrics.consensus import OPINION
from swarmd.sim.metrics.window import presence
from swarmd.sim.plots.theme import ROBOT_COLOURS
from swarmd.sim.trace import Trace

NO_COLOUR = "white"
"""Of lone robots, and of those without an opinion."""
SMALL_COLOUR = "0.6"
"""Of all groups beyond those that have colours of their own."""
_MOST_COUNTED = 4  # opinions that a title has room for


@dataclass(frozen=True, slots=True)
class Grouping:
    """The colour (n,) of each robot, and in words what groups there are."""

    colours: list[str]
    words: str


def opinions_of(trace: Trace) -> list[float]:
    """Every opinion that a robot held at the first or the last instant, in order; often none."""
    opinion = trace.report.get(OPINION)
    if opinion is None or not len(opinion):
        return []
    ends = opinion[[0, -1]]
    return [float(value) for value in np.unique(ends[np.isfinite(ends)])]


def key_of(opinions: Sequence[float]) -> list[tuple[Any, str]]:
    """Handle and label of each opinion that has a colour, for a legend."""
    from matplotlib.patches import Patch

    return [
        (Patch(facecolor=colour, edgecolor="0.1"), f"opinion {value:g}")
        for value, colour in zip(opinions, ROBOT_COLOURS[:-1], strict=False)
    ]


def by_opinion(part: Trace, opinions: Sequence[float]) -> Grouping:
    """By what is held at the first instant of `part`; each of `opinions` has its colour."""
    held = np.where(presence(part), part.report[OPINION], np.nan)[0]
    colour_of = dict.fromkeys(opinions, SMALL_COLOUR)
    colour_of |= dict(zip(opinions, ROBOT_COLOURS[:-1], strict=False))
    colours = [colour_of.get(float(value), NO_COLOUR) for value in held]
    counts = Counter(float(value) for value in held if np.isfinite(value))
    most = sorted(counts, key=lambda value: (-counts[value], value))
    words = [f"opinion {value:g}: {counts[value]}" for value in most[:_MOST_COUNTED]]
    words += [f"{len(most) - _MOST_COUNTED} more"] if len(most) > _MOST_COUNTED else []
    return Grouping(colours, ", ".join(words) or "no opinion yet")


def by_cluster(part: Trace, link: float | None) -> Grouping:
    """By cluster at the first instant of `part`, the largest in colour; alike without a `link`."""
    n = int(presence(part)[0].sum())
    robots = f"{n} robot" if n == 1 else f"{n} robots"
    if link is None:
        return Grouping([ROBOT_COLOURS[0]] * len(part.ids), robots)
    labels = [int(label) for label in clusters(part, link)[0]]
    sizes = Counter(label for label in labels if label >= 0)
    by_size = sorted((label for label in sizes if sizes[label] > 1), key=lambda k: (-sizes[k], k))
    colour_of = dict.fromkeys(sizes, NO_COLOUR) | dict.fromkeys(by_size, SMALL_COLOUR)
    colour_of |= dict(zip(by_size, ROBOT_COLOURS[:-1], strict=False))
    colours = [colour_of.get(label, NO_COLOUR) for label in labels]
    largest = max(sizes.values(), default=0)
    if n > 1 and largest == 1:
        return Grouping(colours, f"all {n} alone")
    if len(sizes) > 1:
        return Grouping(colours, f"{len(sizes)} clusters, the largest of {largest}")
    return Grouping(colours, f"one cluster of {n}" if n > 1 else robots)
