"""An outcome: a number that a pattern has to reach in a swarm, and what its runs reached."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from swarmd.sim.experiments.results import Results


@dataclass(frozen=True, slots=True)
class Outcome:
    """One number of one pattern. `values`: one for each run, or one for all runs.

    `wanted` is the condition as text, `source` the origin of the condition.
    """

    pattern: str
    what: str
    wanted: str
    values: tuple[float, ...]
    is_reached: bool
    source: str

    @property
    def shown(self) -> str:
        """The value as text; several values as least, median and most."""
        if len(self.values) < 2:
            return " ".join(f"{value:.3g}" for value in self.values) or "none"
        some = np.array(self.values)
        return f"{some.min():.3g} / {np.median(some):.3g} / {some.max():.3g}"


def at_most(pattern: str, what: str, bound: float, values: Sequence[float], source: str) -> Outcome:
    """Reached if there are values, and none is above the bound or NaN."""
    is_reached = len(values) > 0 and all(value <= bound for value in values)
    wanted = f"<= {bound:g}" if bound else "0"
    return Outcome(pattern, what, wanted, tuple(values), is_reached, source)


def at_least(
    pattern: str, what: str, bound: float, values: Sequence[float], source: str
) -> Outcome:
    """Reached if there are values, and none is below the bound or NaN."""
    is_reached = len(values) > 0 and all(value >= bound for value in values)
    return Outcome(pattern, what, f">= {bound:g}", tuple(values), is_reached, source)


def metric(results: Results, name: str) -> list[float]:
    """A metric of each run; NaN, which no bound accepts, where a run has no value."""
    return [float(value) for value in results.metric(name)]


def no_contacts(pattern: str, results: Results) -> Outcome:
    """Whether no robot touches another or the arena."""
    both = metric(results, "robot_contacts"), metric(results, "arena_contacts")
    contacts = [robots + arena for robots, arena in zip(*both, strict=True)]
    return at_most(pattern, "contacts", 0.0, contacts, "docs/safety.md")


def number(value: float | None) -> float:
    """A metric's value; NaN, which no bound accepts, if the run has none."""
    return math.nan if value is None else value
