"""Replays the recordings of several robots together, in the order of one timeline.

The timeline is the wall clock of the first robot, in ns since 1970. The offsets between the clocks
of robots come from the exchanges in the recordings (`daemon/recording/clock_offset.py`). A robot
without an exchange is placed by its own wall clock. Each robot gets its own inputs at the times of
its own clock, so an error of an offset changes no command: it changes only the order between
robots.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Sequence
from functools import partial
from operator import itemgetter
from pathlib import Path

from swarmd.daemon.recording.merge import place, survey, time_on
from swarmd.daemon.recording.reader import RecordedMessage
from swarmd.operator.replay.replay import Difference, Life


def place_lives(lives: Sequence[Life], paths: Sequence[Path]) -> None:
    """Place lives on the timeline; the files `paths` have the exchanges between their clocks."""
    placed = place(survey(paths))
    reference = placed[0].source.about
    by_clock = {(one.source.robot, one.source.clock): one.alignment for one in placed}
    for life in lives:
        alignment = by_clock[life.about["robot"], life.about["clock"]]
        life.place = partial(time_on, reference, alignment, life.about)
        life.error = math.inf if alignment is None else alignment.error


def repeat_together(lives: Sequence[Life], until: float | None = None) -> None:
    """Step the robots of all lives to their ends, or to `until` s of the timeline.

    The time counts from the first message of all. A life that cannot go on keeps its `fault`.
    """
    begin: int | None = None
    for at, life, message in heapq.merge(*map(_timed, lives), key=itemgetter(0)):
        begin = at if begin is None else begin
        time = 1e-9 * (at - begin)
        if until is not None and time > until:
            break
        if message is life.messages[0]:
            life.replay.begin = time
        life.take(message)


def _timed(life: Life) -> Iterator[tuple[int, Life, RecordedMessage]]:
    return ((life.place(message.at), life, message) for message in life.messages)


def first_difference(lives: Sequence[Life]) -> tuple[Life, Difference] | None:
    """The first difference on the timeline, and the life that has it; None without one."""
    found = [(life, life.replay.difference) for life in lives]
    differing = [(life, difference) for life, difference in found if difference is not None]
    return min(differing, key=lambda pair: pair[1].at, default=None)
