"""An outcome: a figure that a behaviour is to reach in a swarm, and what runs made of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Outcome:
    """One figure of one pattern. `values`: one a run, or one of all runs.

    `wanted` says in words what is asked, `source` where that is from.
    """

    pattern: str
    what: str
    wanted: str
    values: tuple[float, ...]
    is_reached: bool
    source: str

    @property
    def shown(self) -> str:
        """The values for a reader: one as it is, more as least, median and most."""
        if len(self.values) < 2:
            return " ".join(f"{value:.3g}" for value in self.values) or "none"
        some = np.array(self.values)
        return f"{some.min():.3g} / {np.median(some):.3g} / {some.max():.3g}"


def at_most(bound: float, values: Sequence[float]) -> bool:
    """Whether there are values, and none is above the bound or not a number."""
    return len(values) > 0 and all(value <= bound for value in values)


def at_least(bound: float, values: Sequence[float]) -> bool:
    """Whether there are values, and none is below the bound or not a number."""
    return len(values) > 0 and all(value >= bound for value in values)


def number(value: float | None) -> float:
    """A metric's value; NaN, which no bound lets pass, if the run has none."""
    return math.nan if value is None else value
