"""The pictures of an experiment's folder."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from textwrap import fill

import numpy as np

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.values import Array
from swarmd.sim.experiments.plan import Run
from swarmd.sim.experiments.results import Results, load_results, unit_of
from swarmd.sim.metrics.catalog import METRICS, is_time_to_event, metric_of
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
_YES_OR_NO = "0 or 1"


def draw_experiment(
    folder: Path,
    out: Path | None = None,
    *,
    metrics: Sequence[str] | None = None,
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
        metrics: Sequence[str] | None,
        seeds: Iterable[int] | None,
        suffix: str,
    ) -> None:
        self._metrics = None if metrics is None else [metric_of(name).name for name in metrics]
        self._results = load_results(folder)
        self._out = folder / "plots" if out is None else out
        self._suffix = suffix
        self._runs = _chosen(self._results, folder, seeds)
        self._rows = {row["run"]: row for row in self._results.rows}
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
        for name in RUN_BY_RUN if self._metrics is None else self._metrics:
            values = {v or self._scenario: self._values(name, v) for v in self.variants}
            if any(value is not None for column in values.values() for value in column):
                unit = unit_of(name)
                is_share = unit == _YES_OR_NO
                panels.append(
                    Panel(label=label_of(name), unit=unit, values=values, is_share=is_share,
                          target=targets.get(name), is_time_to_event=is_time_to_event(name))
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
        note = f"by seed: {label_of(self._primary)}" if self._primary else ""
        figure = overview_figure(runs, self._title(variant), note=note)
        return [save(figure, self._path("runs", variant))]

    def chosen_runs(self, variant: str) -> list[Path]:
        """Paths, start and end of a typical run and of the worst one."""
        runs = self._of(variant)
        if not self._has_traces:
            return []
        if self._primary is None:
            return self._first_of(runs, "first")[0]
        values = np.array(
            [np.nan if v is None else v for v in self._values(self._primary, variant)]
        )
        nearest = [runs[k] for k in typical_first(values)]
        made, typical = self._first_of(nearest, "typical")
        order, word = worst_first(values, self._primary)
        # If the trace of the worst is lost, the next one is not the worst.
        worst = [runs[k] for k in order[:1] if runs[k] is not typical]
        return made + self._first_of(worst, word)[0]

    def over_time(self, targets: Mapping[str, float]) -> list[Path]:
        """Metrics over time, of all variants."""
        names = metrics_over_time(OVER_TIME if self._metrics is None else self._metrics)
        found: dict[str, dict[str, list[Series]]] = {name: {} for name in names}
        events: set[tuple[tuple[float, str], ...]] = set()
        for run in self._runs if names and self._has_traces else ():
            trace = self._trace(run)
            if trace is not None:
                events.add(events_of(trace))
                for name in names:
                    _gather(found[name], run.variant.name or self._scenario, name, trace)
        made = []
        for name, groups in found.items():
            if _varies(groups) or (groups and self._metrics is not None):
                is_event = is_time_to_event(name)
                label = label_of(stem_of(name))
                figure = series_figure(
                    groups,
                    label=f"{label} reached" if is_event else label,
                    unit=unit_of(name),
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

    def _values(self, metric: str, variant: str) -> list[float | None]:
        return [self._rows[run.id].get(metric) for run in self._of(variant)]

    def _primary_value(self, run: Run, *, has_name: bool = False) -> str:
        value = None if self._primary is None else self._rows[run.id][self._primary]
        if self._primary is None or value is None:
            return ""
        unit = "" if unit_of(self._primary) in ("share", _YES_OR_NO) else unit_of(self._primary)
        name = f"{label_of(self._primary)} " if has_name else ""
        return f": {name}{value:.3g} {unit}".rstrip()

    def _title(self, variant: str) -> str:
        return fill(f"{self._scenario}, {variant}" if variant else self._scenario, 80)

    def _path(self, name: str, variant: str = "") -> Path:
        run = next(run for run in self._runs if run.variant.name == variant or not variant)
        stem = run.id.rpartition("_s")[0] if variant else ""
        return self._out / f"{f'{stem}_' if stem else ''}{name}{self._suffix}"


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


def _gather(groups: dict[str, list[Series]], variant: str, metric: str, trace: Trace) -> None:
    """Add the run's series; of a time to an event, 0 before the event and 1 from it on."""
    found, t = METRICS[metric], trace.t - trace.t[0]
    if found.is_time_to_event:
        time = found.value(trace)
        values: Array | None = np.zeros(len(t)) if time is None else (t >= time).astype(np.float64)
    else:
        values = None if found.series is None else found.series(trace)
    if values is not None and np.isfinite(values).any():
        groups.setdefault(variant, []).append((t, values.astype(np.float64)))


def _varies(groups: Mapping[str, Sequence[Series]]) -> bool:
    """Whether the values are not all equal."""
    known = [values[np.isfinite(values)] for runs in groups.values() for _, values in runs]
    return bool(known) and bool(np.ptp(np.concatenate(known)) > 0.0)
