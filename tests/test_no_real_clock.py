"""A test in virtual time that reads a clock of this machine fails."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress

import pytest

from swarmd.core.clock import boottime
from tests.histories.swarm import VirtualSwarm
from tests.sequences.virtual_loop import VirtualLoop, run_virtually
from tests.support import hand_clock
from tests.support.no_real_clock import RealClockError, no_real_clock


@pytest.mark.parametrize("read", [boottime, lambda: time.time(), lambda: time.monotonic_ns()])
def test_a_read_of_a_clock_of_this_machine_is_an_error(read: Callable[[], float]) -> None:
    with pytest.raises(RealClockError, match=r"test_no_real_clock\.py"), no_real_clock():
        read()
    assert read() > 0.0


def test_a_read_whose_error_is_caught_is_raised_at_the_end() -> None:
    match = r"reads time\.clock_gettime"
    with pytest.raises(RealClockError, match=match), no_real_clock(), suppress(RealClockError):
        boottime()


def in_history() -> None:
    swarm = VirtualSwarm(1)
    swarm.at(swarm.now + 1.0, boottime)
    swarm.advance(2.0)


async def _story() -> None:
    asyncio.get_running_loop().call_later(1.0, boottime)
    await asyncio.sleep(2.0)


@pytest.mark.parametrize(
    "play",
    [
        in_history,
        lambda: run_virtually(VirtualLoop(), _story()),
        lambda: hand_clock.run(_story()),
    ],
    ids=["histories", "sequences", "hand clock"],
)
def test_a_rig_of_virtual_time_permits_no_real_clock(play: Callable[[], None]) -> None:
    with pytest.raises(RealClockError):
        play()
