"""Reads the calls of an agent from standard input, with the time at which each of them arrived."""

from __future__ import annotations

import os
import select
import threading
from collections.abc import AsyncGenerator, Iterator
from contextlib import aclosing
from contextvars import ContextVar
from functools import partial

from swarmd.client.hand_over import from_thread
from swarmd.client.input_watch import TOO_LATE, InputWatch
from swarmd.core.clock import boottime
from swarmd.core.errors import SwarmError

LOOK_PERIOD = 250  # ms between two looks at an input in which nothing waits


class CallInput:
    """The lines of a file descriptor, as an asynchronous iterator.

    A thread reads them, so that a busy event loop does not delay the time of their arrival. The
    MCP server carries out a call in the context (`contextvars`) in which its line was read.
    """

    def __init__(self, descriptor: int, answers: int) -> None:
        """`answers`: the file descriptor on which the agent reads; the input ends with it, too."""
        self._descriptor, self._answers = descriptor, answers
        self._watch = InputWatch(boottime())
        self._arrived: ContextVar[float] = ContextVar("arrived")

    async def __aiter__(self) -> AsyncGenerator[str, None]:
        ended = threading.Event()
        async with aclosing(from_thread(partial(self._read, ended), ended)) as lines:
            async for line, at in lines:
                self._arrived.set(at)
                yield line.decode(errors="replace")

    def arrival(self) -> float:
        """When the present call arrived, in s on the clock since boot.

        SwarmError if that was too long ago for motion, or if the call may have waited in the input
        of a server that was frozen.
        """
        at = self._arrived.get()
        if not self._watch.is_fresh(at, boottime()):
            raise SwarmError(f"the request was not sent: {TOO_LATE}")
        return at

    def _read(self, ended: threading.Event) -> Iterator[tuple[bytes, float]]:
        """On the thread: each line with its arrival, until the end of the input."""
        poll, begun = select.poll(), b""
        poll.register(self._descriptor, select.POLLIN)
        poll.register(self._answers, 0)  # tells the end alone
        while not ended.is_set():
            now = boottime()  # before the look: the process may be frozen between the two
            found = dict(poll.poll(0))
            if self._answers in found:
                return
            if not found:
                self._watch.look(now)
                poll.poll(LOOK_PERIOD)
                continue
            data = os.read(self._descriptor, 65536)
            *lines, begun = (begun + data).split(b"\n") if data else (begun, b"")
            yield from ((line, self._watch.arrival(now)) for line in lines)
            if not data:
                return
