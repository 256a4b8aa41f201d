"""The results of an experiment, read from its folder: rows, statistics and traces."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from swarmd.core.errors import ConfigError, SwarmError, unknown
from swarmd.core.values import Array
from swarmd.sim.experiments.manifest import read_manifest
from swarmd.sim.experiments.plan import Plan, Run
from swarmd.sim.experiments.report import HEADER, aligned, summary_rows
from swarmd.sim.experiments.statistics import LEVEL, METHOD, Summary, summarize
from swarmd.sim.experiments.store import Row, read_failures, read_table, trace_path
from swarmd.sim.metrics.catalog import METRICS, is_time_to_event
from swarmd.sim.trace import Trace, load_trace

YES_OR_NO = "0 or 1"
"""The unit of metrics that are true or false for a run."""


class Traces:
    """Traces of finished runs, by number or run id; each is read from the disk when accessed."""

    def __init__(self, results: Results) -> None:
        self._results = results  # without it, its temporary folder would be removed
        self._runs = results.runs

    def __len__(self) -> int:
        return len(self._runs)

    def __iter__(self) -> Iterator[Trace]:
        return (self[number] for number in range(len(self)))

    def __getitem__(self, which: int | str) -> Trace:
        """The trace of a run; SwarmError if it was not kept or is damaged."""
        if isinstance(which, str):
            ids = [run.id for run in self._runs]
            if which not in ids:
                raise ConfigError(unknown("run", which, ids))
            which = ids.index(which)
        path = trace_path(self._results.folder, self._runs[which])
        if not path.exists():
            raise SwarmError(f"{path}: there is no trace; it was not kept, or has been removed")
        return load_trace(path)


class Results:
    """The finished runs of an experiment, in the order of its plan.

    `failures`: the reason of each failed run, by run. `variants`: the names of the points of the
    parameter sweep, one empty name without a sweep. `kernels`: `compiled`, or which code ran
    instead.
    """

    def __init__(
        self,
        folder: Path,
        plan: Plan,
        rows: Iterable[Row],
        failures: Mapping[str, str],
        metrics: Sequence[str],
        kernels: str = "",
    ) -> None:
        self.folder = folder
        self.plan = plan
        self.failures = dict(failures)
        self.metrics = tuple(metrics)
        self.kernels = kernels
        self.variants = tuple(variant.name for variant in plan.variants)
        self._rows = tuple(rows)
        self._rows_of: dict[str, list[Row]] = {name: [] for name in self.variants}
        for row in self._rows:
            self._rows_of[row.run.variant.name].append(row)

    @property
    def rows(self) -> list[dict[str, Any]]:
        """A mapping for each run, as pandas takes them: names, swept values, seed and metrics."""
        return [row.plain() for row in self._rows]

    @property
    def runs(self) -> tuple[Run, ...]:
        """The finished runs."""
        return tuple(row.run for row in self._rows)

    @property
    def traces(self) -> Traces:
        """The traces of the finished runs, in the order of `rows`."""
        return Traces(self)

    def metric(self, name: str, variant: str | None = None) -> Array:
        """The values (runs,) of a metric, NaN where it has none; of all variants if None.

        ConfigError with the nearest name if there is no such metric or variant.
        """
        if name not in self.metrics:
            raise ConfigError(unknown("metric", name, self.metrics))
        rows = self._rows if variant is None else self._of(variant)
        return np.array([row.metrics[name] for row in rows], dtype=np.float64)  # None gives NaN

    def seeds(self, variant: str) -> tuple[int, ...]:
        """The seeds of the finished runs of a variant, in the order of `metric`."""
        return tuple(row.run.seed for row in self._of(variant))

    @property
    def times_real_time(self) -> Array:
        """How many times faster than real time each run (runs,) went; a wall time has 1 ms."""
        return np.array(
            [row.run.variant.effective["duration"] / max(row.wall, 1e-3) for row in self._rows]
        )

    def summary(
        self, variant: str | None = None, names: Sequence[str] | None = None
    ) -> dict[str, Summary]:
        """Statistics by metric, of a variant or the only one; of all metrics without `names`.

        ConfigError if there are several variants and none is named.
        """
        if variant is None:
            if len(self.variants) > 1:
                text = f"there are {len(self.variants)} variants: {', '.join(self.variants)}"
                raise ConfigError(f"{text}; name one")
            variant = self.variants[0]
        return {
            name: summarize(
                self.metric(name, variant),
                is_share=unit_of(name) == YES_OR_NO,
                is_time_to_event=is_time_to_event(name),
            )
            for name in names or self.metrics
        }

    def document(self, names: Sequence[str] | None = None) -> dict[str, Any]:
        """All statistics as plain values, or of the named metrics: the contents of summary.json."""
        return {
            "scenario": self.plan.scenario,
            "runs": len(self.plan.runs),
            "finished": len(self._rows),
            "failed": len(self.failures),
            "part": None if self.plan.shard is None else str(self.plan.shard),
            "kernels": self.kernels,
            "times_real_time": self._speed(),
            "wall": sum(row.wall for row in self._rows),
            "level": LEVEL,
            "method": METHOD,
            "variants": [
                {
                    "name": variant.name,
                    "values": dict(variant.values),
                    "finished": len(self.seeds(variant.name)),
                    "metrics": {
                        name: {"unit": unit_of(name), **asdict(summary)}
                        for name, summary in self.summary(variant.name, names).items()
                    },
                }
                for variant in self.plan.variants
            ],
        }

    def text(self, names: Sequence[str] | None = None) -> str:
        """A table of each variant, of all metrics without `names`."""
        failed = f", {len(self.failures)} failed" if self.failures else ""
        part = f"part {self.plan.shard}, " if self.plan.shard else ""
        count = f"{len(self._rows)} of {len(self.plan.runs)} runs"
        found = [f"{self.plan.scenario}: {part}{count}{failed}"]
        if (speed := self._speed()) is not None:
            some = (
                f"{speed['median']:.3g} times real time ({speed['min']:.3g} to {speed['max']:.3g})"
            )
            found.append(f"each run: {some}; all runs: {sum(row.wall for row in self._rows):.3g} s")
        if self.kernels not in ("", "compiled"):
            found.append(f"kernels: {self.kernels}")
        for variant in self.variants:
            found += ["", variant] if variant else [""]
            found += aligned(HEADER, summary_rows(self.summary(variant, names)))
        return "\n".join(found)

    def __str__(self) -> str:
        return self.text()

    def _speed(self) -> dict[str, float] | None:
        found = self.times_real_time
        if not found.size:
            return None
        values = float(np.median(found)), float(found.min()), float(found.max())
        return dict(zip(("median", "min", "max"), values, strict=True))

    def _of(self, variant: str) -> Sequence[Row]:
        if variant not in self._rows_of:
            raise ConfigError(unknown("variant", variant, self.variants))
        return self._rows_of[variant]


def load_results(folder: str | Path) -> Results:
    """The results in an experiment's folder, also of an interrupted one.

    ConfigError in one line if it is no such folder, or damaged.
    """
    place = Path(folder)
    manifest = read_manifest(place)
    plan = manifest.plan
    metrics, rows = read_table(place, plan)
    failures = {run: why for run, why in read_failures(place).items() if run not in rows}
    kernels = manifest.made_with.get("kernels", "")
    return Results(place, plan, rows.values(), failures, metrics, kernels)


def unit_of(metric: str) -> str:
    """The unit of a metric; empty for an unknown one, such as that of another version."""
    return METRICS[metric].unit if metric in METRICS else ""
