"""Runs in the order of their seeds until a requirement on a mean is decided.

The test bets on each value that the mean is above the wanted value, and bets elsewhere that it is
below. If the mean is not above it, the expected capital of the first bet never rises, so that the
capital ever reaches 1 / alpha times its start with a probability of at most alpha (Ville 1939).
So a look after each run costs nothing, and the number of runs need not be fixed before.

The capital is the mean of constant bets (Waudby-Smith and Ramdas, "Estimating means of bounded
random variables by betting", J. R. Stat. Soc. B 86, 2024: the capital process, and its diversified
Kelly bets). For values that are 0 or 1 it is the beta-binomial mixture martingale (Robbins 1970;
Howard, Ramdas, McAuliffe and Sekhon, Ann. Statist. 49, 2021), here of a uniform mixture on one
side of the wanted value. Each side has the whole alpha: only one of both answers can be wrong.

Of 2,000 simulated experiments against `>= 0.9` with alpha 0.05, the median one took 10 runs with a
true share of 0.6, 20 with 0.7, 88 with 0.8 and 43 with 1.0. A true share of 0.9 stays open.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from itertools import chain
from pathlib import Path

import msgspec
import numpy as np

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.values import Array
from swarmd.sim.experiments.manifest import Manifest
from swarmd.sim.experiments.pool import Job, JobResult, Shares
from swarmd.sim.experiments.requirements import Verdict, parse_requirement
from swarmd.sim.experiments.results import Results, load_results
from swarmd.sim.experiments.simulate import OnProgress, Runner, run_experiment
from swarmd.sim.experiments.store import read_table, set_seeds, write_summary
from swarmd.sim.metrics.metric import Metric

BETS = 64
"""Constant bets on each side; 16 give the same numbers of runs to 2 %."""
_ROUNDING = 1e-9  # of a value at a bound, as a share of the range


def bet(capital: Array, values: Array, target: float) -> Array:
    """The capital of experiments after the next value of each.

    `capital` (experiments, 2, BETS): of bets that the mean is above the target, and below it; ones
    at the start. `values` (experiments,): 0 to 1. `target`: above 0 and below 1.
    """
    shares = (np.arange(BETS) + 0.5) / BETS  # of the highest bet, which the worst value ruins
    bets = np.stack((shares / target, -shares / (1.0 - target)))
    return np.asarray(capital * (1.0 + bets * (values[:, None, None] - target)))


def sides_won(capital: Array, alpha: float) -> Array:
    """1 for experiments whose mean is above the target, -1 below, 0 while it is open (n,)."""
    return np.asarray((capital.mean(axis=2) >= 1.0 / alpha) @ np.array([1.0, -1.0]))


class SequentialTest:
    """A requirement on the mean of a bounded metric, decided by runs in the order of their seeds.

    - `runs`: the number of values so far; those after the decision do not count.
    """

    def __init__(self, text: str, alpha: float, about: Callable[[str], Metric]) -> None:
        """`text`: such as `one_cluster_at_end >= 0.9`. `about`: finds the metric by its name.

        ConfigError for a requirement that no number of runs decides: a metric without known bounds,
        a time to an event, a statistic that is not the mean, `==`, or a value that is not within
        the bounds.
        """
        self.requirement = requirement = parse_requirement(text)
        self.metric = about(requirement.metric)
        if self.metric.bounds is None or self.metric.is_time_to_event:
            raise ConfigError(
                f"--until {text!r}: {self.metric.name} has no known range, or is a time to an"
                " event, so that no number of runs is enough; take a share, or give a function of"
                " your own `bounds`"
            )
        self._low, high = self.metric.bounds
        if (
            requirement.statistic != "mean"
            or requirement.comparison == "=="
            or not self._low < requirement.value < high
        ):
            raise ConfigError(
                f"--until {text!r}: expected 'METRIC >= VALUE', a mean with >= <= > or <, and a"
                f" value between {self._low:g} and {high:g}"
            )
        self.alpha = alpha
        self.runs = 0
        self.verdict = Verdict.UNDECIDED
        self._range = high - self._low
        self._capital = np.ones((1, 2, BETS))

    @property
    def is_open(self) -> bool:
        """True before the decision."""
        return self.verdict is Verdict.UNDECIDED

    def add(self, run: str, value: float | None) -> None:
        """Take the value of the next run; None, a run without a value, is passed over.

        SwarmError for a value outside the bounds of the metric.
        """
        if value is None or not self.is_open:
            return
        scaled, target = (np.array([value, self.requirement.value]) - self._low) / self._range
        if not -_ROUNDING <= scaled <= 1.0 + _ROUNDING:
            raise SwarmError(
                f"{self.metric.name} of run {run} is {value:g}, outside its bounds: correct the"
                " bounds of the metric"
            )
        self._capital = bet(self._capital, np.array([scaled]), float(target))
        self.runs += 1
        if side := sides_won(self._capital, self.alpha)[0]:
            is_met = (side > 0.0) == (self.requirement.comparison in (">=", ">"))
            self.verdict = Verdict.MET if is_met else Verdict.NOT_MET

    def document(self) -> dict[str, object]:
        """The answer as plain values."""
        return {
            "requirement": self.requirement.text,
            "alpha": self.alpha,
            "verdict": self.verdict,
            "runs": self.runs,
        }


def run_until(
    test: SequentialTest,
    manifest: Manifest,
    folder: Path,
    runner: Runner,
    *,
    on_progress: OnProgress | None = None,
) -> Results:
    """Do the runs of a manifest with one variant, in their order, until `test` is decided.

    The folder then holds the experiment of the seeds up to the one that decided, whatever the
    runner: later runs that it has done meanwhile are dropped. A later call with the same or more
    seeds takes the runs of the folder at their turn, and repeats those that have failed. The other
    errors are those of `run_experiment`.
    """

    def in_order(jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
        job_by_run = {job.run: job for job in jobs}
        rows = read_table(folder, manifest.plan)[1]
        arrived = {
            run: JobResult(run, row.metrics, bits=row.bits, rules=row.rules)
            for run, row in rows.items()
        }
        waiting = deque(run.id for run in manifest.plan.runs)
        with closing(runner(jobs)) as reports:
            for report in chain([dict[str, float]()], reports):  # at first the rows alone
                if isinstance(report, JobResult):
                    arrived[report.run] = report
                else:
                    yield report
                while test.is_open and waiting and waiting[0] in arrived:
                    result = arrived[waiting.popleft()]
                    test.add(result.run, (result.metrics or {}).get(test.metric.name))
                    if result.run in job_by_run:
                        yield result
                if not test.is_open:
                    break
        for job in map(job_by_run.get, waiting):
            if job is not None and job.trace is not None:
                job.trace.unlink(missing_ok=True)

    set_seeds(folder, manifest, is_longer=True)
    results = run_experiment(manifest, folder, in_order, on_progress=on_progress)
    if not test.is_open:
        last = manifest.seeds.index(results.runs[-1].seed)
        shorter = msgspec.structs.replace(manifest, seeds=manifest.seeds[: last + 1])
        set_seeds(folder, shorter, is_longer=False)
        results = load_results(folder, is_trusted=True)
    write_summary(folder, {**results.document(), "until": test.document()})
    return results
