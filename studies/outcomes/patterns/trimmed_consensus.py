"""Trimmed consensus: honest robots agree within their first values, however a liar speaks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from studies.keeper import each
from studies.outcomes.outcome import Outcome, at_least, at_most
from studies.point_swarm import PointSwarm, Track, at_places
from swarmd.core.values import Array, Value
from tests.support.voting_sim import Air

NAME = "trimmed_consensus"
FILM = {"title": "value", "colour": "report:value"}
ROBOTS, SECONDS, LIE = 7, 60.0, 100.0
LOSSY = Air(delay=0.02, jitter=0.01, loss=0.1, twice=0.1)
_LEBLANC = "LeBlanc et al. 2013: seven robots that all hear each other, F = 1"
_BOUND = "the same: more liars than trim"


@dataclass(frozen=True, slots=True)
class _Setting:
    seed: int
    trim: int
    liars: int


@dataclass(frozen=True, slots=True)
class Agreement:
    """The spread of the honest robots' values, how far a value left the hull, and when they agreed.

    `agreed_at` in s: the first time at which their values differ by at most 0.001.
    """

    spread: float
    outside: float
    agreed_at: float


def outcomes(seeds: Sequence[int], jobs: int = 1) -> list[Outcome]:
    """All outcomes: for each seed no liar, one and two, with and without trimming."""

    def debates(trim: int, liars: int) -> list[Agreement]:
        return each(debate, [_Setting(seed, trim, liars) for seed in seeds], jobs)

    none, one, two, plain = debates(1, 0), debates(1, 1), debates(1, 2), debates(0, 1)
    honest = [*none, *one]
    return [
        at_most(NAME, "spread at the end", 1e-6, [a.spread for a in honest], _LEBLANC),
        at_most(NAME, "way out of the hull", 1e-9, [a.outside for a in honest], _LEBLANC),
        at_most(NAME, "time to agree, a liar [s]", 10.0, [a.agreed_at for a in one], "ours"),
        at_least(NAME, "way out, plain averaging", 50.0, [a.outside for a in plain], _LEBLANC),
        at_least(NAME, "way out, two liars", 50.0, [a.outside for a in two], _BOUND),
    ]


def debate(setting: _Setting) -> Agreement:
    """One debate; the last robots lie."""
    rng = np.random.default_rng(setting.seed)
    first = rng.random(ROBOTS)
    honest = ROBOTS - setting.liars
    own: dict[int, Mapping[str, Value]] = {
        row: {"initial": float(first[row])} for row in range(honest)
    }
    for row in range(honest, ROBOTS):
        own[row] = {"initial": LIE, "is_stubborn": True}
    swarm = PointSwarm(
        NAME,
        at_places(np.zeros((ROBOTS, 2))),
        seed=setting.seed,
        params={"trim": setting.trim},
        own=own,
        air=LOSSY,
    )
    return _judge(swarm.run(SECONDS), first[:honest])


def _judge(track: Track, first: Array) -> Agreement:
    values = track.reported("value")[2:, : len(first)]
    spread = np.ptp(values, axis=1)
    is_agreed = spread <= 1e-3
    agreed_at = float(track.t[2:][is_agreed.argmax()]) if is_agreed.any() else np.inf
    outside = max(float(values.max() - first.max()), float(first.min() - values.min()), 0.0)
    return Agreement(float(spread[-1]), outside, agreed_at)
