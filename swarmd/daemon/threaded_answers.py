"""Answers queries from threads, since a disk may be slow."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial

from swarmd.network.bus import Query, ZenohBus
from swarmd.network.inbound_queue import DropCounter

MAX_TASKS = 8
"""Answers at a time; further queries are dropped, and their askers repeat them."""


class ThreadedAnswers:
    """Queries of the plane `control`; `drops` counts those that cannot be answered."""

    def __init__(self, loop: asyncio.AbstractEventLoop, drops: DropCounter) -> None:
        self._loop, self._drops = loop, drops
        self._tasks: set[asyncio.Task[None]] = set()

    def serve(self, bus: ZenohBus, name: str, answer: Callable[[bytes], bytes]) -> None:
        """Answer `control/<name>` with `answer(payload)`, which runs in a thread."""
        bus.serve("control", name, partial(self.begin, name, answer))

    def begin(self, name: str, answer: Callable[[bytes], bytes], query: Query) -> None:
        """Answer one query of `control/<name>`."""
        if len(self._tasks) >= MAX_TASKS:
            query.drop()
            return
        task = self._loop.create_task(self._run(name, answer, query))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _run(self, name: str, answer: Callable[[bytes], bytes], query: Query) -> None:
        with self._drops.refusing(f"control/{name}", lambda code, text: query.drop()):
            query.reply(await asyncio.to_thread(answer, query.payload))
