"""Hop gradient: hops equal the breadth-first distance to the leader, also when the leader dies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from studies.keeper import each
from studies.outcomes.outcome import Outcome, at_most
from studies.point_swarm import PointSwarm, Track, at_places
from tests.support.voting_sim import Air

NAME = "hop_gradient"
FILM = {"title": "hops to the leader", "colour": "report:hops"}
ROBOTS, SIDE, REACH = 30, 10.0, 2.8
SECONDS, KILLED_AT, PERIOD = 60.0, 30.0, 0.5
LOSSY = Air(delay=0.02, jitter=0.01, loss=0.2, twice=0.1)
CLEAR = Air(delay=0.02, jitter=0.01)
_EXACT = "breadth-first search"
_ROUNDS = "FloodMax, Lynch 1996: a round a hop; the first message is sent at once"
_LEASE = "ours: the lease of 5 s, and half of its length and two rounds a hop at 20 % lost"


@dataclass(frozen=True, slots=True)
class Election:
    """Rounds until all hops are right, and wrong samples later; before and after a death."""

    eccentricity: int
    rounds: float
    wrong: int
    rounds_after: float
    wrong_after: int


def outcomes(seeds: Sequence[int], jobs: int = 1) -> list[Outcome]:
    """All outcomes: a random network with loss and without for each seed."""
    lossy = each(elect, [(seed, LOSSY) for seed in seeds], jobs)
    clear = each(elect, [(seed, CLEAR) for seed in seeds], jobs)
    both = [*lossy, *clear]
    wrong = [float(one.wrong + one.wrong_after) for one in both]
    beyond = [one.rounds - one.eccentricity for one in clear]
    delayed = [one.rounds - 2 * one.eccentricity for one in lossy]
    again = [one.rounds_after * PERIOD for one in both]
    return [
        at_most(NAME, "samples with a wrong hop count after the first right one", 0, wrong, _EXACT),
        at_most(NAME, "rounds beyond the eccentricity", 1.0, beyond, _ROUNDS),
        at_most(NAME, "rounds beyond twice it, 20 % lost", 4.0, delayed, "ours"),
        at_most(NAME, "time until right after the leader's death [s]", 20.0, again, _LEASE),
    ]


def elect(given: tuple[int, Air]) -> Election:
    """One random network, whose leader is dead from `KILLED_AT` on."""
    seed, air = given
    links = connected(seed)
    ends = {0: KILLED_AT}
    places = at_places(np.zeros((ROBOTS, 2)))
    track = PointSwarm(NAME, places, seed=seed, links=links, ends=ends, air=air).run(SECONDS)
    before, after = track.t < KILLED_AT, track.t > KILLED_AT
    rounds, wrong = _compare(track, before, links, dead=0)
    rest = _compare(track, after, links, dead=1)
    return Election(int(distances(links).max()), rounds, wrong, *rest)


def _compare(
    track: Track, when: NDArray[np.bool_], links: NDArray[np.bool_], *, dead: int
) -> tuple[float, int]:
    """Rounds until the living robots are right, and the samples in which one is wrong later."""
    hops = track.reported("hops", -1.0)[when][:, dead:]
    is_right = (hops == distances(links[dead:, dead:])).all(axis=1)
    if not is_right.any():
        return math.inf, 0
    first = int(is_right.argmax())
    return first * 0.1 / PERIOD, int((~is_right[first:]).sum())


def connected(seed: int) -> NDArray[np.bool_]:
    """The links of robots at random places that stay connected without the first one."""
    rng = np.random.default_rng(seed)
    while True:
        x, y = rng.uniform(0.0, SIDE, (2, ROBOTS))
        apart = np.hypot(np.subtract.outer(x, x), np.subtract.outer(y, y))
        links = np.asarray((apart < REACH) & (apart > 0.0))
        if (distances(links) >= 0).all() and (distances(links[1:, 1:]) >= 0).all():
            return links


def distances(links: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Hops (n,) from the first robot by breadth-first search; -1 where there is no way."""
    found = np.full(len(links), -1)
    edge, hops = np.arange(len(links)) == 0, 0
    while edge.any():
        found[edge] = hops
        edge, hops = links[edge].any(axis=0) & (found < 0), hops + 1
    return found
