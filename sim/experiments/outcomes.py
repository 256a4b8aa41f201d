"""Outcomes: bounds on metrics of runs, which a file `outcomes.yaml` names with their sources.

::

    scenario: dispersion
    set: {groups.tb3.count: 5, duration: 40}
    seeds: 20
    outcomes:
      - what: mean path [m]
        requirement: max(path_length) <= 0.73
        source: "ours: no detours"

`swarmctl exp run outcomes.yaml` does the runs, and `swarmctl exp check` judges them. The page is
docs/writing_experiments.md, "Outcomes".

The rows of a file are read here, the values of runs are compared with them, and nothing else:
`simulate` does the runs, each kind of them an experiment of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Literal, TypeAlias

import msgspec
import numpy as np

from swarmd.core.errors import ConfigError, SwarmError, unknown
from swarmd.core.files import user_path
from swarmd.core.values import Array
from swarmd.operator.texts.values import counted
from swarmd.plugins import pattern_folders
from swarmd.settings.layered import Keys, Layered, dotted
from swarmd.settings.yamlfile import read, shown
from swarmd.sim.experiments.plan import Plan, parse_seeds
from swarmd.sim.experiments.requirements import (
    RUNS,
    Requirement,
    RequirementFinding,
    Verdict,
    measured,
    metrics_in,
    parse_requirement,
    verdict_of,
)
from swarmd.sim.experiments.results import Results, load_results
from swarmd.sim.experiments.simulate import plan_of
from swarmd.sim.experiments.statistics import (
    FEW,
    Interval,
    censored_median_interval,
    difference_interval,
    mean_interval,
    median_interval,
    ratio_interval,
    wilson,
)
from swarmd.sim.metrics.catalog import Metric, metric_of, names_file
from swarmd.sim.scenarios.pattern_paths import absolute

NAME = "outcomes.yaml"
"""The file of outcomes beside a pattern, and in the folder of their runs."""
ONLY = "runs"
"""The name of the runs of a file that does not name any."""
SEEDS = 20
_DECIDING = ("min", "max")
"""Statistics that are numbers of the runs themselves: each run has to meet the bound."""

Samples: TypeAlias = tuple[tuple[float, ...], ...]


class _Runs(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is run. Keys that are left out are those of the file."""

    scenario: str | None = None
    set: dict[str, Any] = {}
    sweep: dict[str, list[Any]] = {}
    seeds: int | str | None = None


class _Other(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a value is divided by, or lessened by. Left out: the runs, or the metric, of the row."""

    runs: str | None = None
    metric: str | None = None


class _Row(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An outcome."""

    what: str
    requirement: str
    source: str
    runs: str | list[str] | None = None
    over: str | _Other | None = None
    less: str | _Other | None = None
    if_known: bool = False


class _File(_Runs, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A file of outcomes."""

    runs: dict[str, _Runs] = {}
    outcomes: list[_Row]


@dataclass(frozen=True, slots=True)
class RunsOf:
    """The runs of an experiment, as the arguments of `simulate`."""

    scenario: str
    """A name, or the path of a file."""
    seeds: tuple[int, ...]
    sets: Mapping[str, Any]
    sweep: Mapping[str, Sequence[Any]]
    has_own_seeds: bool = False
    """These runs have other seeds than the rest of the file: with them the runs of one kind."""


@dataclass(frozen=True, slots=True)
class Other:
    """By what a row divides (`over`), or what it takes away (`less`)."""

    kind: Literal["over", "less"]
    runs: tuple[str, ...]
    metric: str


@dataclass(frozen=True, slots=True)
class Row:
    """A bound on a metric of runs, with its origin."""

    what: str
    """The number in words."""
    requirement: Requirement
    source: str
    """The origin of the bound."""
    runs: tuple[str, ...]
    """The names of the runs; several are taken together."""
    other: Other | None = None
    if_known: bool = False
    """Only runs with a value count; else one run without a value misses the bound."""

    @property
    def sides(self) -> tuple[tuple[str, ...], ...]:
        """The names of the runs, and of the others with which they are compared."""
        return (self.runs,) if self.other is None else (self.runs, self.other.runs)

    @property
    def metrics(self) -> Iterator[tuple[str, str]]:
        """The names of runs and of a metric that the row needs of them."""
        yield from product(self.runs, self.requirement.metrics)
        if self.other is not None:
            yield from product(self.other.runs, metrics_in(self.other.metric))


@dataclass(frozen=True, slots=True)
class Outcomes:
    """The rows of a file, and the runs that they need, by name."""

    file: Path
    runs: Mapping[str, RunsOf]
    rows: tuple[Row, ...]

    def metrics(self, name: str) -> list[Metric]:
        """The metrics that rows need of the runs `name`; ConfigError for one that there is not.

        The path of a Python file of metrics begins at the folder of this file.
        """
        found: dict[str, Metric] = {}
        for number, row in enumerate(self.rows):
            for runs, metric in row.metrics:
                if runs == name and metric not in found and metric != RUNS:
                    found[metric] = self._metric(number, metric)
        return list(found.values())

    def _metric(self, number: int, name: str) -> Metric:
        try:
            return metric_of(str(self.file.parent / user_path(name)) if names_file(name) else name)
        except ConfigError as error:
            raise ConfigError(f"{_place(self.file, number)}: {error}") from error

    def plan(
        self,
        name: str,
        seeds: tuple[int, ...] | None = None,
        *,
        on_note: Callable[[str], object] = str,
    ) -> Plan:
        """The plan of the runs `name`, which is checked; `seeds`: in place of those of the file."""
        runs = self.runs[name]
        source = f"{shown(self.file)}: runs {name}"
        try:
            return plan_of(
                runs.scenario,
                runs.seeds if seeds is None else seeds,
                runs.sets,
                runs.sweep,
                on_note=on_note,
                source=source,
            )
        except ConfigError as error:
            text = str(error)
            raise ConfigError(text if text.startswith(source) else f"{source}: {text}") from error


@dataclass(frozen=True, slots=True)
class OutcomeFinding:
    """The check of a row; the variant of `finding` has the names of the runs."""

    row: Row
    finding: RequirementFinding

    def document(self) -> dict[str, Any]:
        """The finding as plain values."""
        return {"what": self.row.what, "source": self.row.source, **self.finding.document()}


def is_outcomes(name: str) -> bool:
    """Whether a scenario's name on a command line is that of a file of outcomes."""
    return Path(name).name.endswith(NAME)


def outcomes_file(name: str) -> Path:
    """The file of outcomes of a path, or of `PATTERN/outcomes.yaml` beside an installed pattern.

    ConfigError if there is neither.
    """
    path = user_path(name)
    if path.exists():
        return path
    folders = pattern_folders()
    pattern = path.parent.name
    if path == Path(pattern, NAME) and pattern in folders:
        file = folders[pattern].path / NAME
        if file.is_file():
            return file
        known = sorted(of for of, folder in folders.items() if (folder.path / NAME).is_file())
        raise ConfigError(f"{name}: {unknown('pattern with rows of outcomes', pattern, known)}")
    hint = f"{unknown('pattern', pattern, folders)}; " if len(path.parts) == 2 else ""
    raise ConfigError(f"{name}: there is no such file; {hint}expected a path, or PATTERN/{NAME}")


def read_outcomes(path: Path, text_of: Path | None = None) -> Outcomes:
    """The outcomes of a file. ConfigError in one line names file, key, value and expected value.

    `text_of`: the file that is read, if it is a copy of `path`.
    """
    place = shown(path)
    layers = Layered((place, read(text_of or path)))
    file = layers.build(_File)
    if not file.outcomes:
        raise layers.error(("outcomes",), "outcomes is empty; expected at least one row")
    named = file.runs or {ONLY: _Runs()}
    runs = {}
    for name, own in named.items():
        if not name.isidentifier():
            text = f"{name!r} is no name of runs; expected letters, digits and _: it names a folder"
            raise layers.error(("runs", name), f"runs: {text}")
        keys: Keys = ("runs", name) if file.runs else ()
        runs[name] = _runs_of(layers, keys, file, own, path.parent)
    rows = tuple(_row(layers, number, row, runs) for number, row in enumerate(file.outcomes))
    for name in runs:
        if not any(name == needed for row in rows for needed, _ in row.metrics):
            raise layers.error(("runs", name), f"runs: {name}: no row needs these runs; leave them")
    return Outcomes(path, runs, rows)


def _runs_of(layers: Layered, keys: Keys, file: _File, own: _Runs, folder: Path) -> RunsOf:
    where = f"{dotted(keys)}: " if keys else ""
    scenario = own.scenario or file.scenario
    if not scenario:
        text = f"{where}scenario is missing; expected a name of `swarmctl exp list`, or a .yaml"
        raise layers.error(keys, text)
    if scenario.endswith(".yaml"):
        scenario = str(folder / user_path(scenario))
    given = own.seeds if own.seeds is not None else file.seeds
    try:
        seeds = parse_seeds(str(SEEDS if given is None else given))
    except ConfigError as error:
        raise layers.error((*keys, "seeds"), f"{where}seeds: {error}") from error
    sets = {**file.set, **own.set}
    sweep = {**file.sweep, **own.sweep}
    for key, value in {**sets, **sweep}.items():
        if not all(str(key).split(".")):
            raise layers.error(keys, f"{where}{key!r} is no dotted key of a scenario: {value!r}")
    return RunsOf(
        scenario,
        seeds,
        absolute(sets, folder),
        {
            key: [absolute({key: value}, folder)[key] for value in values]
            for key, values in sweep.items()
        },
        own.seeds is not None,
    )


def _row(layers: Layered, number: int, row: _Row, runs: Mapping[str, RunsOf]) -> Row:
    """The row of a file; ConfigError if it does not fit the runs of the file."""
    keys: Keys = ("outcomes", number)
    try:
        for key, text in (("what", row.what), ("source", row.source)):
            if not text.strip() or not text.isprintable():
                wanted = "the origin of the bound, a paper or `ours: why`"
                wanted = wanted if key == "source" else "the number in words"
                raise ConfigError(f"{key} is {text!r}; expected {wanted}")
        requirement = parse_requirement(row.requirement)
        if row.runs is None and len(runs) > 1:
            raise ConfigError(f"runs is missing; expected one of {', '.join(runs)}")
        names = _names(runs if row.runs is None else row.runs)
        if row.over is not None and row.less is not None:
            raise ConfigError("over and less stand for two things; keep one of them")
        other = _other(row, names, requirement)
        for one in (*names, *(other.runs if other is not None else ())):
            if one not in runs:
                raise ConfigError(unknown("runs", one, runs))
        if not names or len({*names}) < len(names):
            raise ConfigError(f"runs is {list(names)}; expected names, each of them once")
        if other is not None:
            if RUNS in (requirement.metric, other.metric):
                raise ConfigError(f"{other.kind} goes with a metric; {RUNS} is a number of runs")
            _check_other(other, names, requirement, runs)
    except ConfigError as error:
        raise layers.error(keys, f"{dotted(keys)}: {error}") from error
    return Row(row.what, requirement, row.source, names, other, row.if_known)


def _names(runs: str | Iterable[str]) -> tuple[str, ...]:
    return (runs,) if isinstance(runs, str) else tuple(runs)


def _other(row: _Row, names: tuple[str, ...], requirement: Requirement) -> Other | None:
    given = row.over if row.over is not None else row.less
    if given is None:
        return None
    one = _Other(runs=given) if isinstance(given, str) else given
    kind: Literal["over", "less"] = "over" if row.over is not None else "less"
    if one.runs is None and one.metric is None:
        raise ConfigError(f"{kind} has nothing; expected runs, a metric, or both")
    others = names if one.runs is None else (one.runs,)
    return Other(kind, others, one.metric or requirement.metric)


def _check_other(
    other: Other, names: tuple[str, ...], requirement: Requirement, runs: Mapping[str, RunsOf]
) -> None:
    if (other.runs, other.metric) == (names, requirement.metric):
        raise ConfigError(f"{other.kind}: {names[0]} is compared with itself; name other runs")
    if requirement.statistic not in (*_DECIDING, "mean"):
        raise ConfigError(f"{other.kind} goes with mean, min and max; not with {requirement.text}")
    if requirement.statistic in _DECIDING and other.runs != names:
        own = runs[names[0]]
        others = runs[other.runs[0]]
        if len(names) > 1 or own.seeds != others.seeds or own.sweep != others.sweep:
            raise ConfigError(
                f"{other.kind}: {requirement.statistic} compares run by run, and"
                f" {', '.join(names)} and {other.runs[0]} have not the same seeds and sweep; take"
                " the mean"
            )


def _place(file: Path, number: int) -> str:
    return f"{shown(file)}: {dotted(('outcomes', number))}"


def known_name(metric: str) -> str:
    """The name by which results know a metric of a row: that of a Python file has no folder."""
    return "+".join(
        f"{Path(one.rpartition(':')[0]).name}:{one.rpartition(':')[2]}" if names_file(one) else one
        for one in metrics_in(metric)
    )


def samples_of(row: Row, results: Mapping[str, Results]) -> Samples:
    """The values of a row: one sample of runs, or two if their means are compared.

    In the order of the runs' plan. NaN: a run without a value; inf: an event that never happened.
    With `min` or `max` the values are quotients or differences, run by run.
    """
    own = _values(results, row.runs, row.requirement.metric)
    if row.other is None:
        return (_known(own, row),)
    other = _values(results, row.other.runs, row.other.metric)
    if row.requirement.statistic not in _DECIDING:
        return _known(own, row), _known(other, row)
    if len(own) != len(other):
        names = " and ".join((*row.runs, *row.other.runs))
        text = f"{row.what}: {names} are compared run by run, and have"
        raise SwarmError(f"{text} {len(own)} and {counted(len(other), 'run')}; do the others")
    with np.errstate(divide="ignore", invalid="ignore"):
        values = own - other if row.other.kind == "less" else own / other
    if row.if_known:  # an event that never happened on both sides is no run without a value
        values = values[~(np.isnan(own) | np.isnan(other))]
    return (tuple(values.tolist()),)


def _values(results: Mapping[str, Results], names: Sequence[str], metric: str) -> Array:
    """The values of a metric in runs of these names, together; those without results left out.

    ConfigError if the runs did not measure it: the file of a folder may be of others, and no code
    that it names is imported.
    """
    wanted = known_name(metric)
    known = []
    for name in names:
        if name not in results:
            continue
        lacking = [one for one in metrics_in(wanted) if one not in results[name].metrics]
        if lacking:
            raise ConfigError(
                f"{results[name].folder}: {unknown('metric', lacking[0], results[name].metrics)};"
                " these runs did not measure it: do them again"
            )
        known.append(measured(results[name], wanted)[0])
    return np.concatenate(known)


def _known(values: Array, row: Row) -> tuple[float, ...]:
    some = values[~np.isnan(values)] if row.if_known else values
    return tuple(some.tolist())


def judge(row: Row, results: Mapping[str, Results]) -> OutcomeFinding:
    """Compare the runs of a row with its bound.

    The 95 % interval of a mean, median or share decides, and each run of `min` and `max`, as in
    `requirements.check`. A bound is not met if a run has no value, unless the row has `if_known`.
    With `runs` in place of a metric the number of finished runs is compared.
    """
    requirement = row.requirement
    runs = ", ".join(row.runs)
    if requirement.metric == RUNS:
        done = float(sum(len(results[name].rows) for name in row.runs))
        verdict = verdict_of(requirement, Interval(done, done))
        return OutcomeFinding(row, RequirementFinding(requirement, runs, done, None, "", verdict))
    samples = [np.array(sample) for sample in samples_of(row, results)]
    missing = sum(int(np.isnan(sample).sum()) for sample in samples)
    remark = f"{counted(missing, 'run')} without a value" if missing else ""
    if missing or not all(sample.size for sample in samples):
        about = remark or "no run has a value"
        finding = RequirementFinding(requirement, runs, None, None, about, Verdict.NOT_MET)
        return OutcomeFinding(row, finding)
    value, interval = _statistic(row, samples)
    if requirement.statistic in _DECIDING:
        verdict = verdict_of(requirement, Interval(value, value))
    elif math.isnan(value):
        verdict = Verdict.NOT_MET
    else:
        verdict = verdict_of(requirement, interval or Interval(-math.inf, math.inf))
    fewest = min(sample.size for sample in samples)
    is_bootstrap = interval is not None and requirement.statistic != "share"
    finding = RequirementFinding(
        requirement,
        runs,
        value if math.isfinite(value) else None,
        interval,
        remark,
        verdict,
        fewest if is_bootstrap and fewest < FEW else 0,
    )
    return OutcomeFinding(row, finding)


def _statistic(row: Row, samples: Sequence[Array]) -> tuple[float, Interval | None]:
    """The statistic of a row with its interval; None for `min` and `max`, and without one."""
    statistic = row.requirement.statistic
    own = samples[0]
    if statistic == "min":
        return float(own.min()), None
    if statistic == "max":
        return float(own.max()), None
    if statistic == "median":
        is_never = np.isinf(own)
        if is_never.any():
            times = np.where(is_never, np.nan, own)
            return float(np.median(own)), censored_median_interval(times)
        return float(np.median(own)), median_interval(own)
    if statistic == "share":
        check_share(row, own)
        return float(own.mean()), wilson(int(own.sum()), own.size)
    if row.other is None:
        return float(own.mean()), mean_interval(own)
    other = samples[1]
    if row.other.kind == "less":
        return float(own.mean() - other.mean()), difference_interval(other, own)
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(own.mean() / other.mean()), ratio_interval(own, other)


def check_share(row: Row, values: Array) -> None:
    """ConfigError if `values` of a row with a share are not 0 or 1 each."""
    if not np.isin(values, (0.0, 1.0)).all():
        text = f"{row.what}: {row.requirement.text}: the share of runs for which a metric is 1"
        raise ConfigError(f"{text} needs a metric that is 0 or 1; take the mean")


def judged_folder(folder: Path) -> tuple[list[OutcomeFinding], str]:
    """The findings of the rows whose runs are in `folder`, and what is missing, as text.

    Seeds of the file that were not run are missing, too: a quick look tries no row.
    A row without any run of its kind has no finding. ConfigError if the folder is damaged.
    """
    outcomes = read_outcomes(folder / NAME)
    results: dict[str, Results] = {}
    lacking = []
    for name in outcomes.runs:
        if not (folder / name).is_dir():
            lacking.append(f"{name}: no run")
            continue
        of_runs = load_results(folder / name)
        if of_runs.rows:
            results[name] = of_runs
        if of_runs.lacking or not of_runs.rows:
            lacking.append(f"{name}: {of_runs.lacking or 'no run'}")
        elif left_out := left_out_seeds(outcomes, name, of_runs.plan.seeds):
            lacking.append(left_out)
    return judge_all(outcomes, results), ", ".join(lacking)


def left_out_seeds(outcomes: Outcomes, name: str, seeds: Sequence[int]) -> str:
    """How many seeds of the file the runs `name` leave out, as `--seeds` may; empty if none."""
    wanted = {*outcomes.runs[name].seeds}
    tried = len(wanted.intersection(seeds))
    if tried == len(wanted):
        return ""
    return (
        f"{name}: {tried} of the {counted(len(wanted), 'seed')} of {NAME}; for a verdict run the"
        " file without --seeds into a new folder"
    )


def judge_all(outcomes: Outcomes, results: Mapping[str, Results]) -> list[OutcomeFinding]:
    """The findings of the rows all of whose runs have results."""
    return [judge(row, results) for row in outcomes.rows if has_runs(row, results)]


def has_runs(row: Row, results: Mapping[str, Results]) -> bool:
    """Whether there are results of all runs that a row needs."""
    return all(runs in results for runs, _ in row.metrics)
