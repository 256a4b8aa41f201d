"""Real sessions on loopback in swarms of their own."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import pytest

from swarmd.link.settings import NetworkSettings
from tests.support.fake_daemon import FakeSwarm

Robots = Callable[..., FakeSwarm]
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


@pytest.fixture
def robots(settings: NetworkSettings) -> Iterator[Robots]:
    """Starts light daemons on a loop of their own; all are gone after the test."""
    made: list[FakeSwarm] = []

    def start(*names: str, **options: Any) -> FakeSwarm:
        swarm = FakeSwarm(settings, names, **options)
        made.append(swarm)
        return swarm

    yield start
    for swarm in made:
        swarm.close()
