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
    Course,
    Joining,
    joined,
    judged,
)
from swarmd.sim.experiments.simulate import simulate

_NAME = "discussed_dispersion"
_PAPER = "Kaiser et al., ICRA 2022, experiment 2"
_OURS = "ours: the law keeps 0.14 m more than asked for, another opinion is 0.4 m away"
FARTHER = 0.25
_JOINED = 8.0


def outcomes(seeds: Sequence[int], jobs: int = 1, seconds: float = 72.0) -> list[Outcome]:
    """All of them, of one run a seed each; with fewer `seconds` they are looked at for less."""
    courses = courses_of(seeds, jobs, seconds)
    late = joinings_of(seeds, jobs)
    return [*_of_courses(courses), *_of_joinings(late)]


def courses_of(seeds: Sequence[int], jobs: int = 1, seconds: float = 72.0) -> list[Course]:
    """What seven robots with random opinions make of it."""
    some = {"arena.size": list(LARGER), "duration": seconds}
    results = simulate("paper_exp2", seeds, set=some, jobs=jobs)
    return [judged(results.traces[run.id]) for run in results.runs]


def joinings_of(seeds: Sequence[int], jobs: int = 1) -> list[Joining]:
    """What an eighth robot makes of it that joins when the others disperse, and they of it.

    They do so after 3 s, so that it is soon over.
    """
    robot = "tb3-08"
    events = [
        {"at": _JOINED, "join": robot},
        {"at": _JOINED, "run": _NAME, "targets": robot},
    ]
    some = {f"parameters.{_NAME}.discuss": 3.0, "events": events, "duration": _JOINED + 12.0}
    results = simulate("paper_exp2_late", seeds, set=some, jobs=jobs)
    return [joined(results.traces[run.id], _JOINED) for run in results.runs]


def _of_courses(courses: Sequence[Course]) -> list[Outcome]:
    agreed = [float(course.opinion >= 0) for course in courses]
    moved = [course.moved for course in courses]
    over = [course.least - course.wanted for course in courses]
    strayed = [course.strayed for course in courses]
    moving = [course.moving for course in courses]
    touches = [float(course.touches) for course in courses]
    rows = (
        ("all hold one opinion from 20 s on", "1", agreed, at_least(1.0, agreed), _PAPER),
        ("farthest before 20 s [m]", "<= 0.02", moved, at_most(0.02, moved), _PAPER),
        (
            "least range from 40 s on, over f(opinion) [m]",
            f">= -{TOLERANCE:g}",
            over,
            at_least(-TOLERANCE, over),
            _PAPER,
        ),
        (
            "the same, so that it is that opinion's [m]",
            f"<= {FARTHER:g}",
            over,
            at_most(FARTHER, over),
            _OURS,
        ),
        (
            "farthest from 40 to 70 s [m]",
            f"<= {STRAYED:g}",
            strayed,
            at_most(STRAYED, strayed),
            "ours: the robots stand, but for corrections",
        ),
        (
            "share of that time in which one moves",
            f"<= {MOVING:g}",
            moving,
            at_most(MOVING, moving),
            "ours: the robots stand, but for corrections",
        ),
        ("contacts", "0", touches, at_most(0.0, touches), _PAPER),
    )
    return [
        Outcome(_NAME, what, wanted, tuple(values), is_reached, source)
        for what, wanted, values, is_reached, source in rows
    ]


def _of_joinings(late: Sequence[Joining]) -> list[Outcome]:
    adopted = [one.adopted for one in late]
    swayed = [float(one.is_swayed) for one in late]
    source = "paper: they go on voting, so that the swarm can change its mind when robots join"
    return [
        Outcome(
            _NAME,
            "one that joins late holds what the seven do after [s]",
            "<= 11, two windows",
            tuple(adopted),
            at_most(11.0, adopted),
            source,
        ),
        Outcome(
            _NAME,
            "runs in which it changes the mind of one of them",
            "0",
            tuple(swayed),
            at_most(0.0, swayed),
            "ours: it is one of six neighbours who are counted",
        ),
    ]
