"""Ends, restarts and faults around driver `ros1`, against a real roscore."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import threading
import time
import xmlrpc.client
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from xmlrpc.server import SimpleXMLRPCServer

import pytest

from swarmd.core.messages import Reason
from swarmd.core.values import Twist
from swarmd.driver_api.command_gate import ZERO_REPEAT_TIME
from swarmd.drivers.ros.messages import LaserScan
from swarmd.drivers.ros1.adapter_process import COMMAND_TIMEOUT
from swarmd.drivers.ros1.driver import Ros1Driver
from swarmd.drivers.ros1.serialization import definition, type_name
from swarmd.testing.driver_contract import TIMEOUT, CollectingSink, DriverHarness, is_running
from tests.drivers.ros.contract import last_arrives
from tests.drivers.ros1.rig import RosRobot, ros_robot
from tests.support.processes import CAP, attempts
from tests.support.roscore import RosCore
from tests.support.stories import story

FREEZES = 5


def speaking(roscore: RosCore) -> RosRobot:
    """A robot that publishes by itself."""
    robot = RosRobot(roscore)
    robot.do("rate", hz=10)
    return robot


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


def why(sink: CollectingSink) -> str:
    return sink.states[-1][1] if sink.states else ""


def test_a_master_that_starts_late_ends_and_restarts(roscore: RosCore, tmp_path: Path) -> None:
    async def run() -> None:
        core = RosCore(tmp_path, is_whole=False)
        namespace = "/late"
        options = {"master": core.uri, "ip": "127.0.0.1", "namespace": namespace}
        maker = RosRobot.__new__(RosRobot)
        maker.core, maker.namespace = core, namespace
        driver, sink = maker.make(options), CollectingSink()
        task = asyncio.create_task(driver.run(sink))
        for _ in range(2):
            harness = DriverHarness(maker, driver, sink, task)
            await harness.until(lambda: f"answers at {core.uri}" in why(sink))
            assert "start roscore" in why(sink)
            await asyncio.to_thread(core.start)
            body = await asyncio.to_thread(RosRobot, core, namespace=namespace)
            body.do("rate", hz=10)
            await harness.until(lambda: sink.is_up)
            assert (await DriverHarness(body, driver, sink, task).command(Twist(0.1))).is_zero
            await drive(harness, body)
            core.kill()
            taken: list[Twist] = []

            def is_stopped(body: RosRobot = body, taken: list[Twist] = taken) -> bool:
                driver.send(Twist(0.1), 1, 1)
                taken.extend(body.commands())
                return not sink.is_up and bool(taken) and taken[-1].is_zero

            await harness.until(is_stopped)
            body.close()
        await harness.end()

    asyncio.run(run())


@pytest.fixture
def core(roscore: RosCore, tmp_path: Path) -> Iterator[RosCore]:
    """A master that a test may end."""
    with RosCore(tmp_path, is_whole=False) as own:
        yield own


@story(lambda core: speaking(core))
async def test_a_master_that_restarts_at_once_is_noticed(
    harness: DriverHarness, robot: RosRobot
) -> None:
    await drive(harness, robot)
    first = adapter(harness.driver)
    robot.core.kill()
    await asyncio.to_thread(robot.core.start)
    with closing(RosRobot(robot.core, namespace=robot.namespace)) as again:
        again.do("rate", hz=10)
        await harness.until(lambda: not is_running(first))

        def is_new() -> bool:  # the driver may not have noticed yet that the adapter has ended
            assert isinstance(harness.driver, Ros1Driver)
            return harness.sink.is_up and harness.driver.adapter_pid not in (None, first)

        await harness.until(is_new)
        assert all(twist.is_zero for twist in again.commands())
        beside = DriverHarness(again, harness.driver, harness.sink, harness.task)
        assert (await beside.command(Twist(0.1))).is_zero


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP, signal.SIGTERM])
@story(speaking)
async def test_an_adapter_that_ends_or_hangs_is_replaced_and_stops_the_base(
    harness: DriverHarness, robot: RosRobot, number: signal.Signals
) -> None:
    await drive(harness, robot)
    first = adapter(harness.driver)
    os.kill(first, number)
    await harness.until(lambda: not harness.sink.is_up)
    assert "adapter" in why(harness.sink)
    taken: list[Twist] = []

    def stands() -> bool:
        taken.extend(robot.commands())  # the last ones from before the adapter was harmed
        return bool(taken) and taken[-1].is_zero

    await harness.until(stands)  # nothing is sent: the zero is the next adapter's
    await harness.until(lambda: harness.sink.is_up)
    assert adapter(harness.driver) != first
    assert not is_running(first)
    harness.driver.send(Twist(0.1), 1, 1)
    await asyncio.sleep(0.1)
    assert all(twist.is_zero for twist in robot.commands())
    await drive(harness, robot)


def is_stopped(pid: int) -> bool:
    """True once all threads of a process are stopped, one after the other, or it has ended."""
    try:
        stats = [path.read_text() for path in Path(f"/proc/{pid}/task").glob("*/stat")]
    except OSError:
        return not is_running(pid)
    return all(stat.rpartition(")")[2].split()[0] == "T" for stat in stats)


@story(speaking)
async def test_a_frozen_adapter_delivers_no_late_command(
    harness: DriverHarness, robot: RosRobot
) -> None:
    """Frozen for less than the time after which it is replaced; again if a stall prolonged it."""
    for _ in range(FREEZES):
        await drive(harness, robot)
        await last_arrives(harness, Twist(0.1, 0.5))
        pid = adapter(harness.driver)
        os.kill(pid, signal.SIGSTOP)
        await harness.until(lambda pid=pid: is_stopped(pid))  # type: ignore[misc]
        for number in range(12):
            harness.driver.send(Twist(0.1, 0.01 * number), 1, 1)
            await asyncio.sleep(0.05)
        robot.commands()
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
            break
    else:
        pytest.fail("the adapter was replaced each time")
    taken: list[Twist] = []

    def drives_on() -> bool:
        harness.driver.send(Twist(0.2), 1, 1)
        taken.extend(robot.commands())
        return bool(taken) and taken[-1].linear == 0.2

    await harness.until(drives_on, publishing=True)
    late = [twist for twist in taken if twist.linear == 0.1 and twist.angular < 0.075]
    assert not late, "0.25 s old or older"


@story(speaking)
async def test_an_adapter_that_ros_shuts_down_stops_the_base_first(
    harness: DriverHarness, robot: RosRobot, roscore: RosCore
) -> None:
    await drive(harness, robot)
    nodes = roscore.topics()[f"{robot.namespace}/cmd_vel"]
    with xmlrpc.client.ServerProxy(roscore.uri) as master:
        uri = str(_value(master.lookupNode("/test", nodes[0])))
    with xmlrpc.client.ServerProxy(uri) as node, contextlib.suppress(OSError):
        node.shutdown("/test", "as rosnode kill does")
    taken: list[Twist] = []

    def is_stopped() -> bool:
        taken.extend(robot.commands())
        return bool(taken) and taken[-1].is_zero

    await harness.until(is_stopped)
    await harness.until(lambda: not harness.sink.is_up)
    await harness.until(lambda: harness.sink.is_up)


@story(speaking, cmd_vel_listeners=["second"])
async def test_a_base_that_connects_while_driving_gets_zero_first(
    harness: DriverHarness, robot: RosRobot, roscore: RosCore
) -> None:
    await drive(harness, robot)

    def second() -> RosRobot:
        words = "--no-sensors", "--name", "second"
        return RosRobot(roscore, *words, namespace=robot.namespace)

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


async def moving(
    harness: DriverHarness, seconds: float, condition: Callable[[], bool]
) -> list[Twist]:
    """Command a velocity 20 times a second until the condition holds, and for seconds more."""
    taken: list[Twist] = []

    def has_come() -> bool:
        harness.driver.send(Twist(0.1), 1, 1)
        assert isinstance(harness.rig, RosRobot)
        taken.extend(harness.rig.commands())
        return condition()

    await harness.until(has_come)
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        has_come()
        await asyncio.sleep(0.05)
    return taken


@story(speaking)
async def test_another_driver_gets_the_base_after_zeros_and_is_logged_once(
    harness: DriverHarness, robot: RosRobot, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "swarmd.drivers.ros1.driver")
    await drive(harness, robot)
    other = robot.make({})
    second = asyncio.create_task(other.run(CollectingSink()))
    await moving(harness, 0.0, lambda: not harness.sink.is_up)
    taken = await moving(harness, ZERO_REPEAT_TIME + COMMAND_TIMEOUT, lambda: True)
    while not taken[0].is_zero:  # sent before
        del taken[0]
    assert len(taken) > 10
    assert all(twist.is_zero for twist in taken)
    async with asyncio.timeout(TIMEOUT):
        while await moving(harness, 3.0 * COMMAND_TIMEOUT, lambda: True):
            pass  # the last zeros
    second.cancel()
    await asyncio.gather(second, return_exceptions=True)
    await harness.until(lambda: harness.sink.is_up)
    lines = [record.getMessage() for record in caplog.records]
    named = [line for line in lines if "someone else" in line and "is also published by" in line]
    assert 1 <= len(named) <= 2  # by each of the two
    assert lines[-1].startswith("driver ros1: drives on ")


@story(ros_robot, connected=False)
async def test_no_motion_reaches_two_bases_and_the_end_of_one_frees_the_other(
    harness: DriverHarness, robot: RosRobot
) -> None:
    other = RosRobot(robot.core, "--name", "other", namespace=robot.namespace)
    taken: list[Twist] = []

    def is_held() -> bool:
        harness.driver.send(Twist(0.1), 1, 1)
        taken.extend([*robot.commands(), *other.commands()])
        return harness.sink.hold is Reason.BASE_CONFLICT

    await harness.until(is_held, publishing=True)
    await harness.until(lambda: is_held() and len(taken) >= 40, publishing=True)
    assert all(twist.is_zero for twist in taken)
    await harness.until(lambda: "/other, " in why(harness.sink), publishing=True)
    other.close()  # SIGKILL: the master still lists it
    await harness.until(lambda: harness.sink.hold is None, publishing=True)
    await drive(harness, robot)


@story(speaking)
async def test_a_node_that_connects_and_sends_nothing_blocks_no_base(
    harness: DriverHarness, robot: RosRobot, roscore: RosCore
) -> None:
    topic = f"{robot.namespace}/cmd_vel"
    port = _port_of(roscore, topic)
    with (
        socket.create_connection(("127.0.0.1", port)),
        socket.create_connection(("127.0.0.1", port)) as noisy,
    ):
        noisy.send(b"\xff" * 2000)
        robot.disconnect()
        await moving(harness, 0.0, lambda: not harness.sink.is_up)
        await asyncio.to_thread(robot.reconnect)
        robot.do("rate", hz=10)
        await harness.until(lambda: harness.sink.is_up)
        assert (await harness.command(Twist(0.1))).is_zero


class EndlessPublisher(threading.Thread):
    """Publishes one message without an end on a topic, until its subscriber disconnects."""

    def __init__(self, core: RosCore, topic: str) -> None:
        super().__init__(daemon=True)
        self._server = socket.create_server(("127.0.0.1", 0))
        port = self._server.getsockname()[1]
        self._api = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
        where = [1, "", ["TCPROS", "127.0.0.1", port]]
        self._api.register_function(lambda *asked: where, "requestTopic")
        self._talk = threading.Thread(target=self._api.serve_forever)
        self._talk.start()
        self.start()
        uri = f"http://127.0.0.1:{self._api.server_address[1]}"
        with xmlrpc.client.ServerProxy(core.uri) as master:
            master.registerPublisher("/endless", topic, type_name(LaserScan), uri)

    def run(self) -> None:
        with self._server, self._server.accept()[0] as reader:
            reader.recv(4096)
            fields = {"type": type_name(LaserScan), "md5sum": definition(LaserScan)[1]}
            head = b"".join(_sized(f"{key}={value}") for key, value in fields.items())
            try:
                reader.sendall(len(head).to_bytes(4, "little") + head + b"\xff\xff\xff\xff")
                for _ in range(4096):
                    reader.sendall(bytes(1 << 20))
            except OSError:
                return

    def close(self) -> None:
        self.join(CAP)
        self._api.shutdown()
        self._api.server_close()
        self._talk.join(CAP)


def _sized(text: str) -> bytes:
    return len(text).to_bytes(4, "little") + text.encode()


@story(lambda core: speaking(core))
async def test_a_master_that_hangs_stops_the_robot_until_it_answers(
    harness: DriverHarness, robot: RosRobot
) -> None:
    await drive(harness, robot)
    first, core = adapter(harness.driver), robot.core
    core.send(signal.SIGSTOP)
    try:
        taken = await moving(harness, 1.0, lambda: not harness.sink.is_up)
        assert taken[-1].is_zero
        assert f"{core.uri} (timed out)" in why(harness.sink)
    finally:
        core.send(signal.SIGCONT)
    await harness.until(lambda: harness.sink.is_up)
    robot.commands()
    assert (await harness.command(Twist(0.1))).is_zero
    assert adapter(harness.driver) == first
    core.send(signal.SIGSTOP)
    await harness.end()
    assert not is_running(first)
    core.send(signal.SIGCONT)


@story(speaking)
async def test_an_endless_message_fills_no_memory(
    harness: DriverHarness, robot: RosRobot, roscore: RosCore
) -> None:
    await drive(harness, robot)
    assert isinstance(harness.driver, Ros1Driver)
    for _ in attempts("the adapter ends the connection; a stalled one is replaced"):
        await harness.until(lambda: harness.sink.is_up)
        first = harness.driver.adapter_pid
        with closing(EndlessPublisher(roscore, f"{robot.namespace}/scan")) as publisher:
            await harness.until(lambda: not publisher.is_alive())
        if first == harness.driver.adapter_pid is not None:
            break
    status = Path(f"/proc/{first}/status").read_text()
    peak = int(status.partition("VmHWM:")[2].split()[0])  # kB
    assert peak < 1 << 20
    known = len(harness.sink.scans)
    await harness.until(lambda: harness.sink.is_up and len(harness.sink.scans) > known)


def test_an_address_of_a_node_instead_of_a_master_is_reported(roscore: RosCore) -> None:
    with closing(RosRobot(roscore)) as body:
        with xmlrpc.client.ServerProxy(roscore.uri) as master:
            node = str(_value(master.lookupNode("/test", f"{body.namespace}/robot")))
        driver = body.make({"master": node.rstrip("/")})
        findings = asyncio.run(driver.check(4.0))
    assert [finding.is_well for finding in findings] == [False]
    assert f"{node.rstrip('/')} (" in findings[0].text
    assert "correct driver_options.master" in findings[0].text


def _port_of(core: RosCore, topic: str) -> int:
    """The port on which the first publisher of a topic waits for subscribers."""
    with xmlrpc.client.ServerProxy(core.uri) as master:
        uri = str(_value(master.lookupNode("/test", core.topics()[topic][0])))
    with xmlrpc.client.ServerProxy(uri) as node:
        return int(_value(node.requestTopic("/test", topic, [["TCPROS"]]))[2])


def _value(answer: object) -> Any:
    assert isinstance(answer, list)
    return answer[2]
