"""Real sessions on loopback in swarms of their own."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Awaitable, Callable

import pytest

from swarmd.network.settings import NetworkSettings

Until = Callable[[Callable[[], bool]], Awaitable[None]]


@pytest.fixture
def settings() -> NetworkSettings:
    """Profile dev in a swarm of its own."""
    return NetworkSettings(swarm=f"test-{secrets.token_hex(6)}")


@pytest.fixture
def until() -> Until:
    """Await until a condition holds, looking every 5 ms; fails after 20 s."""

    async def wait(condition: Callable[[], bool]) -> None:
        end = time.monotonic() + 20.0
        while not condition():
            assert time.monotonic() < end, "this never came about"
            await asyncio.sleep(0.005)

    return wait
