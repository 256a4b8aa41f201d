"""Whether an asyncio loop is in use, for what lasts as long as the code that runs on the loop.

A program that runs a loop waits for the code on the loop, not for a task: a cell of a notebook, the
handler of a web server and a child of a task group end while their program goes on. A program that
fails may wait long for a loop that is already shut down: `asyncio.run` cancels all tasks, closes
the async generators (`loop.shutdown_asyncgens`), and then waits for the threads of
`asyncio.to_thread` for as long as these run, such as for an `input()` that nobody answers.

A loop closes each async generator that was begun on it when it is shut down. `LoopLife` begins one
and notes its end. This is documented behaviour of asyncio, which uvloop has, too. A task that waits
to be cancelled would end a moment earlier, but a program that awaits or counts all tasks
(`asyncio.all_tasks`) would see it.

1. A loop that is shut down or closed is over.
2. A loop that stands between two `run_until_complete` goes on, as that of a notebook between cells,
   as long as the thread that ran it lives.
3. A loop whose code blocks goes on.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import AsyncGenerator, Awaitable
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Self

from swarmd.core.closing import Closing

if TYPE_CHECKING:
    import asyncio


class LoopLife(Closing):
    """The use of `loop`, which runs in the present thread; call `close` once it is not needed."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.thread = threading.current_thread()
        self._loop = loop
        self._is_shut_down = False
        self._watch = self._until_shutdown()
        _step(anext(self._watch))  # from now on the loop knows the generator

    @classmethod
    def of_caller(cls) -> Self | None:
        """The use of the loop that runs the caller; None outside of a loop."""
        # A program that has not imported asyncio runs no loop, and need not import it for this.
        asyncio = sys.modules.get("asyncio")
        if asyncio is None:
            return None
        try:
            return cls(asyncio.get_running_loop())
        except RuntimeError:
            return None

    @property
    def is_over(self) -> bool:
        """True once the loop is shut down or closed, or its thread has ended."""
        # Private, in asyncio since Python 3.9: the threads of `to_thread` are waited for.
        awaits_threads = getattr(self._loop, "_executor_shutdown_called", False)
        if self._is_shut_down or awaits_threads or self._loop.is_closed():
            return True
        return not self._loop.is_running() and not self.thread.is_alive()

    def close(self) -> None:
        """Watch the loop no longer."""
        with suppress(RuntimeError):  # the loop closes the generator at this moment
            _step(self._watch.aclose())

    async def _until_shutdown(self) -> AsyncGenerator[None, None]:
        try:
            yield
        finally:
            self._is_shut_down = True


def _step(step: Awaitable[Any]) -> None:
    """Carry out a step of an async generator that awaits nothing, in any thread."""
    with suppress(StopIteration, StopAsyncIteration):
        step.__await__().send(None)
