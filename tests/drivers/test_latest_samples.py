"""Only the newest reaches the loop."""

from __future__ import annotations

import asyncio
import threading

from swarmd.drivers.latest_samples import LatestSamples

Taken = list[tuple[str, bytes]]


async def settle() -> None:
    """Let the loop carry out what has been handed to it."""
    for _ in range(3):
        await asyncio.sleep(0)


def test_after_a_stall_of_the_loop_only_the_newest_of_each_is_delivered() -> None:
    async def run() -> Taken:
        taken: Taken = []
        inbox = LatestSamples(
            asyncio.get_running_loop(), lambda name, payload: taken.append((name, payload))
        )
        for k in range(10):  # the loop does not run meanwhile
            inbox.put("scan", b"%d" % k)
            inbox.put("odometry", b"%d" % -k)
        await settle()
        return taken

    assert asyncio.run(run()) == [("scan", b"9"), ("odometry", b"-9")]


def test_in_a_loop_that_keeps_up_each_is_delivered() -> None:
    async def run() -> Taken:
        taken: Taken = []
        inbox = LatestSamples(
            asyncio.get_running_loop(), lambda name, payload: taken.append((name, payload))
        )
        for k in range(3):
            inbox.put("scan", b"%d" % k)
            await settle()
        return taken

    assert [payload for _, payload in asyncio.run(run())] == [b"0", b"1", b"2"]


def test_what_was_overtaken_is_counted() -> None:
    async def run() -> list[str]:
        dropped: list[str] = []
        loop = asyncio.get_running_loop()
        inbox = LatestSamples(loop, lambda name, payload: None, dropped.append)
        for name in ("scan", "scan", "odometry", "scan"):
            inbox.put(name, b"")
        await settle()
        inbox.put("scan", b"")
        await settle()
        return dropped

    assert asyncio.run(run()) == ["scan:overtaken", "scan:overtaken"]


def test_nothing_is_delivered_after_closing_not_even_what_was_on_its_way() -> None:
    async def run() -> Taken:
        taken: Taken = []
        inbox = LatestSamples(
            asyncio.get_running_loop(), lambda name, payload: taken.append((name, payload))
        )
        inbox.put("scan", b"1")
        inbox.close()
        inbox.put("scan", b"2")
        await settle()
        return taken

    assert asyncio.run(run()) == []


def test_what_comes_from_another_thread_is_taken_on_the_loops() -> None:
    async def run() -> tuple[int, int]:
        threads: list[int] = []
        arrived = asyncio.Event()

        def take(name: str, payload: bytes) -> None:
            threads.append(threading.get_ident())
            arrived.set()

        inbox = LatestSamples(asyncio.get_running_loop(), take)
        await asyncio.to_thread(inbox.put, "scan", b"1")
        await asyncio.wait_for(arrived.wait(), 20.0)
        return threads[0], threading.get_ident()

    taken_on, loops = asyncio.run(run())
    assert taken_on == loops


def test_what_comes_after_the_loop_has_ended_is_dropped() -> None:
    loop = asyncio.new_event_loop()
    loop.close()
    taken: list[bytes] = []
    LatestSamples(loop, lambda name, payload: taken.append(payload)).put("scan", b"1")
    assert not taken
