"""Discussed dispersion: experiment 2 of the paper, where there is room for every opinion.

Seven Waffle Pis in 1.4 times the paper's arena, so that opinion 2, 1.4 m, can be kept too; and an
eighth that joins late with another opinion.
"""

from __future__ import annotations

from collections.abc import Sequence

from studies.outcomes.outcome import Outcome, at_least, at_most
from studies.paper_exp2 import (
    LARGER,
    MOVING,
    STRAYED,
    TOLERANCE,
    joined,
    judged,
)
from swarmd.sim.experiments.simulate import simulate

SHORT_FORM = {"seconds": 46.0}
IS_LONG = True
FILM = {"colour": "opinion"}

_NAME = "discussed_dispersion"
_PAPER = "Kaiser et al., ICRA 2022, experiment 2"
_OURS = "ours: the law keeps 0.14 m more than asked for, another opinion is 0.4 m away"
FARTHER = 0.25
_JOINED = 8.0


def outcomes(seeds: Sequence[int], jobs: int = 1, seconds: float = 72.0) -> list[Outcome]:
    """All outcomes, of one run for each seed; `seconds` is the duration of a run."""
    larger = {"arena.size": list(LARGER), "duration": seconds}
    courses = [judged(t) for t in simulate("paper_exp2", seeds, set=larger, jobs=jobs).traces]
    # An eighth robot joins while the others disperse, after 3 s already, so that a run is short.
    robot = "tb3-08"
    events = [
        {"at": _JOINED, "join": robot},
        {"at": _JOINED, "run": _NAME, "targets": robot},
    ]
    some = {f"parameters.{_NAME}.discuss": 3.0, "events": events, "duration": _JOINED + 12.0}
    results = simulate("paper_exp2_late", seeds, set=some, jobs=jobs)
    late = [joined(trace, _JOINED) for trace in results.traces]
    over = [course.least - course.wanted for course in courses]
    least, that = "least range from 40 s on, over f(opinion) [m]", "the same, of that opinion [m]"
    stand = "ours: the robots stand, but for corrections"
    paper = "paper: they go on voting, so that the swarm can change its opinion when robots join"
    return [
        at_least(_NAME, "all hold one opinion from 20 s on", 1.0,
                 [float(course.opinion >= 0) for course in courses], _PAPER),
        at_most(_NAME, "farthest before 20 s [m]", 0.02, [c.moved for c in courses], _PAPER),
        at_least(_NAME, least, -TOLERANCE, over, _PAPER),
        at_most(_NAME, that, FARTHER, over, _OURS),
        at_most(_NAME, "farthest from 40 to 70 s [m]", STRAYED,
                [course.strayed for course in courses], stand),
        at_most(_NAME, "share of that time in which one moves", MOVING,
                [course.moving for course in courses], stand),
        at_most(_NAME, "contacts", 0.0, [float(c.contacts) for c in courses], _PAPER),
        at_most(_NAME, "time until a late robot holds the opinion of the seven [s]", 11.0,
                [one.adopted for one in late], f"{paper}; 11 s are two windows"),
        at_most(_NAME, "runs in which it changes another's opinion", 0.0,
                [float(one.is_swayed) for one in late],
                "ours: it is one of six neighbours that are counted"),
    ]  # fmt: skip
