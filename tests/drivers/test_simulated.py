"""The simulated driver against a body in the test's hand, over real Zenoh on loopback."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

import numpy as np
import pytest
import zenoh

from swarmd.drivers.simulated import SILENCE, SimulatedDriver
from swarmd.errors import ConfigError
from swarmd.platforms import load_platform
from swarmd.sensing import (
    CommandWire,
    decode_command,
    encode_neighbors,
    encode_odometry,
    encode_readings,
    encode_scan,
)
from swarmd.sim.link import WorldLink
from swarmd.values import Neighbor, Odometry, Pose, Scan, Twist, Value

CAP = 20.0
PLATFORM = load_platform("burger")
SPEC = PLATFORM.scan
ODOMETRY = Odometry(1.0, Pose(0.1, 0.2, 0.3), Twist(0.1, 0.2))


def scan(seq: int) -> Scan:
    ranges = np.full(360, 1.5)
    ranges[:3] = (np.inf, -np.inf, np.nan)
    return Scan(seq, 0.2 * seq, ranges, SPEC.bearings, SPEC.range_min, SPEC.range_max)


@dataclass
class Heard:
    """A sink that remembers everything."""

    scans: list[Scan] = field(default_factory=list)
    odometries: list[Odometry] = field(default_factory=list)
    neighborhoods: list[tuple[Neighbor, ...]] = field(default_factory=list)
    values: list[Mapping[str, float]] = field(default_factory=list)
    states: list[tuple[bool, str]] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    order: list[str] = field(default_factory=list)

    def scan(self, scan: Scan) -> None:
        self.scans.append(scan)
        self.order.append("scan")

    def odometry(self, odometry: Odometry) -> None:
        self.odometries.append(odometry)

    def neighbors(self, neighbors: tuple[Neighbor, ...]) -> None:
        self.neighborhoods.append(neighbors)

    def readings(self, values: Mapping[str, float]) -> None:
        self.values.append(values)

    def state(self, is_up: bool, text: str) -> None:
        self.states.append((is_up, text))
        self.order.append("up" if is_up else "lost")

    def dropped(self, what: str) -> None:
        self.lost.append(what)


@dataclass
class Stage:
    """A body (the world's end of the link), a driver running against it, and what it heard."""

    link: WorldLink
    driver: SimulatedDriver
    heard: Heard
    task: asyncio.Task[None]

    def body_sends(self, name: str, payload: bytes) -> None:
        self.link.publish("r", name, payload)

    def command(self) -> CommandWire | None:
        """The newest command at the body since the last call."""
        taken = self.link.take_commands().get("r")
        return None if taken is None else decode_command(taken[0])

    async def connected(self) -> None:
        """Send odometry until the driver is up."""
        async with asyncio.timeout(CAP):
            while not self.heard.states or not self.heard.states[-1][0]:
                self.body_sends("odometry", encode_odometry(ODOMETRY))
                await asyncio.sleep(0.005)

    async def until(self, condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(CAP):
            while not condition():
                await asyncio.sleep(0.002)

    async def next_command(self) -> CommandWire:
        async with asyncio.timeout(CAP):
            while (command := self.command()) is None:
                await asyncio.sleep(0.002)
            return command


def make(endpoint: Value = "tcp/127.0.0.1:7790", **options: Value) -> SimulatedDriver:
    return SimulatedDriver(
        swarm="s", robot="r", platform=PLATFORM, options={"endpoint": endpoint, **options}
    )


@asynccontextmanager
async def stage() -> AsyncIterator[Stage]:
    link = WorldLink("s", ("r",), "tcp/127.0.0.1:0")
    driver, heard = make(link.endpoint), Heard()
    task = asyncio.create_task(driver.run(heard))
    try:
        yield Stage(link, driver, heard, task)
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        link.close()


def play(story: Callable[[Stage], Awaitable[None]]) -> None:
    async def run() -> None:
        async with stage() as one:
            await one.connected()
            await story(one)

    asyncio.run(run())


def test_is_simulated() -> None:
    assert make().is_simulated


def test_all_senses_arrive_as_they_were_sent() -> None:
    async def story(stage: Stage) -> None:
        neighbors = (Neighbor("x", 0.0, 1.0, 0.5), Neighbor("y", 0.0))
        stage.body_sends("scan", encode_scan(scan(7)))
        stage.body_sends("neighbors", encode_neighbors(neighbors))
        stage.body_sends("readings", encode_readings({"light": 0.25}))
        heard = stage.heard
        await stage.until(lambda: bool(heard.scans and heard.neighborhoods and heard.values))
        assert heard.scans[0].seq == 7
        np.testing.assert_allclose(heard.scans[0].ranges, scan(7).ranges)
        np.testing.assert_allclose(heard.scans[0].bearings, SPEC.bearings, atol=1e-9)
        assert heard.odometries[0] == ODOMETRY
        assert heard.neighborhoods == [neighbors]
        assert heard.values == [{"light": 0.25}]

    play(story)


def test_says_that_there_is_no_body_until_there_is_one_and_before_its_first_sense() -> None:
    async def run() -> None:
        async with stage() as one:
            await one.until(lambda: bool(one.heard.states))
            async with asyncio.timeout(CAP):
                while not one.heard.scans:
                    one.body_sends("scan", encode_scan(scan(1)))
                    await asyncio.sleep(0.005)
            assert one.heard.order[:3] == ["lost", "up", "scan"]
            assert one.link.endpoint in one.heard.states[0][1]

    asyncio.run(run())


def test_nothing_is_sent_before_a_body_is_heard() -> None:
    async def run() -> None:
        async with stage() as one:
            for _ in range(20):
                one.driver.send(Twist(0.2), 1, 1)
                await asyncio.sleep(0.01)
            await one.connected()
            one.driver.send(Twist(0.1), 2, 2)
            assert (await one.next_command()).scan_seq == 2

    asyncio.run(run())


def test_the_first_command_is_zero_whatever_is_asked() -> None:
    async def story(stage: Stage) -> None:
        stage.driver.send(Twist(0.2, 0.5), 1, 1)
        first = await stage.next_command()
        stage.driver.send(Twist(0.2, 0.5), 2, 1)
        second = await stage.next_command()
        assert (first.linear, first.angular, first.lateral, first.scan_seq) == (0.0, 0.0, 0.0, 1)
        assert (second.linear, second.angular, second.scan_seq, second.wish_seq) == (0.2, 0.5, 2, 1)

    play(story)


def test_silence_is_a_lost_body_and_nothing_is_sent_meanwhile() -> None:
    async def story(stage: Stage) -> None:
        await stage.until(lambda: not stage.heard.states[-1][0])
        stage.command()
        stage.driver.send(Twist(0.2), 3, 3)
        assert f"{SILENCE:g} s" in stage.heard.states[-1][1]
        await stage.connected()
        # Back again: zero first, though commands were sent before the silence.
        stage.driver.send(Twist(0.2), 4, 4)
        command = await stage.next_command()
        assert (command.linear, command.scan_seq) == (0.0, 4)

    play(story)


def test_finds_a_body_that_starts_later_and_one_that_comes_back() -> None:
    async def run() -> None:
        first = WorldLink("s", ("r",), "tcp/127.0.0.1:0")
        endpoint = first.endpoint
        first.close()
        driver, heard = make(endpoint), Heard()
        task = asyncio.create_task(driver.run(heard))
        one = Stage(first, driver, heard, task)
        await one.until(lambda: bool(heard.states))
        for _ in range(2):
            one.link = WorldLink("s", ("r",), endpoint)
            await one.connected()
            one.link.close()
            await one.until(lambda: not heard.states[-1][0])
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        assert [is_up for is_up, _ in heard.states] == [False, True, False, True, False]

    asyncio.run(run())


def test_sends_zero_on_the_way_out() -> None:
    async def story(stage: Stage) -> None:
        for seq in range(2):
            stage.driver.send(Twist(0.2), seq, seq)
        await stage.until(lambda: (command := stage.command()) is not None and command.linear > 0.0)
        stage.task.cancel()
        last = await stage.next_command()
        await asyncio.gather(stage.task, return_exceptions=True)
        assert (last.linear, last.angular, last.lateral) == (0.0, 0.0, 0.0)
        stage.driver.send(Twist(0.2), 9, 9)  # too late, and no error
        assert stage.command() is None

    play(story)


def test_sends_zero_when_its_sink_fails() -> None:
    class Broken(Heard):
        def state(self, is_up: bool, text: str) -> None:
            super().state(is_up, text)
            if len(self.states) == 3:  # lost again
                raise RuntimeError("broken")

    async def run() -> None:
        async with stage() as one:
            one.task.cancel()
            await asyncio.gather(one.task, return_exceptions=True)
            one.heard = Broken()
            one.task = asyncio.create_task(one.driver.run(one.heard))
            await one.connected()
            one.link.take_commands()
            with pytest.raises(RuntimeError, match="broken"):
                await one.task
            last = await one.next_command()
            assert (last.linear, last.scan_seq) == (0.0, -1)

    asyncio.run(run())


@pytest.mark.parametrize("payload", [b"", b"\x01", b"\x02\xc0", b"\x01" + b"\xff" * 200_000])
@pytest.mark.parametrize("name", ["scan", "odometry", "neighbors", "readings"])
def test_what_cannot_be_read_is_counted_and_no_sign_of_life(name: str, payload: bytes) -> None:
    async def story(stage: Stage) -> None:
        stage.body_sends(name, payload)
        await stage.until(lambda: bool(stage.heard.lost))
        assert stage.heard.lost == [f"hw/{name}"]
        assert not stage.heard.scans

    play(story)


def test_garbage_alone_does_not_bring_a_body_up() -> None:
    async def run() -> None:
        async with stage() as one:
            async with asyncio.timeout(CAP):
                while not one.heard.lost:
                    one.body_sends("scan", b"\x01rubbish")
                    await asyncio.sleep(0.005)
            assert [is_up for is_up, _ in one.heard.states] == [False]

    asyncio.run(run())


def test_a_run_cancelled_while_it_opens_leaves_no_session_behind() -> None:
    go_on = threading.Event()
    sessions: list[zenoh.Session] = []

    class Slow(SimulatedDriver):
        def _open(self) -> zenoh.Session:
            go_on.wait(CAP)
            sessions.append(super()._open())
            return sessions[-1]

    async def run() -> None:
        link = WorldLink("s", ("r",), "tcp/127.0.0.1:0")
        driver = Slow(swarm="s", robot="r", platform=PLATFORM, options={"endpoint": link.endpoint})
        heard = Heard()
        task = asyncio.create_task(driver.run(heard))
        while not heard.states:
            await asyncio.sleep(0)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        go_on.set()
        async with asyncio.timeout(CAP):
            while not sessions or not sessions[0].is_closed():
                await asyncio.sleep(0.005)
        link.close()

    asyncio.run(run())


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"endpont": "tcp/127.0.0.1:1"}, "did you mean 'endpoint'"),
        ({"endpoint": 7790}, "endpoint is 7790; wanted is such as"),
        ({"endpoint": "127.0.0.1:7790"}, "wanted is such as tcp/"),
    ],
)
def test_options_it_does_not_know_are_refused(options: Mapping[str, Value], complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        SimulatedDriver(swarm="s", robot="r", platform=PLATFORM, options=options)


def test_check_finds_a_body_and_moves_nothing() -> None:
    async def run() -> None:
        link = WorldLink("s", ("r",), "tcp/127.0.0.1:0")

        async def body() -> None:
            while True:
                link.publish("r", "scan", encode_scan(scan(1)))
                link.publish("r", "odometry", encode_odometry(ODOMETRY))
                await asyncio.sleep(0.01)

        task = asyncio.create_task(body())
        findings = await make(link.endpoint).check(CAP)
        task.cancel()
        commands = link.take_commands()
        link.close()
        assert [finding.subject for finding in findings] == ["scan", "odometry", "cmd_vel"]
        assert all(finding.is_well for finding in findings)
        assert all(decode_command(c).linear == 0.0 for c, _ in commands.values())

    asyncio.run(run())


def test_check_tells_what_is_missing_and_the_next_step() -> None:
    findings = asyncio.run(make("tcp/127.0.0.1:9").check(0.3))
    assert not any(finding.is_well for finding in findings)
    assert all("swarmctl sim up" in finding.text for finding in findings)


def test_a_second_run_after_the_first_works() -> None:
    async def story(stage: Stage) -> None:
        stage.task.cancel()
        await asyncio.gather(stage.task, return_exceptions=True)
        stage.heard.states.clear()
        stage.task = asyncio.create_task(stage.driver.run(stage.heard))
        await stage.connected()
        assert [is_up for is_up, _ in stage.heard.states] == [False, True]

    play(story)
