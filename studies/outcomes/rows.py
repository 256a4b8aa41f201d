"""The outcomes of a pattern whose bounds are rows of `patterns/<name>/outcomes.yaml`.

`swarmctl exp run <name>/outcomes.yaml` does the same runs. Here their values make the table of a
page: a mean is reached if it is beyond the bound, `exp check` asks its interval.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec
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
from swarmd.settings.yamlfile import read
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

Sets = Mapping[str, Mapping[str, Any] | None]
"""Overrides of a scenario by dotted key, by the name of runs; None: the runs are left out."""
NOTHING: Mapping[str, Any] = MappingProxyType({})
_FORMS = Path(__file__).with_name("forms.yaml")


class Form(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The short form and the film of a pattern; the file `forms.yaml` says what each key means.

    In a file of its own: a word in this module would make a pattern a source of all tables.
    """

    short: dict[str, dict[str, Any] | None] = {}
    bounds: dict[str, float] = {}
    is_long: bool = False
    film: dict[str, Any] = {}


@cache
def forms() -> Mapping[str, Form]:
    """The forms that are kept, by pattern."""
    return msgspec.convert(read(_FORMS), dict[str, Form])


@dataclass(frozen=True)
class RowsOf:
    """A pattern with a file of outcomes, as the modules of `patterns` are: see `catalog`."""

    pattern: str

    @cached_property
    def file(self) -> Outcomes:
        """The rows and their runs."""
        return read_outcomes(PATTERNS / self.pattern / NAME)

    @property
    def form(self) -> Form:
        """What differs in the short form and in the film."""
        return forms().get(self.pattern, Form())

    @property
    def SEEDS(self) -> int:
        """The number of seeds, from 0 on."""
        return 1 + max(seed for runs in self.file.runs.values() for seed in runs.seeds)

    @property
    def IS_LONG(self) -> bool:
        """Whether the short form is long."""
        return self.form.is_long

    @property
    def FILM(self) -> Mapping[str, Any]:
        """How the film differs from the whole scenario."""
        return self.form.film

    @property
    def SHORT_FORM(self) -> Mapping[str, Any]:
        """The arguments of `outcomes` for the short form."""
        return {"sets": self.form.short, "bounds": self.form.bounds}

    def outcomes(
        self,
        seeds: Sequence[int],
        jobs: int = 1,
        sets: Sets = NOTHING,
        bounds: Mapping[str, float] = NOTHING,
    ) -> list[Outcome]:
        """All outcomes, in the order of the rows; `bounds` in place of those of rows."""
        made, _ = outcomes_with_runs(self.file, self.pattern, seeds, jobs, sets, bounds)
        return made


def outcomes_with_runs(
    file: Outcomes,
    pattern: str,
    seeds: Sequence[int],
    jobs: int = 1,
    sets: Sets = NOTHING,
    bounds: Mapping[str, float] = NOTHING,
    *,
    traces: bool = False,
) -> tuple[list[Outcome], dict[str, Results]]:
    """The outcomes of the rows of a file, and the runs by name.

    `sets`: changes of the runs; rows of runs that are left out have no outcome. `bounds`: in place
    of those of rows, by what is measured. `traces`: keep the traces of the runs.
    """
    results = {}
    for name, runs in file.runs.items():
        own = sets.get(name, NOTHING)
        some = [seed for seed in seeds if seed in runs.seeds] if runs.has_own_seeds else seeds
        if own is not None and some:
            results[name] = _runs(file, name, runs, some, jobs, own, traces=traces)
    made = [
        _outcome(pattern, row, results, bounds.get(row.what, row.requirement.value))
        for row in file.rows
        if all(not results.keys().isdisjoint(names) for names in row.sides)
    ]
    return made, results


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


def _outcome(pattern: str, row: Row, results: Mapping[str, Results], bound: float) -> Outcome:
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
