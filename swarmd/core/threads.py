"""The only way from foreign threads to the loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TypeVarTuple, Unpack

Args = TypeVarTuple("Args")


def hand_over(
    loop: asyncio.AbstractEventLoop, function: Callable[[Unpack[Args]], object], *args: Unpack[Args]
) -> None:
    """Call `function(*args)` on the loop's thread; dropped if the loop has closed."""
    try:
        loop.call_soon_threadsafe(function, *args)
    except RuntimeError:  # the loop closed while the network was still talking
        return
