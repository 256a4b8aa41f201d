"""The majority rule: a swarm agrees soon, on any opinion alike, and as theory has it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from studies.debates import (
    IN_STEP,
    Motion,
    Result,
    agreed_by,
    at_random,
    hold_all,
    most_frequent,
)
from studies.outcomes.outcome import Outcome, at_least, at_most, share_of
from swarmd.core.values import Value
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.metrics.consensus import consensus_time
from swarmd.sim.scenarios.scenariofile import scenario_of
from tests.support.voting_sim import Air

NAME = "majority_rule"
SHORT_FORM = {"runs": 20}
IS_LONG = True
FILM = {"stop": 30.0, "colour": "opinion"}
RUNS = 50
"""Debates a seed: 1,000 with 20 seeds."""
ROBOTS, OPINIONS, WITHIN = 7, 3, 20.0
ROUNDS = 4
# Of a standard normal once in 2,000, of chi-squared with 2 degrees of freedom once in 1,000.
Z_MAX, CHI2_MAX = 3.5, 13.8
LOSSY = Air(delay=0.05, jitter=0.03, loss=0.1, twice=0.1)
_PAPER = "Kaiser et al., ICRA 2022, experiment 2: 20 s; original rule: all of 2,000 runs"
_WINDOW = "each robot has decided once by then; original rule, windows not in step: 14 s"
_CHAIN = "exact Markov chain of synchronous updates"
# A lockstep run of as short windows costs a third of a second.
_SHORT: Mapping[str, Value] = {"window": 1.0}
_IN_LOCKSTEP = 8


def outcomes(seeds: Sequence[int], jobs: int = 1, runs: int = RUNS) -> list[Outcome]:
    """All outcomes; `runs` debates of each kind for each seed."""
    seeds = [seed * runs + run for seed in seeds for run in range(runs)]
    return [
        *free(debates(seeds, jobs), "7 robots, 3 opinions"),
        *free(debates(seeds, jobs, air=LOSSY), "the same, 10 % lost, 10 % twice"),
        split(seeds, jobs),
        tie(seeds, jobs),
        in_step(seeds, jobs),
        like_lockstep(seeds, jobs),
    ]


def debates(
    seeds: Sequence[int],
    jobs: int = 1,
    *,
    air: Air | None = None,
    params: Mapping[str, Value] | None = None,
    count: int = ROBOTS,
    held: tuple[int, ...] | None = None,
) -> list[Result]:
    """A debate for each seed, of `WITHIN` s."""
    motions = [
        Motion(NAME, count, seed, WITHIN, params or {}, held, air or Air()) for seed in seeds
    ]
    return hold_all(motions, jobs)


def free(results: Sequence[Result], what: str) -> list[Outcome]:
    """How many swarms agree in time, how soon, and on which opinion."""
    times = [result.agreed_at for result in results]
    share = share_of(time <= WITHIN for time in times)
    median = float(np.median(times))
    wins = [sum(result.winner == opinion for result in results) for opinion in range(OPINIONS)]
    even = sum(wins) / OPINIONS
    bias = sum((win - even) ** 2 for win in wins) / even if even else math.inf
    alike = "no opinion is better: all win alike"
    return [
        at_least(NAME, f"{what}: share agreed within 20 s", 0.99, share, _PAPER),
        at_most(NAME, f"{what}: median time, s", 5.3, [median], _WINDOW, len(results)),
        at_most(NAME, f"{what}: chi-squared of who wins", CHI2_MAX, [bias], alike, len(results)),
    ]


def split(seeds: Sequence[int], jobs: int = 1) -> Outcome:
    """Six robots, three against three: in step they would swap opinions for ever."""
    results = debates(seeds, jobs, count=6, held=(0, 0, 0, 1, 1, 1))
    share = share_of(result.agreed_at <= WITHIN for result in results)
    what = "6 robots, three against three: share agreed within 20 s"
    return at_least(NAME, what, 0.99, share, _PAPER)


def tie(seeds: Sequence[int], jobs: int = 1) -> Outcome:
    """How often opinion 0 wins if three robots hold opinion 0, three hold 1, and one holds 2.

    All robots decide in rounds. By symmetry opinions 0 and 1 should win equally often. The value is
    by how many standard errors the share of opinion 0 differs from a half; inf if opinion 2 or no
    opinion wins a run.
    """
    results = debates(seeds, jobs, params=IN_STEP, held=(0, 0, 0, 1, 1, 1, 2))
    wins = [sum(result.winner == opinion for result in results) for opinion in (0, 1)]
    off = abs(wins[0] - 0.5 * len(results)) / math.sqrt(0.25 * len(results))
    off = off if sum(wins) == len(results) else math.inf
    what = "rounds of three, three and one: who wins, off from half by standard errors"
    return at_most(NAME, what, Z_MAX, [off], "between equals any is as likely", len(results))


def in_step(seeds: Sequence[int], jobs: int = 1) -> Outcome:
    """The shares of swarms that agreed after 1, 2 ... rounds of decisions, compared with theory.

    The value is the greatest difference in standard errors.
    """
    results = debates(seeds, jobs, params=IN_STEP, air=Air(twice=0.1))
    expected = agreed_by(at_random(ROBOTS, OPINIONS), most_frequent, ROUNDS)
    off = [
        abs(np.mean([result.rounds <= number for result in results]) - share)
        / math.sqrt(share * (1.0 - share) / len(results))
        for number, share in enumerate(expected)
        if number
    ]
    worst = float(max(off))
    what = "rounds: share agreed after 1 to 4, off by standard errors"
    return at_most(NAME, what, Z_MAX, [worst], _CHAIN, len(results))


def like_lockstep(seeds: Sequence[int], jobs: int = 1) -> Outcome:
    """Difference in standard errors between the mean times here and in the lockstep simulation."""
    group = {"platform": "burger", "count": ROBOTS, "pattern": NAME, "parameters": dict(_SHORT)}
    start = {"layout": "grid", "spacing": 1.0}
    scenario = scenario_of({"duration": 4.0, "groups": {"all": group}, "start": start})
    there = [consensus_time(simulate_run(scenario, seed)) for seed in range(_IN_LOCKSTEP)]
    here = [r.agreed_at for r in debates(seeds, jobs, params=_SHORT)]
    times = np.array([math.nan if time is None else time for time in there])
    error = math.sqrt(times.var(ddof=1) / len(times) + np.var(here, ddof=1) / len(here))
    off = abs(float(times.mean() - np.mean(here))) / error
    what = "mean time without bodies and in lockstep, apart by standard errors"
    return at_most(NAME, what, Z_MAX, [off], "the same patterns run", _IN_LOCKSTEP)
