"""A robot's base in a test's hand, a driver that runs against it, and what the driver told."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

from swarmd.core.values import Neighbor, Odometry, Platform, Scan, Twist, Value
from swarmd.driver_api.driver import Driver

CAP = 30.0
"""Seconds that anything may take before the test fails; nothing waits that long if all is well."""

PACE = 0.01


class Rig(Protocol):
    """The robot's base in a test's hand. It is silent at first."""

    platform: Platform

    def make(self, options: Mapping[str, Value]) -> Driver:
        """A driver for this base, with `options` added to those it needs to find the base."""

    def publish(self) -> None:
        """Make the base send a scan and an odometry, each with the next stamp."""

    def commands(self) -> Sequence[Twist]:
        """What has reached the base since the last call, oldest first; the newest is enough."""

    def close(self) -> None:
        """End the base."""


@runtime_checkable
class ScriptedRig(Protocol):
    """What a rig may also do, if its base can be made to say anything at all."""

    def publish_scan(self, scan: Scan) -> None:
        """Make the base send this sweep; its bearings are regular, its range limits do not count.

        How many rays it has, what they measured, sequence and stamp are as given.
        """

    def publish_odometry(self) -> None:
        """Make the base send an odometry with the next stamp, and nothing else."""

    def publish_garbage(self) -> None:
        """Send bytes that are no message, and messages cut short, wherever the base speaks."""


@runtime_checkable
class DetachableRig(Protocol):
    """What a rig may also do, if its base can be taken away, links and all."""

    def disconnect(self) -> None:
        """Be gone from one moment to the next, as by a pulled plug."""

    def reconnect(self) -> None:
        """Be there again at the same place, silent."""


@dataclass(slots=True)
class CollectingSink:
    """A sink that remembers everything."""

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
        """What the driver said last of its base."""
        return bool(self.states) and self.states[-1][0]

    def scan(self, scan: Scan) -> None:
        """Remember a sweep."""
        self.scans.append(scan)
        self.order.append("scan")
        self.threads.add(threading.get_ident())

    def odometry(self, odometry: Odometry) -> None:
        """Remember a pose and twist."""
        self.odometries.append(odometry)
        self.order.append("odometry")
        self.threads.add(threading.get_ident())

    def neighbors(self, neighbors: tuple[Neighbor, ...]) -> None:
        """Remember the robots within hearing."""
        self.neighborhoods.append(neighbors)

    def readings(self, values: Mapping[str, float]) -> None:
        """Remember scalar sensors."""
        self.values.append(values)

    def state(self, is_up: bool, text: str) -> None:
        """Remember how the base is."""
        self.states.append((is_up, text))
        self.order.append("up" if is_up else "lost")

    def dropped(self, what: str) -> None:
        """Remember what could not be read."""
        self.lost.append(what)


@dataclass(frozen=True, slots=True, eq=False)
class DriverHarness:
    """A base, a driver running against it, and what the driver told."""

    rig: Rig
    driver: Driver
    sink: CollectingSink
    task: asyncio.Task[None]

    async def until(self, condition: Callable[[], bool], *, speaking: bool = False) -> None:
        """Wait for a condition, with the base speaking meanwhile or silent."""
        async with asyncio.timeout(CAP):
            while not condition():
                if speaking:
                    self.rig.publish()
                await asyncio.sleep(PACE)

    async def connect(self) -> None:
        """Let the base speak until the driver says that it is there."""
        await self.until(lambda: self.sink.is_up, speaking=True)
        self.rig.commands()

    async def command(self) -> Twist:
        """The next command that reaches the base, the base being silent."""
        taken: list[Twist] = []

        def has_come() -> bool:
            taken.extend(self.rig.commands())
            return bool(taken)

        await self.until(has_come)
        return taken[-1]

    async def end(self) -> None:
        """Cancel the driver and wait until it has ended."""
        self.task.cancel()
        async with asyncio.timeout(CAP):
            await asyncio.gather(self.task, return_exceptions=True)


@asynccontextmanager
async def running_driver(rig: Rig) -> AsyncIterator[DriverHarness]:
    """A driver running against the rig's base, both gone afterwards."""
    driver, sink = rig.make({}), CollectingSink()
    harness = DriverHarness(rig, driver, sink, asyncio.create_task(driver.run(sink)))
    try:
        yield harness
    finally:
        await harness.end()
        rig.close()


def is_running(pid: int) -> bool:
    """True while a process runs; one that has ended and waits to be reaped does not."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] not in ("Z", "X")
