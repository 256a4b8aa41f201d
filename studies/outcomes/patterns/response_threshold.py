"""Response thresholds: as many work as the demand needs, first those with a low threshold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from studies.keeper import each
from studies.outcomes.outcome import Outcome, at_most
from studies.point_swarm import PointSwarm, at_places
from swarmd.core.values import Array
from swarmd.patterns.response_threshold.pattern import ResponseThresholdParams

NAME = "response_threshold"
IS_LONG = True
FILM = {"title": "a stimulus is strongest in the middle", "colour": "report:works"}
ROBOTS, SECONDS, SETTLED, LEFT_AT = 40, 300.0, 60.0, 150.0
DEMAND, WORK = 1.0, 3.0
"""The stimulus rises by the demand a second; all robots at work lower it by so much a second."""
LOW, HIGH = 1.0, 20.0
_STOP = ResponseThresholdParams().stop
# The stimulus is found between 0 and this by bisection.
_MOST = 1e4
_BALANCE = "Bonabeau et al. 1996: demand / work, here a third"
_MEAN = "mean-field balance of Bonabeau et al. 1996"


@dataclass(frozen=True, slots=True)
class _Setting:
    seed: int
    thresholds: tuple[float, ...]
    leave: int = 0


class Store:
    """The stimulus: it rises with time, and falls by the work of the robots."""

    def __init__(self) -> None:
        self.level = self.now = 0.0
        self.at_work: dict[int, float] = {}

    def __call__(self, now: float, row: int, poses: Array) -> Mapping[str, float]:
        """The reading at this time."""
        share = sum(self.at_work.values()) / ROBOTS
        self.level = max(self.level + (DEMAND - WORK * share) * (now - self.now), 0.0)
        self.now = now
        return {"stimulus": self.level}


def outcomes(seeds: Sequence[int], jobs: int = 1) -> list[Outcome]:
    """All outcomes: alike robots, and two castes whose specialists leave."""
    castes = (LOW,) * (ROBOTS // 2) + (HIGH,) * (ROBOTS // 2)
    alike = each(work, [_Setting(seed, (5.0,) * ROBOTS) for seed in seeds], jobs)
    mixed = each(work, [_Setting(seed, castes) for seed in seeds], jobs)
    lost = each(work, [_Setting(seed, castes, ROBOTS // 2) for seed in seeds], jobs)
    needed = DEMAND / WORK
    low, high = expected(castes)
    off = [abs(float(shares.mean()) - needed) for shares in alike]
    off_low = [abs(float(shares[: ROBOTS // 2].mean()) - low) for shares in mixed]
    off_high = [abs(float(shares[ROBOTS // 2 :].mean()) - high) for shares in mixed]
    rest = [abs(float(shares[ROBOTS // 2 :].mean()) / 2.0 - needed) for shares in lost]
    return [
        at_most(NAME, "share at work, off from a third", 0.03, off, _BALANCE),
        at_most(NAME, f"of those with a low threshold, off from {low:.3f}", 0.05, off_low, _MEAN),
        at_most(NAME, f"of those with a high one, off from {high:.3f}", 0.05, off_high, _MEAN),
        at_most(NAME, "after the specialists left, of all, off from a third", 0.05, rest, _BALANCE),
    ]


def work(setting: _Setting) -> Array:
    """The share (n,) of the time in which each robot works.

    The time is that from `SETTLED` on, or the last 100 s if robots leave.
    """
    store = Store()
    swarm = PointSwarm(
        NAME,
        at_places(np.zeros((ROBOTS, 2))),
        seed=setting.seed,
        own={row: {"threshold": one} for row, one in enumerate(setting.thresholds)},
        ends=dict.fromkeys(range(setting.leave), LEFT_AT),
        sense=store,
    )

    def note(reports: Sequence[Mapping[str, object]]) -> bool:
        store.at_work = {row: bool(one.get("works")) for row, one in enumerate(reports)}
        return False

    track = swarm.run(SECONDS, until=note)
    begin = SECONDS - 100.0 if setting.leave else SETTLED
    return np.asarray(track.reported("works", 0.0)[track.t >= begin].mean(axis=0))


def expected(thresholds: Sequence[float]) -> tuple[float, float]:
    """The share at work of the first and the last robot where work and demand are equal."""
    low, high = 0.0, _MOST
    for _ in range(100):
        level = 0.5 * (low + high)
        if float(np.mean([_share(level, one) for one in thresholds])) < DEMAND / WORK:
            low = level
        else:
            high = level
    return _share(low, thresholds[0]), _share(low, thresholds[-1])


def _share(stimulus: float, threshold: float) -> float:
    """The share of the time for which a robot works at a stimulus that stays the same."""
    begin = stimulus**2 / (stimulus**2 + threshold**2)
    return begin / (begin + _STOP)
