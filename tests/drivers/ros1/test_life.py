"""What ends and comes back around driver `ros1`: the master, the adapter, the daemon."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import subprocess
import sys
import time
import xmlrpc.client
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from swarmd.core.values import Twist
from swarmd.drivers.ros1.adapter_process import SILENCE, STOPPING
from swarmd.drivers.ros1.driver import Ros1Driver
from swarmd.testing.driver_contract import CollectingSink, DriverHarness, running_driver
from swarmd.testing.driver_rig import is_running
from tests.drivers.ros1.rig import RosRobot, robot
from tests.support.processes import wait_until
from tests.support.roscore import RosCore

DAEMON = Path(__file__).with_name("daemon_process.py")


def play(rig: RosRobot, story: Callable[[DriverHarness, RosRobot], Awaitable[None]]) -> None:
    async def run() -> None:
        async with running_driver(rig) as harness:
            rig.do("rate", hz=10)
            await harness.until(lambda: harness.sink.is_up)
            await story(harness, rig)

    asyncio.run(run())


async def drive(harness: DriverHarness, body: RosRobot) -> None:
    """Command a velocity until the base has it."""
    taken: list[Twist] = []

    def moves() -> bool:
        harness.driver.send(Twist(0.1), 1, 1)
        taken.extend(body.commands())
        return bool(taken) and not taken[-1].is_zero

    await harness.until(moves)


def adapter(driver: object) -> int:
    assert isinstance(driver, Ros1Driver)
    pid = driver.adapter_pid
    assert pid is not None
    return pid


def why(heard: CollectingSink) -> str:
    return heard.states[-1][1] if heard.states else ""


def test_a_master_that_comes_late_goes_and_comes_back(roscore: RosCore, tmp_path: Path) -> None:
    async def run() -> None:
        core = RosCore(tmp_path, is_whole=False)
        namespace = "/late"
        options = {"master": core.uri, "ip": "127.0.0.1", "namespace": namespace}
        maker = RosRobot.__new__(RosRobot)
        maker.core, maker.namespace = core, namespace
        driver, heard = maker.make(options), CollectingSink()
        task = asyncio.create_task(driver.run(heard))
        for _ in range(2):
            harness = DriverHarness(maker, driver, heard, task)
            await harness.until(lambda: f"answers at {core.uri}" in why(heard))
            assert "start roscore" in why(heard)
            await asyncio.to_thread(core.start)
            body = await asyncio.to_thread(RosRobot, core, namespace=namespace)
            body.do("rate", hz=10)
            await harness.until(lambda: heard.is_up)
            driver.send(Twist(0.1), 1, 1)
            assert (await DriverHarness(body, driver, heard, task).command()).is_zero
            await drive(harness, body)
            core.kill()
            taken: list[Twist] = []

            def stands(body: RosRobot = body, taken: list[Twist] = taken) -> bool:
                driver.send(Twist(0.1), 1, 1)
                taken.extend(body.commands())
                return not heard.is_up and bool(taken) and taken[-1].is_zero

            await harness.until(stands)
            body.close()
        await harness.end()

    asyncio.run(run())


def test_a_master_started_anew_at_once_is_noticed(roscore: RosCore, tmp_path: Path) -> None:
    with RosCore(tmp_path, is_whole=False) as core:

        async def story(harness: DriverHarness, body: RosRobot) -> None:
            await drive(harness, body)
            first = adapter(harness.driver)
            core.kill()
            await asyncio.to_thread(core.start)
            with robot(core, namespace=body.namespace) as again:
                again.do("rate", hz=10)
                await harness.until(lambda: not is_running(first))
                await harness.until(lambda: harness.sink.is_up)
                assert adapter(harness.driver) != first
                assert not any(twist.is_zero is False for twist in again.commands())
                harness.driver.send(Twist(0.1), 1, 1)
                assert (
                    await DriverHarness(again, harness.driver, harness.sink, harness.task).command()
                ).is_zero

        play(RosRobot(core), story)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP, signal.SIGTERM])
def test_an_adapter_that_ends_or_hangs_is_replaced_and_stops_the_base(
    roscore: RosCore, number: signal.Signals
) -> None:
    async def story(harness: DriverHarness, body: RosRobot) -> None:
        await drive(harness, body)
        first = adapter(harness.driver)
        os.kill(first, number)
        await harness.until(lambda: not harness.sink.is_up)
        assert "adapter" in why(harness.sink)
        while not (await harness.command()).is_zero:  # nothing is sent: the next adapter's
            pass  # on its way when the adapter was harmed
        await harness.until(lambda: harness.sink.is_up)
        assert adapter(harness.driver) != first
        assert not is_running(first)
        harness.driver.send(Twist(0.1), 1, 1)
        await asyncio.sleep(0.1)
        assert all(twist.is_zero for twist in body.commands())
        await drive(harness, body)

    play(RosRobot(roscore), story)


def test_an_adapter_that_ros_shuts_down_stops_the_base_first(roscore: RosCore) -> None:
    async def story(harness: DriverHarness, body: RosRobot) -> None:
        await drive(harness, body)
        nodes = roscore.topics()[f"{body.namespace}/cmd_vel"]
        with xmlrpc.client.ServerProxy(roscore.uri) as master:
            found: object = master.lookupNode("/test", nodes[0])
        assert isinstance(found, list)
        with xmlrpc.client.ServerProxy(found[2]) as node, contextlib.suppress(OSError):
            node.shutdown("/test", "as rosnode kill does")
        taken: list[Twist] = []

        def stands() -> bool:
            taken.extend(body.commands())
            return bool(taken) and taken[-1].is_zero

        await harness.until(stands)
        await harness.until(lambda: not harness.sink.is_up)
        await harness.until(lambda: harness.sink.is_up)

    play(RosRobot(roscore), story)


def test_a_killed_node_no_longer_counts_though_the_master_lists_it(roscore: RosCore) -> None:
    async def story(harness: DriverHarness, body: RosRobot) -> None:
        other = body.make({})
        second = asyncio.create_task(other.run(heard_too := CollectingSink()))
        await harness.until(lambda: not harness.sink.is_up)
        await harness.until(lambda: bool(heard_too.states) and "another node" in why(heard_too))
        os.kill(adapter(other), signal.SIGKILL)
        second.cancel()
        await asyncio.gather(second, return_exceptions=True)
        await harness.until(lambda: harness.sink.is_up)
        assert len(roscore.topics()[f"{body.namespace}/cmd_vel"]) > 1

    play(RosRobot(roscore), story)


def test_a_base_that_connects_while_driving_gets_zero_first(roscore: RosCore) -> None:
    async def story(harness: DriverHarness, body: RosRobot) -> None:
        await drive(harness, body)

        def second() -> RosRobot:
            return RosRobot(roscore, "--name", "second", namespace=body.namespace)

        starting = asyncio.create_task(asyncio.to_thread(second))
        while not starting.done():
            harness.driver.send(Twist(0.1), 1, 1)
            await asyncio.sleep(0.05)
        base, taken = starting.result(), list[Twist]()

        def drives() -> bool:
            harness.driver.send(Twist(0.1), 1, 1)
            taken.extend(base.commands())
            return any(not twist.is_zero for twist in taken)

        try:
            await harness.until(drives)
        finally:
            base.close()
        assert taken[0].is_zero

    play(RosRobot(roscore), story)


@contextmanager
def running_daemon(body: RosRobot) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """A daemon that drives the robot, and its adapter's process id; both gone afterwards."""
    body.do("rate", hz=10)
    command = [sys.executable, str(DAEMON), json.dumps(body.options)]
    daemon = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert daemon.stdout is not None
    pid = int(daemon.stdout.readline())
    try:
        wait_until(lambda: any(not twist.is_zero for twist in body.commands()), "it drives")
        yield daemon, pid
    finally:
        daemon.kill()
        daemon.wait()
        daemon.stdout.close()
        wait_until(lambda: not is_running(pid), "the adapter has left")


def test_the_base_of_a_killed_daemon_is_stopped_and_nothing_is_left(roscore: RosCore) -> None:
    with robot(roscore) as body, running_daemon(body) as (daemon, pid):
        daemon.kill()
        killed = time.monotonic()
        taken = taken_until_zero(body)
        stopped = time.monotonic()
        wait_until(lambda: not is_running(pid), "the adapter has left")
        left = time.monotonic()
        taken += body.commands()
        zeros = sum(twist.is_zero for twist in taken)
        assert taken[-1].is_zero
        assert stopped - killed < SILENCE + 2.0
        assert left - killed > STOPPING - 0.1
        assert zeros > 0.5 * STOPPING / 0.05


def test_the_base_of_a_frozen_daemon_is_stopped_until_it_is_back(roscore: RosCore) -> None:
    with robot(roscore) as body, running_daemon(body) as (daemon, pid):
        daemon.send_signal(signal.SIGSTOP)
        frozen = time.monotonic()
        taken_until_zero(body)
        assert time.monotonic() - frozen < SILENCE + 2.0
        time.sleep(STOPPING + 1.0)
        taken = body.commands()
        assert len(taken) > 20
        assert all(twist.is_zero for twist in taken)
        assert is_running(pid)
        daemon.send_signal(signal.SIGCONT)
        wait_until(lambda: any(not twist.is_zero for twist in body.commands()), "it drives again")


def taken_until_zero(body: RosRobot) -> list[Twist]:
    taken: list[Twist] = []

    def stands() -> bool:
        taken.extend(body.commands())
        return bool(taken) and taken[-1].is_zero

    wait_until(stands, "the base stands")
    return taken
