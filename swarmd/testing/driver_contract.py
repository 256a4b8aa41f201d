"""Tests that every driver must pass.

In your own tests, run by pytest::

    from swarmd.testing.driver_contract import DriverContract

    class TestMyDriver(DriverContract):
        def rig(self):
            return MyRig()      # a fake of your robot's base, see `Rig`
"""

from __future__ import annotations

import asyncio
import itertools
import math
import os
import threading
import time
import types
import uuid
from collections import defaultdict
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import pytest
from msgspec.structs import astuple

from swarmd.core.errors import ConfigError
from swarmd.core.events import SensorInput, tag_of
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Array, Odometry, Platform, Scan, Twist, Value
from swarmd.driver_api.driver import Driver

TIMEOUT = 60.0
"""Seconds that a test waits for a condition before it fails."""
POLL_PERIOD = 0.01
SETTLE_TIME = 0.3
"""Seconds in which what was sent arrives, and what should not have been sent as well."""
RUN_SENDS = 1000
"""Commands after which a test that waits for motion begins a new run: 10 s and more."""

_MARK = "SWARMD_DRIVER_CONTRACT"
_BURST = 200
_MAX_BURST_TIME = 2.0
_MAX_CHECKS = 3
_STALL = 0.5  # s without a turn of a loop that publishes every 0.05 s
_MIN_GARBAGE = 5


class Rig(Protocol):
    """A fake of the robot's base, controlled by a test; silent at first."""

    platform: Platform

    def make(self, options: Mapping[str, Value]) -> Driver:
        """A driver for this base, with `options` added to those it needs to find the base."""

    def publish(self) -> None:
        """Make the base publish a scan and an odometry, each with the next stamp."""

    def commands(self) -> Sequence[Twist]:
        """The commands that reached the base since the last call, oldest first.

        The newest command must be in the list; older commands may be missing.
        """

    def close(self) -> None:
        """End the base."""


@runtime_checkable
class ScriptedRig(Protocol):
    """A rig whose base publishes what the test gives it."""

    def publish_scan(self, scan: Scan) -> None:
        """Make the base publish rays, sequence number and stamp of this scan.

        The bearings are regular; the range limits of the scan are ignored.
        """

    def publish_odometry(self) -> None:
        """Make the base publish an odometry with the next stamp, and nothing else."""

    def publish_garbage(self) -> None:
        """Publish bytes that are no message, and truncated messages, on every channel."""


@runtime_checkable
class RingRig(Protocol):
    """A rig whose platform has the section `ranges`, and whose base has such sensors."""

    def publish_ranges(self, ranges: Array) -> None:
        """Make these sensors publish (n,) m, with the next stamp; n as in the platform's file."""


@runtime_checkable
class DetachableRig(Protocol):
    """A rig whose base can be taken away with all its links."""

    def disconnect(self) -> None:
        """Take the base away at once, as by a pulled plug."""

    def reconnect(self) -> None:
        """Bring the base back at the same address, silent."""


@runtime_checkable
class MotorRig(Protocol):
    """A rig whose base can move although each command that reached it is zero, such as a drone."""

    def is_at_rest(self) -> bool:
        """True while the base stands and its motors are off."""


@runtime_checkable
class HazardRig(Protocol):
    """A rig whose base reports one hazard."""

    hazard: Hazard
    hazard_options: Mapping[str, Value]  # the options with which a driver reads the hazard

    def publish_hazard(self, *, is_present: bool) -> None:
        """Make the base publish only whether it senses the hazard."""


@dataclass(slots=True)
class CollectingSink:
    """A sink that records everything. `taken`: by kind, the values of the sensor inputs."""

    taken: defaultdict[str, list[Any]] = field(default_factory=lambda: defaultdict(list))
    messages: list[tuple[str, str, bytes]] = field(default_factory=list)
    states: list[tuple[bool, str]] = field(default_factory=list)
    hold: Reason | None = None
    gets_zero: bool = False
    lost: list[str] = field(default_factory=list)
    order: list[str] = field(default_factory=list)
    threads: set[int] = field(default_factory=set)

    @property
    def is_up(self) -> bool:
        """Whether the base is up, by the driver's last report."""
        return bool(self.states) and self.states[-1][0]

    @property
    def scans(self) -> list[Scan]:
        """The scans of the lidar."""
        return self.taken["scan"]

    @property
    def rings(self) -> list[Scan]:
        """The scans of the ring of range sensors."""
        return self.taken["ranges"]

    @property
    def odometries(self) -> list[Odometry]:
        """The readings of odometry."""
        return self.taken["odometry"]

    def take(self, input: SensorInput) -> None:
        """Record the value of an input."""
        kind = tag_of(input)
        (value,) = astuple(input)
        self.taken[kind].append(value)
        self.order.append(kind)
        self.threads.add(threading.get_ident())

    def message(self, sender: str, channel: str, payload: bytes) -> None:
        """Record a message that the base's radio received."""
        self.messages.append((sender, channel, payload))

    def state(
        self, is_up: bool, text: str, *, hold: Reason | None = None, gets_zero: bool = False
    ) -> None:
        """Record the state of the base."""
        self.states.append((is_up, text))
        self.hold = hold
        self.gets_zero = gets_zero
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
        """Wait for a condition, while the base publishes scan and odometry, or stays silent."""
        async with asyncio.timeout(TIMEOUT):
            while not condition():
                if publishing:
                    self.rig.publish()
                await asyncio.sleep(POLL_PERIOD)

    async def connect(self) -> None:
        """Let the base publish until the driver reports it up."""
        await self.until(lambda: self.sink.is_up, publishing=True)
        self.rig.commands()

    async def command(self, twist: Twist | None = None, *, is_stopped: bool = False) -> Twist:
        """Send `twist` by the driver, and return the next command that reaches the base.

        `twist` is sent now and every SETTLE_TIME, since a driver drops a command that waited long.
        The base publishes nothing meanwhile.
        """
        taken: list[Twist] = []
        loop = asyncio.get_running_loop()
        due = -math.inf

        def has_come() -> bool:
            nonlocal due
            if twist is not None and loop.time() >= due:
                due = loop.time() + SETTLE_TIME
                self.driver.send(twist, 1, 1, is_stopped=is_stopped)
            taken.extend(self.rig.commands())
            return bool(taken)

        await self.until(has_come)
        return taken[0]

    def runs(self, twist: Twist) -> Callable[[], None]:
        """A call for a loop, which sends `twist`, and zero once after RUN_SENDS calls.

        A drone that a stall of the machine sent back to the ground waits for that zero: a new run.
        """
        sent = itertools.cycle([twist] * RUN_SENDS + [ZERO])
        return lambda: self.driver.send(next(sent), 1, 1)

    async def end(self) -> None:
        """Cancel the driver and wait until it has ended."""
        self.task.cancel()
        async with asyncio.timeout(TIMEOUT):
            await asyncio.gather(self.task, return_exceptions=True)

    def run_again(self, sink: CollectingSink) -> AbstractAsyncContextManager[DriverHarness]:
        """Run the same driver once more, after `end`, with another sink."""
        return _running(self.rig, self.driver, sink)


@asynccontextmanager
async def running_driver(
    rig: Rig, options: Mapping[str, Value] = types.MappingProxyType({})
) -> AsyncIterator[DriverHarness]:
    """A driver that runs with the rig's base; both end with the context."""
    try:
        async with _running(rig, rig.make(options), CollectingSink()) as harness:
            yield harness
    finally:
        rig.close()


def play(
    rig: Rig,
    story: Callable[[DriverHarness], Awaitable[None]],
    *,
    connected: bool = True,
    **options: Value,
) -> None:
    """Run a story with a driver that has found its base, or not yet."""

    async def run() -> None:
        async with running_driver(rig, options) as harness:
            if connected:
                await harness.connect()
            await story(harness)

    asyncio.run(run())


@asynccontextmanager
async def _running(rig: Rig, driver: Driver, sink: CollectingSink) -> AsyncIterator[DriverHarness]:
    harness = DriverHarness(rig, driver, sink, asyncio.create_task(driver.run(sink)))
    try:
        yield harness
    finally:
        await harness.end()  # retrieves an exception of the driver, which would be logged late


def _connected(story: Callable[[Any, DriverHarness], Awaitable[None]]) -> Callable[[Any], None]:
    """A test of a story with a driver that has found its base."""

    def test(self: DriverContract) -> None:
        self.play(partial(story, self))

    test.__name__ = story.__name__
    test.__doc__ = story.__doc__
    return test


class DriverContract:
    """The contract of a driver: subclass it in a test module with a `rig`, for pytest to run."""

    def rig(self) -> Rig:
        """A fresh base, still silent."""
        raise NotImplementedError

    def play(
        self, story: Callable[[DriverHarness], Awaitable[None]], *, connected: bool = True
    ) -> None:
        """Run a story with a driver of a fresh base."""
        play(self.rig(), story, connected=connected)

    def test_reports_the_base_up_before_it_passes_data(self) -> None:
        """The core drops data of a base that is not up."""

        async def story(harness: DriverHarness) -> None:
            sink = harness.sink
            await harness.until(lambda: "scan" in sink.order, publishing=True)
            assert "up" in sink.order
            before = sink.order[: sink.order.index("up")]
            assert set(before) <= {"lost"}

        self.play(story, connected=False)

    @_connected
    async def test_scans_are_whole_and_advance(self, harness: DriverHarness) -> None:
        """Matching arrays, the platform's range limits, advancing sequence and stamp."""
        sink = harness.sink

        def count() -> int:
            """Scans since the base was last lost, as by a stall: sequences then begin anew."""
            order = sink.order
            return order[
                max((i for i, one in enumerate(order) if one == "lost"), default=0) :
            ].count("scan")

        await harness.until(lambda: count() >= 5, publishing=True)
        assert sink.threads == {threading.get_ident()}
        for scan in sink.scans:
            assert scan.ranges.shape == scan.bearings.shape == (len(scan.ranges),)
            assert scan.ranges.dtype == scan.bearings.dtype == np.float64
            assert np.isfinite(scan.bearings).all()
            assert scan.range_min == harness.rig.platform.scan.range_min
            assert scan.range_max == harness.rig.platform.scan.range_max
        for before, after in itertools.pairwise(sink.scans[-count() :]):
            assert after.seq > before.seq
            assert after.stamp > before.stamp

    @_connected
    async def test_odometry_is_finite_and_advances(self, harness: DriverHarness) -> None:
        """No NaN, and stamps that advance."""
        sink = harness.sink
        await harness.until(lambda: len(sink.odometries) >= 5, publishing=True)
        for odometry in sink.odometries:
            pose = odometry.pose
            assert np.isfinite([pose.x, pose.y, pose.yaw]).all()
            assert odometry.twist.is_finite
        for before, after in itertools.pairwise(sink.odometries):
            assert after.stamp > before.stamp

    def test_commands_without_a_base_are_dropped(self) -> None:
        """The driver queues nothing: a late command must not start motion."""

        async def story(harness: DriverHarness) -> None:
            for _ in range(10):
                harness.driver.send(Twist(0.1, 0.1), 0, 0)
                await asyncio.sleep(POLL_PERIOD)
            await harness.until(lambda: harness.sink.is_up, publishing=True)
            assert all(twist.is_zero for twist in harness.rig.commands())

        self.play(story, connected=False)

    @_connected
    async def test_the_first_command_is_zero_and_the_next_as_sent(
        self, harness: DriverHarness
    ) -> None:
        """A base that returns must not start with a command that was sent during its absence."""
        *zeros, moving = await _moving(harness, -0.2)
        assert zeros
        assert all(twist.is_zero for twist in zeros)
        assert moving.linear == pytest.approx(0.1, abs=1e-6)
        assert moving.angular == pytest.approx(-0.2, abs=1e-6)

    @_connected
    async def test_a_stopped_robot_is_sent_zero(self, harness: DriverHarness) -> None:
        """The daemon marks the commands of a robot that is stopped, estopped or faulted."""
        taken = await _moving(harness)

        def stands() -> bool:
            harness.driver.send(ZERO, 2, 2, is_stopped=True)
            taken.extend(harness.rig.commands())
            return taken[-1].is_zero

        await harness.until(stands, publishing=True)

    @_connected
    async def test_a_silent_base_is_lost_and_gets_zero_first_when_back(
        self, harness: DriverHarness
    ) -> None:
        """A base without sensors may still drive; a base that returns starts again, at rest."""
        taken = await _moving(harness)
        await harness.until(lambda: not harness.sink.is_up)
        assert harness.sink.states[-1][1], "the reason"
        harness.driver.send(Twist(0.1), 3, 3)
        await _ends_with_zero(harness, taken)
        await _comes_back_at_rest(harness)

    @_connected
    async def test_a_base_that_vanishes_and_returns_gets_zero_first(
        self, harness: DriverHarness
    ) -> None:
        """As after a silence, but with cut links: the driver reconnects by itself.

        At once, and after a silence, as of a base that a person switches off and on.
        """
        rig = _detachable(harness)
        for is_silent_before in (False, True):
            await _moving(harness)
            if is_silent_before:
                await harness.until(lambda: not harness.sink.is_up)
            rig.disconnect()
            await harness.until(lambda: not harness.sink.is_up)
            harness.driver.send(Twist(0.1), 4, 4)
            rig.reconnect()
            await _comes_back_at_rest(harness)

    def test_a_hazard_is_told_and_its_end_and_its_silence(self) -> None:
        """The driver reports a hazard (such as a bump), its end, and a silent source of hazards.

        For a silent source, also before its first message, the driver reports NOT_HEARD, which
        holds the robot.
        """
        rig = self.rig()
        if not isinstance(rig, HazardRig):
            rig.close()
            pytest.skip("this rig is no HazardRig")

        async def story(harness: DriverHarness) -> None:
            reports: list[tuple[Hazard, ...]] = harness.sink.taken["hazards"]
            order = harness.sink.order
            await harness.until(lambda: "scan" in order, publishing=True)
            # "up": connected. The hold must come before the first scan, which lets the robot drive.
            assert order.index("up") < order.index("hazards") < order.index("scan")
            not_heard = reports[0]
            assert [hazard.kind for hazard in not_heard] == [HazardKind.NOT_HEARD]

            async def publish_until_reported(hazards: tuple[Hazard, ...]) -> None:
                """Publish the hazard of the rig, or its end, until the driver reports `hazards`."""

                def are_reported() -> bool:
                    rig.publish_hazard(is_present=bool(hazards))
                    return reports[-1] == hazards

                await harness.until(are_reported, publishing=True)

            for _ in range(2):
                await publish_until_reported((rig.hazard,))
                await publish_until_reported(())
            # Silence: the rig publishes no hazards any more, only scan and odometry. A driver that
            # loses its base by a stall of this process reports NOT_HEARD for that.
            begin = len(order)
            await harness.until(lambda: reports[-1] == not_heard, publishing=True)
            while "lost" in order[begin:]:
                await publish_until_reported(())
                begin = len(order)
                await harness.until(lambda: reports[-1] == not_heard, publishing=True)

        play(rig, story, connected=True, **rig.hazard_options)

    @_connected
    async def test_garbage_is_counted_and_survived(self, harness: DriverHarness) -> None:
        """Malformed bytes neither end a driver nor hide the messages after them."""
        rig = _scripted(harness)
        sink = harness.sink

        def received() -> tuple[int, int]:
            return len(sink.scans), len(sink.odometries)

        before = -1, -1
        while before != received():  # earlier messages may still arrive
            before = received()
            await asyncio.sleep(SETTLE_TIME)

        def is_counted() -> bool:
            rig.publish_garbage()
            return len(sink.lost) >= _MIN_GARBAGE

        await harness.until(is_counted)
        known = received()
        assert known == before, "garbage was handed on"
        await harness.until(lambda: len(sink.scans) > known[0] + 2, publishing=True)
        await harness.until(lambda: len(sink.odometries) > known[1] + 2, publishing=True)
        assert not harness.task.done()

    @_connected
    async def test_nan_and_infinity_arrive_as_measured(self, harness: DriverHarness) -> None:
        """NaN, infinity and ranges stay distinct, also in a scan of one kind only."""
        rig = _scripted(harness)
        n = len(_bearings(harness))
        some = np.full(n, 1.5)
        some[:2] = (np.nan, np.inf)
        for seq, ranges in enumerate((np.full(n, np.nan), some, np.full(n, np.inf)), 1000):
            await _sent_scan(harness, rig, seq, ranges)

    @_connected
    async def test_the_number_of_rays_may_change(self, harness: DriverHarness) -> None:
        """A real LDS-02 changes the number in each scan; ranges and bearings agree in length."""
        rig = _scripted(harness)
        n = len(_bearings(harness))
        for seq, count in enumerate((n, n + 3, n - 2, n + 1), 1000):
            ranges = np.linspace(0.5, 2.0, count)
            scan = await _sent_scan(harness, rig, seq, ranges)
            wanted = _regular(harness, count)
            assert scan.bearings.shape == ranges.shape
            off = np.abs((scan.bearings - wanted + np.pi) % (2.0 * np.pi) - np.pi)
            assert off.max() < 1e-3

    @_connected
    async def test_a_ring_of_range_sensors_is_a_scan_of_its_own(
        self, harness: DriverHarness
    ) -> None:
        """Scans of a ring of range sensors arrive as `ranges`, apart from scans of the lidar.

        Their sequence numbers and stamps rise, and no ring's scan arrives as a scan of the lidar.
        """
        rig = harness.rig
        sink = harness.sink
        spec = rig.platform.ranges
        if spec is None or not isinstance(rig, RingRig):
            pytest.skip("this rig is no RingRig")
        ranges = np.linspace(spec.range_min, spec.range_max, len(spec.bearings))
        ranges[-1] = np.inf  # a sensor without a return

        def have_three_arrived() -> bool:
            rig.publish_ranges(ranges)
            equal = [np.allclose(scan.ranges, ranges, rtol=1e-6) for scan in sink.rings]
            return sum(equal) >= 3

        await harness.until(have_three_arrived)
        for scan in sink.rings:
            assert scan.ranges.shape == ranges.shape
            bearing_errors = (scan.bearings - spec.bearings + np.pi) % (2.0 * np.pi) - np.pi
            assert np.abs(bearing_errors).max() < 1e-3
            assert (scan.range_min, scan.range_max) == (spec.range_min, spec.range_max)
        for before, after in itertools.pairwise(sink.rings):
            assert after.seq > before.seq
            assert after.stamp > before.stamp
        # No scan of the ring counts as a scan of the lidar, which has another number of rays.
        assert all(len(scan.ranges) != len(ranges) for scan in sink.scans)
        # The sink is called on the thread of the loop only.
        assert sink.threads == {threading.get_ident()}

    @pytest.mark.parametrize(("rate", "seconds"), [(1.0, 3.2), (50.0, 1.0)])
    def test_slow_and_fast_sensors_are_not_lost(self, rate: float, seconds: float) -> None:
        """A lidar at `rate` Hz for `seconds` s: the driver hands scans on, and stays connected.

        One scan a second does not count as silence, nor fifty scans as a flood.
        """

        async def story(harness: DriverHarness) -> None:
            rig = _scripted(harness)
            sink = harness.sink
            loop = asyncio.get_running_loop()
            spec = harness.rig.platform.scan
            ray_count = len(_bearings(harness))
            numbers = itertools.count()

            def next_scan() -> Scan:
                """A scan whose ranges differ from those before, as those of a real lidar do."""
                number = next(numbers)
                seq = 1000 + number  # above the numbers of earlier scans of the test
                ranges = np.linspace(0.5, 2.0 + 0.01 * (number % 7), ray_count)
                bearings = _regular(harness, ray_count)
                return Scan(seq, seq / rate, ranges, bearings, spec.range_min, spec.range_max)

            async def half_arrives() -> bool | None:
                """Publish for `seconds` s; True if half of the scans arrive and the base stays.

                None if they do not, but this process stood still, which makes its base silent.
                """
                arrived_before = len(sink.scans)
                states_before = len(sink.order)
                begin = loop.time()
                sent = 0
                last = 0.0
                widest = 0.0
                while (elapsed := loop.time() - begin) < seconds:
                    widest = max(widest, elapsed - last)
                    last = elapsed
                    rig.publish_odometry()
                    is_scan_due = elapsed * rate >= sent
                    if is_scan_due:
                        rig.publish_scan(next_scan())
                        sent += 1
                    await asyncio.sleep(min(0.05, 1.0 / rate))
                await asyncio.sleep(SETTLE_TIME)
                stays = sink.is_up and "lost" not in sink.order[states_before:]
                if stays and len(sink.scans) - arrived_before >= max(sent // 2, 1):
                    return True
                return None if max(widest, elapsed - last) > _STALL else False

            # On a busy machine newer scans replace scans that the driver has not read: try again.
            checks = 1
            end = loop.time() + TIMEOUT
            while not (has_arrived := await half_arrives()) and checks < _MAX_CHECKS:
                checks += has_arrived is False or loop.time() > end
                await harness.until(lambda: sink.is_up, publishing=True)
            assert has_arrived

        self.play(story)

    def test_check_finds_the_base_and_moves_nothing(self) -> None:
        """`swarmd --check` is safe for a robot on a table.

        The check measures rates; it is repeated if the machine has suspended this process.
        """

        async def run() -> None:
            rig = self.rig()
            for _ in range(_MAX_CHECKS):
                checking = asyncio.create_task(rig.make({}).check(TIMEOUT))
                while not checking.done():
                    rig.publish()
                    await asyncio.sleep(POLL_PERIOD)
                unwell = [finding for finding in checking.result() if not finding.is_well]
                if not unwell:
                    break
            commands = rig.commands()
            rig.close()
            assert checking.result()
            assert not unwell
            assert not commands, "another daemon may be driving this base"

        asyncio.run(run())

    def test_check_of_a_silent_base_names_the_remedy(self) -> None:
        """The findings name what is missing, within the time given."""

        async def run() -> None:
            rig = self.rig()
            findings = await rig.make({}).check(0.5)
            rig.close()
            unwell = [finding for finding in findings if not finding.is_well]
            assert unwell
            assert all(finding.subject and finding.text for finding in unwell)

        asyncio.run(run())

    def test_an_unknown_option_is_refused(self) -> None:
        """A misspelt option raises ConfigError with its name."""

        rig = self.rig()
        try:
            with pytest.raises(ConfigError, match="no_such_option"):
                rig.make({"no_such_option": 1})
        finally:
            rig.close()

    @_connected
    async def test_the_last_command_is_zero_and_nothing_follows(
        self, harness: DriverHarness
    ) -> None:
        """Cancelling the driver sends zero."""
        taken = await _moving(harness)
        await harness.end()
        harness.driver.send(Twist(0.1), 2, 2)
        await _ends_with_zero(harness, taken)

    @_connected
    async def test_a_command_just_before_the_end_does_not_outlive_it(
        self, harness: DriverHarness
    ) -> None:
        """The last zero follows every command, also a command sent just before the end."""
        for seq in range(5):
            harness.driver.send(Twist(0.1), seq, seq)
        await harness.end()
        await _ends_with_zero(harness, [])

    @_connected
    async def test_the_last_command_is_zero_if_the_sink_raises(
        self, harness: DriverHarness
    ) -> None:
        """The driver sends zero also after an exception."""
        await harness.end()
        sink = _RaisingSink()
        async with harness.run_again(sink) as again:
            await again.connect()
            taken = await _moving(again)
            sink.raises = True
            await again.until(lambda: not sink.is_up)
        await _ends_with_zero(harness, taken)

    @_connected
    async def test_sending_to_a_lost_base_does_not_block(self, harness: DriverHarness) -> None:
        """A command that cannot be sent is dropped at once, without delay of the tick."""
        await _moving(harness)
        _detachable(harness).disconnect()
        began = time.monotonic()
        for seq in range(_BURST):
            harness.driver.send(Twist(0.1), seq, seq)
        assert time.monotonic() - began < _MAX_BURST_TIME
        _detachable(harness).reconnect()

    def test_leaves_no_task_file_or_process_behind(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """A driver can run again; only a helper that sends zero may outlive `run`."""
        mark = uuid.uuid4().hex

        async def story(harness: DriverHarness) -> None:
            await harness.end()
            monkeypatch.setenv(_MARK, mark)
            tasks = asyncio.all_tasks()
            await self._run_once(harness)
            await asyncio.sleep(SETTLE_TIME)
            before = _open_files()
            for _ in range(3):
                await self._run_once(harness)
            await harness.until(lambda: asyncio.all_tasks() <= tasks)
            await harness.until(lambda: _open_files() <= before)
            await harness.until(lambda: not _marked_processes(mark))

        self.play(story)

    async def _run_once(self, harness: DriverHarness) -> None:
        async with harness.run_again(CollectingSink()) as again:
            await again.connect()
            assert (await again.command(Twist(0.1))).is_zero


async def _moving(harness: DriverHarness, angular: float = 0.0) -> list[Twist]:
    """Send commands until the base gets a command to move; returns all commands up to it."""
    taken: list[Twist] = []
    drive = harness.runs(Twist(0.1, angular))

    def moves() -> bool:
        drive()
        for command in harness.rig.commands():
            if not taken or taken[-1].is_zero:
                taken.append(command)
        return bool(taken) and not taken[-1].is_zero

    await harness.until(moves, publishing=True)
    return taken


async def _ends_with_zero(harness: DriverHarness, taken: list[Twist]) -> None:
    """Assert that the last command that reaches the base is zero, and stays the last."""

    def stands() -> bool:
        taken.extend(harness.rig.commands())
        return bool(taken) and taken[-1].is_zero

    await harness.until(stands)
    await asyncio.sleep(SETTLE_TIME)
    taken.extend(harness.rig.commands())
    assert taken[-1].is_zero


async def _comes_back_at_rest(harness: DriverHarness) -> None:
    """Let a lost base publish again; assert that nothing moves while the daemon commands no motion.

    One command to move is sent as the first one, which must reach the base as zero. Zeros to a
    stopped robot follow, as of a daemon whose run has ended with the loss.
    """
    rig = harness.rig
    loop = asyncio.get_running_loop()
    taken: list[Twist] = []

    def rests() -> bool:
        return not isinstance(rig, MotorRig) or rig.is_at_rest()

    await harness.until(rests)
    await harness.connect()
    harness.driver.send(Twist(0.1), 5, 5)
    end = loop.time() + SETTLE_TIME

    def has_stood() -> bool:
        harness.driver.send(ZERO, 6, 6, is_stopped=True)
        taken.extend(rig.commands())
        assert rests(), "the motors of a base that came back run by themselves"
        return bool(taken) and loop.time() >= end

    await harness.until(has_stood, publishing=True)
    assert all(twist.is_zero for twist in taken)


async def _sent_scan(harness: DriverHarness, rig: ScriptedRig, seq: int, ranges: Array) -> Scan:
    """Publish a scan with these ranges (m) at regular bearings; returns the driver's scan.

    The scan is published again every second, since a message that waits long may be dropped.
    TimeoutError if the driver hands no scan with these ranges on.
    """
    spec = harness.rig.platform.scan
    bearings = _regular(harness, len(ranges))
    published = Scan(seq, 0.1 * seq, ranges, bearings, spec.range_min, spec.range_max)
    earlier_count = len(harness.sink.scans)
    loop = asyncio.get_running_loop()
    publish_at = -math.inf
    arrived: list[Scan] = []

    def has_ranges(scan: Scan) -> bool:
        is_equal = scan.ranges.shape == ranges.shape
        return is_equal and np.allclose(scan.ranges, ranges, rtol=1e-6, equal_nan=True)

    def has_arrived() -> bool:  # called again and again by `harness.until`
        nonlocal publish_at
        if loop.time() >= publish_at:
            publish_at = loop.time() + 1.0
            rig.publish_scan(published)
            rig.publish_odometry()
        arrived.extend(filter(has_ranges, harness.sink.scans[earlier_count:]))
        return bool(arrived)

    await harness.until(has_arrived)
    return arrived[0]


def _bearings(harness: DriverHarness) -> Array:
    """(n,) the nominal bearings of the rig's sensor in rad."""
    return harness.rig.platform.scan.bearings


def _regular(harness: DriverHarness, count: int) -> Array:
    """(count,) regular bearings in rad over one turn, from the sensor's first bearing."""
    first = float(_bearings(harness)[0])
    return np.asarray(first + 2.0 * np.pi / count * np.arange(count), dtype=np.float64)


def _scripted(harness: DriverHarness) -> ScriptedRig:
    """The rig as a ScriptedRig; skips the test for any other rig."""
    if not isinstance(harness.rig, ScriptedRig):
        pytest.skip("this rig is no ScriptedRig")
    return harness.rig


def _detachable(harness: DriverHarness) -> DetachableRig:
    """The rig as a DetachableRig; skips the test for any other rig."""
    if not isinstance(harness.rig, DetachableRig):
        pytest.skip("this rig is no DetachableRig")
    return harness.rig


def is_running(pid: int) -> bool:
    """True while a process runs; False for a zombie."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] not in ("Z", "X")


def _marked_processes(mark: str) -> list[int]:
    """The living processes that were started with this mark in their environment."""
    wanted = f"{_MARK}={mark}".encode()
    pids = []
    for environ in Path("/proc").glob("[0-9]*/environ"):
        try:
            if wanted in environ.read_bytes().split(b"\0"):
                pids.append(int(environ.parent.name))
        except OSError:  # the process has ended, or belongs to another user
            continue
    return [pid for pid in pids if is_running(pid)]


def _open_files() -> int:
    """The count of open files, sockets and pipes of this process."""
    return len(os.listdir("/proc/self/fd"))


class _RaisingSink(CollectingSink):
    """A sink that raises when the base is lost, once it `raises`."""

    raises = False

    def state(
        self, is_up: bool, text: str, *, hold: Reason | None = None, gets_zero: bool = False
    ) -> None:
        """Record the state; RuntimeError at a loss of the base."""
        was_up = self.is_up
        super().state(is_up, text, hold=hold, gets_zero=gets_zero)
        if was_up and not is_up and self.raises:
            raise RuntimeError("this sink is broken")
