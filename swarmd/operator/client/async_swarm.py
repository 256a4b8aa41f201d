"""A swarm from asyncio: the methods of `Swarm`, each carried out on a thread."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncGenerator, Callable, Coroutine, Iterator
from concurrent.futures import Future, wait
from functools import partial, wraps
from types import TracebackType
from typing import Any, Concatenate, Self

from swarmd.core.errors import P, R
from swarmd.operator.client.hand_over import begin, from_thread, in_thread
from swarmd.operator.client.swarm import Swarm

MAX_LOOKS = 4
"""Looks that have a thread; more wait in the loop. Looks that have threads share queries."""
_ENDING = 6.0  # s; a call that is cancelled sends its stops within 5 s


def _awaited(
    method: Callable[Concatenate[Swarm, P], R],
) -> Callable[Concatenate[AsyncSwarm, P], Coroutine[Any, Any, R]]:
    @wraps(method)
    async def call(self: AsyncSwarm, /, *args: P.args, **kwargs: P.kwargs) -> R:
        cancelled = threading.Event()
        swarm = self._swarm._cancellable(cancelled)
        work = begin(partial(method, swarm, *args, **kwargs))
        self._under_way.add(work)
        work.add_done_callback(self._under_way.discard)
        try:
            return await asyncio.wrap_future(work)
        except asyncio.CancelledError:
            cancelled.set()
            raise

    return call


def _in_turn(
    method: Callable[Concatenate[Swarm, P], R],
) -> Callable[Concatenate[AsyncSwarm, P], Coroutine[Any, Any, R]]:
    """As `_awaited`, for a look: a look that waits for its turn has no thread."""
    awaited = _awaited(method)

    @wraps(method)
    async def call(self: AsyncSwarm, /, *args: P.args, **kwargs: P.kwargs) -> R:
        async with self._looks:
            return await awaited(self, *args, **kwargs)

    return call


def _iterated(
    method: Callable[Concatenate[Swarm, P], Iterator[R]],
) -> Callable[Concatenate[AsyncSwarm, P], AsyncGenerator[R, None]]:
    @wraps(method)
    def call(self: AsyncSwarm, /, *args: P.args, **kwargs: P.kwargs) -> AsyncGenerator[R, None]:
        cancelled = threading.Event()
        swarm = self._swarm._cancellable(cancelled)
        return from_thread(partial(method, swarm, *args, **kwargs), cancelled)

    return call


class AsyncSwarm:
    """A swarm, as `swarmd.connect` gives it in an `async with` block.

    The methods, their parameters and results are those of `Swarm`. `events` and `states` are async
    iterators; all other methods are awaited. Each method runs on a thread, so that the event loop
    does not wait for robots. A stop waits for no other method. `drive` gives a `Hand`, for `async
    with await swarm.drive(...) as hand`. Looks (`members`, `describe`,
    `goal`, `incidents`, `params`, `frame`) take turns. SwarmError if 8 requests are under way.

    A cancelled task no longer waits, but robots may have applied its request. The cancellation also
    ends six methods: a `wait`; a run with a canary, whose canaries are stopped; a run `at` a later
    moment, whose robots are stopped before they start; a push with a canary, whose other robots get
    nothing; a `fetch_incident`, whose next call continues; and an `acceptance`, whose robot is
    stopped. Its function `answer` runs on a thread.
    """

    def __init__(self, swarm: Swarm) -> None:
        self._swarm = swarm
        self._under_way: set[Future[Any]] = set()
        self._looks = asyncio.Semaphore(MAX_LOOKS)

    members = _in_turn(Swarm.members)
    describe = _in_turn(Swarm.describe)
    goal = _in_turn(Swarm.goal)
    incidents = _in_turn(Swarm.incidents)
    params = _in_turn(Swarm.params)
    frame = _in_turn(Swarm.frame)
    run = _awaited(Swarm.run)
    drive = _awaited(Swarm.drive)
    stop = _awaited(Swarm.stop)
    estop = _awaited(Swarm.estop)
    reset = _awaited(Swarm.reset)
    param = _awaited(Swarm.param)
    label = _awaited(Swarm.label)
    mark = _awaited(Swarm.mark)
    fetch_incident = _awaited(Swarm.fetch_incident)
    push = _awaited(Swarm.push)
    acceptance = _awaited(Swarm.acceptance)
    resume = _awaited(Swarm.resume)
    undo = _awaited(Swarm.undo)
    wait = _awaited(Swarm.wait)
    events = _iterated(Swarm.events)
    states = _iterated(Swarm.states)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Leave the network.

        Waits up to 6 s for calls under way: a cancelled call may still have to stop its robots, and
        the end of the program would prevent that stop.
        """

        def close() -> None:
            self._swarm.close()
            wait(tuple(self._under_way), _ENDING)

        await asyncio.shield(in_thread(close))
