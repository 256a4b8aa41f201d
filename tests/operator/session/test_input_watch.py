"""Commands that waited for a program that was frozen start nothing; times are handed in."""

from __future__ import annotations

import math

import pytest

from swarmd.operator.session.clocks import InputWatch


def watched(*looks: float) -> InputWatch:
    watch = InputWatch(looks[0])
    for at in looks[1:]:
        watch.look(at)
    return watch


@pytest.mark.parametrize(
    ("looks", "read_at", "done_at", "is_fresh"),
    [
        # The reader looked at most a second ago (docs/evidence/motion.md), and it is done soon.
        ((0.0, 0.25, 0.5), 0.6, 0.7, True),
        ((0.0,), 1.0, 1.0, True),
        # The reader was frozen for 30 s, and the command was in its input.
        ((0.0, 0.25), 30.25, 30.3, False),
        # The same, and the reader looks again before the command is carried out.
        ((0.0, 0.25, 30.4, 30.6), 30.25, 30.7, False),
        # What is read after a look behind the gap is new.
        ((0.0, 0.25, 30.4), 30.5, 30.6, True),
        # The program was frozen between the reading and the carrying out.
        ((0.0, 0.25), 0.3, 2.3, False),
        # A busy program that goes on to look carries the command out after 3 s or more.
        ((0.0, 1.0, 2.0, 3.0), 0.1, 3.1, False),
        ((0.0, 1.0, 2.0), 0.1, 2.9, True),
    ],
)
def test_a_command_is_fresh_if_the_reader_looked(
    looks: tuple[float, ...], read_at: float, done_at: float, is_fresh: bool
) -> None:
    watch = watched(*(at for at in looks if at <= read_at))
    arrived = watch.arrival(read_at)
    for at in looks:
        if at > read_at:
            watch.look(at)
    assert watch.is_fresh(arrived, done_at) is is_fresh


def test_input_that_waited_for_a_frozen_reader_has_no_time_of_arrival() -> None:
    assert watched(0.0).arrival(1.1) == -math.inf
