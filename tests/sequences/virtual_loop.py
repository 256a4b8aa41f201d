"""An asyncio loop whose time passes at once: it never sleeps."""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Coroutine, Mapping
from typing import Any

from tests.support.no_real_clock import no_real_clock

LEAST = 1e-6  # s by which the time advances at least where the loop would sleep


class _Selector(selectors.SelectSelector):
    """Lets the time pass instead of waiting for files."""

    now = 1000.0  # s

    def select(self, timeout: float | None = None) -> Any:
        """The files that are ready now; AssertionError if nothing would ever happen."""
        ready = super().select(0)
        if not ready:
            assert timeout is not None, "nothing is due: the loop would wait for ever"
            self.now += max(timeout, LEAST) if timeout > 0.0 else 0.0
        return ready


class VirtualLoop(asyncio.SelectorEventLoop):
    """A loop that starts at 1000 s."""

    def __init__(self) -> None:
        self._virtual = _Selector()
        super().__init__(self._virtual)

    def time(self) -> float:
        """The virtual time in s."""
        return self._virtual.now


def run_virtually(loop: VirtualLoop, main: Coroutine[Any, Any, None]) -> None:
    """Run to the end, then close the loop. An error that only the loop has seen is raised, too.

    A read of a clock of this machine is an error.
    """
    errors: list[Mapping[str, Any]] = []
    loop.set_exception_handler(lambda _, context: errors.append(context))
    try:
        with no_real_clock():
            loop.run_until_complete(main)
    finally:
        for task in asyncio.all_tasks(loop):
            task.cancel()
        loop.run_until_complete(asyncio.sleep(0.0))
        loop.close()
    for context in errors:
        raise context.get("exception") or AssertionError(context["message"])
