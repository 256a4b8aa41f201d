"""Discussed dispersion: experiment 2 of the paper, where there is room for every opinion.

Seven Waffle Pis run in 1.4 times the paper's arena, in which they can also keep the largest
distance, 1.4 m of opinion 2. In further runs an eighth robot joins late with another opinion.
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
    """Compare the vote and the dispersion of seven robots with experiment 2 of the paper.

    The robots vote on a distance, agree within 20 s, spread to this distance and stand. For each
    seed there is a run of `seconds` s, and a short run in which an eighth robot with another
    opinion joins. An outcome: text of the number, bound, values of the runs, source of the bound.
    """
    # 1. Seven robots in the larger arena. `judged` measures votes, ranges and motion of a run.
    changes = {"arena.size": list(LARGER), "duration": seconds}
    courses = [judged(t) for t in simulate("paper_exp2", seeds, set=changes, jobs=jobs).traces]
    # m above the agreed distance; far above, the robots would keep that of another opinion.
    over = [course.least - course.wanted for course in courses]
    # 2. An eighth robot joins while seven robots disperse. The vote takes 3 s in place of 20 s, so
    # that a run is short.
    robot = "tb3-08"
    events = [
        {"at": _JOINED, "join": robot},
        {"at": _JOINED, "run": _NAME, "targets": robot},
    ]
    late_changes = {
        f"parameters.{_NAME}.discuss": 3.0, "events": events, "duration": _JOINED + 12.0
    }  # fmt: skip
    late_results = simulate("paper_exp2_late", seeds, set=late_changes, jobs=jobs)
    late_robots = [joined(trace, _JOINED) for trace in late_results.traces]
    # 3. The bounds. STRAYED and MOVING bound the motion of robots that should stand.
    least_label = "least range from 40 s on, over f(opinion) [m]"
    stand = "ours: the robots stand, but for corrections"
    paper = "paper: they go on voting, so that the swarm can change its opinion when robots join"
    return [
        at_least(_NAME, "all hold one opinion from 20 s on", 1.0,
                 [float(course.opinion >= 0) for course in courses], _PAPER),
        at_most(_NAME, "farthest before 20 s [m]", 0.02,
                [course.moved for course in courses], _PAPER),
        at_least(_NAME, least_label, -TOLERANCE, over, _PAPER),
        at_most(_NAME, "the same, of that opinion [m]", FARTHER, over, _OURS),
        at_most(_NAME, "farthest from 40 to 70 s [m]", STRAYED,
                [course.strayed for course in courses], stand),
        at_most(_NAME, "share of that time in which one moves", MOVING,
                [course.moving for course in courses], stand),
        at_most(_NAME, "contacts", 0.0, [float(course.contacts) for course in courses], _PAPER),
        at_most(_NAME, "time until a late robot holds the opinion of the seven [s]", 11.0,
                [late.adopted for late in late_robots], f"{paper}; 11 s are two windows"),
        at_most(_NAME, "runs in which it changes another's opinion", 0.0,
                [float(late.is_swayed) for late in late_robots],
                "ours: it is one of six neighbours that are counted"),
    ]  # fmt: skip
