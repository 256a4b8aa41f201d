"""What every driver must hold to, as tests.

In your own tests, run by pytest::

    from swarmd.testing.driver_contract import DriverContract

    class TestMyDriver(DriverContract):
        def rig(self):
            return MyRig()      # a fake of your robot's base, see `Rig`
"""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import pytest

from swarmd.driver import Driver
from swarmd.errors import ConfigError
from swarmd.values import Neighbor, Odometry, Platform, Scan, Twist, Value

CAP = 30.0
"""Seconds that anything may take before the test fails; nothing waits that long if all is well."""

_PACE = 0.01


class Rig(Protocol):
    """The robot's base in a test's hand. It is silent at first."""

    platform: Platform

    def make(self, options: Mapping[str, Value]) -> Driver:
        """A driver for this base, with `options` added to those it needs to find the base."""

    def speak(self) -> None:
        """Make the base send a scan and an odometry, each with the next stamp."""

    def commands(self) -> Sequence[Twist]:
        """What has reached the base since the last call, oldest first; the newest is enough."""

    def close(self) -> None:
        """End the base."""


@dataclass(slots=True)
class Heard:
    """A sink that remembers everything."""

    scans: list[Scan] = field(default_factory=list)
    odometries: list[Odometry] = field(default_factory=list)
    neighborhoods: list[tuple[Neighbor, ...]] = field(default_factory=list)
    values: list[Mapping[str, float]] = field(default_factory=list)
    states: list[tuple[bool, str]] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    order: list[str] = field(default_factory=list)

    @property
    def is_up(self) -> bool:
        """What the driver said last of its base."""
        return bool(self.states) and self.states[-1][0]

    def scan(self, scan: Scan) -> None:
        """Remember a sweep."""
        self.scans.append(scan)
        self.order.append("scan")

    def odometry(self, odometry: Odometry) -> None:
        """Remember a pose and twist."""
        self.odometries.append(odometry)
        self.order.append("odometry")

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
class Stage:
    """A base, a driver running against it, and what the driver told."""

    rig: Rig
    driver: Driver
    heard: Heard
    task: asyncio.Task[None]

    async def until(self, condition: Callable[[], bool], *, speaking: bool = False) -> None:
        """Wait for a condition, with the base speaking meanwhile or silent."""
        async with asyncio.timeout(CAP):
            while not condition():
                if speaking:
                    self.rig.speak()
                await asyncio.sleep(_PACE)

    async def connect(self) -> None:
        """Let the base speak until the driver says that it is there."""
        await self.until(lambda: self.heard.is_up, speaking=True)
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
async def on_stage(rig: Rig) -> AsyncIterator[Stage]:
    """A driver running against the rig's base, both gone afterwards."""
    driver, heard = rig.make({}), Heard()
    stage = Stage(rig, driver, heard, asyncio.create_task(driver.run(heard)))
    try:
        yield stage
    finally:
        await stage.end()
        rig.close()


class DriverContract:
    """Inherit, and give a rig."""

    def rig(self) -> Rig:
        """A fresh base, not yet speaking."""
        raise NotImplementedError

    def play(self, story: Callable[[Stage], Awaitable[None]], *, connected: bool = True) -> None:
        """Run a story on a stage whose driver has found its base (or not yet)."""

        async def run() -> None:
            async with on_stage(self.rig()) as stage:
                if connected:
                    await stage.connect()
                await story(stage)

        asyncio.run(run())

    def test_says_that_the_base_is_there_before_it_hands_on_anything(self) -> None:
        """The core drops what comes from a base that is not there."""

        async def story(stage: Stage) -> None:
            heard = stage.heard
            await stage.until(lambda: "scan" in heard.order, speaking=True)
            assert "up" in heard.order
            before = heard.order[: heard.order.index("up")]
            assert set(before) <= {"lost"}

        self.play(story, connected=False)

    def test_scans_are_whole_and_go_forward(self) -> None:
        """Matching arrays, the platform's limits, sequence and stamp that advance."""

        async def story(stage: Stage) -> None:
            heard = stage.heard
            await stage.until(lambda: len(heard.scans) >= 5, speaking=True)
            for scan in heard.scans:
                assert scan.ranges.shape == scan.bearings.shape == (len(scan.ranges),)
                assert scan.ranges.dtype == scan.bearings.dtype == np.float64
                assert np.isfinite(scan.bearings).all()
                assert scan.range_min == stage.rig.platform.scan.range_min
                assert scan.range_max == stage.rig.platform.scan.range_max
            for before, after in itertools.pairwise(heard.scans):
                assert after.seq > before.seq
                assert after.stamp > before.stamp

        self.play(story)

    def test_odometry_is_finite_and_goes_forward(self) -> None:
        """No NaN, and stamps that advance."""

        async def story(stage: Stage) -> None:
            heard = stage.heard
            await stage.until(lambda: len(heard.odometries) >= 5, speaking=True)
            for odometry in heard.odometries:
                pose = odometry.pose
                assert np.isfinite([pose.x, pose.y, pose.yaw]).all()
                assert odometry.twist.is_finite
            for before, after in itertools.pairwise(heard.odometries):
                assert after.stamp > before.stamp

        self.play(story)

    def test_what_is_commanded_while_there_is_no_base_is_dropped(self) -> None:
        """No queue: nothing late may start motion."""

        async def story(stage: Stage) -> None:
            for _ in range(10):
                stage.driver.send(Twist(0.1, 0.1), 0, 0)
                await asyncio.sleep(_PACE)
            await stage.until(lambda: stage.heard.is_up, speaking=True)
            assert all(twist.is_zero for twist in stage.rig.commands())

        self.play(story, connected=False)

    def test_the_first_command_is_zero_and_the_next_as_asked(self) -> None:
        """A base that was away must not start with what was wished meanwhile."""

        async def story(stage: Stage) -> None:
            stage.driver.send(Twist(0.1, -0.2), 1, 1)
            assert (await stage.command()).is_zero
            stage.driver.send(Twist(0.1, -0.2), 2, 2)
            sent = await stage.command()
            assert sent.linear == pytest.approx(0.1, abs=1e-6)
            assert sent.angular == pytest.approx(-0.2, abs=1e-6)

        self.play(story)

    def test_a_base_that_falls_silent_is_lost_and_gets_zero_first_when_it_is_back(self) -> None:
        """Silence is told, with a reason, and a return is a new beginning."""

        async def story(stage: Stage) -> None:
            for seq in range(2):
                stage.driver.send(Twist(0.1), seq, seq)
            await stage.until(lambda: not stage.heard.is_up)
            assert stage.heard.states[-1][1]
            stage.rig.commands()
            stage.driver.send(Twist(0.1), 3, 3)
            await stage.connect()
            stage.driver.send(Twist(0.1), 4, 4)
            assert (await stage.command()).is_zero

        self.play(story)

    def test_the_last_command_is_zero_and_nothing_follows(self) -> None:
        """Every way out sends zero."""

        async def story(stage: Stage) -> None:
            taken: list[Twist] = []

            def moves() -> bool:
                stage.driver.send(Twist(0.1), 1, 1)
                taken.extend(stage.rig.commands())
                return bool(taken) and not taken[-1].is_zero

            await stage.until(moves, speaking=True)
            await stage.end()
            stage.driver.send(Twist(0.1), 2, 2)

            def stands() -> bool:
                taken.extend(stage.rig.commands())
                return taken[-1].is_zero

            await stage.until(stands)

        self.play(story)

    def test_runs_again_after_it_has_ended(self) -> None:
        """`run` leaves nothing behind that would keep a second one from working."""

        async def story(stage: Stage) -> None:
            await stage.end()
            again = Stage(
                stage.rig, stage.driver, heard := Heard(),
                asyncio.create_task(stage.driver.run(heard)),
            )  # fmt: skip
            await again.connect()
            stage.driver.send(Twist(0.1), 1, 1)
            assert (await again.command()).is_zero
            await again.end()

        self.play(story)

    def test_check_finds_the_base_and_moves_nothing(self) -> None:
        """`swarmd --check` is safe on a robot that stands on a table."""

        async def run() -> None:
            rig = self.rig()
            checking = asyncio.create_task(rig.make({}).check(CAP))
            while not checking.done():
                rig.speak()
                await asyncio.sleep(_PACE)
            commands = rig.commands()
            rig.close()
            assert checking.result()
            assert all(finding.is_well for finding in checking.result())
            assert not commands, "another daemon may be driving this base"

        asyncio.run(run())

    def test_check_of_a_silent_base_says_what_to_do(self) -> None:
        """What is missing is named, within the time given."""

        async def run() -> None:
            rig = self.rig()
            findings = await rig.make({}).check(0.5)
            rig.close()
            unwell = [finding for finding in findings if not finding.is_well]
            assert unwell
            assert all(finding.subject and finding.text for finding in unwell)

        asyncio.run(run())

    def test_an_option_it_does_not_know_is_refused(self) -> None:
        """A misspelt option is an error that names it."""

        rig = self.rig()
        try:
            with pytest.raises(ConfigError, match="no_such_option"):
                rig.make({"no_such_option": 1})
        finally:
            rig.close()
