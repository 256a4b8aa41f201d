"""Standstills of a process: by gaps of its loops, without the time that it lacks a processor."""

from __future__ import annotations

import math
import threading

import pytest

from swarmd.operator.session.clocks import MAX_GAP, START_TIME, LoopWatch, processor_waits


class Waited:
    """The times for which threads waited for a processor, set by hand."""

    def __init__(self) -> None:
        self.seconds = {"loop": 0.0, "other": 0.0}

    def __call__(self) -> dict[str, float]:
        return dict(self.seconds)


@pytest.mark.parametrize(
    ("turn", "pause", "waited", "stood"),
    [
        (100.9, 0.0, 0.0, 0.0),
        (101.4, 0.5, 0.0, 0.0),  # a wait of 0.5 s and a delay of 0.9 s
        (101.6, 0.5, 0.0, 1.1),
        (140.0, 0.5, 0.0, 39.5),
        (140.0, 0.5, 39.0, 0.0),  # a loaded computer, which stopped nothing
        (140.0, 0.5, 2.0, 37.5),
    ],
)
@pytest.mark.parametrize("thread", ["loop", "other", "new"])
def test_a_gap_beyond_the_wait_is_a_standstill(
    turn: float, pause: float, waited: float, stood: float, thread: str
) -> None:
    processor = Waited()
    watch = LoopWatch(processor)
    watch.begin(100.0)
    processor.seconds[thread] = waited
    assert watch.turn(turn, pause) == pytest.approx(stood)
    assert watch.stood(99.0) == pytest.approx(stood)
    assert watch.stood(turn) == 0.0  # an order of later
    assert MAX_GAP == 1.0  # docs/evidence/motion.md


def test_loops_count_as_work_and_pauses_between_them_do_not() -> None:
    watch = LoopWatch(Waited())
    for begin, end in ((100.0, 102.0), (150.0, 153.0)):
        watch.begin(begin)
        for number in range(1, 11):
            watch.turn(begin + number * (end - begin) / 10, 0.5)
    assert watch.worked(100.0) == pytest.approx(5.0)
    assert watch.worked(101.5) == pytest.approx(3.5)
    assert watch.worked(149.0) == pytest.approx(4.0)  # with the second before the loop
    assert watch.worked(103.0) == pytest.approx(3.0 + START_TIME)
    assert watch.worked(200.0) == 0.0


def test_a_standstill_is_no_work() -> None:
    watch = LoopWatch(Waited())
    watch.begin(100.0)
    watch.turn(100.5, 0.5)
    watch.turn(140.5, 0.5)
    watch.turn(141.0, 0.5)
    assert watch.worked(100.0) == pytest.approx(1.0)


def test_a_wait_of_long_ago_hides_no_standstill() -> None:
    processor = Waited()
    watch = LoopWatch(processor)
    watch.begin(100.0)
    for number in range(1, 101):
        processor.seconds["loop"] += 0.09  # a loaded computer for 10 s
        assert watch.turn(100.0 + 0.1 * number, 0.05) == 0.0
    assert watch.turn(112.0, 0.05) > MAX_GAP


def test_the_kernel_counts_the_time_without_a_processor() -> None:
    first, second = processor_waits(), processor_waits()
    assert str(threading.main_thread().native_id) in first
    assert all(0.0 <= first[thread] <= second.get(thread, math.inf) for thread in first)
