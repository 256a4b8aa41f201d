"""Tuning: the values of a scenario's parameters with the best mean of a metric.

::

    from swarmd.sim.experiments.tune import tune

    tuning = tune("aggregation", "gather_time:min", budget=200, param=["spacing=0.6..0.9"])
    print(tuning)

`swarmctl exp tune` calls this function. A tuning has these phases:

1. A sampler draws new candidates from the results of earlier races.
2. A race runs all its candidates over the same seeds in the same order. A candidate ends early when
   a rank test shows that the leader is significantly better (`racing.py`).
3. The best candidate of a race also takes part in the next race. Races repeat until the budget is
   used.
4. Held-out seeds, which no race has used, compare the best candidate with the values of the
   scenario.

Sampler: optuna's tree-structured Parzen estimator (J. Bergstra et al., "Algorithms for
hyper-parameter optimization", NIPS 2011; multivariate: S. Falkner et al., "BOHB", ICML 2018) with a
fixed seed. The sampler learns between races alone. So the result depends neither on the order in
which runs end nor on the number of processes.
"""

from __future__ import annotations

import json
import math
import shutil
import tempfile
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib.util import find_spec
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, cast

import msgspec
import numpy as np

from swarmd.core.errors import ConfigError, PluginError, SwarmError
from swarmd.core.files import read_regular
from swarmd.sim.experiments import manifest as manifests
from swarmd.sim.experiments.compare import Difference, Side
from swarmd.sim.experiments.compare import compare as compare_sides
from swarmd.sim.experiments.manifest import Manifest, manifest_of, plain, write_json, write_whole
from swarmd.sim.experiments.plan import MAX_RUNS, Plan, Variant, check_seeds
from swarmd.sim.experiments.pool import STEP_TIMEOUT, run_jobs
from swarmd.sim.experiments.racing import ALPHA, looks, losers, mean_loss
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.search_space import SOURCE, ParameterSpace, parameter_space
from swarmd.sim.experiments.simulate import OnProgress, Runner, run_experiment, run_here
from swarmd.sim.experiments.statistics import number
from swarmd.sim.experiments.tuned_values import tuned_document
from swarmd.sim.metrics.catalog import Metric, beyond_catalog, metric_of
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import load_scenario

if TYPE_CHECKING:
    from optuna import Study
    from optuna.trial import Trial

Goal = Literal["min", "max"]
STATE = "tune.json"
RACES = "races"
HELD_OUT = "held_out"
RESULT = "tuned.yaml"
PRESENT, TUNED = "present", "tuned"
"""Names of the two variants on held-out seeds: the scenario's values, and the best candidate's."""
CANDIDATES = 8
_FORMAT = 1
_SAMPLER_SEED = 2011
_MIN_TRIALS = 10  # with fewer trials no importance is computed
_MAX_DRAWS = 40  # draws in a row that the scenario may refuse or that repeat a candidate


@dataclass(slots=True)
class Candidate:
    """Values of the parameters that a tuning tries; number 0 has the values of the scenario."""

    number: int
    values: dict[str, Any]
    """Values by parameter; candidate 0 has the values inside the search space, or none."""
    overrides: dict[str, Any]
    """Overrides of the scenario by dotted key."""
    effective: Mapping[str, Any]
    """The complete scenario."""
    losses: list[float] = field(default_factory=list)
    """A loss for each seed run so far, in the order of the seeds; the least loss is the best.

    inf: the run failed, or its metric has no value."""
    is_out: bool = False
    """A race has ended the candidate early."""
    estimate: float = math.nan
    """The mean loss over all seeds of a race, extrapolated if `is_out`; NaN during the race."""
    trial: Any = None
    """The trial of optuna that drew the values; None for candidate 0."""


@dataclass(frozen=True, slots=True)
class Look:
    """A look is an interim analysis of a race: the state of a tuning after a block of seeds."""

    race: int  # counted from 1
    runs: int  # finished so far
    budget: int  # of runs
    alive: int  # new candidates of this race that have not ended early
    candidates: tuple[Candidate, ...]  # of all races, best first; those that ended early come last
    metric: str
    goal: Goal

    def value(self, candidate: Candidate) -> float | None:
        """The mean of the metric over the candidate's finished runs; None if all failed."""
        mean = mean_loss(candidate.losses)[1]
        if math.isinf(mean):
            return None
        return mean if self.goal == "min" else -mean

    @property
    def headline(self) -> str:
        """The progress of the tuning, on one line."""
        count = len(self.candidates)
        return (
            f"{self.runs} of {self.budget} runs, race {self.race}, {count} candidates,"
            f" {self.alive} of them new in the race"
        )

    @property
    def leader_text(self) -> str:
        """The best candidate so far: its values and its mean."""
        best = self.candidates[0]
        values = " ".join(f"{name}={value}" for name, value in best.values.items())
        name = "present values" if best.number == 0 else values
        return f"{name}, {self.metric} {number(self.value(best))}"


OnLook: TypeAlias = Callable[[Look], None]


@dataclass(slots=True, weakref_slot=True)
class Tuning:
    """The result of a tuning, whose files are in `folder`."""

    folder: Path
    metric: Metric
    goal: Goal
    space: ParameterSpace
    seeds: tuple[int, ...]
    held_out: tuple[int, ...]
    runs: int
    best: Candidate
    """Candidate number 0 if no candidate has a better mean over the seeds of the races."""
    candidates: tuple[Candidate, ...]
    importance: dict[str, float]
    """The importance of each parameter as a share of 1, by PED-ANOVA; empty if not computed."""
    gain: Difference | None = None
    """The scenario's values (side a) against the tuned values (side b) on held-out seeds.

    None without held-out seeds, or if `best` is candidate 0."""
    drops: dict[str, Difference] = field(default_factory=dict)
    """By variant: its held-out runs (side a) against the same seeds in pseudo-reality (side b)."""
    document: str = ""
    """The text of tuned.yaml."""

    def value(self, candidate: Candidate) -> float:
        """The mean of the metric over the seeds of the races.

        A failed run counts as the worst run of the race. The mean of a candidate that ended early
        is extrapolated: it is the mean of the race's leader over all seeds, plus the candidate's
        mean difference from the leader over the seeds that the candidate has run.
        """
        return candidate.estimate if self.goal == "min" else -candidate.estimate

    def __str__(self) -> str:
        return self.document


def plain_tuning(tuning: Tuning) -> dict[str, Any]:
    """A tuning as dicts, lists, texts and numbers, for JSON."""

    def about(candidate: Candidate) -> dict[str, Any]:
        return {
            "candidate": candidate.number,
            "values": candidate.values,
            "mean": tuning.value(candidate),
            "seeds": len(candidate.losses),
            "is_out": candidate.is_out,
        }

    return {
        "folder": str(tuning.folder),
        "metric": tuning.metric.name,
        "goal": tuning.goal,
        "runs": tuning.runs,
        "seeds": list(tuning.seeds),
        "held_out": list(tuning.held_out),
        "best": about(tuning.best),
        "gain": None if tuning.gain is None else asdict(tuning.gain),
        "drops": {name: asdict(drop) for name, drop in tuning.drops.items()},
        "importance": tuning.importance,
        "candidates": [about(candidate) for candidate in tuning.candidates],
    }


def split_metric(text: str, goal: str | None = None) -> tuple[Metric, Goal]:
    """The metric and the direction ("min" or "max") that a text `M`, `M:min` or `M:max` names.

    `goal`: a direction that takes precedence over the text. ConfigError if neither the text, nor
    `goal`, nor the metric itself has a direction.
    """
    name, _, word = text.rpartition(":")
    if goal is None and word in ("min", "max") and name not in ("", "report", "reading"):
        text, goal = name, word
    metric = metric_of(text)
    direction = {"less": "min", "more": "max"}.get(metric.better or "") if goal is None else goal
    if direction not in ("min", "max"):
        wanted = f"expected {text}:min or {text}:max"
        raise ConfigError(f"metric {text}: neither less nor more is better as such; {wanted}")
    return metric, cast("Goal", direction)


def tune(
    scenario: str | Path,
    metric: str,
    *,
    budget: int = 500,
    seeds: int | Iterable[int] = 20,
    param: Iterable[str] = (),
    set: Mapping[str, Any] | None = None,
    held_out: int | Iterable[int] = 50,
    pseudo_reality: bool = False,
    candidates: int = CANDIDATES,
    jobs: int = 1,
    timeout: float = STEP_TIMEOUT,
    out: str | Path | None = None,
    runner: Runner | None = None,
    on_note: Callable[[str], object] = str,
    on_look: OnLook | None = None,
    on_step: Callable[[str], object] = str,
    on_progress: OnProgress | None = None,
) -> Tuning:
    """Search the parameter values with the best mean of a metric over the seeds.

    - `scenario`: the name of a scenario, or the path of its file (.yaml).
    - `metric`: a name as in `--metrics`, with `:min` or `:max` where the metric itself does not say
      which direction is better.
    - `budget`: the most runs that all races together make. Held-out runs are not counted.
    - `seeds`: the seeds of the races; a number n means 0 to n - 1.
    - `param`: the keys to search, as in `--param`: "spacing=0.5..0.9", "groups.tb3.count=5..9",
      "law=settling,paper". By default all parameters of the scenario's patterns.
    - `set`: overrides of the scenario for all runs, by dotted key: `{"groups.tb3.count": 5}`.
    - `held_out`: the held-out seeds, or their number; they then follow the greatest of `seeds`.
    - `pseudo_reality`: the held-out runs are repeated with the scenario's `pseudo_reality` on, so
      that `drops` of the result says how much worse the metric is there.
    - `candidates`: the most new candidates of a race.
    - `jobs`: worker processes. `timeout`: s without progress after which a run fails. The result
      does not depend on `jobs`.
    - `out`: the folder of the tuning. A repeated call with this folder and equal arguments
      continues an interrupted tuning. Without `out` the results lie in a temporary folder, which is
      deleted with the returned object or on an error.
    - `runner`: does the runs in place of `jobs` worker processes.
    - `on_note`: called with a line for each parameter that is not tuned.
    - `on_look`: called after each block of seeds of a race, with the state of the tuning.
    - `on_step`: called with a line before each race and each set of held-out runs.
    - `on_progress`: called after each run with the progress inside a block of seeds or a set of
      held-out runs; with worker processes also during runs.

    ConfigError before anything runs if an argument is invalid. SwarmError if all runs of a race
    failed. PluginError without optuna.
    """
    if find_spec("optuna") is None:
        raise PluginError("tuning needs optuna, not installed; run: pip install 'swarmd[sim,tune]'")
    if jobs < 1 or candidates < 2:
        raise ConfigError(f"jobs is {jobs} and candidates {candidates}; expected 1 and 2, or more")
    parsed_metric, goal = split_metric(metric)
    race_seeds = check_seeds(range(int(seeds)) if isinstance(seeds, Integral) else seeds)  # type: ignore[arg-type]
    held_out_seeds = _held_out(held_out, race_seeds)
    if not 2 * len(race_seeds) <= budget <= MAX_RUNS:
        raise ConfigError(
            f"budget is {budget} runs; expected {2 * len(race_seeds)} (two candidates with"
            f" {len(race_seeds)} seeds) to {MAX_RUNS}"
        )
    loaded = load_scenario(str(scenario), set)
    loaded.starts(race_seeds[0])  # ConfigError if there is no room for the robots
    in_workers = partial(run_jobs, processes=jobs, timeout=timeout)
    folder = Path(tempfile.mkdtemp(prefix="swarmd-tune-")) if out is None else Path(out)
    try:
        tuner = _Tuner(
            scenario=str(scenario),
            sets=dict(set or {}),
            loaded=loaded,
            space=parameter_space(loaded, param, on_note),
            metric=parsed_metric,
            goal=goal,
            seeds=race_seeds,
            budget=budget,
            per_race=candidates,
            folder=folder,
            runner=runner or (in_workers if jobs > 1 else run_here),
            on_look=on_look or (lambda look: None),
            on_step=on_step,
            on_progress=on_progress,
        )
        tuning = tuner.search()
        tuner.assess(tuning, held_out_seeds, pseudo_reality=pseudo_reality)
    except BaseException:
        if out is None:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    if out is None:
        weakref.finalize(tuning, shutil.rmtree, folder, ignore_errors=True)
    return tuning


def _held_out(given: int | Iterable[int], race_seeds: Sequence[int]) -> tuple[int, ...]:
    """The held-out seeds: `given`, or if it is a number, as many seeds above all `race_seeds`.

    ConfigError if a seed is both held out and a seed of the races.
    """
    if isinstance(given, Integral):
        first, count = max(race_seeds) + 1, int(given)
        return check_seeds(range(first, first + count)) if count else ()
    held_out = check_seeds(cast("Iterable[int]", given))
    if common := sorted({*held_out} & {*race_seeds}):
        raise ConfigError(f"seed {common[0]} is both held out and raced; keep one of them")
    return held_out


@dataclass(slots=True, kw_only=True)
class _Tuner:
    """One tuning: its arguments, and the candidates and races so far."""

    scenario: str
    sets: dict[str, Any]
    loaded: Scenario
    space: ParameterSpace
    metric: Metric
    goal: Goal
    seeds: tuple[int, ...]
    budget: int
    per_race: int
    folder: Path
    runner: Runner
    on_look: OnLook
    on_step: Callable[[str], object]
    on_progress: OnProgress | None
    candidates: list[Candidate] = field(default_factory=list)
    races: list[list[int]] = field(default_factory=list)
    """By race the numbers of its candidates; the first is the best candidate of the race before."""

    def search(self) -> Tuning:
        """Race candidates until the budget of runs is used; returns the best and all candidates.

        The best candidate of a race also takes part in the next race, without new runs. Races that
        the folder has recorded are not run again: an interrupted tuning continues.
        """
        study = _study()
        recorded_races = self._open()
        present = Candidate(0, self.space.present or {}, {}, plain(self.loaded.effective))
        self.candidates.append(present)
        best = present
        while True:
            index = len(self.races)
            is_first = index == 0
            recorded = recorded_races[index] if index < len(recorded_races) else None
            # Drawn for a recorded race, too: the sampler continues as without interruption.
            drawn = self._draw(study, self._drawn_count(index, recorded))
            # In race 0 the values of the scenario are new, too.
            new = [present, *drawn] if is_first else drawn
            earlier_best = [] if is_first else [best]
            if not new:
                break  # the budget is used, or the sampler draws no further values

            racing = [*earlier_best, *new]
            self.races.append([candidate.number for candidate in racing])
            if recorded is None:
                self._race(new, earlier_best, index)
            else:
                self._recall(new, recorded)

            for candidate in new:
                _tell(study, candidate, racing, self.space)
            finishers = (candidate for candidate in racing if not candidate.is_out)
            best = min(finishers, key=lambda candidate: mean_loss(candidate.losses))
            if recorded is None:
                self._record()
            if not drawn:
                break  # race 0 had the values of the scenario alone
        return Tuning(
            folder=self.folder,
            metric=self.metric,
            goal=self.goal,
            space=self.space,
            seeds=self.seeds,
            held_out=(),
            runs=self._runs,
            best=best,
            candidates=self._ranked(),
            importance=_importance(study),
        )

    def _drawn_count(self, index: int, recorded: Sequence[object] | None) -> int:
        """The number of candidates to draw for race `index`, from 0 on.

        `recorded`: the candidates of this race in an interrupted tuning, as many as are drawn
        again; None: the race is new, and gets `per_race` candidates, or fewer if the budget does
        not allow as many.
        """
        affordable = (self.budget - self._runs) // len(self.seeds)
        count = min(self.per_race, affordable) if recorded is None else len(recorded)
        # In race 0, candidate 0 (the values of the scenario) is one of them, and is not drawn.
        return max(count - 1 if index == 0 else count, 0)

    def assess(self, tuning: Tuning, held_out: tuple[int, ...], *, pseudo_reality: bool) -> None:
        """Compare the best candidate with the scenario's values on held-out seeds.

        `held_out`: seeds that no race has used; empty: nothing is compared. `pseudo_reality`: the
        held-out runs are repeated in pseudo-reality. Sets the fields `held_out`, `gain`, `drops`
        and `document` of the tuning, and writes the result files.
        """
        tuning.held_out = held_out
        present = self.candidates[0]  # the values of the scenario
        has_better_values = tuning.best is not present
        if held_out:
            variants = {PRESENT: present.effective}
            if has_better_values:
                variants[TUNED] = tuning.best.effective
            nominal = self._run_held_out(HELD_OUT, held_out, variants)
            if has_better_values:
                tuning.gain = self._difference((nominal, PRESENT), (nominal, TUNED))
            if pseudo_reality:
                # A scenario may give its own bounds of pseudo-reality; True: the default bounds.
                varied = {
                    name: {**effective, "pseudo_reality": effective.get("pseudo_reality") or True}
                    for name, effective in variants.items()
                }
                pseudo = self._run_held_out(f"{HELD_OUT}_pseudo_reality", held_out, varied)
                tuning.drops = {
                    name: self._difference((nominal, name), (pseudo, name)) for name in variants
                }
        tuning.document = tuned_document(tuning, self.scenario, self.sets, self.manifest())
        write_whole(self.folder / RESULT, tuning.document)

    def manifest(self, candidates: Sequence[Candidate] = ()) -> Manifest:
        """The manifest of the runs of these candidates, by default of the scenario's values."""
        named = {str(candidate.number): candidate.effective for candidate in candidates}
        named = named or {"0": plain(self.loaded.effective)}
        return self._manifest(named, self.seeds, traces=False)

    def _race(
        self, new: Sequence[Candidate], earlier_best: Sequence[Candidate], number: int
    ) -> None:
        """Run the new candidates of a race in blocks of seeds, and set their losses.

        After each block except the last, a rank test ends the new candidates that are significantly
        worse than the leader (`is_out`). SwarmError if no run of the first block has a value.

        `earlier_best`: the best candidate of the race before; empty in race 0. All losses of this
        candidate are known, so it takes part in the tests, but neither runs nor ends. `number`: of
        the race, from 0 on.
        """
        racing = [*earlier_best, *new]
        self.on_step(f"race {number + 1}, {len(new)} new candidates over {len(self.seeds)} seeds")
        manifest = self.manifest(new)
        comparison_counts = looks(len(self.seeds))
        for count in (*comparison_counts, len(self.seeds)):
            alive = [candidate for candidate in new if not candidate.is_out]
            if not alive:
                break
            self._run_block(manifest, alive, number, count)
            if not any(math.isfinite(loss) for candidate in racing for loss in candidate.losses):
                raise SwarmError(self._why_all_failed(number))
            if count < len(self.seeds):  # after all seeds no run is left to save
                # Bonferroni: the level is divided by the number of comparisons.
                level = ALPHA / len(comparison_counts)
                _end_losers(alive, earlier_best, count, level)
            self._report(number, sum(not candidate.is_out for candidate in new))

    def _run_block(
        self, manifest: Manifest, alive: Sequence[Candidate], number: int, count: int
    ) -> None:
        """Run the candidates `alive` over the first `count` seeds, and set their losses.

        `number`: of the race, from 0 on. Runs that the race's folder has already are not repeated.
        """
        race_folder = self.folder / RACES / f"{number + 1:02d}"
        seeds = {*self.seeds[:count]}
        by_variant = {_variant(str(candidate.number)): candidate for candidate in alive}
        runs_of_block = {
            run.id
            for run in manifest.plan.runs
            if run.seed in seeds and run.variant.name in by_variant
        }
        results = run_experiment(
            manifest,
            race_folder,
            self.runner,
            only=runs_of_block,
            on_progress=self.on_progress,
            summarized=[self.metric],
        )
        for name, candidate in by_variant.items():
            values = results.metric(self.metric, name).tolist()
            value_by_seed = dict(zip(results.seeds(name), values, strict=True))
            candidate.losses = [
                self._loss(value_by_seed.get(seed), candidate) for seed in self.seeds[:count]
            ]

    def _loss(self, value: float | None, candidate: Candidate) -> float:
        """The loss of a run, from the value of its metric; the least loss is the best.

        `value`: None if the run failed, NaN if the metric has no value. The loss is inf in both
        cases, except that the time to an event that never happened (NaN) counts as the duration of
        the run.
        """
        if value is None:
            return math.inf
        if math.isnan(value):
            if not self.metric.is_time_to_event:
                return math.inf
            value = float(candidate.effective["duration"])
        return value if self.goal == "min" else -value

    def _why_all_failed(self, number: int) -> str:
        """The reason of the first failed run of a race whose runs have no finite loss."""
        from swarmd.sim.experiments.results import load_results

        results = load_results(self.folder / RACES / f"{number + 1:02d}")
        for run, reason in results.failures.items():
            return f"all runs of race {number + 1} failed; the first, {run}: {reason}"
        return f"no run of race {number + 1} has a value of {self.metric.name}"

    def _run_held_out(
        self, name: str, seeds: tuple[int, ...], variants: Mapping[str, Mapping[str, Any]]
    ) -> Results:
        """Run these variants over held-out seeds, with traces, in the folder `name`."""
        place = " in pseudo-reality" if name != HELD_OUT else ""
        self.on_step(f"{len(seeds)} held-out seeds of {' and '.join(variants)} values{place}")
        return run_experiment(
            self._manifest(variants, seeds, traces=True),
            self.folder / name,
            self.runner,
            on_progress=self.on_progress,
            summarized=[self.metric],
        )

    def _difference(self, a: tuple[Results, str], b: tuple[Results, str]) -> Difference:
        """The difference in the metric between two variants, each as (results, name)."""
        first, second = (
            Side(f"{results.folder}:{_variant(name)}", results, _variant(name))
            for results, name in (a, b)
        )
        return compare_sides(first, second, [self.metric])[0]

    def _manifest(
        self, variants: Mapping[str, Mapping[str, Any]], seeds: Sequence[int], *, traces: bool
    ) -> Manifest:
        plan = Plan(
            self.scenario,
            tuple(seeds),
            tuple(
                Variant(_variant(name), {"candidate": name}, effective)
                for name, effective in variants.items()
            ),
            self.sets,
            {"candidate": [*variants]},
        )
        own = beyond_catalog([self.metric])
        return manifest_of(plan, traces=traces, command=[], metrics=own)

    def _draw(self, study: Study, count: int) -> list[Candidate]:
        """Draw `count` new candidates that the scenario accepts; also adds them to `candidates`.

        A candidate is refused if its values are invalid or equal those of an earlier candidate.
        After _MAX_DRAWS refusals in a row, no more candidates are drawn. ConfigError if the whole
        tuning has no accepted candidate.
        """
        is_first_race = len(self.candidates) == 1  # candidate 0 alone
        accepted: list[Candidate] = []
        refusals = 0  # in a row
        last_refusal = ""
        while len(accepted) < count and refusals < _MAX_DRAWS:
            trial = study.ask()
            try:
                candidate = self._candidate(trial)
            except ConfigError as error:
                refusals += 1
                last_refusal = str(error)
                _refuse(study, trial)
                continue
            refusals = 0
            self.candidates.append(candidate)
            accepted.append(candidate)
        if count and not accepted and is_first_race:
            text = f"no values of {', '.join(self.space.text)} are accepted"
            raise ConfigError(f"{text}; the last: {last_refusal}")
        return accepted

    def _candidate(self, trial: Trial) -> Candidate:
        """The candidate of a trial; ConfigError if its values are refused."""
        values = self.space.draw(trial)
        for candidate in self.candidates:
            if candidate.values == values:
                raise ConfigError(f"they are those of candidate {candidate.number}")
        overrides = self.space.overrides(values)
        scenario = load_scenario(self.scenario, {**self.sets, **overrides}, source=SOURCE)
        scenario.starts(self.seeds[0])  # ConfigError if there is no room for the robots
        effective = plain(scenario.effective)
        return Candidate(len(self.candidates), values, overrides, effective, trial=trial)

    @property
    def _runs(self) -> int:
        return sum(len(candidate.losses) for candidate in self.candidates)

    def _ranked(self) -> tuple[Candidate, ...]:
        """The candidates with runs, best first; those that ended early come last."""
        tried = [candidate for candidate in self.candidates if candidate.losses]
        return tuple(
            sorted(tried, key=lambda c: (c.is_out, -len(c.losses), mean_loss(c.losses), c.number))
        )

    def _report(self, number: int, alive: int) -> None:
        self.on_look(Look(number + 1, self._runs, self.budget, alive, self._ranked(),
                          self.metric.name, self.goal))  # fmt: skip

    # The folder

    def _open(self) -> list[list[dict[str, Any]]]:
        """Make or open the folder of the tuning; returns the candidates of each finished race.

        A new folder has no finished race. ConfigError if the folder is damaged, belongs to another
        tuning, or has files that are not of a tuning.
        """
        path = self.folder / STATE
        head = self._head()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if not path.exists():
                if entries := sorted(entry.name for entry in self.folder.iterdir()):
                    raise ConfigError(
                        f"{self.folder}: is not the folder of a tuning: it holds {entries[0]};"
                        " name a new or empty one with --out"
                    )
                write_json(path, {**head, "races": []})
                return []
            contents = read_regular(path)
        except OSError as error:
            raise ConfigError(f"{error.filename or self.folder}: {error.strerror}") from error
        return self._recorded_races(path, contents, head)

    def _recorded_races(
        self, path: Path, contents: bytes, head: Mapping[str, Any]
    ) -> list[list[dict[str, Any]]]:
        """The races in the `contents` of tune.json; ConfigError unless `head` is that of the file.

        The head holds the arguments of the tuning (`asked`) and its software (`manifest`).
        """
        try:
            data = json.loads(contents)
            recorded_manifest = msgspec.convert(data["manifest"], Manifest)
            recorded_arguments, races = dict(data["asked"]), list(data["races"])
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise ConfigError(f"{path}: damaged; remove the folder, and tune again") from error
        manifest = msgspec.convert(head["manifest"], Manifest)
        # The first difference of software, else of arguments.
        difference = next(manifests.differences(recorded_manifest, manifest), None)
        for key, value in head["asked"].items():
            recorded = recorded_arguments.get(key)
            if difference is None and recorded != value:
                difference = f"{key} was {recorded}, now {value}"
        if difference is not None:
            text = f"{self.folder}: holds another tuning: {difference}"
            raise ConfigError(f"{text}; name another folder with --out, or remove this one")
        return races

    def _head(self) -> dict[str, Any]:
        """The arguments and the software of the tuning, which an interrupted tuning must share."""
        from optuna import __version__

        asked = {
            "format": _FORMAT,
            "metric": self.metric.origin or self.metric.name,
            "goal": self.goal,
            "budget": self.budget,
            "candidates": self.per_race,
            "parameters": self.space.text,
            "optuna": __version__,
        }
        return {"asked": asked, "manifest": msgspec.to_builtins(self.manifest())}

    def _record(self) -> None:
        """Write the candidates and losses of all races so far to tune.json."""
        races = []
        for index, numbers in enumerate(self.races):
            new = [self.candidates[n] for n in numbers if n != numbers[0] or index == 0]
            races.append([
                {"candidate": candidate.number, "values": candidate.values,
                 "is_out": candidate.is_out,
                 "losses": [None if math.isinf(x) else x for x in candidate.losses]}
                for candidate in new
            ])  # fmt: skip
        write_json(self.folder / STATE, {**self._head(), "races": races})

    def _recall(self, new: Sequence[Candidate], known: Sequence[Mapping[str, Any]]) -> None:
        """Set the losses of the new candidates of a race from the recorded race, without runs."""
        drawn = [(candidate.number, plain(candidate.values)) for candidate in new]
        if drawn != [(row["candidate"], row["values"]) for row in known]:
            path = self.folder / STATE
            raise ConfigError(f"{path}: the sampler draws other candidates; tune in a new folder")
        for candidate, row in zip(new, known, strict=True):
            candidate.is_out = bool(row["is_out"])
            candidate.losses = [math.inf if x is None else float(x) for x in row["losses"]]


def _end_losers(
    alive: Sequence[Candidate], earlier_best: Sequence[Candidate], count: int, level: float
) -> None:
    """Set `is_out` of those of the candidates `alive` that lose the rank test after `count` seeds.

    `earlier_best`: the best candidate of the race before, which takes part in the test but does not
    end; empty in race 0. `level`: of significance.
    """
    compared = [*alive, *earlier_best]
    table = np.array([candidate.losses[:count] for candidate in compared]).T
    for column in losers(table, level):
        if column < len(alive):
            alive[column].is_out = True


def _variant(name: str) -> str:
    return f"candidate={name}"


def _study() -> Study:
    import warnings

    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        sampler = optuna.samplers.TPESampler(
            seed=_SAMPLER_SEED, multivariate=True, group=True, constant_liar=True
        )
    return optuna.create_study(sampler=sampler)


def _refuse(study: Study, trial: Trial) -> None:
    """Tell the sampler that the scenario refuses the values of a trial, as bad values."""
    from optuna.trial import TrialState

    study.tell(trial, state=TrialState.PRUNED)


def _tell(
    study: Study, candidate: Candidate, racing: Sequence[Candidate], space: ParameterSpace
) -> None:
    """Set a candidate's `estimate`, its mean loss over all seeds, and tell it to the sampler.

    `racing`: all candidates of the race. If the candidate ended early, the estimate is extrapolated
    (see `Tuning.value`) from the losses of the race's leader: the candidate with the least mean
    loss of those that have run all seeds.
    """
    finite = [loss for racer in racing for loss in racer.losses if math.isfinite(loss)]
    worst = max(finite)
    finishers = (racer for racer in racing if not racer.is_out)
    leader = min(finishers, key=lambda racer: mean_loss(racer.losses))
    losses = np.minimum(candidate.losses, worst)  # inf, a failed run, counts as the worst run
    leader_losses = np.minimum(leader.losses, worst)
    difference = (losses - leader_losses[: len(losses)]).mean()
    candidate.estimate = float(leader_losses.mean() + difference)
    if candidate.trial is not None:
        study.tell(candidate.trial, candidate.estimate)
    elif (known := space.known_trial(candidate.values, candidate.estimate)) is not None:
        study.add_trial(known)


def _importance(study: Study) -> dict[str, float]:
    """The importance of each parameter as a share of 1, by PED-ANOVA (Watanabe et al., IJCAI 2023).

    PED-ANOVA measures how much narrower the values of a parameter are in the best tenth of the
    candidates. A parameter is left out unless all candidates have it. Empty if there are fewer than
    _MIN_TRIALS candidates, or if all losses are equal.
    """
    from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances
    from optuna.trial import TrialState

    complete = study.get_trials(deepcopy=False, states=[TrialState.COMPLETE])
    if len(complete) < _MIN_TRIALS:
        return {}
    common = [key for key in complete[0].params if all(key in t.params for t in complete)]
    if not common:
        return {}
    if len({trial.value for trial in complete}) < 2:
        return {}
    evaluator = PedAnovaImportanceEvaluator()
    return dict(get_param_importances(study, evaluator=evaluator, params=common))
