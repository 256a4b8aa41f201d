"""Hands calls from foreign threads to the asyncio loop; no other code does."""

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
    except RuntimeError:  # the loop has closed, while a network thread still delivers
        return
