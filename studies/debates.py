"""Thousands of debates of a voting pattern, and the theory of synchronous updates.

The expected numbers come from the exact Markov chain of the counts: all robots decide at once, each
from the opinions of all others. `tests.support.voting_sim` runs the debates.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from studies.keeper import each
from swarmd.core.values import Value
from tests.support.voting_sim import Air, Debate, VotingSim

Counts: TypeAlias = tuple[int, ...]
Choice: TypeAlias = Callable[[Counts], Sequence[float]]
"""From the counts of opinions that a robot hears to the probability that it adopts each."""

IN_STEP: Mapping[str, Value] = {
    "windows": "rounds",
    "window": 2.0,
    "share_period": 0.3,
    "expiry": 1.0,
}
"""Rounds of about 0.4 s."""


@dataclass(frozen=True, slots=True)
class Motion:
    """The settings of a debate (see `VotingSim`), which ends `settled` s after all have agreed."""

    pattern: str
    count: int
    seed: int
    seconds: float
    params: Mapping[str, Value] = field(default_factory=dict)
    held: tuple[int, ...] | None = None
    air: Air = field(default_factory=Air)
    settled: float = 10.0


@dataclass(frozen=True, slots=True)
class Result:
    """The result of a debate."""

    agreed_at: float  # s; inf: never
    winner: int | None  # the common opinion; None without one
    rounds: float  # until all robots held one opinion; inf: never
    sent: int  # messages of all robots


def hold(motion: Motion) -> Result:
    """Run one debate."""
    m = motion
    swarm = VotingSim(m.pattern, m.count, seed=m.seed, params=m.params, held=m.held, air=m.air)
    debate = swarm.run(m.seconds, until_agreed=m.settled)
    return Result(debate.agreed_at, debate.winner, rounds_of(debate), debate.sent)


def hold_all(motions: Iterable[Motion], jobs: int = 1) -> list[Result]:
    """Run all debates in `jobs` processes; the results in the order of `motions`."""
    return each(hold, list(motions), jobs)


def rounds_of(debate: Debate) -> float:
    """The number of the first round in which all robots held one opinion; inf: no such round."""
    for number in range(int(debate.rounds.min(axis=1).max()) + 1):
        is_then = debate.rounds == number
        if not is_then.any(axis=0).all():
            continue
        first = is_then.argmax(axis=0)
        if np.ptp(debate.opinions[first, np.arange(len(first))]) == 0:
            return float(number)
    return math.inf


def most_frequent(heard: Counts) -> Sequence[float]:
    """The majority rule's choice: one of the most frequent opinions, with equal probability."""
    leaders = [count == max(heard) for count in heard]
    return [is_leader / sum(leaders) for is_leader in leaders]


def any_of(heard: Counts) -> Sequence[float]:
    """The voter model's choice: the opinion of a random robot."""
    return [count / sum(heard) for count in heard]


def agreed_by(start: Mapping[Counts, float], choice: Choice, rounds: int) -> list[float]:
    """The probability that all agree after 0, 1 ... `rounds` synchronous updates."""
    chances, steps = dict(start), {state: _step(state, choice) for state in _reachable(start)}
    shares = [_agreed(chances)]
    for _ in range(rounds):
        after: dict[Counts, float] = {}
        for state, chance in chances.items():
            for new, part in steps[state].items():
                after[new] = after.get(new, 0.0) + chance * part
        chances = after
        shares.append(_agreed(chances))
    return shares


def at_random(count: int, opinions: int) -> Mapping[Counts, float]:
    """The probability of each state if all robots draw their opinions."""
    states: dict[Counts, float] = {(0,) * opinions: 1.0}
    for _ in range(count):
        states = _add_one(states, [1.0 / opinions] * opinions)
    return states


def _step(state: Counts, choice: Choice) -> Mapping[Counts, float]:
    """The probability of each next state."""
    after: dict[Counts, float] = {(0,) * len(state): 1.0}
    for opinion, count in enumerate(state):
        heard = tuple(n - (k == opinion) for k, n in enumerate(state))
        for _ in range(count):
            after = _add_one(after, choice(heard))
    return after


def _add_one(states: Mapping[Counts, float], chances: Sequence[float]) -> dict[Counts, float]:
    after: dict[Counts, float] = {}
    for state, chance in states.items():
        for opinion, part in enumerate(chances):
            if part > 0.0:
                new = (*state[:opinion], state[opinion] + 1, *state[opinion + 1 :])
                after[new] = after.get(new, 0.0) + chance * part
    return after


def _reachable(start: Mapping[Counts, float]) -> Iterable[Counts]:
    """All states with as many robots and opinions as the states of `start`."""
    some = next(iter(start))
    return at_random(sum(some), len(some))


def _agreed(chances: Mapping[Counts, float]) -> float:
    return sum(chance for state, chance in chances.items() if max(state) == sum(state))
