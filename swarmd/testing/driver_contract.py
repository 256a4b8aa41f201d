"""The part of the driver contract that is about ends: zero comes last, and nothing is left.

What every driver must hold to, as tests.

In your own tests, run by pytest::

    from swarmd.testing.driver_contract import DriverContract

    class TestMyDriver(DriverContract):
        def rig(self):
            return MyRig()      # a fake of your robot's base, see `Rig`
"""

from __future__ import annotations

import asyncio
import itertools
import os
import threading
import time
import uuid
from collections.abc import Awaitable, Callable
from pathlib import Path

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array, Scan, Twist
from swarmd.testing.driver_rig import (
    CAP,
    PACE,
    CollectingSink,
    DetachableRig,
    DriverHarness,
    Rig,
    ScriptedRig,
    is_running,
    running_driver,
)

SETTLE = 0.3
"""Seconds in which what was sent arrives, and what should not have been sent as well."""

_MARK = "SWARMD_DRIVER_CONTRACT"
_MANY = 200
_AT_ONCE = 2.0


def mortal_of(harness: DriverHarness) -> DetachableRig:
    """The rig, if its base can be taken away; else the test is skipped."""
    if not isinstance(harness.rig, DetachableRig):
        pytest.skip("this rig is not Mortal")
    return harness.rig


async def moving(harness: DriverHarness) -> list[Twist]:
    """Command until the base moves; what has reached it."""
    taken: list[Twist] = []

    def moves() -> bool:
        harness.driver.send(Twist(0.1), 1, 1)
        taken.extend(harness.rig.commands())
        return bool(taken) and not taken[-1].is_zero

    await harness.until(moves, speaking=True)
    return taken


async def ends_with_zero(harness: DriverHarness, taken: list[Twist]) -> None:
    """The last that reaches the base is zero, and stays so."""

    def stands() -> bool:
        taken.extend(harness.rig.commands())
        return bool(taken) and taken[-1].is_zero

    await harness.until(stands)
    await asyncio.sleep(SETTLE)
    taken.extend(harness.rig.commands())
    assert taken[-1].is_zero


def marked(mark: str) -> list[int]:
    """The living processes that were started with this mark in their environment."""
    wanted, found = f"{_MARK}={mark}".encode(), []
    for environ in Path("/proc").glob("[0-9]*/environ"):
        try:
            if wanted in environ.read_bytes().split(b"\0"):
                found.append(int(environ.parent.name))
        except OSError:  # it has ended meanwhile, or is somebody else's
            continue
    return [pid for pid in found if is_running(pid)]


def open_files() -> int:
    """How many files, sockets and pipes this process holds."""
    return len(os.listdir("/proc/self/fd"))


class Broken(CollectingSink):
    """A sink that cannot bear the loss of its base."""

    def state(self, is_up: bool, text: str) -> None:
        """Remember it, and fail if the base was there before."""
        was_up = self.is_up
        super().state(is_up, text)
        if was_up and not is_up:
            raise RuntimeError("this sink is broken")


class DriverEnds:
    """Inherited by `DriverContract`."""

    def rig(self) -> Rig:
        """A fresh base, not yet speaking."""
        raise NotImplementedError

    def play(
        self, story: Callable[[DriverHarness], Awaitable[None]], *, connected: bool = True
    ) -> None:
        """Run a story on a stage whose driver has found its base (or not yet)."""

        async def run() -> None:
            async with running_driver(self.rig()) as harness:
                if connected:
                    await harness.connect()
                await story(harness)

        asyncio.run(run())

    def test_the_last_command_is_zero_and_nothing_follows(self) -> None:
        """Every way out sends zero."""

        async def story(harness: DriverHarness) -> None:
            taken = await moving(harness)
            await harness.end()
            harness.driver.send(Twist(0.1), 2, 2)
            await ends_with_zero(harness, taken)

        self.play(story)

    def test_a_command_just_before_the_end_does_not_outlive_it(self) -> None:
        """The zero of the way out comes after all that was sent, however shortly before."""

        async def story(harness: DriverHarness) -> None:
            for seq in range(5):
                harness.driver.send(Twist(0.1), seq, seq)
            await harness.end()
            await ends_with_zero(harness, [])

        self.play(story)

    def test_a_base_that_falls_silent_is_told_to_stand(self) -> None:
        """Its sensors may be gone and its wheels may not."""

        async def story(harness: DriverHarness) -> None:
            taken = await moving(harness)
            await harness.until(lambda: not harness.sink.is_up)
            harness.driver.send(Twist(0.1), 2, 2)
            await ends_with_zero(harness, taken)

        self.play(story)

    def test_the_last_command_is_zero_though_its_sink_fails(self) -> None:
        """An exception is a way out like any other."""

        async def story(harness: DriverHarness) -> None:
            await harness.end()
            heard = Broken()
            task = asyncio.create_task(harness.driver.run(heard))
            again = DriverHarness(harness.rig, harness.driver, heard, task)
            await again.connect()
            taken = await moving(again)
            await again.until(lambda: not heard.is_up)
            await again.end()
            await ends_with_zero(again, taken)

        self.play(story)

    def test_nobody_waits_for_a_base_that_is_gone(self) -> None:
        """A command that cannot be sent is dropped at once: the tick must go on."""

        async def story(harness: DriverHarness) -> None:
            await moving(harness)
            mortal_of(harness).disconnect()
            began = time.monotonic()
            for seq in range(_MANY):
                harness.driver.send(Twist(0.1), seq, seq)
            assert time.monotonic() - began < _AT_ONCE
            mortal_of(harness).reconnect()

        self.play(story)

    def test_runs_again_after_it_has_ended(self) -> None:
        """`run` leaves nothing behind that would keep a second one from working."""

        async def story(harness: DriverHarness) -> None:
            await harness.end()
            await self._run_once(harness)

        self.play(story)

    def test_leaves_no_task_file_or_process_behind(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Neither a session nor a helper outlives `run`, but for what says zero a little longer."""
        mark = uuid.uuid4().hex

        async def story(harness: DriverHarness) -> None:
            await harness.end()
            monkeypatch.setenv(_MARK, mark)
            tasks = asyncio.all_tasks()
            await self._run_once(harness)
            await asyncio.sleep(SETTLE)
            before = open_files()
            for _ in range(3):
                await self._run_once(harness)
            await harness.until(lambda: asyncio.all_tasks() <= tasks)
            await harness.until(lambda: open_files() <= before)
            await harness.until(lambda: not marked(mark))

        self.play(story)

    async def _run_once(self, harness: DriverHarness) -> None:
        heard = CollectingSink()
        task = asyncio.create_task(harness.driver.run(heard))
        again = DriverHarness(harness.rig, harness.driver, heard, task)
        await again.connect()
        harness.driver.send(Twist(0.1), 1, 1)
        assert (await again.command()).is_zero
        await again.end()


__all__ = [
    "CAP",
    "CollectingSink",
    "DetachableRig",
    "DriverContract",
    "DriverHarness",
    "Rig",
    "ScriptedRig",
    "running_driver",
]


def _bearings(harness: DriverHarness) -> Array:
    """(n,) the nominal bearings of the rig's sensor."""
    return harness.rig.platform.scan.bearings


def _regular(harness: DriverHarness, count: int) -> Array:
    """(count,) bearings in rad, evenly around from the sensor's first."""
    first = float(_bearings(harness)[0])
    return np.asarray(first + 2.0 * np.pi / count * np.arange(count), dtype=np.float64)


def _speaker(harness: DriverHarness) -> ScriptedRig:
    """The rig, if its base can be made to say anything; else the test is skipped."""
    if not isinstance(harness.rig, ScriptedRig):
        pytest.skip("this rig is no Speaker")
    return harness.rig


_ENOUGH = 5


class DriverContract(DriverEnds):
    """Inherit, and give a rig."""

    def test_says_that_the_base_is_there_before_it_hands_on_anything(self) -> None:
        """The core drops what comes from a base that is not there."""

        async def story(harness: DriverHarness) -> None:
            heard = harness.sink
            await harness.until(lambda: "scan" in heard.order, speaking=True)
            assert "up" in heard.order
            before = heard.order[: heard.order.index("up")]
            assert set(before) <= {"lost"}

        self.play(story, connected=False)

    def test_scans_are_whole_and_go_forward(self) -> None:
        """Matching arrays, the platform's limits, sequence and stamp that advance."""

        async def story(harness: DriverHarness) -> None:
            heard = harness.sink
            await harness.until(lambda: len(heard.scans) >= 5, speaking=True)
            assert heard.threads == {threading.get_ident()}
            for scan in heard.scans:
                assert scan.ranges.shape == scan.bearings.shape == (len(scan.ranges),)
                assert scan.ranges.dtype == scan.bearings.dtype == np.float64
                assert np.isfinite(scan.bearings).all()
                assert scan.range_min == harness.rig.platform.scan.range_min
                assert scan.range_max == harness.rig.platform.scan.range_max
            for before, after in itertools.pairwise(heard.scans):
                assert after.seq > before.seq
                assert after.stamp > before.stamp

        self.play(story)

    def test_odometry_is_finite_and_goes_forward(self) -> None:
        """No NaN, and stamps that advance."""

        async def story(harness: DriverHarness) -> None:
            heard = harness.sink
            await harness.until(lambda: len(heard.odometries) >= 5, speaking=True)
            for odometry in heard.odometries:
                pose = odometry.pose
                assert np.isfinite([pose.x, pose.y, pose.yaw]).all()
                assert odometry.twist.is_finite
            for before, after in itertools.pairwise(heard.odometries):
                assert after.stamp > before.stamp

        self.play(story)

    def test_what_is_commanded_while_there_is_no_base_is_dropped(self) -> None:
        """No queue: nothing late may start motion."""

        async def story(harness: DriverHarness) -> None:
            for _ in range(10):
                harness.driver.send(Twist(0.1, 0.1), 0, 0)
                await asyncio.sleep(PACE)
            await harness.until(lambda: harness.sink.is_up, speaking=True)
            assert all(twist.is_zero for twist in harness.rig.commands())

        self.play(story, connected=False)

    def test_the_first_command_is_zero_and_the_next_as_asked(self) -> None:
        """A base that was away must not start with what was wished meanwhile."""

        async def story(harness: DriverHarness) -> None:
            harness.driver.send(Twist(0.1, -0.2), 1, 1)
            assert (await harness.command()).is_zero
            harness.driver.send(Twist(0.1, -0.2), 2, 2)
            sent = await harness.command()
            assert sent.linear == pytest.approx(0.1, abs=1e-6)
            assert sent.angular == pytest.approx(-0.2, abs=1e-6)

        self.play(story)

    def test_a_base_that_falls_silent_is_lost_and_gets_zero_first_when_it_is_back(self) -> None:
        """Silence is told, with a reason, and a return is a new beginning."""

        async def story(harness: DriverHarness) -> None:
            for seq in range(2):
                harness.driver.send(Twist(0.1), seq, seq)
            await harness.until(lambda: not harness.sink.is_up)
            assert harness.sink.states[-1][1]
            harness.rig.commands()
            harness.driver.send(Twist(0.1), 3, 3)
            await harness.connect()
            harness.driver.send(Twist(0.1), 4, 4)
            assert (await harness.command()).is_zero

        self.play(story)

    def test_a_base_that_vanishes_and_returns_gets_zero_first(self) -> None:
        """As it falls silent, but with its links cut: the driver finds it again by itself."""

        async def story(harness: DriverHarness) -> None:
            rig = mortal_of(harness)
            for seq in range(3):
                harness.driver.send(Twist(0.1), seq, seq)
            rig.disconnect()
            await harness.until(lambda: not harness.sink.is_up)
            harness.driver.send(Twist(0.1), 4, 4)
            rig.reconnect()
            await harness.connect()
            harness.driver.send(Twist(0.1), 5, 5)
            assert (await harness.command()).is_zero

        self.play(story)

    def test_garbage_is_dropped_counted_and_survived(self) -> None:
        """No bytes from outside end a driver, and what follows them is heard."""

        async def story(harness: DriverHarness) -> None:
            rig, heard = _speaker(harness), harness.sink
            await asyncio.sleep(SETTLE)
            before = len(heard.scans), len(heard.odometries)

            def is_counted() -> bool:
                rig.publish_garbage()
                return len(heard.lost) >= _ENOUGH

            await harness.until(is_counted)
            known = len(heard.scans), len(heard.odometries)
            assert known == before, "garbage was handed on"
            await harness.until(lambda: len(heard.scans) > known[0] + 2, speaking=True)
            await harness.until(lambda: len(heard.odometries) > known[1] + 2, speaking=True)
            assert not harness.task.done()

        self.play(story)

    def test_what_is_unknown_or_not_there_arrives_as_it_was_measured(self) -> None:
        """NaN and infinity are told apart from ranges, in a whole sweep of them too."""

        async def story(harness: DriverHarness) -> None:
            rig = _speaker(harness)
            n = len(_bearings(harness))
            some = np.full(n, 1.5)
            some[:2] = (np.nan, np.inf)
            for seq, ranges in enumerate((np.full(n, np.nan), some, np.full(n, np.inf)), 1000):
                heard = await self._heard(harness, rig, seq, ranges)
                assert heard.ranges.shape == ranges.shape
                assert np.allclose(heard.ranges, ranges, rtol=1e-6, equal_nan=True)

        self.play(story)

    def test_the_number_of_rays_may_change_from_sweep_to_sweep(self) -> None:
        """A real LDS-02 does so all the time; ranges and bearings agree in each."""

        async def story(harness: DriverHarness) -> None:
            rig = _speaker(harness)
            n = len(_bearings(harness))
            for seq, count in enumerate((n, n + 3, n - 2, n + 1), 1000):
                ranges = np.linspace(0.5, 2.0, count)
                heard = await self._heard(harness, rig, seq, ranges)
                assert heard.ranges.shape == ranges.shape
                assert np.allclose(heard.ranges, ranges, rtol=1e-6)
                wanted = _regular(harness, count)
                assert heard.bearings.shape == ranges.shape
                off = np.abs((heard.bearings - wanted + np.pi) % (2.0 * np.pi) - np.pi)
                assert off.max() < 1e-3

        self.play(story)

    async def _heard(
        self, harness: DriverHarness, rig: ScriptedRig, seq: int, ranges: Array
    ) -> Scan:
        """What the driver makes of these ranges, spread evenly, once they have come."""
        spec, bearings = harness.rig.platform.scan, _regular(harness, len(ranges))
        scan = Scan(seq, 0.1 * seq, ranges, bearings, spec.range_min, spec.range_max)
        known = len(harness.sink.scans)
        rig.publish_scan(scan)
        rig.publish_odometry()
        await harness.until(lambda: len(harness.sink.scans) > known)
        return harness.sink.scans[-1]

    @pytest.mark.parametrize(("rate", "seconds"), [(1.0, 3.2), (50.0, 1.0)])
    def test_slow_and_fast_sensors_are_heard_all_the_same(
        self, rate: float, seconds: float
    ) -> None:
        """One sweep a second is no silence, and fifty are no flood."""

        async def story(harness: DriverHarness) -> None:
            rig, heard, loop = _speaker(harness), harness.sink, asyncio.get_running_loop()
            spec, n = harness.rig.platform.scan, len(_bearings(harness))
            known, begin, sent = len(heard.scans), loop.time(), 0
            while (passed := loop.time() - begin) < seconds:
                rig.publish_odometry()
                if passed * rate >= sent:
                    bearings, seq = _regular(harness, n), 1000 + sent
                    ranges = np.linspace(0.5, 2.0 + 0.01 * (sent % 7), n)
                    rig.publish_scan(
                        Scan(seq, seq / rate, ranges, bearings, spec.range_min, spec.range_max)
                    )
                    sent += 1
                await asyncio.sleep(min(0.05, 1.0 / rate))
            await harness.until(lambda: len(heard.scans) > known, speaking=True)
            assert heard.is_up
            assert "lost" not in heard.order[heard.order.index("up") :]
            assert len(heard.scans) - known >= sent // 2  # the newest counts, not each

        self.play(story)

    def test_check_finds_the_base_and_moves_nothing(self) -> None:
        """`swarmd --check` is safe on a robot that stands on a table."""

        async def run() -> None:
            rig = self.rig()
            checking = asyncio.create_task(rig.make({}).check(CAP))
            while not checking.done():
                rig.publish()
                await asyncio.sleep(PACE)
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
