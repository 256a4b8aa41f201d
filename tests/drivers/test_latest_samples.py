"""Only the newest sample of each name reaches the loop."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable

from swarmd.drivers.latest_samples import LatestSamples

Taken = list[tuple[str, bytes]]


def play(story: Callable[[LatestSamples], Awaitable[None]]) -> tuple[Taken, list[str]]:
    """The samples taken and dropped while a story ran."""
    taken: Taken = []
    dropped: list[str] = []

    async def run() -> None:
        loop, thread = asyncio.get_running_loop(), threading.get_ident()

        def take(name: str, payload: bytes) -> None:
            assert threading.get_ident() == thread
            taken.append((name, payload))

        await story(LatestSamples(loop, take, dropped.append))
        await settle()

    asyncio.run(run())
    return taken, dropped


async def settle() -> None:
    """Let the loop carry out what has been handed to it."""
    for _ in range(3):
        await asyncio.sleep(0)


def test_after_a_stall_of_the_loop_only_the_newest_of_each_is_delivered() -> None:
    async def story(inbox: LatestSamples) -> None:
        for k in range(3):  # the loop does not run meanwhile
            inbox.put("scan", b"%d" % k)
        inbox.put("odometry", b"1")

    taken, dropped = play(story)
    assert taken == [("scan", b"2"), ("odometry", b"1")]
    assert dropped == ["scan:overtaken", "scan:overtaken"]


def test_in_a_loop_that_keeps_up_each_is_delivered() -> None:
    async def story(inbox: LatestSamples) -> None:
        for k in range(3):
            inbox.put("scan", b"%d" % k)
            await settle()

    assert play(story) == ([("scan", b"0"), ("scan", b"1"), ("scan", b"2")], [])


def test_nothing_is_delivered_after_closing() -> None:
    async def story(inbox: LatestSamples) -> None:
        inbox.put("scan", b"1")
        inbox.close()
        inbox.put("scan", b"2")

    assert play(story)[0] == []


def test_a_sample_of_another_thread_is_taken_on_the_loops_thread() -> None:
    async def story(inbox: LatestSamples) -> None:
        await asyncio.to_thread(inbox.put, "scan", b"1")

    assert play(story)[0] == [("scan", b"1")]


def test_a_sample_after_the_end_of_the_loop_is_dropped() -> None:
    loop = asyncio.new_event_loop()
    loop.close()
    taken: list[bytes] = []
    LatestSamples(loop, lambda name, payload: taken.append(payload)).put("scan", b"1")
    assert not taken
