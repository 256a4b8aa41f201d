"""The results of an experiment, read from its folder: rows, statistics and traces."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from swarmd.core.errors import ConfigError, SwarmError, unknown
from swarmd.core.values import Array
from swarmd.operator.texts.values import counted
from swarmd.sim.experiments import statistics
from swarmd.sim.experiments.manifest import Manifest, read_manifest
from swarmd.sim.experiments.plan import Plan, Run
from swarmd.sim.experiments.store import Row, read_errors, read_failures, read_table, trace_path
from swarmd.sim.experiments.trust import check_code
from swarmd.sim.metrics.catalog import (
    METRICS,
    Metric,
    check_has_value,
    measure,
    metric_of,
    names_file,
)
from swarmd.sim.metrics.own import MetricError, digest_of_file
from swarmd.sim.metrics.protection import FAILED_PATTERNS
from swarmd.sim.trace import Trace, load_trace, pandas

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


@dataclass(frozen=True, slots=True)
class CustomMetrics:
    """The metrics of an experiment that are not in the catalog.

    `errors`: why a metric has no value, by run and metric. `is_trusted`: the user trusts the Python
    files of the metrics, also if they have changed since the runs, or if this user has never run
    them. `report_units`: units by the keys of reports.
    """

    by_name: Mapping[str, Metric]
    errors: Mapping[str, Mapping[str, str]]
    is_trusted: bool = False
    report_units: Mapping[str, str] = field(default_factory=dict)


class Results:
    """The finished runs of an experiment, in the order of its plan.

    - `failures`: the reason of each failed run, by run.
    - `errors`: why custom metrics have no value, by run and metric; and `pattern_faults`.
    - `metrics`: the metrics in the columns of the table.
    - `variants`: the names of the variants, a variant for each combination of swept values; one
      empty name without a sweep.
    - `kernels`: `compiled`, or a text about the code that ran instead of compiled kernels.
    """

    def __init__(
        self,
        folder: Path,
        plan: Plan,
        rows: Iterable[Row],
        failures: Mapping[str, str],
        metrics: Sequence[str],
        kernels: str = "",
        custom: CustomMetrics | None = None,
    ) -> None:
        """`rows`: the finished runs in the order of `plan`.

        `custom`: the metrics beyond the catalog, whether their code is trusted, and the units of
        reports; None: the catalog alone. All other arguments become attributes.
        """
        self.folder = folder
        self.plan = plan
        self.failures = dict(failures)
        self.metrics = tuple(metrics)
        self.kernels = kernels
        custom = custom or CustomMetrics({}, {})
        self.errors = {run: dict(reasons) for run, reasons in custom.errors.items()}
        self._custom = dict(custom.by_name)
        self._is_trusted = custom.is_trusted
        self.report_units = custom.report_units
        # Metrics measured from traces later, by (name, digest of the code) and by run.
        self._measured: dict[tuple[str, str], dict[str, float | None]] = {}
        self.variants = tuple(variant.name for variant in plan.variants)
        self._rows = tuple(rows)
        self._rows_of: dict[str, list[Row]] = {name: [] for name in self.variants}
        for row in self._rows:
            self._rows_of[row.run.variant.name].append(row)

    @property
    def rows(self) -> list[dict[str, Any]]:
        """A mapping for each run, as pandas takes them: names, swept values, seed and metrics."""
        return [row.plain() for row in self._rows]

    def frame(self) -> Any:
        """`rows` as a pandas DataFrame; SwarmError without pandas."""
        table = pandas().DataFrame(self.rows)
        numbers = [*self.metrics, "wall"]
        return table.astype(dict.fromkeys(numbers, float)) if len(table) else table

    @property
    def runs(self) -> tuple[Run, ...]:
        """The finished runs."""
        return tuple(row.run for row in self._rows)

    @property
    def lacking(self) -> str:
        """A text with the numbers of finished and failed runs; empty if all runs have finished."""
        planned = len(self.plan.runs)
        finished = len(self._rows)
        if planned == finished:
            return ""
        failed = f", {len(self.failures)} failed" if self.failures else ""
        return f"{finished} of {counted(planned, 'run')} done{failed}"

    @property
    def traces(self) -> Traces:
        """The traces of the finished runs, in the order of `rows`."""
        return Traces(self)

    def about(self, which: str | Metric) -> Metric:
        """The metric of that name; ConfigError with the nearest name for an unknown metric."""
        if isinstance(which, str) and which in self._custom:
            return self._custom[which]
        if isinstance(which, str) and which in self.metrics and which not in METRICS:
            return Metric(which, "", "", "another version of swarmd", value=lambda trace: None)
        return metric_of(which, report_units=self.report_units, others=self._custom)

    def asked(self, name: str | Metric) -> Metric:
        """The metric that the user asks for by name; that of a Python file has its present code.

        The code may have changed since the runs, and the user means the present code. ConfigError
        if the file is new, has changed or has never been run by this user, unless these results are
        trusted. For all other names the result is that of `about`.
        """
        known = self._custom.get(name) if isinstance(name, str) else None
        file = known.origin.rpartition(":")[0] if known is not None else ""
        if known is not None and file and Path(file).is_file():
            return _Code(self.folder, known.origin, known.digest, self._is_trusted).metric
        return self.about(name)

    def metric(self, which: str | Metric, variant: str | None = None) -> Array:
        """The values (runs,) of a metric in the finished runs; NaN: no value.

        `variant`: the runs of this variant; None: all runs. A metric that the runs did not measure,
        or measured with other code, is measured now on the traces. ConfigError with the nearest
        name for an unknown metric or variant. SwarmError if traces are missing.
        """
        metric = self.about(which)
        rows = self._rows if variant is None else self._of(variant)
        known = self._custom.get(metric.name)
        if metric.name in self.metrics and (known is None or known.digest == metric.digest):
            values = [row.metrics[metric.name] for row in rows]
        else:
            measured = self._from_traces(metric)
            values = [measured[row.run.id] for row in rows]
        return np.array(values, dtype=np.float64)  # None gives NaN

    @property
    def pattern_faults(self) -> dict[str, str]:
        """The first error of a pattern in each run with one, by run; such a run has its row."""
        return {
            run: why[FAILED_PATTERNS] for run, why in self.errors.items() if FAILED_PATTERNS in why
        }

    def unreported(self) -> dict[str, str]:
        """A line for each metric `report:KEY` or `reading:KEY` whose value no robot ever gave."""
        custom = self._custom.values()
        empty = [m for m in custom if not any(row.metrics[m.name] for row in self._rows)]
        return {metric.name: fault for metric in empty if (fault := self._unreported(metric))}

    def _unreported(self, metric: Metric) -> str:
        """Why no run has a value other than 0; "" if a trace has the reported value."""
        fault = ""
        for number in range(len(self._rows)):
            try:
                check_has_value(metric, self.traces[number])
                return ""
            except SwarmError as error:
                fault = str(error)
        return fault

    def _from_traces(self, metric: Metric) -> Mapping[str, float | None]:
        """The value of a metric by run, measured on the traces; later calls return the same values.

        None: a custom metric failed, with its error in `errors`. SwarmError if a trace is missing.
        ConfigError if no robot ever reports the value that the metric takes.
        """
        key = metric.origin or metric.name, metric.digest
        if key not in self._measured:
            measured: dict[str, float | None] = {}
            for errors in self.errors.values():
                errors.pop(metric.name, None)  # from the metric's code at the time of the runs
            for row in self._rows:
                try:
                    value = measure(self.traces[row.run.id], [metric])[metric.name]
                    measured[row.run.id] = value
                except MetricError as error:
                    measured[row.run.id] = None
                    self.errors.setdefault(row.run.id, {})[metric.name] = str(error)
                except SwarmError as error:
                    text = f"metric {metric.name} was not measured by the runs, and {error}"
                    raise SwarmError(f"{text}; run again with --metrics {metric.name}") from error
            # Without any value (None or 0): perhaps no robot reports the key of the metric.
            if not any(measured.values()) and (fault := self._unreported(metric)):
                raise ConfigError(fault)
            self._measured[key] = measured
        return self._measured[key]

    def seeds(self, variant: str) -> tuple[int, ...]:
        """The seeds of the finished runs of a variant, in the order of `metric`."""
        return tuple(row.run.seed for row in self._of(variant))

    def duration(self, variant: str) -> float:
        """The duration in s of the runs of a variant."""
        named = {planned.name: planned for planned in self.plan.variants}
        return float(named[variant].effective["duration"])

    @property
    def times_real_time(self) -> Array:
        """Simulated over wall time of each run (runs,); a wall time counts as at least 1 ms.

        NaN for a run that was taken from the store of runs.
        """
        return np.array(
            [
                math.nan
                if row.wall is None
                else row.run.variant.effective["duration"] / max(row.wall, 1e-3)
                for row in self._rows
            ]
        )

    @property
    def stored(self) -> int:
        """The number of finished runs that were taken from the store of runs."""
        return sum(row.wall is None for row in self._rows)

    @property
    def _wall(self) -> float:
        """s that the runs took that were done."""
        return sum(row.wall for row in self._rows if row.wall is not None)

    def summary(
        self, variant: str | None = None, names: Sequence[str | Metric] | None = None
    ) -> dict[str, statistics.Summary]:
        """The statistics of metrics over the runs of one variant, by the metric's name.

        `variant`: None for an experiment with one variant; ConfigError if it has several. `names`:
        the metrics; None: all.
        """
        if variant is None:
            if len(self.variants) > 1:
                text = f"there are {len(self.variants)} variants: {', '.join(self.variants)}"
                raise ConfigError(f"{text}; name one")
            variant = self.variants[0]
        return {
            metric.name: statistics.summarize(
                self.metric(metric, variant),
                is_share=metric.unit == YES_OR_NO,
                is_time_to_event=metric.is_time_to_event,
            )
            for metric in map(self.about, names or self.metrics)
        }

    def document(self, names: Sequence[str | Metric] | None = None) -> dict[str, Any]:
        """The contents of summary.json: counts of runs, speed, and statistics by variant.

        `names`: the metrics; None: all.
        """
        return {
            "scenario": self.plan.scenario,
            "runs": len(self.plan.runs),
            "finished": len(self._rows),
            "failed": len(self.failures),
            "part": None if self.plan.shard is None else str(self.plan.shard),
            "kernels": self.kernels,
            "times_real_time": self._speed(),
            "wall": self._wall,
            "stored": self.stored,
            "level": statistics.LEVEL,
            "method": statistics.METHOD,
            "variants": [
                {
                    "name": variant.name,
                    "values": dict(variant.values),
                    "finished": len(self.seeds(variant.name)),
                    "metrics": {
                        metric.name: {"unit": metric.unit, **asdict(summary)}
                        for metric, summary in self._summaries(variant.name, names)
                    },
                }
                for variant in self.plan.variants
            ],
        }

    def _summaries(
        self, variant: str, names: Sequence[str | Metric] | None
    ) -> list[tuple[Metric, statistics.Summary]]:
        metrics = [self.about(name) for name in names or self.metrics]
        summaries = self.summary(variant, metrics)
        return [(metric, summaries[metric.name]) for metric in metrics]

    def text(self, names: Sequence[str | Metric] | None = None) -> str:
        """A table for each variant with the metrics `names`; None: all that have a value."""
        lines = self._head_lines()
        tables = {variant: self._summaries(variant, names) for variant in self.variants}
        if names is not None:
            shown = {metric.name for metric in map(self.about, names)}
        else:
            shown = {
                metric.name
                for table in tables.values()
                for metric, summary in table
                if summary.n or summary.never
            }
        for variant, table in tables.items():
            lines += ["", variant] if variant else [""]
            rows = [row for row in table if row[0].name in shown]
            lines += statistics.aligned(statistics.HEADER, statistics.summary_rows(rows))
        if names is None and self._rows:
            left_out = [name for name in self.metrics if name not in shown]
            if left_out:
                lines += ["", f"without a value in any run: {', '.join(left_out)}"]
        return "\n".join(lines)

    def _head_lines(self) -> list[str]:
        """The number of runs, the speed, and a line about kernels that are not compiled."""
        failed = f", {len(self.failures)} failed" if self.failures else ""
        part = f"part {self.plan.shard}, " if self.plan.shard else ""
        count = f"{len(self._rows)} of {counted(len(self.plan.runs), 'run')}"
        lines = [f"{self.plan.scenario}: {part}{count}{failed}"]
        if (speed := self._speed()) is not None:
            least_and_most = f"{speed['min']:.3g} to {speed['max']:.3g}"
            each = f"{speed['median']:.3g} times real time ({least_and_most})"
            lines.append(f"each run: {each}; all runs: {self._wall:.3g} s")
        if self.stored:
            lines.append(f"taken from the store of runs: {counted(self.stored, 'run')}")
        if self.kernels not in ("", "compiled"):
            lines.append(f"kernels: {self.kernels}")
        return lines

    def __repr__(self) -> str:
        return f"Results({str(self.folder)!r}, {len(self._rows)} of {len(self.plan.runs)} runs)"

    def __str__(self) -> str:
        return self.text()

    def _speed(self) -> dict[str, float] | None:
        speeds = self.times_real_time[~np.isnan(self.times_real_time)]
        if not speeds.size:
            return None
        values = float(np.median(speeds)), float(speeds.min()), float(speeds.max())
        return dict(zip(("median", "min", "max"), values, strict=True))

    def _of(self, variant: str) -> Sequence[Row]:
        if variant not in self._rows_of:
            raise ConfigError(unknown("variant", variant, self.variants))
        return self._rows_of[variant]


def load_results(folder: str | Path, *, is_trusted: bool = False) -> Results:
    """The results in the folder of an experiment, which may have been interrupted.

    ConfigError in one line if the folder is damaged or has no experiment. `is_trusted`: Python
    files that the results name may be run although they are new or have changed.
    """
    place = Path(folder)
    manifest = read_manifest(place)
    plan = manifest.plan
    metrics, rows = read_table(place, plan)
    failures = {run: why for run, why in read_failures(place).items() if run not in rows}
    kernels = manifest.made_with.get("kernels", "")
    own = known_metrics(manifest, place, is_trusted=is_trusted)
    errors = {run: why for run, why in read_errors(place).items() if run in rows}
    custom = CustomMetrics(own, errors, is_trusted, manifest.report_units)
    return Results(place, plan, rows.values(), failures, metrics, kernels, custom)


def known_metrics(manifest: Manifest, folder: Path, *, is_trusted: bool) -> dict[str, Metric]:
    """The metrics beyond the catalog that an experiment measured, by name."""
    metrics = {}
    for own in manifest.metrics:
        code = _Code(folder, own.origin, manifest.plugins.get(own.origin, ""), is_trusted)
        metrics[own.name] = Metric(
            **msgspec.structs.asdict(own),
            meaning="",
            source=own.origin,
            value=code.value,
            series=code.series,
            digest=code.digest,
        )
    return metrics


@dataclass(frozen=True)
class _Code:
    """The code of a metric that the results in `folder` name.

    The code is imported when a value is measured, since recorded values can be shown without it.
    `digest`: SHA-256 of the code that the runs used. If the code is new, has changed or has never
    been run by this user, measuring raises ConfigError, unless `is_trusted`.
    """

    folder: Path
    origin: str
    digest: str
    is_trusted: bool

    @cached_property
    def metric(self) -> Metric:
        """The metric with its present code."""
        if not names_file(self.origin):
            return metric_of(self.origin)
        present = digest_of_file(self.origin)
        names = {self.origin: self.digest}, {self.origin: present}
        check_code(self.folder, *names, is_trusted=self.is_trusted)
        return metric_of(self.origin, present)

    def value(self, trace: Trace) -> float | None:
        """The number of a run."""
        return self.metric.value(trace)

    def series(self, trace: Trace) -> Array | None:
        """The values over time, None where the metric has none."""
        return None if self.metric.series is None else self.metric.series(trace)
