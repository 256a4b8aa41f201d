"""The pictures of an experiment's folder."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from textwrap import fill

import numpy as np

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.experiments.plan import Run
from swarmd.sim.experiments.results import Results, load_results, unit_of
from swarmd.sim.metrics.catalog import METRICS, metric_of
from swarmd.sim.plots.bands import draw_series
from swarmd.sim.plots.events import events_of
from swarmd.sim.plots.intervals import Panel, draw_intervals
from swarmd.sim.plots.overview import draw_overview
from swarmd.sim.plots.select import (
    OVER_TIME,
    RUN_BY_RUN,
    label_of,
    metrics_over_time,
    primary_metric,
    smoothing_of,
    stem_of,
    typical_first,
    worst_first,
)
from swarmd.sim.plots.spread import Series
from swarmd.sim.plots.start_and_end import draw_start_and_end
from swarmd.sim.plots.trajectories import draw_trajectories
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

    For each variant all runs at a glance, and a typical run (of the median) and the worst one (the
    least typical, where it depends on the task which way is good) with their starts and ends;
    metrics over time and run by run for all variants together.
    `metrics`: those instead of the usual ones, of which the first tells runs apart; `seeds`: the
    runs of those alone; `targets` by metric. A trace that is missing or damaged is one line of
    warning. ConfigError for an unknown metric, seed or folder, SwarmError if nothing has finished.
    """
    gallery = _Gallery(folder, out, metrics, seeds, suffix)
    made = gallery.intervals(targets or {})
    for variant in gallery.variants:
        made += gallery.overview(variant)
        made += gallery.chosen_runs(variant)
    return made + gallery.over_time(targets or {})


def draw_runs(
    folder: Path,
    out: Path | None = None,
    *,
    seeds: Iterable[int] | None = None,
    suffix: str = ".png",
) -> list[Path]:
    """Draw up to 25 runs of each variant at a glance; otherwise as `draw_experiment`."""
    gallery = _Gallery(folder, out, None, seeds, suffix)
    return [path for variant in gallery.variants for path in gallery.overview(variant)]


class _Gallery:
    """An experiment, and where its pictures go."""

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
        self._chief = primary_metric(self._results, self._metrics)
        self._scenario = Path(self._results.plan.scenario).stem
        self._told: set[str] = set()
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
                          target=targets.get(name))
                )  # fmt: skip
        if not panels:
            return []
        path = self._path("intervals")
        draw_intervals(panels, path, self._scenario)
        return [path]

    def overview(self, variant: str) -> list[Path]:
        """All runs of a variant at a glance."""
        if not self._has_traces:
            return []
        runs = [
            (f"seed {run.seed}{self._chief_words(run)}", lambda run=run: self._trace(run))
            for run in self._of(variant)
        ]
        path = self._path("runs", variant)
        note = f"by seed: {label_of(self._chief)}" if self._chief else ""
        draw_overview(runs, path, self._title(variant), note=note)
        return [path]

    def chosen_runs(self, variant: str) -> list[Path]:
        """The ways, start and end of a typical run and of the worst one."""
        runs = self._of(variant)
        if not self._has_traces:
            return []
        if self._chief is None:
            return self._first_of(runs, "first")[0]
        values = np.array([np.nan if v is None else v for v in self._values(self._chief, variant)])
        nearest = [runs[k] for k in typical_first(values)]
        made, typical = self._first_of(nearest, "typical")
        order, word = worst_first(values, self._chief)
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
            if _says_something(groups) or (groups and self._metrics is not None):
                path = self._path(f"over_time_{stem_of(name)}")
                draw_series(groups, path, label=label_of(stem_of(name)), unit=unit_of(name),
                            title=self._scenario, target=targets.get(name),
                            events=next(iter(events)) if len(events) == 1 else (),
                            smoothing=smoothing_of(name))  # fmt: skip
                made.append(path)
        return made

    def _first_of(self, runs: Sequence[Run], word: str) -> tuple[list[Path], Run | None]:
        """Pictures of the first of the runs that has a trace, and which one that is."""
        for run in runs:
            trace = self._trace(run)
            if trace is not None:
                title = f"{self._title(run.variant.name)}, seed {run.seed}"
                title += f"\n{word} run{self._chief_words(run, has_name=True)}"
                name = word.replace(" ", "_")
                ways = self._path(f"{name}_trajectories", run.variant.name)
                ends = self._path(f"{name}_start_and_end", run.variant.name)
                draw_trajectories(trace, ways, title, has_links=True)
                draw_start_and_end(trace, ends, title)
                return [ways, ends], run
        return [], None

    def _trace(self, run: Run) -> Trace | None:
        """The trace of a run; None, and one line the first time, if it cannot be drawn."""
        try:
            trace = self._results.traces[run.id]
            if len(trace.t) and len(trace.ids):
                return trace
            problem = f"{self._results.folder / 'traces' / run.id}.npz: holds no instant"
        except SwarmError as error:
            problem = str(error)
        if run.id not in self._told:
            self._told.add(run.id)
            _log.warning("%s; the run is left out", problem)
        return None

    def _of(self, variant: str) -> list[Run]:
        return [run for run in self._runs if run.variant.name == variant]

    def _values(self, metric: str, variant: str) -> list[float | None]:
        return [self._rows[run.id].get(metric) for run in self._of(variant)]

    def _chief_words(self, run: Run, *, has_name: bool = False) -> str:
        value = None if self._chief is None else self._rows[run.id][self._chief]
        if self._chief is None or value is None:
            return ""
        unit = "" if unit_of(self._chief) in ("share", _YES_OR_NO) else unit_of(self._chief)
        name = f"{label_of(self._chief)} " if has_name else ""
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
    series = METRICS[metric].series
    values = None if series is None else series(trace)
    if values is not None and np.isfinite(values).any():
        groups.setdefault(variant, []).append((trace.t - trace.t[0], values.astype(np.float64)))


def _says_something(groups: Mapping[str, Sequence[Series]]) -> bool:
    """Whether the values are not one and the same all the time."""
    known = [values[np.isfinite(values)] for runs in groups.values() for _, values in runs]
    return bool(known) and bool(np.ptp(np.concatenate(known)) > 0.0)
