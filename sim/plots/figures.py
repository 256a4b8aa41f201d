"""The pictures of an experiment's folder."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import Path
from string import ascii_lowercase
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from swarmd.core.errors import ConfigError, SwarmError, unknown
from swarmd.core.values import Array
from swarmd.settings.layered import Layered
from swarmd.sim.experiments.compare import Side, compare
from swarmd.sim.experiments.plan import Run
from swarmd.sim.experiments.results import YES_OR_NO, Results, load_results
from swarmd.sim.metrics.catalog import METRICS, Metric, series
from swarmd.sim.plots import select
from swarmd.sim.plots.bands import Series, series_figure
from swarmd.sim.plots.intervals import (
    DifferencePanel,
    Panel,
    curve_figure,
    differences_figure,
    intervals_figure,
)
from swarmd.sim.plots.survival import Times, survival_figure
from swarmd.sim.plots.theme import save
from swarmd.sim.plots.trajectories import overview_figure, trajectories_figure
from swarmd.sim.scenarios.environment import fields_of
from swarmd.sim.trace import Trace
from swarmd.sim.world.scalar_fields import Field

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_log = logging.getLogger(__name__)


STATISTICS = ("intervals", "differences", "survival", "over_time")
KINDS = (*STATISTICS, "runs", "trajectories")
"""The kinds of pictures; the last two are of traces seen from above."""
CURVE = "curve"
"""A further kind, over a swept number, that is drawn only where it is named."""
SeriesByPanel = dict[str, dict[str, list[Series]]]
"""The runs of a metric by panel and label of the variant."""
Events = tuple[tuple[float, str], ...]
"""The events of a run: times in s, with their texts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """Options of the pictures of an experiment."""

    suffix: str = ".png"  # .png, .svg or .pdf
    only: Collection[str] | None = None
    """The kinds of pictures, of KINDS and CURVE. None: STATISTICS, or KINDS for chosen seeds."""
    labels: Mapping[str, str] = field(default_factory=dict)
    """Texts of axes, such as `lidar range [m]`, by metric or swept key."""
    width: float | None = None
    """Width in inches for a paper: small texts, thin lines, no titles; panels have letters."""
    facet: str | None = None
    """A swept key; each of its values has a panel."""
    targets: Mapping[str, float] = field(default_factory=dict)
    """Values of dashed lines, by metric."""


def draw_experiment(
    folder: Path,
    out: Path | None = None,
    *,
    metrics: Sequence[str | Metric] | None = None,
    seeds: Iterable[int] | None = None,
    look: Look | None = None,
) -> list[Path]:
    """Draw the pictures of the experiment in `folder`; returns the paths of the files.

    The kinds of pictures are those of `look.only`. Without `look.only`, they are STATISTICS, or
    KINDS if `seeds` are chosen.

    - STATISTICS: pictures of all variants together: metrics run by run and over time, times to
      events as survival curves, differences from the first variant. A metric with one value in all
      runs is not drawn.
    - `runs`: for each variant a picture of all its runs from above.
    - `trajectories`: for each variant the paths of two runs from above: a typical run, nearest to
      the median, and the worst run. A metric of which neither direction is better has no worst run:
      the run farthest from the median is drawn.

    `out`: the folder of the pictures; None: `plots` in the experiment's folder. `metrics`: the
    metrics to draw, of which the first selects the typical run; None: default metrics. `seeds`:
    only runs with these seeds are drawn; None: all runs.

    A missing or damaged trace gives one warning. ConfigError for an unknown metric, seed, facet or
    folder. SwarmError if no run has finished.
    """
    look = look or Look()
    default_kinds = STATISTICS if seeds is None else KINDS
    kinds = default_kinds if look.only is None else look.only
    gallery = _Gallery(folder, out, metrics, seeds, look)
    paths: list[Path] = []
    for kind in (*KINDS, CURVE):  # CURVE is in `kinds` only if `look.only` names it
        if kind in kinds:
            paths += gallery.draw(kind)
    return paths


def compared_over_time(
    sides: Mapping[str, Side], metric: str | Metric, look: Look | None = None, title: str = ""
) -> Figure:
    """A picture of one metric over time, of variants of several experiments.

    `sides`: the variants, by their labels in the legend. ConfigError for an unknown metric, or a
    metric without values over time. SwarmError if a trace is missing.
    """
    look = look or Look()
    runs_by_label: dict[str, list[Series]] = {}
    found_metric = next(side.results.about(metric) for side in sides.values())
    for label, side in sides.items():
        for run, trace in zip(side.results.runs, side.results.traces, strict=True):
            values = series(trace, found_metric) if run.variant.name == side.variant else None
            if values is not None:
                runs_by_label.setdefault(label, []).append((trace.t - trace.t[0], values))
    return series_figure(
        {"": runs_by_label},
        label=select.label_of(select.stem_of(found_metric.name)),
        unit=found_metric.unit,
        title=title,
        target=look.targets.get(found_metric.name),
        smoothing=select.smoothing_of(found_metric.name),
        width=look.width,
    )


class _Gallery:
    """The pictures of one experiment."""

    def __init__(
        self,
        folder: Path,
        out: Path | None,
        metrics: Sequence[str | Metric] | None,
        seeds: Iterable[int] | None,
        look: Look,
    ) -> None:
        """See `draw_experiment`, also for the errors."""
        self._results = load_results(folder)
        # The metrics to draw; None: the default metrics.
        self._metrics = None if metrics is None else [*map(self._results.asked, metrics)]
        self._out = folder / "plots" if out is None else out
        self._look = look
        self._runs = _chosen(self._results, folder, seeds)
        # The metric that selects the typical and the worst run.
        self._primary = select.primary_metric(self._results, self._metrics)
        self._scenario = Path(self._results.plan.scenario).stem
        self._check_labels()
        # The facet of each variant, by the variant's name.
        facets = select.facets_of(self._results.plan, look.facet, self._scenario, look.labels)
        self._facets = _lettered(facets, look)
        self._warned: set[str] = set()  # runs whose trace cannot be drawn
        drawn_variants = {run.variant.name for run in self._runs}
        self.variants = [name for name in self._results.variants if name in drawn_variants]
        self._has_traces = (folder / "traces").is_dir()
        if not self._has_traces:
            _log.warning("%s: no traces were kept; what needs them is not drawn", folder)

    def draw(self, kind: str) -> list[Path]:
        """All pictures of a kind of KINDS, or of CURVE."""
        of_all: dict[str, Callable[[], list[Path]]] = {
            "intervals": partial(self._run_by_run, intervals_figure, "intervals"),
            "curve": self.curve,  # CURVE
            "differences": self.differences,
            "survival": self.survival,
            "over_time": self.over_time,
        }
        if kind in of_all:
            return of_all[kind]()
        of_variant = self.overview if kind == "runs" else self.chosen_runs
        return [path for variant in self.variants for path in of_variant(variant)]

    def _check_labels(self) -> None:
        swept = self._results.plan.sweep
        known = {*swept, *(key.rpartition(".")[2] for key in swept), *self._results.metrics}
        known |= {metric.name for metric in self._metrics or ()}
        for name in self._look.labels:
            if name not in known:
                raise ConfigError(f"--label: {unknown('swept key or metric', name, known)}")

    def _quantity(self, metric: Metric, name: str = "") -> select.Quantity:
        """What the axis of a metric shows; `name` in place of the metric's own."""
        text = self._look.labels.get(metric.name)
        own = select.Quantity(select.label_of(name or metric.name), metric.unit)
        return own if text is None else select.Quantity.parse(text)

    def curve(self) -> list[Path]:
        """Metrics over the values of a swept number; ConfigError if there is no such number."""
        if not self._axis:
            raise ConfigError(
                "--only curve: expected one swept number; of several swept keys, a panel for each"
                " value of one: --facet KEY"
            )
        return self._run_by_run(curve_figure, "curve")

    def _run_by_run(self, draw: Callable[..., Figure], name: str) -> list[Path]:
        """The picture by `draw` of a panel for each metric and facet whose values differ."""
        panels = []
        for metric in self._asked(select.RUN_BY_RUN):
            for panel, variants in self._by_panel().items():
                values = {self._facets[v].label: self._values(metric, v) for v in variants}
                if not self._has_spread(metric, panel, list(values.values())):
                    continue
                quantity = self._quantity(metric)
                panels.append(
                    Panel(label=_joined(quantity.name, panel), unit=quantity.unit,
                          values=values,
                          quantity=select.stem_of(metric.name),
                          is_share=metric.unit == YES_OR_NO,
                          target=self._look.targets.get(metric.name),
                          is_time_to_event=metric.is_time_to_event)
                )  # fmt: skip
        return self._drawn(draw, panels, name)

    def _drawn(
        self, draw: Callable[..., Figure], panels: Sequence[object], name: str
    ) -> list[Path]:
        """Draw the panels in one picture, and save it; draw nothing without panels."""
        if not panels:
            return []
        figure = draw(panels, self._scenario, width=self._look.width, axis=self._axis)
        return [self._save(figure, name)]

    def differences(self) -> list[Path]:
        """The difference of each variant from the first, by metric."""
        if len(self._runs) < len(self._results.runs):  # a few chosen seeds show no differences
            return []
        panels = []
        for metric in self._asked(select.RUN_BY_RUN):
            for panel, (first, *further) in self._by_panel().items():
                differences = {
                    f"{self._facets[v].label} - {self._facets[first].label}": compare(
                        Side(first, self._results, first), Side(v, self._results, v), [metric]
                    )[0]
                    for v in further
                }
                if any(d.interval and d.interval != (0.0, 0.0) for d in differences.values()):
                    quantity = self._quantity(metric)
                    label = _joined(quantity.name, panel)
                    panels.append(DifferencePanel(label, quantity.unit, differences))
        return self._drawn(differences_figure, panels, "differences")

    def survival(self) -> list[Path]:
        """A picture for each time to an event: over time, the share of runs without the event.

        Without a picture if the event never happened.
        """
        paths = []
        for metric in self._asked(select.OVER_TIME):
            if not metric.is_time_to_event:
                continue
            facets = self._times_to_event(metric)
            all_times = [times for variants in facets.values() for times in variants.values()]
            if any(np.isfinite(times.times).any() for times in all_times):
                figure = survival_figure(
                    facets,
                    event=self._event_of(metric),
                    title=self._scenario,
                    width=self._look.width,
                    legend_title=self._axis,
                )
                paths.append(self._save(figure, f"survival_{metric.name}"))
        return paths

    def _times_to_event(self, metric: Metric) -> dict[str, dict[str, Times]]:
        """The times to the event of a metric, by panel and label of the variant."""
        facets: dict[str, dict[str, Times]] = {}
        for panel, variants in self._by_panel().items():
            for variant in variants:
                first_run = self._of(variant)[0]  # all runs of a variant have one duration
                duration = float(first_run.variant.effective["duration"])
                values = self._values(metric, variant)
                times = Times(values, np.full(len(values), duration))
                facets.setdefault(panel, {})[self._facets[variant].label] = times
        return facets

    def _event_of(self, metric: Metric) -> str:
        """A noun for the event of a metric: the text of --label, else the metric's own noun."""
        name = self._quantity(metric).name
        if metric.name in self._look.labels:
            return name
        return metric.event or f"the event of {name}"

    def overview(self, variant: str) -> list[Path]:
        """All runs of a variant in one picture."""
        if not self._has_traces:
            return []
        runs = [
            (f"seed {run.seed}{self._primary_value(run)}", lambda run=run: self._trace(run))
            for run in self._of(variant)
        ]
        note = f"by seed: {select.label_of(self._primary.name)}" if self._primary else ""
        figure = overview_figure(
            runs, self._title(variant), note=note, fields=self._fields(variant),
            width=self._look.width,
        )  # fmt: skip
        return [self._save(figure, "runs", variant)]

    def chosen_runs(self, variant: str) -> list[Path]:
        """The paths of a typical run and of the worst one."""
        runs = self._of(variant)
        if not self._has_traces:
            return []
        if self._primary is None:
            return self._first_of(runs, "first")[0]
        values = self._values(self._primary, variant)
        nearest_first = [runs[k] for k in select.typical_first(values)]
        paths, typical = self._first_of(nearest_first, "typical")
        order, word = select.worst_first(values, self._primary.better)
        # Only the worst run: if its trace is lost, no second run takes its place.
        worst = [runs[k] for k in order[:1] if runs[k] is not typical]
        return paths + self._first_of(worst, word)[0]

    def over_time(self) -> list[Path]:
        """A picture of each metric over time whose values differ."""
        # 1. Values over time by metric, and the events of each run. Each trace is loaded once.
        asked = [metric for metric in self._asked(select.OVER_TIME) if not metric.is_time_to_event]
        metrics = select.metrics_over_time(asked)
        values_of: dict[str, SeriesByPanel] = {metric.name: {} for metric in metrics}
        events_of_runs: set[Events] = set()
        runs = self._runs if metrics and self._has_traces else []
        for run in runs:
            trace = self._trace(run)
            if trace is not None:
                events_of_runs.add(select.events_of(trace))
                for metric in metrics:
                    self._add_series(values_of[metric.name], metric, run, trace)

        # 2. The pictures. Events are drawn if they are the same in all runs.
        events = next(iter(events_of_runs)) if len(events_of_runs) == 1 else ()
        drawn = [metric for metric in metrics if _varies(values_of[metric.name])]
        return [self._draw_over_time(metric, values_of[metric.name], events) for metric in drawn]

    def _add_series(self, series: SeriesByPanel, metric: Metric, run: Run, trace: Trace) -> None:
        """Add the values of a metric over the time of a run to `series`, if there are values."""
        values = None if metric.series is None else metric.series(trace)
        if values is not None and np.isfinite(values).any():
            facet = self._facets[run.variant.name]
            run_values = trace.t - trace.t[0], values.astype(np.float64)
            series.setdefault(facet.panel, {}).setdefault(facet.label, []).append(run_values)

    def _draw_over_time(self, metric: Metric, series: SeriesByPanel, events: Events) -> Path:
        """The picture of a metric over time. `events`: times in s, with their texts."""
        stem = select.stem_of(metric.name)
        quantity = self._quantity(metric, stem)
        labels = {label for by_label in series.values() for label in by_label}
        missing_labels = {facet.label for facet in self._facets.values()} - labels
        # If only one of several variants has values, the figure has no legend. The title then
        # names the variant.
        is_alone = len(labels) == 1 and bool(missing_labels)
        only_label = f", {min(labels)}" if is_alone else ""
        figure = series_figure(
            series,
            label=quantity.name,
            unit=quantity.unit,
            legend_title=self._axis,
            title=self._scenario + only_label,
            target=self._look.targets.get(metric.name),
            events=events,
            smoothing=select.smoothing_of(metric.name),
            width=self._look.width,
        )
        return self._save(figure, f"over_time_{stem}")

    def _first_of(self, runs: Sequence[Run], word: str) -> tuple[list[Path], Run | None]:
        """Draw the first of `runs` that has a trace, as a `word` run ("typical", "worst").

        Returns the path of the picture and the run; no path and None if no run has a trace.
        """
        for run in runs:
            trace = self._trace(run)
            if trace is not None:
                variant = run.variant.name
                figure = trajectories_figure(
                    trace,
                    f"{self._title(variant)}, seed {run.seed}"
                    f"\n{word} run{self._primary_value(run, has_name=True)}",
                    fields=self._fields(variant),
                    width=self._look.width,
                )
                stem = f"{word.replace(' ', '_')}_trajectories"
                return [self._save(figure, stem, variant)], run
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

    @property
    def _axis(self) -> str:
        """What the labels of variants are values of."""
        return next(iter(self._facets.values())).axis

    def _by_panel(self) -> dict[str, list[str]]:
        """The drawn variants of each panel."""
        by_panel: dict[str, list[str]] = {}
        for variant in self.variants:
            by_panel.setdefault(self._facets[variant].panel, []).append(variant)
        return by_panel

    def _has_spread(self, metric: Metric, panel: str, values: Sequence[Array]) -> bool:
        """False if a picture would show nothing: no run has a value, or all values are equal.

        `values`: (runs,) of each variant. Equal values of a metric that the user asked for give a
        warning.
        """
        all_values = np.concatenate(values)
        known = all_values[np.isfinite(all_values)]
        if not known.size:
            return False
        is_equal = known.size == all_values.size and np.ptp(known) == 0.0
        if is_equal and self._metrics is not None:
            where = f" with {panel}" if panel else ""
            text = "%s is %.4g in all runs%s; it is not drawn"
            _log.warning(text, metric.name, known[0], where)
        return not is_equal

    def _fields(self, variant: str) -> tuple[Field, ...]:
        """The scalar fields of the variant's scenario."""
        effective = self._of(variant)[0].variant.effective
        layers = Layered((str(self._results.folder), effective))
        return tuple(fields_of(layers, effective.get("fields", ())))

    def _save(self, figure: Figure, name: str, variant: str = "") -> Path:
        return save(figure, self._path(name, variant), width=self._look.width)

    def _of(self, variant: str) -> list[Run]:
        return [run for run in self._runs if run.variant.name == variant]

    def _asked(self, default: Sequence[str]) -> list[Metric]:
        return [METRICS[name] for name in default] if self._metrics is None else self._metrics

    def _values(self, metric: Metric, variant: str) -> Array:
        """(runs,) the values of the variant's chosen runs, NaN without one."""
        if metric.name in METRICS and metric.name not in self._results.metrics:
            return np.full(len(self._of(variant)), np.nan)  # of another version
        by_seed = dict(
            zip(self._results.seeds(variant), self._results.metric(metric, variant), strict=True)
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
        name = f"{select.label_of(self._primary.name)} " if has_name else ""
        return f": {name}{value:.3g} {unit}".rstrip()

    def _title(self, variant: str) -> str:
        return fill(f"{self._scenario}, {variant}" if variant else self._scenario, 80)

    def _path(self, name: str, variant: str = "") -> Path:
        run = next(run for run in self._runs if run.variant.name == variant or not variant)
        stem = re.sub("[,=]", "-", run.id.rpartition("_s")[0]) if variant else ""
        # LaTeX and make take no commas and equals signs, and LaTeX no dots, as in file.py:warm.
        safe = re.sub(r"(\.py)?[^\w+-]+", "_", name)
        return self._out / f"{f'{stem}_' if stem else ''}{safe}{self._look.suffix}"


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


def _varies(facets: Mapping[str, Mapping[str, Sequence[Series]]]) -> bool:
    """Whether the values are not all equal."""
    runs = [run for panel in facets.values() for runs in panel.values() for run in runs]
    known = [values[np.isfinite(values)] for _, values in runs]
    return bool(known) and bool(np.ptp(np.concatenate(known)) > 0.0)


def _lettered(facets: Mapping[str, select.Facet], look: Look) -> dict[str, select.Facet]:
    """The facets; for a paper their panels are (a), (b), and one line tells which is which."""
    panels = [panel for panel in dict.fromkeys(facet.panel for facet in facets.values()) if panel]
    if look.width is None or not panels:
        return dict(facets)
    names = [*ascii_lowercase, *map("".join, product(ascii_lowercase, repeat=2))]
    letters = {panel: f"({name})" for panel, name in zip(panels, names, strict=False)}
    _log.warning("panels: %s", ", ".join(f"{letter} {p}" for p, letter in letters.items()))
    return {name: replace(facet, panel=letters[facet.panel]) for name, facet in facets.items()}


def _joined(label: str, panel: str) -> str:
    return f"{panel} {label}" if panel.startswith("(") else f"{label}, {panel}" if panel else label
