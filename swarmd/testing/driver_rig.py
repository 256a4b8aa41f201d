"""A fake base that a test controls, a driver that runs with it, and what its sink received."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

from swarmd.core.values import Neighbor, Odometry, Platform, Scan, Twist, Value
from swarmd.driver_api.driver import Driver

TIMEOUT = 30.0
"""Seconds that a test waits for a condition before it fails."""

POLL_PERIOD = 0.01


class Rig(Protocol):
    """A fake of the robot's base, controlled by a test; silent at first."""

    platform: Platform

    def make(self, options: Mapping[str, Value]) -> Driver:
        """A driver for this base, with `options` added to those it needs to find the base."""

    def publish(self) -> None:
        """Make the base publish a scan and an odometry, each with the next stamp."""

    def commands(self) -> Sequence[Twist]:
        """Commands that reached the base since the last call, oldest first; at least the newest."""

    def close(self) -> None:
        """End the base."""


@runtime_checkable
class ScriptedRig(Protocol):
    """A rig whose base publishes what the test gives it."""

    def publish_scan(self, scan: Scan) -> None:
        """Make the base publish this scan: its rays, sequence and stamp.

        The bearings are regular; the range limits do not count.
        """

    def publish_odometry(self) -> None:
        """Make the base publish an odometry with the next stamp, and nothing else."""

    def publish_garbage(self) -> None:
        """Publish bytes that are no message, and truncated messages, on every channel."""


@runtime_checkable
class DetachableRig(Protocol):
    """A rig whose base can be taken away with all its links."""

    def disconnect(self) -> None:
        """Take the base away at once, as by a pulled plug."""

    def reconnect(self) -> None:
        """Bring the base back at the same address, silent."""


@dataclass(slots=True)
class CollectingSink:
    """A sink that records everything."""

    scans: list[Scan] = field(default_factory=list)
    odometries: list[Odometry] = field(default_factory=list)
    neighborhoods: list[tuple[Neighbor, ...]] = field(default_factory=list)
    values: list[Mapping[str, float]] = field(default_factory=list)
    states: list[tuple[bool, str]] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    order: list[str] = field(default_factory=list)
    threads: set[int] = field(default_factory=set)

    @property
    def is_up(self) -> bool:
        """Whether the base is up, by the driver's last report."""
        return bool(self.states) and self.states[-1][0]

    def scan(self, scan: Scan) -> None:
        """Record a scan."""
        self.scans.append(scan)
        self.order.append("scan")
        self.threads.add(threading.get_ident())

    def odometry(self, odometry: Odometry) -> None:
        """Record an odometry."""
        self.odometries.append(odometry)
        self.order.append("odometry")
        self.threads.add(threading.get_ident())

    def neighbors(self, neighbors: tuple[Neighbor, ...]) -> None:
        """Record the robots in radio range."""
        self.neighborhoods.append(neighbors)

    def readings(self, values: Mapping[str, float]) -> None:
        """Record scalar sensors."""
        self.values.append(values)

    def state(self, is_up: bool, text: str) -> None:
        """Record the state of the base."""
        self.states.append((is_up, text))
        self.order.append("up" if is_up else "lost")

    def dropped(self, what: str) -> None:
        """Record an input that could not be read."""
        self.lost.append(what)


@dataclass(frozen=True, slots=True, eq=False)
class DriverHarness:
    """A base, a driver that runs with it, and the driver's sink."""

    rig: Rig
    driver: Driver
    sink: CollectingSink
    task: asyncio.Task[None]

    async def until(self, condition: Callable[[], bool], *, publishing: bool = False) -> None:
        """Wait for a condition, while the base publishes or stays silent."""
        async with asyncio.timeout(TIMEOUT):
            while not condition():
                if publishing:
                    self.rig.publish()
                await asyncio.sleep(POLL_PERIOD)

    async def connect(self) -> None:
        """Let the base publish until the driver reports it up."""
        await self.until(lambda: self.sink.is_up, publishing=True)
        self.rig.commands()

    async def command(self) -> Twist:
        """The next command that reaches the base, which stays silent."""
        taken: list[Twist] = []

        def has_come() -> bool:
            taken.extend(self.rig.commands())
            return bool(taken)

        await self.until(has_come)
        return taken[0]

    async def end(self) -> None:
        """Cancel the driver and wait until it has ended."""
        self.task.cancel()
        async with asyncio.timeout(TIMEOUT):
            await asyncio.gather(self.task, return_exceptions=True)

    def run_again(self, sink: CollectingSink) -> AbstractAsyncContextManager[DriverHarness]:
        """Run the same driver once more, after `end`, with another sink."""
        return _running(self.rig, self.driver, sink)


@asynccontextmanager
async def running_driver(rig: Rig) -> AsyncIterator[DriverHarness]:
    """A driver that runs with the rig's base; both end with the context."""
    try:
        async with _running(rig, rig.make({}), CollectingSink()) as harness:
            yield harness
    finally:
        rig.close()


@asynccontextmanager
async def _running(rig: Rig, driver: Driver, sink: CollectingSink) -> AsyncIterator[DriverHarness]:
    harness = DriverHarness(rig, driver, sink, asyncio.create_task(driver.run(sink)))
    try:
        yield harness
    finally:
        await harness.end()  # it takes what the driver raised, which would be logged at any time


def is_running(pid: int) -> bool:
    """True while a process runs; False for one that waits to be reaped."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] not in ("Z", "X")
