"""Tuning: the values of a scenario's parameters with the best mean of a metric.

::

    from swarmd.sim.experiments.tune import tune

    tuning = tune("aggregation", "gather_time:min", budget=200, param=["spacing=0.6..0.9"])
    print(tuning)

`swarmctl exp tune` calls this function. A tuning has these phases:

1. Batch 0 runs the values of the scenario over all seeds.
2. The sampler draws a batch of candidates from the results of all earlier batches.
3. The candidates of a batch run over the same seeds. At each look, which is an interim analysis
   after a number of seeds, a candidate ends early if it is significantly worse than the best
   candidate of the earlier batches. Batches repeat until the budget is used.
4. Held-out seeds, which no batch has used, compare the best candidate with the values of the
   scenario.

Sampler: optuna's tree-structured Parzen estimator (J. Bergstra et al., "Algorithms for
hyper-parameter optimization", NIPS 2011; multivariate: S. Falkner et al., "BOHB", ICML 2018), with
a seed for each batch. Test: optuna's WilcoxonPruner, Wilcoxon's one-sided signed-rank test of the
losses with equal seeds. Both know results of earlier batches alone. So the result depends neither
on the order in which runs end nor on the number of processes, and a repeated call brings optuna to
the same state again from the stored runs.

Optuna gets the loss of a run minus that of the scenario's values with the same seed: the common
effect of a seed cancels, and means over different numbers of seeds can be compared.
"""

from __future__ import annotations

import math
import shutil
import tempfile
import warnings
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import msgspec
import numpy as np

from swarmd.core.errors import ConfigError, PluginError, SwarmError
from swarmd.core.files import read_regular
from swarmd.core.numbers import python_value
from swarmd.core.values import Array
from swarmd.sim.experiments.compare import Difference, Side
from swarmd.sim.experiments.compare import compare as compare_sides
from swarmd.sim.experiments.known_runs import known_runs
from swarmd.sim.experiments.manifest import Manifest, manifest_of, plain, write_json, write_whole
from swarmd.sim.experiments.plan import MAX_RUNS, Plan, Variant, check_seeds
from swarmd.sim.experiments.pool import STEP_TIMEOUT, has_workers
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.search_space import SOURCE, ParameterSpace, parameter_space
from swarmd.sim.experiments.simulate import OnProgress, Runner, run_experiment, runner_of
from swarmd.sim.experiments.statistics import number as number_text
from swarmd.sim.experiments.tuned_values import tuned_document
from swarmd.sim.metrics.catalog import Metric, beyond_catalog, metric_of
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import load_scenario

if TYPE_CHECKING:
    from optuna import Study
    from optuna.samplers import BaseSampler
    from optuna.trial import Trial

Goal = Literal["min", "max"]
STATE = "tune.json"
BATCHES = "batches"
HELD_OUT = "held_out"
RESULT = "tuned.yaml"
PRESENT = "present"
TUNED = "tuned"
"""Names of the two variants on held-out seeds: the scenario's values, and the best candidate's."""
CANDIDATES = 8
ALPHA = 0.05
"""The level of the test of a candidate, divided by the number of its looks (Bonferroni)."""
FIRST_LOOK = 6
"""Seeds. With six pairs of one sign p is 1/64, below the level of each of up to three looks."""
_FORMAT = 2
_SAMPLER_SEED = 2010  # plus the number of a batch
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
    trial: Trial
    """The trial of optuna."""
    losses: list[float] = field(default_factory=list)
    """A loss for each seed run so far, in the order of the seeds; the least loss is the best.

    inf: the run failed, or its metric has no value."""
    is_out: bool = False
    """A look has ended the candidate early."""
    differences: list[float] = field(default_factory=list)
    """By seed: the loss minus that of candidate 0; a failed run counts as the worst run so far."""
    estimate: float = math.nan
    """The mean loss over all seeds: that of candidate 0 plus the mean of `differences`."""


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
    """Candidate number 0 if no candidate has a better mean over the seeds of the search."""
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
        """The mean of the metric over the seeds of the search.

        A failed run counts as the worst run so far. The mean of a candidate that ended early is
        extrapolated: it is the mean of candidate 0 over all seeds, plus the candidate's mean
        difference from candidate 0 over the seeds that the candidate has run.
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


def split_metric(text: str) -> tuple[Metric, Goal]:
    """The metric and the direction ("min" or "max") that a text `M`, `M:min` or `M:max` names.

    ConfigError if neither the text nor the metric itself has a direction.
    """
    name, _, goal = text.rpartition(":")
    if goal in ("min", "max") and name not in ("", "report", "reading"):
        return metric_of(name), cast("Goal", goal)
    metric = metric_of(text)
    if metric.better is None:
        wanted = f"expected {text}:min or {text}:max"
        raise ConfigError(f"metric {text}: neither less nor more is better as such; {wanted}")
    return metric, "min" if metric.better == "less" else "max"


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
    fresh: bool = False,
    on_note: Callable[[str], object] = str,
    on_step: Callable[[str], object] = str,
    on_progress: OnProgress | None = None,
) -> Tuning:
    """Search the parameter values with the best mean of a metric over the seeds.

    - `scenario`: the name of a scenario, or the path of its file (.yaml).
    - `metric`: a name as in `--metrics`, with `:min` or `:max` where the metric itself does not say
      which direction is better.
    - `budget`: the most runs that all batches together make. Held-out runs are not counted.
    - `seeds`: the seeds of the search; a number n means 0 to n - 1.
    - `param`: the keys to search, as in `--param`: "spacing=0.5..0.9", "groups.tb3.count=5..9",
      "law=settling,paper". By default all parameters of the scenario's patterns.
    - `set`: overrides of the scenario for all runs, by dotted key: `{"groups.tb3.count": 5}`.
    - `held_out`: the held-out seeds, or their number; they then follow the greatest of `seeds`.
    - `pseudo_reality`: the held-out runs are repeated with the scenario's `pseudo_reality` on, so
      that `drops` of the result says how much worse the metric is there.
    - `candidates`: the most candidates of a batch.
    - `jobs`: worker processes. `timeout`: s without progress after which a run fails. The result
      does not depend on `jobs`.
    - `out`: the folder of the tuning. A repeated call with this folder and equal arguments
      continues an interrupted tuning. Without `out` the results lie in a temporary folder, which is
      deleted with the returned object or on an error.
    - `runner`: does the runs in place of `jobs` worker processes, and without the store of runs.
    - `fresh`: all runs are done, also those that the store of runs has, and none is kept there.
    - `on_note`: called with a line for each parameter that is not tuned.
    - `on_step`: called with a line after each batch and before each set of held-out runs.
    - `on_progress`: called after each run with the progress inside a block of seeds or a set of
      held-out runs; with worker processes also during runs.

    ConfigError before anything runs if an argument is invalid. SwarmError if no run of the
    scenario's values has a value of the metric. PluginError without optuna.
    """
    if find_spec("optuna") is None:
        raise PluginError("tuning needs optuna, not installed; run: pip install 'swarmd[sim,tune]'")
    if min(jobs, candidates) < 1:
        raise ConfigError(f"jobs is {jobs} and candidates {candidates}; expected 1 or more")
    parsed_metric, goal = split_metric(metric)
    search_seeds = check_seeds(range(int(seeds)) if isinstance(seeds, Integral) else seeds)  # type: ignore[arg-type]
    held_out_seeds = _held_out(held_out, search_seeds)
    if not 2 * len(search_seeds) <= budget <= MAX_RUNS:
        raise ConfigError(
            f"budget is {budget} runs; expected {2 * len(search_seeds)} (two candidates with"
            f" {len(search_seeds)} seeds) to {MAX_RUNS}"
        )
    loaded = load_scenario(str(scenario), set)
    loaded.starts(search_seeds[0])  # ConfigError if there is no room for the robots
    folder = Path(tempfile.mkdtemp(prefix="swarmd-tune-")) if out is None else Path(out)
    try:
        tuner = _Tuner(
            scenario=str(scenario),
            sets=python_value(set or {}),
            loaded=loaded,
            space=parameter_space(loaded, param, on_note),
            metric=parsed_metric,
            goal=goal,
            seeds=search_seeds,
            budget=budget,
            per_batch=candidates,
            folder=folder,
            runner=runner or _workers(jobs, timeout, is_fresh=fresh),
            on_step=on_step,
            on_progress=on_progress,
        )
        with quiet_optuna():
            tuning = tuner.search()
        tuner.assess(tuning, held_out_seeds, pseudo_reality=pseudo_reality)
    except BaseException:
        if out is None:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    if out is None:
        weakref.finalize(tuning, shutil.rmtree, folder, ignore_errors=True)
    return tuning


def _workers(jobs: int, timeout: float, *, is_fresh: bool) -> Runner:
    """Worker processes, for runs that the store does not have; this process without workers."""
    runner = runner_of(jobs, timeout)
    known = known_runs(is_fresh=is_fresh or not has_workers())
    return runner if known is None else known.runner(runner)


def _held_out(given: int | Iterable[int], search_seeds: Sequence[int]) -> tuple[int, ...]:
    """The held-out seeds: `given`, or if it is a number, as many seeds above all `search_seeds`.

    ConfigError if a seed is both held out and a seed of the search.
    """
    if isinstance(given, Integral):
        first = max(search_seeds) + 1
        count = int(given)
        return check_seeds(range(first, first + count)) if count else ()
    held_out = check_seeds(cast("Iterable[int]", given))
    if common := sorted({*held_out} & {*search_seeds}):
        raise ConfigError(f"seed {common[0]} is both held out and searched; keep one of them")
    return held_out


class _State(msgspec.Struct, forbid_unknown_fields=True):
    """The contents of tune.json."""

    asked: dict[str, str | int | list[str]]  # the arguments, which an interrupted tuning must share
    batches: int = 0  # that are over


@dataclass(slots=True, kw_only=True)
class _Tuner:
    """One tuning: its arguments, and the candidates so far."""

    scenario: str
    sets: dict[str, Any]
    loaded: Scenario
    space: ParameterSpace
    metric: Metric
    goal: Goal
    seeds: tuple[int, ...]
    budget: int
    per_batch: int
    folder: Path
    runner: Runner
    on_step: Callable[[str], object]
    on_progress: OnProgress | None
    candidates: list[Candidate] = field(default_factory=list)
    baseline: Array = field(default_factory=lambda: np.zeros(0))
    """The losses of candidate 0 by seed; a failed run counts as its worst run."""

    def search(self) -> Tuning:
        """Run batches until the budget of runs is used; returns the best and all candidates.

        Runs that the folder has already are not repeated: an interrupted tuning continues.
        """
        state = self._open()
        study = make_study(len(self.seeds))
        values = self.space.present or {}
        if values:
            study.enqueue_trial(self.space.numbers(values))
        # Outside of the search space: a trial without parameters, for the test alone.
        trial = study.ask(self.space.distributions if values else None)
        batch = [Candidate(0, values, {}, plain(self.loaded.effective), trial)]
        self.candidates += batch
        first = self._draw(study, 1)  # ConfigError before anything runs
        number = 0
        while batch:  # until the budget is used, or the sampler draws no further values
            self._run_batch(batch, number, is_over=number < state.batches)
            for candidate in batch:
                study.tell(candidate.trial, candidate.estimate)
            number += 1
            state.batches = max(number, state.batches)
            write_json(self.folder / STATE, msgspec.to_builtins(state))
            batch = first if number == 1 else self._draw(study, number)
        ranked = self._ranked()
        return Tuning(
            folder=self.folder,
            metric=self.metric,
            goal=self.goal,
            space=self.space,
            seeds=self.seeds,
            held_out=(),
            runs=self._runs,
            best=ranked[0],
            candidates=ranked,
            importance=_importance(study),
        )

    def _draw(self, study: Study, number: int) -> list[Candidate]:
        """Draw the candidates of batch `number`, and add them to `candidates`.

        They are `per_batch`, or as many as the budget allows. A candidate is refused if its values
        are invalid or equal those of an earlier candidate. After _MAX_DRAWS refusals in a row, no
        more candidates are drawn. ConfigError if the whole tuning has no accepted candidate.
        """
        from optuna.trial import TrialState

        study.sampler = _sampler(number)
        planned = sum(len(one.losses) or len(self.seeds) for one in self.candidates)
        count = min(self.per_batch, (self.budget - planned) // len(self.seeds))
        batch: list[Candidate] = []
        refusals = 0  # in a row
        while len(batch) < count and refusals < _MAX_DRAWS:
            trial = study.ask(self.space.distributions)
            try:
                candidate = self._candidate(trial)
            except ConfigError as error:
                refusals += 1
                last_refusal = error
                study.tell(trial, state=TrialState.PRUNED)  # counts as bad values
                continue
            refusals = 0
            self.candidates.append(candidate)
            batch.append(candidate)
        if refusals and len(self.candidates) == 1:
            text = f"no values of {', '.join(self.space.text)} are accepted"
            raise ConfigError(f"{text}; the last: {last_refusal}")
        return batch

    def _candidate(self, trial: Trial) -> Candidate:
        """The candidate with the values of a trial; ConfigError if it is refused."""
        values = self.space.values(trial.params)
        for candidate in self.candidates:
            if candidate.values == values:
                raise ConfigError(f"they are those of candidate {candidate.number}")
        overrides = self.space.overrides(values)
        scenario = load_scenario(self.scenario, {**self.sets, **overrides}, source=SOURCE)
        scenario.starts(self.seeds[0])  # ConfigError if there is no room for the robots
        effective = plain(scenario.effective)
        return Candidate(len(self.candidates), values, overrides, effective, trial)

    def _run_batch(self, batch: Sequence[Candidate], number: int, *, is_over: bool) -> None:
        """Run the candidates of batch `number` in blocks of seeds, and set their losses.

        After each block except the last, a test ends candidates (`is_out`). `is_over`: the batch
        was over in an interrupted tuning, so that its failed runs are not repeated either.
        SwarmError if no run of batch 0 has a value.
        """
        variants = {
            one.number: _variant(str(one.number), one.effective, one.overrides) for one in batch
        }
        manifest = self._manifest([*variants.values()], self.seeds, traces=False)
        begin = 0
        for end in (*(looks(len(self.seeds)) if number else ()), len(self.seeds)):
            block = self.seeds[begin:end]
            alive = [candidate for candidate in batch if not candidate.is_out]
            names = {variants[candidate.number].name for candidate in alive}
            results = run_experiment(
                manifest,
                self.folder / BATCHES / f"{number:02d}",
                self.runner,
                only={
                    run.id
                    for run in manifest.plan.runs
                    if not is_over and run.seed in block and run.variant.name in names
                },
                on_progress=self.on_progress,
                summarized=[self.metric],
            )
            for candidate in alive:
                name = variants[candidate.number].name
                values = results.metric(self.metric, name).tolist()
                value_by_seed = dict(zip(results.seeds(name), values, strict=True))
                candidate.losses += [self._loss(value_by_seed.get(s), candidate) for s in block]
            self._compare(alive, begin, results)
            begin = end
        best = self._ranked()[0]
        values = " ".join(f"{name}={value}" for name, value in best.values.items())
        mean = number_text(best.estimate if self.goal == "min" else -best.estimate)
        self.on_step(
            f"{self._runs} of {self.budget} runs, batch {number}: {len(alive)} of {len(batch)}"
            f" candidates ran with all seeds; best: {values or 'present values'},"
            f" {self.metric.name} {mean}"
        )

    def _compare(self, alive: Sequence[Candidate], begin: int, results: Results) -> None:
        """Set differences and estimates after a block of seeds, the first of them `begin`, and end
        the candidates that lose the test against the best candidate of earlier batches.

        SwarmError if no run so far has a value; `results` has the reason.
        """
        losses = [loss for candidate in self.candidates for loss in candidate.losses]
        worst = max(filter(math.isfinite, losses), default=None)
        if worst is None:
            failures = (f"the first, {run}: {why}" for run, why in results.failures.items())
            reason = next(failures, f"none has a value of {self.metric.name}")
            raise SwarmError(f"all runs of the scenario's values failed; {reason}")
        if not self.baseline.size:
            self.baseline = np.minimum(self.candidates[0].losses, worst)
        for candidate in alive:
            end = len(candidate.losses)
            differences = np.minimum(candidate.losses, worst)[begin:] - self.baseline[begin:end]
            candidate.differences += differences.tolist()
            candidate.estimate = float(self.baseline.mean() + np.mean(candidate.differences))
            for step in range(begin, end):
                candidate.trial.report(candidate.differences[step], step)
            candidate.is_out = end < len(self.seeds) and candidate.trial.should_prune()

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

    def assess(self, tuning: Tuning, held_out: tuple[int, ...], *, pseudo_reality: bool) -> None:
        """Compare the best candidate with the scenario's values on held-out seeds.

        `held_out`: seeds that no batch has used; empty: nothing is compared. `pseudo_reality`: the
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
        manifest = self._manifest([_variant("0", present.effective)], self.seeds, traces=False)
        tuning.document = tuned_document(tuning, self.scenario, self.sets, manifest)
        write_whole(self.folder / RESULT, tuning.document)

    def _run_held_out(
        self, name: str, seeds: tuple[int, ...], variants: Mapping[str, Mapping[str, Any]]
    ) -> Results:
        """Run these variants over held-out seeds, with traces, in the folder `name`."""
        place = " in pseudo-reality" if name != HELD_OUT else ""
        self.on_step(f"{len(seeds)} held-out seeds of {' and '.join(variants)} values{place}")
        named = [_variant(variant, effective) for variant, effective in variants.items()]
        return run_experiment(
            self._manifest(named, seeds, traces=True),
            self.folder / name,
            self.runner,
            on_progress=self.on_progress,
            summarized=[self.metric],
        )

    def _difference(self, a: tuple[Results, str], b: tuple[Results, str]) -> Difference:
        """The difference in the metric between two variants, each as (results, name)."""
        first, second = (
            Side(f"{results.folder}:{(variant := _variant(name, {}).name)}", results, variant)
            for results, name in (a, b)
        )
        return compare_sides(first, second, [self.metric])[0]

    def _manifest(
        self, variants: Sequence[Variant], seeds: tuple[int, ...], *, traces: bool
    ) -> Manifest:
        columns = {key: [one.values[key] for one in variants] for key in variants[0].values}
        plan = Plan(self.scenario, seeds, tuple(variants), self.sets, columns)
        own = beyond_catalog([self.metric])
        return manifest_of(plan, traces=traces, command=[], metrics=own)

    @property
    def _runs(self) -> int:
        return sum(len(candidate.losses) for candidate in self.candidates)

    def _ranked(self) -> tuple[Candidate, ...]:
        """The candidates with runs, best first; those that ended early come last."""
        return tuple(
            sorted(
                (one for one in self.candidates if one.losses),
                key=lambda one: (one.is_out, one.losses.count(math.inf), one.estimate, one.number),
            )
        )

    def _open(self) -> _State:
        """Make or open the folder of the tuning; returns its state.

        ConfigError if the folder is damaged, belongs to another tuning, or has files that are not
        of a tuning. That the software is the same is checked in the folder of each batch.
        """
        from optuna import __version__

        path = self.folder / STATE
        state = _State(
            {
                "format": _FORMAT,
                "metric": self.metric.origin or self.metric.name,
                "goal": self.goal,
                "budget": self.budget,
                "candidates": self.per_batch,
                "parameters": self.space.text,
                "optuna": __version__,
            }
        )
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if path.exists():
                recorded = msgspec.json.decode(read_regular(path), type=_State)
            elif entries := sorted(entry.name for entry in self.folder.iterdir()):
                raise ConfigError(
                    f"{self.folder}: is not the folder of a tuning: it holds {entries[0]};"
                    " name a new or empty one with --out"
                )
            else:
                recorded = state
        except OSError as error:
            raise ConfigError(f"{error.filename or self.folder}: {error.strerror}") from error
        except msgspec.DecodeError as error:
            raise ConfigError(f"{path}: damaged; remove the folder, and tune again") from error
        for key, value in state.asked.items():
            if (known := recorded.asked.get(key)) != value:
                raise ConfigError(
                    f"{self.folder}: holds another tuning: {key} was {known}, now {value}; name"
                    " another folder with --out, or remove this one"
                )
        write_json(path, msgspec.to_builtins(recorded))
        return recorded


def looks(seeds: int) -> tuple[int, ...]:
    """The numbers of seeds after which candidates are tested: 6, 12, 24 ..., below `seeds`."""
    counts = (FIRST_LOOK << doublings for doublings in range(seeds.bit_length()))
    return tuple(count for count in counts if count < seeds)


def _variant(name: str, effective: Mapping[str, Any], values: Mapping[str, Any] = {}) -> Variant:
    return Variant(f"candidate={name}", {"candidate": name, **values}, effective)


def make_study(seeds: int) -> Study:
    """A new study, whose pruner has the level of one look of a search with so many seeds."""
    import optuna

    level = ALPHA / max(len(looks(seeds)), 1)
    return optuna.create_study(pruner=optuna.pruners.WilcoxonPruner(p_threshold=level))


def _sampler(number: int) -> BaseSampler:
    """The sampler of batch `number`."""
    from optuna.samplers import TPESampler

    seed = _SAMPLER_SEED + number
    return TPESampler(seed=seed, multivariate=True, group=True, constant_liar=True)


@contextmanager
def quiet_optuna() -> Iterator[None]:
    """Without optuna's log and its warnings of experimental parts; afterwards all is as before."""
    import optuna

    verbosity = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with warnings.catch_warnings(action="ignore", category=optuna.exceptions.ExperimentalWarning):
        try:
            yield
        finally:
            optuna.logging.set_verbosity(verbosity)


def _importance(study: Study) -> dict[str, float]:
    """The importance of each parameter as a share of 1, by PED-ANOVA (Watanabe et al., IJCAI 2023).

    PED-ANOVA measures how much narrower the values of a parameter are in the best tenth of the
    candidates. Empty if there are fewer than _MIN_TRIALS candidates, or if all losses are equal.
    """
    from optuna import create_study
    from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances
    from optuna.trial import TrialState

    # Without candidate 0 if it is outside of the search space, and so has no parameters.
    complete = [trial for trial in study.get_trials(states=[TrialState.COMPLETE]) if trial.params]
    if len(complete) < _MIN_TRIALS or len({trial.value for trial in complete}) < 2:
        return {}
    rated = create_study()
    rated.add_trials(complete)
    return dict(get_param_importances(rated, evaluator=PedAnovaImportanceEvaluator()))
