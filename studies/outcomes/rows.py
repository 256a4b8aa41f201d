"""The outcomes of a pattern whose bounds are rows of `patterns/<name>/outcomes.yaml`.

`swarmctl exp run <name>/outcomes.yaml` does the same runs. Here their values make the table of a
page: a mean is reached if it is beyond the bound, `exp check` asks its interval.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from studies.outcomes.outcome import (
    PATTERNS,
    Joined,
    Outcome,
    at_least,
    at_most,
    difference_of,
    mean_of,
    median_of,
    ratio_of,
    share_of,
)
from swarmd.sim.experiments.outcomes import (
    NAME,
    Outcomes,
    Row,
    RunsOf,
    check_share,
    read_outcomes,
    samples_of,
)
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import simulate

Sets = Mapping[str, Mapping[str, Any]]
"""Overrides of a scenario by dotted key, by the name of runs."""
NO_SETS: Sets = MappingProxyType({})

SHORT_FORMS: Mapping[str, Sets] = {
    "attraction": {"runs": {"duration": 40.0}},
    "cooperative_transport": {"six": {"duration": 80.0, "arena.boxes.0.size": [0.5, 0.5]}},
    "flocking": {name: {"duration": 30.0} for name in ("flock", "walkers")},
    "one_bit_aggregation": {name: {"duration": 120.0} for name in ("swarm", "blocked", "blind")},
}
"""What a test of a few seconds changes, by pattern; a key that is swept is set in its place."""
LONG = frozenset(
    (
        *("attraction", "cooperative_transport", "cue_aggregation", "one_bit_aggregation"),
        *("phototaxis", "policy", "source_seeking"),
    )
)
"""Patterns whose short form takes two seconds of processor time and more."""
FILMS: Mapping[str, Mapping[str, Any]] = {
    "attraction": {"stop": 90.0},
    "cooperative_transport": {"title": "to a lamp on the right", "stop": 75.0},
    "cue_aggregation": {"title": "the right is warmer", "stop": 240.0},
    "dispersion": {"stop": 40.0, "sets": {"arena.size": [6, 6]}},
    "drive": {"title": "towards a wall", "stop": 25.0},
    "flocking": {"stop": 40.0, "seed": 1},
    "one_bit_aggregation": {"stop": 240.0},
    "phototaxis": {"title": "to a lamp on the right", "stop": 60.0},
    "policy": {"title": "a learned network"},
    "source_seeking": {"title": "up to the right", "stop": 120.0},
}
"""How the films of patterns differ from their whole scenarios: the fields of `films.Shot`."""


@dataclass(frozen=True)
class RowsOf:
    """A pattern with a file of outcomes, as the modules of `patterns` are: see `catalog`."""

    pattern: str

    @cached_property
    def file(self) -> Outcomes:
        """The rows and their runs."""
        return read_outcomes(PATTERNS / self.pattern / NAME)

    @property
    def SEEDS(self) -> int:
        """The number of runs of each setting."""
        return max(len(runs.seeds) for runs in self.file.runs.values())

    @property
    def IS_LONG(self) -> bool:
        """Whether the short form is long."""
        return self.pattern in LONG

    @property
    def FILM(self) -> Mapping[str, Any]:
        """How the film differs from the whole scenario."""
        return FILMS.get(self.pattern, {})

    @property
    def SHORT_FORM(self) -> Mapping[str, Any]:
        """The arguments of `outcomes` for the short form."""
        return {"sets": SHORT_FORMS.get(self.pattern, {})}

    def outcomes(self, seeds: Sequence[int], jobs: int = 1, sets: Sets = NO_SETS) -> list[Outcome]:
        """All outcomes, in the order of the rows."""
        made, _ = outcomes_with_runs(self.file, self.pattern, seeds, jobs, sets)
        return made


def outcomes_with_runs(
    file: Outcomes,
    pattern: str,
    seeds: Sequence[int],
    jobs: int = 1,
    sets: Sets = NO_SETS,
    *,
    traces: bool = False,
) -> tuple[list[Outcome], dict[str, Results]]:
    """The outcomes of the rows of a file, and the runs by name.

    `sets`: changes of the runs. `traces`: keep the traces of the runs.
    """
    results = {
        name: _runs(file, name, runs, seeds, jobs, sets.get(name, {}), traces=traces)
        for name, runs in file.runs.items()
    }
    return [_outcome(pattern, row, results) for row in file.rows], results


def _runs(
    file: Outcomes,
    name: str,
    runs: RunsOf,
    seeds: Sequence[int],
    jobs: int,
    sets: Mapping[str, Any],
    *,
    traces: bool,
) -> Results:
    return simulate(
        runs.scenario,
        seeds,
        set={**runs.sets, **sets},
        sweep={key: values for key, values in runs.sweep.items() if key not in sets},
        jobs=jobs,
        traces=traces,
        metrics=file.metrics(name),
    )


def _outcome(pattern: str, row: Row, results: Mapping[str, Results]) -> Outcome:
    bound = row.requirement.value
    make = {"<=": at_most, ">=": at_least}[row.requirement.comparison]
    return make(pattern, row.what, bound, _values(row, results), row.source)


def _values(row: Row, results: Mapping[str, Results]) -> tuple[float, ...] | Joined:
    samples = samples_of(row, results)
    match row.requirement.statistic:
        case "min" | "max":
            (values,) = samples
            return values
        case "median":
            return median_of(samples[0])
        case "share":
            check_share(row, np.array(samples[0]))
            return share_of(value == 1.0 for value in samples[0])
    if row.other is None:
        return mean_of(samples[0])
    return ratio_of(*samples) if row.other.kind == "over" else difference_of(*samples)
