"""The public suite of benchmark tasks: task files, patterns that fit a task, and the result table.

A task file in `config/benchmark` says what the robots shall do, the metric in words with its better
direction, the seeds, and the patterns to try. Its scenario has groups without a pattern. These
groups run the pattern that is tried in the task. A task file needs no other file. The runs of a
pattern in a task are an experiment in a folder of its own.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO, TextIOWrapper
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, Struct

import swarmd.config
from swarmd.core.errors import ConfigError, unknown
from swarmd.core.files import read_regular, user_path
from swarmd.core.numbers import finite_number, read_number
from swarmd.plugins import find_pattern
from swarmd.settings.layered import Layered
from swarmd.settings.platforms import PlatformFile
from swarmd.settings.yamlfile import read, shown
from swarmd.sim.experiments import statistics
from swarmd.sim.experiments.plan import MAX_SEED
from swarmd.sim.metrics.catalog import beyond_catalog, metric_of, names_file
from swarmd.sim.metrics.metric import Better
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.scenarios.schema import ScenarioFile, Values
from swarmd.sim.world.scalar_fields import Field
from swarmd.texts.values import NOTHING

if TYPE_CHECKING:
    from swarmd.sim.experiments.results import Results
    from swarmd.sim.experiments.simulate import OnProgress, Runner

SUITE = 1
"""The version of the suite: results of different versions do not compare."""
COLUMNS = ("task", "seed", "value")
"""The columns of a CSV file with results of other programs; a column `name` may be added."""
Bounds = tuple[float | None, float | None]
_STAND_IN = "drive"  # in place of the judged pattern, while a task file is checked


class MetricSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The metric of a task.

    - `name`: the metric that swarmd computes.
    - `formula`: the metric in words.
    - `source`: the publication of the task or the metric.
    - `better`: the better direction.
    - `bounds`: the least and the greatest possible value; null: no bound.
    """

    name: str
    formula: str
    source: str
    unit: str
    better: Better
    bounds: Bounds = (None, None)


class Candidate(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A pattern to try: `parameters` for all judged groups, `by_group` for single groups."""

    pattern: str
    parameters: Values = {}
    by_group: dict[str, Values] = {}


class TaskFile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The keys of a task file of the benchmark suite.

    - `suite`: the version of the suite.
    - `task`: what the robots shall do, in words.
    - `seeds`: the number n of seeds, 0 to n - 1. A seed decides the start poses of layout random,
      and all noise.
    - `groups`: the judged groups of the scenario: they run the pattern that is judged, and have no
      pattern in the file.
    - `candidates`: the patterns that are judged unless the user names patterns.
    - `scenario`: the world and the robots, with the keys of a scenario's file. `duration` is the
      time budget in s. Platforms are complete, with `extends: null`.
    """

    suite: int
    title: str
    task: str
    metric: MetricSection
    seeds: Annotated[int, Meta(ge=1, le=1000)] = 20
    groups: Annotated[list[str], Meta(min_length=1)]
    candidates: list[Candidate] = []
    scenario: dict[str, Any]


class CompleteScenario(ScenarioFile, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A scenario that needs no other file: its platforms and fields in full."""

    platforms: dict[str, PlatformFile]  # type: ignore[assignment]
    fields: tuple[Field, ...] = ()  # type: ignore[assignment]


class CompleteTaskFile(TaskFile, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A file of the suite in full, from which the JSON schema is made."""

    scenario: CompleteScenario  # type: ignore[assignment]  # the same data, read in full


@dataclass(frozen=True, slots=True)
class Task:
    """A task of the suite; `where` is the file's path as error messages show it."""

    name: str
    where: str
    file: TaskFile

    @property
    def robots(self) -> int:
        """The number of robots of all groups."""
        groups = self.file.scenario["groups"].values()
        return sum(group.get("count") or len(group["robots"]) for group in groups)

    def scenario(self, pattern: str, plugin_dir: Path | None = None) -> Scenario:
        """The scenario in which the judged groups run `pattern`.

        If the task file names the pattern as a candidate, the parameters are those of the file,
        else the pattern's defaults. ConfigError if the robots do not meet a need of the pattern.
        """
        declared = next(
            (candidate for candidate in self.file.candidates if candidate.pattern == pattern), None
        )
        chosen = declared or Candidate(pattern=pattern)
        data = dict(self.file.scenario)
        groups = {name: dict(group) for name, group in data["groups"].items()}
        for name in self.file.groups:
            own = {**chosen.parameters, **chosen.by_group.get(name, {})}
            groups[name] |= {"pattern": pattern, "parameters": own}
        folder = None if plugin_dir is None else str(plugin_dir)
        made = {**data, "name": self.name, "description": self.file.title}
        return scenario_of({**made, "groups": groups, "plugin_dir": folder}, home=self.where)


def task_names() -> tuple[str, ...]:
    """The names of the tasks of the suite."""
    return tuple(sorted(path.stem for path in _folder().glob("*.yaml")))


def load_task(name: str) -> Task:
    """The task that `name` names: a task of the suite, or the path of a task file (.yaml).

    ConfigError names the file, the key and the expected value.
    """
    is_path = name.endswith(".yaml")
    path = user_path(name) if is_path else _folder() / f"{name}.yaml"
    if not is_path and name not in task_names():
        fault = unknown("benchmark task", name, task_names())
        raise ConfigError(f"{fault} (or give a path ending in .yaml)")
    layers = Layered((shown(path), read(path)))
    task = Task(path.stem, shown(path), layers.build(TaskFile))
    if task.file.suite != SUITE:
        text = f"suite is {task.file.suite}; this swarmd has version {SUITE} of the suite"
        raise layers.error(("suite",), text)
    _check_scenario(task.file, layers)
    _check_metric(task.file, layers)
    # ConfigError for faults that only a whole scenario shows: _STAND_IN is a pattern that runs on
    # each robot, in place of the judged pattern.
    task.scenario(_STAND_IN)
    return task


def _check_scenario(file: TaskFile, layers: Layered) -> None:
    """ConfigError unless the scenario is complete, and the judged groups have no pattern.

    `layers`: the file, for messages.
    """
    try:
        msgspec.convert(file.scenario, CompleteScenario)
    except msgspec.ValidationError as error:
        text = f"scenario: {error}; a task holds its robots in full, and extends: null"
        raise layers.error(("scenario",), text) from error
    groups = file.scenario["groups"]
    for group in file.groups:
        if group not in groups:
            raise layers.error(("groups",), f"groups: {unknown('group', group, groups)}")
        if "pattern" in groups[group]:
            text = f"scenario.groups.{group}.pattern: the group is judged; leave its pattern out"
            raise layers.error(("scenario", "groups", group, "pattern"), text)
    for platform, section in file.scenario["platforms"].items():
        # Without the key, a platform would extend the installed platform of its name.
        if "extends" not in section or section["extends"] is not None:
            text = (
                f"scenario.platforms.{platform}.extends: expected null, so that no file is needed"
            )
            raise layers.error(("scenario", "platforms", platform, "extends"), text)


def _check_metric(file: TaskFile, layers: Layered) -> None:
    """ConfigError unless the catalog or a package has the task's metric in its unit and direction.

    A metric of a Python file is refused: it would run code of the task's author. `layers`: the file
    of the task, for messages.
    """
    try:
        if names_file(file.metric.name):
            raise ConfigError(f"{file.metric.name}: a task names no file; see `exp metrics`")
        metric = metric_of(file.metric.name)
    except ConfigError as error:
        raise layers.error(("metric", "name"), f"metric.name: {error}") from error
    if metric.better != file.metric.better or metric.unit != file.metric.unit:
        text = f"metric: {metric.name} is in {metric.unit}, and {metric.better} is better"
        raise layers.error(("metric",), f"{text}; expected the same unit and direction")


def _folder() -> Path:
    return Path(swarmd.config.__path__[0]).resolve() / "benchmark"


@dataclass(frozen=True, slots=True)
class TaskEntry:
    """A pattern in a task, with its complete scenario."""

    task: Task
    pattern: str
    scenario: Scenario


@dataclass(frozen=True, slots=True)
class Misfit:
    """A pattern that a task does not run, and why in one line."""

    task: str
    pattern: str
    why: str


def entries_of(
    tasks: Sequence[Task], patterns: Sequence[str] = (), plugin_dir: Path | None = None
) -> tuple[list[TaskEntry], list[Misfit]]:
    """The pairs of task and pattern to run, and the pairs whose task does not fit the pattern.

    In a pair that does not fit, the robots lack an input that the pattern needs. `patterns`: the
    names to try in each task; if empty, each task tries the candidates of its file.
    ConfigError for an unknown pattern, and for a candidate of a task file that does not fit.
    """
    for pattern in patterns:
        find_pattern(pattern, plugin_dir)
    entries, misfits = [], []
    for task in tasks:
        declared = [candidate.pattern for candidate in task.file.candidates]
        for pattern in patterns or declared:
            try:
                scenario = task.scenario(pattern, plugin_dir=plugin_dir)
            except ConfigError as error:
                if not patterns:
                    raise
                misfits.append(Misfit(task.name, pattern, str(error)))
            else:
                entries.append(TaskEntry(task, pattern, scenario))
    return entries, misfits


def run_entry(
    entry: TaskEntry,
    seeds: Iterable[int] | None,
    folder: Path,
    runner: Runner,
    *,
    traces: bool,
    command: Sequence[str],
    on_progress: OnProgress | None = None,
) -> Results:
    """Do the missing runs of an entry as an experiment in FOLDER/TASK/PATTERN.

    `seeds`: None for the seeds of the task. `command`: the command line for the manifest.
    """
    # Imported here: the completion of task names in the shell must not wait for the simulator.
    from swarmd.sim.experiments.manifest import manifest_of
    from swarmd.sim.experiments.simulate import plan_of, run_experiment

    file = entry.task.file
    own = beyond_catalog([metric_of(file.metric.name)])
    plan = plan_of(entry.scenario, range(file.seeds) if seeds is None else seeds)
    manifest = manifest_of(plan, traces=traces, command=list(command), metrics=own)
    place = folder / entry.task.name / entry.pattern
    return run_experiment(manifest, place, runner, on_progress=on_progress)


def values_by_seed(entry: TaskEntry, results: Results) -> dict[int, float]:
    """The metric of each seed of an entry; NaN for a run that failed."""
    values = results.metric(metric_of(entry.task.file.metric.name)).tolist()
    measured = dict(zip(results.seeds(""), values, strict=True))
    return dict.fromkeys(results.plan.seeds, math.nan) | measured


@dataclass(frozen=True, slots=True)
class Cell:
    """The results of one row in one task."""

    values: Mapping[int, float]  # by seed; NaN for a run without a value
    summary: statistics.Summary
    rank: int | None = None
    """The place, if the interval of the median overlaps the interval of no other row.

    None where intervals overlap, since other seeds may change the order, and where either row has
    no interval."""
    place: float = math.inf
    """The place by median, from 1 on; inf without a median. Rows of equal median share a place."""


Table = dict[str, dict[str, Cell]]
"""Cells by row, then by task."""


def table_of(
    values: Mapping[tuple[str, str], Mapping[int, float]], better: Mapping[str, Better]
) -> Table:
    """The table of a benchmark, with median, interval, place and rank of each cell.

    `values`: the metric by (name of the table row, task) and by seed. `better`: the direction of
    the metric of each task. Rows are sorted by their best place, then by the number of tasks, then
    by name.
    """
    summaries = {key: _summary(by_seed) for key, by_seed in values.items()}
    table: Table = {}
    for (row, task), summary in summaries.items():
        rivals = [
            rival
            for (rival_row, rival_task), rival in summaries.items()
            if rival_task == task and rival_row != row
        ]
        place = _place(summary, rivals, better[task])
        has_rank = math.isfinite(place) and all(_is_apart(summary, rival) for rival in rivals)
        rank = int(place) if has_rank else None
        table.setdefault(row, {})[task] = Cell(values[row, task], summary, rank, place)
    return dict(sorted(table.items(), key=_order))


def _place(
    summary: statistics.Summary, rivals: Iterable[statistics.Summary], better: Better
) -> float:
    """The place by median among the rivals of a task, from 1 on; inf without a median."""
    if summary.median is None:
        return math.inf
    sign = 1.0 if better == "less" else -1.0
    medians = [rival.median for rival in rivals if rival.median is not None]
    return 1 + sum(sign * median < sign * summary.median for median in medians)


def _is_apart(a: statistics.Summary, b: statistics.Summary) -> bool:
    """Whether the intervals of two medians do not overlap; True if `b` has no median."""
    if b.median is None:
        return True
    left, right = a.median_interval, b.median_interval
    if left is None or right is None:
        return False
    return left.high < right.low or right.high < left.low


def _order(item: tuple[str, Mapping[str, Cell]]) -> tuple[float, int, str]:
    row, cells = item
    return (min((cell.place for cell in cells.values()), default=math.inf), -len(cells), row)


def _summary(values: Mapping[int, float]) -> statistics.Summary:
    return statistics.summarize(np.array([*values.values()], dtype=np.float64))


def cell_text(cell: Cell | None) -> str:
    """The text of a cell: median, 95 % interval and rank, such as `0.71 (0.6 to 0.8) #2`.

    ` of 3/20` is added if only three of twenty runs have a value. Empty without a cell.
    """
    if cell is None:
        return ""
    median, interval = cell.summary.median, cell.summary.median_interval
    n, runs = cell.summary.n, len(cell.values)
    if median is None:
        return NOTHING
    between = "" if interval is None else f" ({interval.low:.3g} to {interval.high:.3g})"
    rank = "" if cell.rank is None else f" #{cell.rank}"
    return f"{median:.3g}{between}{rank}" + (f" of {n}/{runs}" if n < runs else "")


def read_results(
    path: Path, tasks: Iterable[str], bounds: Mapping[str, Bounds] = MappingProxyType({})
) -> dict[tuple[str, str], dict[int, float]]:
    """The values of another program from a CSV file, by (name of the table row, task) and by seed.

    The file has a line for each run, with the columns task, seed and value. A column `name` may
    give the name of the table row, which else is the file's name. An empty value, for a run without
    a result, becomes NaN. `tasks`: the tasks that a line may name. `bounds`: (least, greatest)
    value of the metric by task; a value outside is wrong or in another unit. ConfigError with path
    and line for a fault of the file.
    """
    task_names = tuple(tasks)
    values: dict[tuple[str, str], dict[int, float]] = {}
    try:
        with TextIOWrapper(BytesIO(read_regular(path)), "utf-8-sig", newline="") as file:
            reader = csv.DictReader(file)
            missing_columns = [name for name in COLUMNS if name not in (reader.fieldnames or ())]
            if missing_columns:
                text = f"{path}:1: there is no column {missing_columns[0]}"
                raise ConfigError(f"{text}; expected {','.join(COLUMNS)}")
            for cells in reader:
                where = f"{path}:{reader.line_num}"
                if None in cells or None in cells.values():  # too many cells, or too few
                    header = ",".join(reader.fieldnames or ())
                    raise ConfigError(f"{where}: expected as many cells as the head: {header}")
                task, name = cells["task"], cells.get("name") or path.stem
                if task not in task_names:
                    raise ConfigError(f"{where}: {unknown('benchmark task', task, task_names)}")
                seed, value = _seed(where, cells["seed"]), _value(where, cells["value"])
                low, high = bounds.get(task, (None, None))
                if (low is not None and value < low) or (high is not None and value > high):
                    text = f"{where}: value is {value:g}; expected {low} to {high}"
                    raise ConfigError(f"{text} in the unit of the task's metric")
                if seed in values.setdefault((name, task), {}):
                    raise ConfigError(f"{where}: {name} has seed {seed} of {task} twice; keep one")
                values[name, task][seed] = value
    except (OSError, UnicodeError, csv.Error) as error:
        fault = error.strerror if isinstance(error, OSError) else error
        raise ConfigError(f"{path}: cannot be read: {fault}") from error
    return values


def _seed(where: str, text: str) -> int:
    seed = read_number(text)
    if not isinstance(seed, int) or not 0 <= seed <= MAX_SEED:
        raise ConfigError(f"{where}: seed is {text!r}; expected a whole number 0 to {MAX_SEED}")
    return seed


def _value(where: str, text: str) -> float:
    value = finite_number(text)
    if math.isnan(value) and text.lower() not in ("", "nan"):  # as NumPy and pandas write NaN
        raise ConfigError(f"{where}: value is {text!r}; expected a number, or nothing")
    return value


def document(tasks: Sequence[Task], table: Table, misfits: Sequence[Misfit]) -> dict[str, Any]:
    """The table as plain values."""
    return {
        "suite": SUITE,
        "level": statistics.LEVEL,
        "method": statistics.METHOD,
        "tasks": [
            {
                "name": task.name,
                "title": task.file.title,
                "metric": msgspec.to_builtins(task.file.metric),
                "results": [*_results_of(task.name, table)],
            }
            for task in tasks
        ],
        "misfits": [
            {"task": misfit.task, "pattern": misfit.pattern, "why": misfit.why}
            for misfit in misfits
        ],
    }


def _results_of(task: str, table: Table) -> Iterator[dict[str, Any]]:
    for row, cells in table.items():
        if task in cells:
            cell = cells[task]
            yield {
                "name": row,
                "rank": cell.rank,
                "median": cell.summary.median,
                "median_interval": cell.summary.median_interval,
                "mean": cell.summary.mean,
                "mean_interval": cell.summary.mean_interval,
                "runs": cell.summary.n,
                "values": {s: None if math.isnan(v) else v for s, v in cell.values.items()},
            }
