"""The delay queue releases items at their time and in order."""

from __future__ import annotations

from swarmd.sim.world.delay_queue import DelayQueue


def test_comes_by_time_and_then_in_the_order_put_in() -> None:
    held: DelayQueue[str] = DelayQueue()
    for at, item in ((3.0, "z"), (1.0, "late"), (1.0, "a"), (2.0, "m"), (1.0, "b")):
        held.put(at, item)
    assert held.due(0.99) == []
    assert held.due(2.0) == ["late", "a", "b", "m"]
    assert held.due(3.0) == ["z"]
    assert held.due(4.0) == []


def test_a_rounding_error_of_summed_steps_delays_nothing() -> None:
    held: DelayQueue[int] = DelayQueue()
    held.put(0.3, 1)
    assert held.due(0.1 + 0.1 + 0.1 - 1e-15) == [1]


def test_items_of_one_time_come_by_rank() -> None:
    held: DelayQueue[str] = DelayQueue()
    for rank, item in ((0.7, "c"), (0.1, "a"), (0.7, "d"), (0.5, "b")):
        held.put(1.0, item, rank)
    assert held.due(1.0) == ["a", "b", "c", "d"]
