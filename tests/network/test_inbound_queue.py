"""The bounded way in from Zenoh's threads."""

from __future__ import annotations

import asyncio
import threading

import pytest

from swarmd.network.inbound_queue import BATCH, CAPACITY, DropCounter, InboundQueue

pytestmark = pytest.mark.filterwarnings("error")


def queue(drops: DropCounter, **options: float) -> InboundQueue:
    return InboundQueue(asyncio.get_running_loop(), drops, "msg/x", **options)  # type: ignore[arg-type]


def test_calls_from_a_thread_run_in_order() -> None:
    async def steps() -> list[int]:
        got: list[int] = []
        done = asyncio.Event()
        way = queue(DropCounter())

        def foreign() -> None:
            for number in range(100):
                way.offer(got.append, number)
            way.offer(done.set)

        thread = threading.Thread(target=foreign)
        thread.start()
        await done.wait()
        thread.join()
        return got

    assert asyncio.run(steps()) == list(range(100))


def test_a_full_queue_drops_and_counts_the_newest() -> None:
    async def steps() -> tuple[list[int], dict[str, int]]:
        got: list[int] = []
        drops = DropCounter()
        way = queue(drops)
        accepted = [way.offer(got.append, number) for number in range(CAPACITY + 10)]
        assert accepted.count(False) == 10
        while len(got) < CAPACITY:
            await asyncio.sleep(0)
        return got, drops.counts()

    got, counts = asyncio.run(steps())
    assert got == list(range(CAPACITY))
    assert counts == {"msg/x:full": 10}


def test_the_loop_gets_its_turn_between_batches() -> None:
    async def steps() -> list[int]:
        got: list[int] = []
        seen: list[int] = []
        way = queue(DropCounter())
        for number in range(4 * BATCH):
            way.offer(got.append, number)
        while len(got) < 4 * BATCH:
            await asyncio.sleep(0)
            seen.append(len(got))
        return seen

    assert {BATCH, 2 * BATCH, 3 * BATCH} <= set(asyncio.run(steps()))


def test_a_handler_that_raises_loses_only_its_own_call() -> None:
    async def steps() -> tuple[list[int], list[object]]:
        got: list[int] = []
        errors: list[object] = []
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _loop, context: errors.append(context["exception"]))
        way = queue(DropCounter())
        way.offer(got.append, 1)
        way.offer(lambda: 1 // 0)
        way.offer(got.append, 2)
        while len(got) < 2:
            await asyncio.sleep(0)
        return got, errors

    got, errors = asyncio.run(steps())
    assert got == [1, 2]
    assert isinstance(errors[0], ZeroDivisionError)


def test_a_closed_queue_discards_its_calls_and_takes_no_more() -> None:
    async def steps() -> list[int]:
        got: list[int] = []
        way = queue(DropCounter())
        way.offer(got.append, 1)
        way.close()
        assert not way.offer(got.append, 2)
        for _ in range(3):
            await asyncio.sleep(0)
        return got

    assert asyncio.run(steps()) == []


def test_kinds_are_bounded_in_length_and_number() -> None:
    drops = DropCounter()
    for number in range(1000):
        drops.add(f"{number}" + "x" * 200)
    counts = drops.counts()
    assert sum(counts.values()) == 1000
    assert len(counts) <= 257
    assert max(map(len, counts)) <= 64
