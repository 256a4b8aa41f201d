"""Circle formation: robots from anywhere form a circle, rest, and close it when one is removed.

The error and its bound, a tenth of the spacing, are the project's own.
"""

from __future__ import annotations

from collections.abc import Sequence

from studies.outcomes.line_formation import BY_LIDAR, SETTINGS, Setting, formed
from studies.outcomes.outcome import Outcome
from swarmd.sim.metrics.formation import circle_errors

_ALL = (*SETTINGS, BY_LIDAR)


def outcomes(
    seeds: Sequence[int], jobs: int = 1, settings: Sequence[Setting] = _ALL
) -> list[Outcome]:
    return formed("circle_formation", circle_errors, seeds, jobs, settings)
