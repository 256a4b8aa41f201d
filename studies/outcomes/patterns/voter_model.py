"""The voter model: an opinion wins as often as its share at first, as late as theory has it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from studies.debates import IN_STEP, Counts, Motion, Result, agreed_by, any_of, hold_all
from studies.outcomes.outcome import Outcome, at_most, mean_of, within
from swarmd.core.values import Value
from swarmd.patterns.voter_model.pattern import VoterModelParams
from tests.support.voting_sim import Air

NAME = "voter_model"
SHORT_FORM = {"has_times": False, "runs": 25}
IS_LONG = True
FILM = {"colour": "opinion"}
RUNS = 50
"""Debates a seed and setting: 1,000 with 20 seeds."""
ROBOTS = 10
FIRST = (2, 5, 8)
"""How many of the ten hold opinion 1 at first."""
WITHIN = 300.0
SHORT: Mapping[str, Value] = {"opinions": 2, "window": 0.5, "share_period": 0.25, "expiry": 1.0}
"""Short windows: the winner does not depend on their length."""
LOSSY = Air(delay=0.02, jitter=0.01, loss=0.1, twice=0.1)
# Of chi-squared with 3 degrees of freedom once in 1,000, of a standard normal once in 2,000.
CHI2_MAX, Z_MAX = 16.3, 3.5
RATIO = (0.8, 1.25)
"""Messages take time, and a robot may hear no other robot in its first window."""
TWO: Mapping[str, Value] = {"opinions": 2}
_LONGEST = 200
_SIMULATED = 3000
_LINEAR = "voter model on a complete graph: Sood and Redner, PRL 94, 2005"
_IN_TURN = "the model itself, 3,000 runs: ten robots in turn, without time for words"
_CHAIN = "exact Markov chain of synchronous updates"


def outcomes(
    seeds: Sequence[int], jobs: int = 1, *, has_times: bool = True, runs: int = RUNS
) -> list[Outcome]:
    """All outcomes, or those without mean times; `runs` debates of each kind for each seed."""
    seeds = [seed * runs + run for seed in seeds for run in range(runs)]
    found = [exits(seeds, jobs), in_step(seeds, jobs)]
    return [*found, in_turn(seeds, jobs)] if has_times else found


def exits(seeds: Sequence[int], jobs: int = 1) -> Outcome:
    """Compare the number of wins of opinion 1 with theory, by a chi-squared test.

    The windows do not overlap, and the radio loses messages. In theory opinion 1 wins with a
    probability equal to its share at the start.
    """
    off = 0.0
    for first in FIRST:
        winners = [result.winner for result in debates(seeds, jobs, first, SHORT, LOSSY)]
        won = math.nan if None in winners else float(np.mean([one == 1 for one in winners]))
        expected = first / ROBOTS
        off += (won - expected) ** 2 / (expected * (1.0 - expected) / len(winners))
    what = "chi-squared of the share won by opinion 1, at first held by 2, 5 and 8 of 10"
    return at_most(NAME, what, CHI2_MAX, [off], _LINEAR, len(seeds))


def in_step(seeds: Sequence[int], jobs: int = 1) -> Outcome:
    """Compare the mean number of rounds until all robots agree with theory.

    The value is the difference in standard errors.
    """
    results = debates(seeds, jobs, 5, {**IN_STEP, "opinions": 2}, Air(twice=0.1))
    mean, spread = expected_rounds(ROBOTS, 5)
    off = abs(float(np.mean([r.rounds for r in results])) - mean) * math.sqrt(len(results)) / spread
    what = "rounds: mean number until 10 robots agree, off by standard errors"
    return at_most(NAME, what, Z_MAX, [off], _CHAIN, len(seeds))


def in_turn(seeds: Sequence[int], jobs: int = 1) -> Outcome:
    """Tumbling windows: the mean time until all agree, as a multiple of that of `simulated`."""
    results = debates(seeds, jobs, 5, TWO, Air())
    length = VoterModelParams().window
    model = length * simulated(ROBOTS, 5)
    ratio = mean_of(result.agreed_at / model for result in results)
    what = "tumbling: mean time until 10 robots agree, as a multiple of the model's"
    return within(NAME, what, *RATIO, ratio, _IN_TURN)


def debates(
    seeds: Sequence[int], jobs: int, first: int, params: Mapping[str, Value], air: Air
) -> list[Result]:
    """A debate a seed, in which `first` of the robots hold 1 at first and the others 0."""
    motions = []
    for seed in seeds:
        held = np.random.default_rng(seed).permutation([1] * first + [0] * (ROBOTS - first))
        opinions = tuple(int(opinion) for opinion in held)
        motions.append(Motion(NAME, ROBOTS, seed, WITHIN, params, opinions, air, 3.0))
    return hold_all(motions, jobs)


def expected_rounds(count: int, first: int) -> tuple[float, float]:
    """Mean and standard deviation of the rounds until all agree, by the exact Markov chain.

    At the start `first` of `count` robots hold opinion 1 of two opinions.
    """
    start: Mapping[Counts, float] = {(count - first, first): 1.0}
    late = 1.0 - np.array(agreed_by(start, any_of, _LONGEST))
    mean = float(late.sum())
    square = float(((2.0 * np.arange(len(late)) + 1.0) * late).sum())
    return mean, math.sqrt(square - mean**2)


def simulated(count: int, first: int) -> float:
    """Mean number of windows until all agree, in a simulation without messages.

    In each window every robot, in turn, adopts the opinion of another random robot at once.
    """
    rng = np.random.default_rng(0)
    taken = []
    for _ in range(_SIMULATED):
        held = rng.permutation([1] * first + [0] * (count - first)).tolist()
        ends = np.sort(rng.random(count)).tolist()  # when the windows of each robot end
        turn = 0
        while 0 < sum(held) < count:
            robot = turn % count
            held[robot] = held[(robot + int(rng.integers(1, count))) % count]
            turn += 1
        taken.append((turn - 1) // count + ends[(turn - 1) % count])
    return float(np.mean(taken))
