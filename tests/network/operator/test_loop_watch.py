"""Standstills of a process: by gaps of its loops, without the time that it lacks a processor."""

from __future__ import annotations

import pytest

from swarmd.network.operator.loop_watch import MAX_GAP, START_TIME, LoopWatch, processor_wait


class Waited:
    """The time for which a thread waited for a processor, set by hand."""

    seconds = 0.0

    def __call__(self) -> float:
        return self.seconds


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
def test_a_gap_beyond_the_wait_is_a_standstill(
    turn: float, pause: float, waited: float, stood: float
) -> None:
    processor = Waited()
    watch = LoopWatch(processor)
    watch.begin(100.0)
    processor.seconds = waited
    assert watch.turn(turn, pause) == pytest.approx(stood)
    assert watch.stood(99.0) == pytest.approx(stood)
    assert watch.stood(turn) == 0.0  # an order of later
    assert MAX_GAP == 1.0  # docs/safety.md


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


def test_the_kernel_counts_the_time_without_a_processor() -> None:
    assert 0.0 <= processor_wait() <= processor_wait()
