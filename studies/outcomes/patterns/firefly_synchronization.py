"""Firefly synchronisation: flashes come together under latency and loss; dead robots are named."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from studies.keeper import each
from studies.outcomes.outcome import Outcome, at_least, at_most
from studies.point_swarm import PointSwarm, Track, at_places
from swarmd.core.values import Array
from tests.support.voting_sim import Air

NAME = "firefly_synchronization"
FILM = {"title": "phase", "colour": "report:phase"}
ROBOTS, PERIOD = 10, 2.0
SECONDS, KILLED_AT = 60.0, 40.0
IN_STEP = 0.99
LOSSY = Air(delay=0.02, jitter=0.01, loss=0.1, twice=0.1)
SLOW = Air(delay=0.1, jitter=0.05, loss=0.3, twice=0.1)
_MIROLLO = "Mirollo and Strogatz 1990: order 1; 5 periods: ours"
_LATENCY = "ours: phases differ by up to 0.15 s of 2 s"
_CHRISTENSEN = "ours; Christensen et al. 2009 name robots by one missed flash"
_CHANCE = "independent phases: 0.28 on average"


@dataclass(frozen=True, slots=True)
class _Setting:
    seed: int
    air: Air
    coupling: float = 0.1
    is_chain: bool = False


@dataclass(frozen=True, slots=True)
class Flashes:
    """The numbers of a run, each as the function of its name gives it."""

    settled: float
    late: float
    naming: float
    false: float


def outcomes(seeds: Sequence[int], jobs: int = 1) -> list[Outcome]:
    """All outcomes: four runs for each seed, in the first of which a robot is killed."""
    lossy = each(run, [_Setting(seed, LOSSY) for seed in seeds], jobs)
    slow = each(run, [_Setting(seed, SLOW) for seed in seeds], jobs)
    alone = each(run, [_Setting(seed, LOSSY, coupling=0.0) for seed in seeds], jobs)
    chain = each(run, [_Setting(seed, LOSSY, is_chain=True) for seed in seeds], jobs)
    in_step = [one.settled for one in lossy]
    named = [one.naming for one in lossy]
    wrongly_named = [one.false for one in lossy]
    return [
        at_most(NAME, "periods until the order is 0.99", 5.0, in_step, _MIROLLO),
        at_least(NAME, "least late order", 0.998, late_orders(lossy), _MIROLLO),
        at_least(NAME, "the same, 100 ms, 30 % lost", 0.98, late_orders(slow), _LATENCY),
        at_least(NAME, "the same, a chain of ten", 0.9, late_orders(chain), "ours"),
        at_most(NAME, "the same, without coupling", 0.98, late_orders(alone), _CHANCE),
        at_most(NAME, "periods until all name a dead robot", 2.0, named, _CHRISTENSEN),
        at_most(NAME, "times a living robot is named", 0.0, wrongly_named, "ours"),
    ]


def late_orders(flashes: Sequence[Flashes]) -> list[float]:
    """The least late order of each run."""
    return [one.late for one in flashes]


def run(setting: _Setting) -> Flashes:
    """What a run of a minute gave."""
    track = flash(setting)
    return Flashes(settled(track), late(track), naming(track), false(track))


def flash(setting: _Setting) -> Track:
    """Ten robots for a minute; the first one is dead from `KILLED_AT` on."""
    number = np.arange(ROBOTS)
    links = np.abs(np.subtract.outer(number, number)) == 1 if setting.is_chain else None
    swarm = PointSwarm(
        NAME,
        at_places(np.zeros((ROBOTS, 2))),
        seed=setting.seed,
        params={"period": PERIOD, "coupling": setting.coupling},
        links=links,
        ends={} if setting.is_chain else {0: KILLED_AT},
        air=setting.air,
    )
    return swarm.run(SECONDS)


def order(track: Track) -> Array:
    """The length (T,) of the mean of the phases as unit vectors, before a robot is killed."""
    is_before = (track.t > 0.2) & (track.t < KILLED_AT)
    since = track.t[:, None] - track.stepped
    phase = (track.reported("phase") + since / PERIOD)[is_before]
    return np.asarray(np.abs(np.exp(2j * math.pi * phase).mean(axis=1)))


def settled(track: Track) -> float:
    """The periods until the order is and remains at 0.99; infinite if it never is."""
    is_low = np.flatnonzero(order(track) < IN_STEP)
    last = 0.1 * float(is_low[-1] + 4) if len(is_low) else 0.0
    return last / PERIOD if last < KILLED_AT - PERIOD else math.inf


def late(track: Track) -> float:
    """The least order of the last ten periods before a robot is killed."""
    return float(order(track)[-round(10 * PERIOD / 0.1) :].min())


def naming(track: Track) -> float:
    """The periods from the death of a robot until all others name it, and it alone."""
    everyone = [
        all(report.get("silent") == "robot-000" for report in reports[1:])
        for reports in track.reports
    ]
    is_named = np.array(everyone) & (track.t > KILLED_AT)
    if not is_named.any():
        return math.inf
    return float(track.t[is_named.argmax()] - KILLED_AT) / PERIOD


def false(track: Track) -> float:
    """How many samples of a robot name another one than the dead one."""
    names = (str(report.get("silent", "")) for reports in track.reports for report in reports)
    return float(sum(name not in ("", "robot-000") for name in names))
