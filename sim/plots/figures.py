"""The pictures of an experiment's folder."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from textwrap import fill

import numpy as np

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.values import Array
from swarmd.sim.experiments.plan import Run
from swarmd.sim.experiments.results import YES_OR_NO, Results, load_results
from swarmd.sim.metrics.catalog import METRICS, Metric
from swarmd.sim.plots.bands import Series, series_figure
from swarmd.sim.plots.intervals import Panel, intervals_figure
from swarmd.sim.plots.overview import overview_figure
from swarmd.sim.plots.select import (
    OVER_TIME,
    RUN_BY_RUN,
    events_of,
    label_of,
    metrics_over_time,
    primary_metric,
    smoothing_of,
    stem_of,
    typical_first,
    worst_first,
)
from swarmd.sim.plots.start_and_end import start_and_end_figure
from swarmd.sim.plots.theme import save
from swarmd.sim.plots.trajectories import trajectories_figure
from swarmd.sim.trace import Trace

_log = logging.getLogger(__name__)


def draw_experiment(
    folder: Path,
    out: Path | None = None,
    *,
    metrics: Sequence[str | Metric] | None = None,
    seeds: Iterable[int] | None = None,
    targets: Mapping[str, float] | None = None,
    suffix: str = ".png",
) -> list[Path]:
    """Draw what an experiment's folder holds into `out`, by default its `plots`; the files made.

    For each variant: all runs in one picture, and a typical run (nearest to the median) and the
    worst run, with their starts and ends. Where neither direction of the metric is good as such,
    the least typical run is drawn instead of the worst. For all variants together: metrics over
    time and run by run.

    `metrics` replaces the default ones; the first of them selects the typical run. `seeds` limits
    the runs. `targets` are by metric. A trace that is missing or damaged gives one warning.
    ConfigError for an unknown metric, seed or folder, SwarmError if no run has finished.
    """
    gallery = _Gallery(folder, out, metrics, seeds, suffix)
    made = gallery.intervals(targets or {})
    for variant in gallery.variants:
        made += gallery.overview(variant)
        made += gallery.chosen_runs(variant)
    return made + gallery.over_time(targets or {})


class _Gallery:
    """The pictures of one experiment."""

    def __init__(
        self,
        folder: Path,
        out: Path | None,
        metrics: Sequence[str | Metric] | None,
        seeds: Iterable[int] | None,
        suffix: str,
    ) -> None:
        self._results = load_results(folder)
        self._metrics = None if metrics is None else [*map(self._results.asked, metrics)]
        self._out = folder / "plots" if out is None else out
        self._suffix = suffix
        self._runs = _chosen(self._results, folder, seeds)
        self._primary = primary_metric(self._results, self._metrics)
        self._scenario = Path(self._results.plan.scenario).stem
        self._warned: set[str] = set()
        names = {run.variant.name for run in self._runs}
        self.variants = [name for name in self._results.variants if name in names]
        self._has_traces = (folder / "traces").is_dir()
        if not self._has_traces:
            _log.warning("%s: no traces were kept; what needs them is not drawn", folder)

    def intervals(self, targets: Mapping[str, float]) -> list[Path]:
        """Metrics run by run."""
        panels = []
        for one in self._asked(RUN_BY_RUN):
            values = {v or self._scenario: self._values(one, v) for v in self.variants}
            if any(np.isfinite(column).any() for column in values.values()):
                panels.append(
                    Panel(label=label_of(one.name), unit=one.unit, values=values,
                          is_share=one.unit == YES_OR_NO, target=targets.get(one.name),
                          is_time_to_event=one.is_time_to_event)
                )  # fmt: skip
        if not panels:
            return []
        return [save(intervals_figure(panels, self._scenario), self._path("intervals"))]

    def overview(self, variant: str) -> list[Path]:
        """All runs of a variant in one picture."""
        if not self._has_traces:
            return []
        runs = [
            (f"seed {run.seed}{self._primary_value(run)}", lambda run=run: self._trace(run))
            for run in self._of(variant)
        ]
        note = f"by seed: {label_of(self._primary.name)}" if self._primary else ""
        figure = overview_figure(runs, self._title(variant), note=note)
        return [save(figure, self._path("runs", variant))]

    def chosen_runs(self, variant: str) -> list[Path]:
        """Paths, start and end of a typical run and of the worst one."""
        runs = self._of(variant)
        if not self._has_traces:
            return []
        if self._primary is None:
            return self._first_of(runs, "first")[0]
        values = self._values(self._primary, variant)
        nearest = [runs[k] for k in typical_first(values)]
        made, typical = self._first_of(nearest, "typical")
        order, word = worst_first(values, self._primary.better)
        # If the trace of the worst is lost, the next one is not the worst.
        worst = [runs[k] for k in order[:1] if runs[k] is not typical]
        return made + self._first_of(worst, word)[0]

    def over_time(self, targets: Mapping[str, float]) -> list[Path]:
        """Metrics over time, of all variants."""
        metrics = metrics_over_time(self._asked(OVER_TIME))
        found: dict[str, dict[str, list[Series]]] = {one.name: {} for one in metrics}
        events: set[tuple[tuple[float, str], ...]] = set()
        for run in self._runs if metrics and self._has_traces else ():
            trace = self._trace(run)
            if trace is not None:
                events.add(events_of(trace))
                for one in metrics:
                    _gather(found[one.name], run.variant.name or self._scenario, one, trace)
        made = []
        for one in metrics:
            name, groups = one.name, found[one.name]
            if _varies(groups) or (groups and self._metrics is not None):
                is_event = one.is_time_to_event
                label = label_of(stem_of(name))
                figure = series_figure(
                    groups,
                    label=f"{label} reached" if is_event else label,
                    unit=one.unit,
                    title=self._scenario,
                    target=None if is_event else targets.get(name),
                    events=next(iter(events)) if len(events) == 1 else (),
                    smoothing=smoothing_of(name),
                )
                made.append(save(figure, self._path(f"over_time_{stem_of(name)}")))
        return made

    def _first_of(self, runs: Sequence[Run], word: str) -> tuple[list[Path], Run | None]:
        """Pictures of the first run with a trace, and that run."""
        for run in runs:
            trace = self._trace(run)
            if trace is not None:
                title = f"{self._title(run.variant.name)}, seed {run.seed}"
                title += f"\n{word} run{self._primary_value(run, has_name=True)}"
                name = word.replace(" ", "_")
                paths = self._path(f"{name}_trajectories", run.variant.name)
                ends = self._path(f"{name}_start_and_end", run.variant.name)
                save(trajectories_figure(trace, title), paths)
                save(start_and_end_figure(trace, title), ends)
                return [paths, ends], run
        return [], None

    def _trace(self, run: Run) -> Trace | None:
        """The trace of a run; None, and one warning a run, if it cannot be drawn."""
        try:
            trace = self._results.traces[run.id]
            if len(trace.t) and len(trace.ids):
                return trace
            problem = f"{self._results.folder / 'traces' / run.id}.npz: holds no instant"
        except SwarmError as error:
            problem = str(error)
        if run.id not in self._warned:
            self._warned.add(run.id)
            _log.warning("%s; the run is left out", problem)
        return None

    def _of(self, variant: str) -> list[Run]:
        return [run for run in self._runs if run.variant.name == variant]

    def _asked(self, default: Sequence[str]) -> list[Metric]:
        return [METRICS[name] for name in default] if self._metrics is None else self._metrics

    def _values(self, metric: Metric, variant: str) -> Array:
        """(runs,) the values of the variant's chosen runs, NaN without one."""
        if metric.name in METRICS and metric.name not in self._results.metrics:
            return np.full(len(self._of(variant)), np.nan)  # of another version
        by_seed = dict(
            zip(
                self._results.seeds(variant),
                self._results.metric(metric, variant),
                strict=True,
            )
        )
        return np.array([by_seed[run.seed] for run in self._of(variant)])

    def _primary_value(self, run: Run, *, has_name: bool = False) -> str:
        if self._primary is None:
            return ""
        runs = self._of(run.variant.name)
        value = self._values(self._primary, run.variant.name)[runs.index(run)]
        if np.isnan(value):
            return ""
        unit = "" if self._primary.unit in ("share", YES_OR_NO) else self._primary.unit
        name = f"{label_of(self._primary.name)} " if has_name else ""
        return f": {name}{value:.3g} {unit}".rstrip()

    def _title(self, variant: str) -> str:
        return fill(f"{self._scenario}, {variant}" if variant else self._scenario, 80)

    def _path(self, name: str, variant: str = "") -> Path:
        run = next(run for run in self._runs if run.variant.name == variant or not variant)
        stem = run.id.rpartition("_s")[0] if variant else ""
        safe = re.sub(r"[^\w.,=+-]+", "_", name)
        return self._out / f"{f'{stem}_' if stem else ''}{safe}{self._suffix}"


def _chosen(results: Results, folder: Path, seeds: Iterable[int] | None) -> list[Run]:
    runs = list(results.runs)
    if not runs:
        raise SwarmError(f"{folder}: no run has finished: nothing to draw")
    if seeds is None:
        return runs
    wanted = list(seeds)
    known = {run.seed for run in runs}
    missing = [seed for seed in wanted if seed not in known]
    if missing or not wanted:
        text = f"no finished run has seed {missing[0]}" if missing else "no seed is named"
        raise ConfigError(f"{folder}: {text}; there are {', '.join(map(str, sorted(known)))}")
    return [run for run in runs if run.seed in wanted]


def _gather(groups: dict[str, list[Series]], variant: str, metric: Metric, trace: Trace) -> None:
    """Add the run's series; of a time to an event, 0 before the event and 1 from it on."""
    t = trace.t - trace.t[0]
    if metric.is_time_to_event:
        time = metric.value(trace)
        values: Array | None = np.zeros(len(t)) if time is None else (t >= time).astype(np.float64)
    else:
        values = None if metric.series is None else metric.series(trace)
    if values is not None and np.isfinite(values).any():
        groups.setdefault(variant, []).append((t, values.astype(np.float64)))


def _varies(groups: Mapping[str, Sequence[Series]]) -> bool:
    """Whether the values are not all equal."""
    known = [values[np.isfinite(values)] for runs in groups.values() for _, values in runs]
    return bool(known) and bool(np.ptp(np.concatenate(known)) > 0.0)
