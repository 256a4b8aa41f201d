"""Sessions that are opened for somebody who does not wait for them."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Callable

import pytest
import zenoh

from swarmd.network.session import open_in_thread
from swarmd.testing.driver_contract import TIMEOUT


def session() -> zenoh.Session:
    config = zenoh.Config()
    for key in ("scouting/multicast/enabled", "scouting/gossip/enabled"):
        config.insert_json5(key, json.dumps(False))
    config.insert_json5("listen/endpoints", json.dumps([]))
    return zenoh.open(config)


def opener(made: list[zenoh.Session], go_on: threading.Event) -> Callable[[], zenoh.Session]:
    def open_it() -> zenoh.Session:
        go_on.wait(TIMEOUT)
        made.append(session())
        return made[-1]

    return open_it


def test_it_is_handed_to_who_waits() -> None:
    found = asyncio.run(open_in_thread(session))
    assert not found.is_closed()
    found.close()


def test_none_may_be_found() -> None:
    assert asyncio.run(open_in_thread(lambda: None)) is None


@pytest.mark.parametrize("waits", [False, True])
def test_it_is_closed_when_nobody_waits_any_more(waits: bool) -> None:
    made: list[zenoh.Session] = []
    go_on = threading.Event()

    async def run() -> None:
        task = asyncio.create_task(open_in_thread(opener(made, go_on)))
        await asyncio.sleep(0.01)
        task.cancel()
        if waits:
            await asyncio.gather(task, return_exceptions=True)
        go_on.set()  # the loop ends before the opening does

    asyncio.run(run())
    assert [one.is_closed() for one in made] == [True]


def test_it_is_closed_when_it_comes_as_the_wait_ends() -> None:
    made: list[zenoh.Session] = []
    is_made = threading.Event()

    def open_it() -> zenoh.Session:
        made.append(session())
        is_made.set()
        return made[-1]

    async def run() -> None:
        task = asyncio.create_task(open_in_thread(open_it))
        await asyncio.sleep(0)
        assert is_made.wait(TIMEOUT)  # the loop is held up, and has not heard of it
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    asyncio.run(run())
    assert [one.is_closed() for one in made] == [True]
