"""The bounded way in from Zenoh's threads."""

from __future__ import annotations

import asyncio
import threading

import pytest

from swarmd.core.errors import CodecError, CoreFault, fail_stop
from swarmd.core.messages import Code
from swarmd.link.carriers.inbound_queue import (
    BATCH,
    CAPACITY,
    FAILED,
    MAX_KIND_LENGTH,
    MAX_KINDS,
    DropCounter,
    InboundQueue,
)

pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture
def drops() -> DropCounter:
    return DropCounter()


@pytest.fixture
def queue(runner: asyncio.Runner, drops: DropCounter) -> InboundQueue:
    return InboundQueue(runner.get_loop(), drops, "msg/x")


async def test_calls_from_a_thread_run_in_order(queue: InboundQueue) -> None:
    got: list[int] = []
    done = asyncio.Event()

    def foreign() -> None:
        for number in range(100):
            queue.offer(got.append, number)
        queue.offer(done.set)

    thread = threading.Thread(target=foreign)
    thread.start()
    await done.wait()
    thread.join()
    assert got == list(range(100))


async def test_a_full_queue_drops_and_counts_the_newest(
    queue: InboundQueue, drops: DropCounter
) -> None:
    got: list[int] = []
    accepted = [queue.offer(got.append, number) for number in range(CAPACITY + 10)]
    assert accepted.count(False) == 10
    while len(got) < CAPACITY:
        await asyncio.sleep(0)
    assert got == list(range(CAPACITY))
    assert drops.counts() == {"msg/x:full": 10}


async def test_the_loop_gets_its_turn_between_batches(queue: InboundQueue) -> None:
    got: list[int] = []
    seen: list[int] = []
    for number in range(4 * BATCH):
        queue.offer(got.append, number)
    while len(got) < 4 * BATCH:
        await asyncio.sleep(0)
        seen.append(len(got))
    assert {BATCH, 2 * BATCH, 3 * BATCH} <= set(seen)


async def test_a_handler_that_raises_loses_only_its_own_call(queue: InboundQueue) -> None:
    got: list[int] = []
    errors: list[object] = []
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _loop, context: errors.append(context["exception"]))
    queue.offer(got.append, 1)
    queue.offer(lambda: 1 // 0)
    queue.offer(got.append, 2)
    while len(got) < 2:
        await asyncio.sleep(0)
    assert got == [1, 2]
    assert isinstance(errors[0], ZeroDivisionError)


async def test_a_closed_queue_discards_its_calls_and_takes_no_more(queue: InboundQueue) -> None:
    got: list[int] = []
    queue.offer(got.append, 1)
    queue.close()
    assert not queue.offer(got.append, 2)
    for _ in range(3):
        await asyncio.sleep(0)
    assert got == []


def test_what_a_handler_raises_is_counted_refused_and_logged_at_a_limited_rate(
    drops: DropCounter, caplog: pytest.LogCaptureFixture
) -> None:
    reasons: list[tuple[Code, str]] = []
    for error in (CodecError("not MessagePack"), *[ValueError("a bug")] * 100):
        with drops.refusing("control/x", lambda *reason: reasons.append(reason)):
            raise error
    assert drops.counts() == {"control/x:malformed": 1, "control/x:failed": 100}
    assert reasons[0] == (Code.REFUSED, "not MessagePack")
    assert set(reasons[1:]) == {(Code.FAILED, FAILED)}
    assert 1 <= len(caplog.records) <= 10
    assert caplog.records[0].exc_info is not None


def test_a_refusal_that_raises_is_counted(drops: DropCounter) -> None:
    with drops.refusing("control/x", lambda code, text: 1 // 0):
        raise ValueError
    assert drops.counts() == {"control/x:failed": 2}


def test_an_error_of_the_robots_core_is_not_refused(drops: DropCounter) -> None:
    @fail_stop
    def decide() -> float:
        return 1 / 0

    with pytest.raises(CoreFault) as raised, drops.refusing("control/x"):
        decide()
    assert isinstance(raised.value.__cause__, ZeroDivisionError)
    assert drops.counts() == {}


def test_kinds_are_bounded_in_length_and_number(drops: DropCounter) -> None:
    for number in range(1000):
        drops.add(f"{number}" + "x" * 200)
    counts = drops.counts()
    assert sum(counts.values()) == 1000
    assert len(counts) <= MAX_KINDS + 1
    assert max(map(len, counts)) <= MAX_KIND_LENGTH
