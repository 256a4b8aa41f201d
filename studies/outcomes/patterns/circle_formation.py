"""Circle formation: robots from anywhere form a circle, rest, and close it when one is removed.

The error and its bound, a tenth of the spacing, are the project's own.
"""

from __future__ import annotations

from collections.abc import Sequence

from studies.outcomes.outcome import Outcome
from studies.outcomes.patterns.line_formation import BURGERS, BY_LIDAR, SETTINGS, Setting, formed
from swarmd.sim.metrics.formation import circle_errors

SHORT_FORM = {"settings": (BURGERS,)}
IS_LONG = True
FILM = {"title": "one robot is removed", "sets": {"arena.size": [6, 6]}}
_ALL = (*SETTINGS, BY_LIDAR)


def outcomes(
    seeds: Sequence[int], jobs: int = 1, settings: Sequence[Setting] = _ALL
) -> list[Outcome]:
    """The outcomes of each setting."""
    return formed("circle_formation", circle_errors, seeds, jobs, settings)
