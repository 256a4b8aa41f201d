"""Circle formation: robots from anywhere form a circle, rest, and close it when one is removed.

The error and its bound, a tenth of the spacing, are the project's own.
"""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.mutations import Mutant
from benchmarks.outcomes.line_formation import BY_LIDAR, SETTINGS, Setting, formed
from benchmarks.outcomes.outcome import Outcome
from swarmd.sim.metrics.formation import circle_errors

_FORMATION, _FORMING = "swarmd/kit/formation.py", "swarmd/kit/forming.py"
_TESTS = "tests/outcomes/test_circle_formation.py"
_ALL = (*SETTINGS, BY_LIDAR)


def outcomes(
    seeds: Sequence[int], jobs: int = 1, settings: Sequence[Setting] = _ALL
) -> list[Outcome]:
    """What 5 to 8 robots, by the seed, make of it in each setting."""
    return formed("circle_formation", circle_errors, seeds, jobs, settings)


def mutant(what: str, change: str, path: str, old: str, new: str) -> Mutant:
    """A wrong circle formation."""
    return Mutant(f"circle formation: {what}", change, path, old, new, tests=_TESTS)


MUTANTS = (
    mutant(
        "outwards",
        "it goes to the other side of the circle",
        _FORMATION,
        "place: Array = middle + radius *",
        "place: Array = middle - radius *",
    ),
    mutant(
        "middle",
        "the middle is the mean of the others",
        _FORMATION,
        "middle: Array = points.sum(axis=0) / count\n    if count",
        "middle: Array = points[1:].sum(axis=0) / max(count - 1, 1)\n    if count",
    ),
    mutant(
        "equal angles",
        "it stays in the direction in which it is",
        _FORMATION,
        "own = first + 2.0 * math.pi / count * _rank(angles)",
        "own = float(angles[0]) + 0.0 * first",
    ),
    mutant(
        "order",
        "it counts the others the other way round",
        _FORMATION,
        "own = first + 2.0 * math.pi / count * _rank(angles)",
        "own = first - 2.0 * math.pi / count * _rank(angles)",
    ),
    mutant(
        "count",
        "it does not count itself",
        "patterns/circle_formation.py",
        "radius_of(self.params.spacing, len(others) + 1)",
        "radius_of(self.params.spacing, len(others))",
    ),
    mutant(
        "spacing",
        "the radius does not depend on how many they are",
        "patterns/circle_formation.py",
        "radius_of(self.params.spacing, len(others) + 1)",
        "self.params.spacing",
    ),
    mutant(
        "left and right",
        "what is sensed to the left is taken to be on the right",
        _FORMATION,
        "place = here + heading * cmath.rect(distance, bearing)",
        "place = here + heading * cmath.rect(distance, -bearing)",
    ),
    mutant(
        "rest",
        "it never rests",
        _FORMING,
        "return ZERO if self._is_settled else self._follow(way, length)",
        "return self._follow(way, length)",
    ),
)
