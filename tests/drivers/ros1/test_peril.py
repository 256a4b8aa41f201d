"""What others do to driver `ros1`, and what it says of them: against a real roscore."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import threading
import time
import xmlrpc.client
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xmlrpc.server import SimpleXMLRPCServer

import pytest

from swarmd.core.values import Twist
from swarmd.driver_api.command_gate import ZERO_REPEAT_TIME
from swarmd.drivers.ros.messages import LaserScan
from swarmd.drivers.ros1.adapter_process import SILENCE, STOPPING
from swarmd.drivers.ros1.serialization import definition, type_name
from swarmd.testing.driver_contract import CollectingSink, DriverHarness
from swarmd.testing.driver_rig import is_running
from tests.drivers.ros1.rig import RosRobot, robot
from tests.drivers.ros1.test_life import adapter, drive, play, running_daemon
from tests.support.processes import CAP, children, wait_until
from tests.support.roscore import RosCore


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


def test_another_driver_is_left_alone_after_zeros_and_logged_once(
    roscore: RosCore, caplog: pytest.LogCaptureFixture
) -> None:
    async def story(harness: DriverHarness, body: RosRobot) -> None:
        await drive(harness, body)
        other = body.make({})
        second = asyncio.create_task(other.run(CollectingSink()))
        await moving(harness, 0.0, lambda: not harness.sink.is_up)
        told = await moving(harness, ZERO_REPEAT_TIME + SILENCE, lambda: True)
        while not told[0].is_zero:  # sent before
            del told[0]
        assert len(told) > 10
        assert all(twist.is_zero for twist in told)
        assert not await moving(harness, 3.0 * SILENCE, lambda: not body.commands())
        second.cancel()
        await asyncio.gather(second, return_exceptions=True)
        await harness.until(lambda: harness.sink.is_up)

    with caplog.at_level("INFO", "swarmd.drivers.ros1.driver"):
        play(RosRobot(roscore), story)
    lines = [record.getMessage() for record in caplog.records]
    named = [line for line in lines if "another node" in line and "is also published by" in line]
    assert 1 <= len(named) <= 2  # by each of the two
    assert lines[-1].startswith("driver ros1: drives on ")


def test_a_daemon_that_was_silent_is_not_obeyed_before_enough_zeros(roscore: RosCore) -> None:
    with robot(roscore) as body, running_daemon(body) as (daemon, _):
        body.commands()
        daemon.send_signal(signal.SIGSTOP)
        wait_until(lambda: any(twist.is_zero for twist in body.commands()), "it is told to stand")
        begin = time.monotonic()
        daemon.send_signal(signal.SIGCONT)
        wait_until(lambda: any(not twist.is_zero for twist in body.commands()), "it drives again")
        assert time.monotonic() - begin > 0.75 * STOPPING


def test_a_node_that_connects_and_sends_nothing_blocks_no_base(roscore: RosCore) -> None:
    async def story(harness: DriverHarness, body: RosRobot) -> None:
        topic = f"{body.namespace}/cmd_vel"
        port = _port_of(roscore, topic)
        with (
            socket.create_connection(("127.0.0.1", port)),
            socket.create_connection(("127.0.0.1", port)) as noisy,
        ):
            noisy.send(b"\xff" * 2000)
            body.disconnect()
            await moving(harness, 0.0, lambda: not harness.sink.is_up)
            await asyncio.to_thread(body.reconnect)
            body.do("rate", hz=10)
            await harness.until(lambda: harness.sink.is_up)
            harness.driver.send(Twist(0.1), 1, 1)
            assert (await harness.command()).is_zero

    play(RosRobot(roscore), story)


class Liar(threading.Thread):
    """Who publishes one message without an end on a topic, until he is hung up on."""

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
        with _master_of(core) as master:
            master.registerPublisher("/liar", topic, type_name(LaserScan), uri)

    def run(self) -> None:
        with self._server, self._server.accept()[0] as reader:
            reader.recv(4096)
            says = {"type": type_name(LaserScan), "md5sum": definition(LaserScan)[1]}
            head = b"".join(_sized(f"{key}={value}") for key, value in says.items())
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


def test_a_master_that_hangs_stops_the_robot_until_it_answers(
    roscore: RosCore, tmp_path: Path
) -> None:
    with RosCore(tmp_path, is_whole=False) as core:

        async def story(harness: DriverHarness, body: RosRobot) -> None:
            await drive(harness, body)
            first = adapter(harness.driver)
            core.send(signal.SIGSTOP)
            try:
                taken = await moving(harness, 1.0, lambda: not harness.sink.is_up)
                assert taken[-1].is_zero
                said = harness.sink.states[-1][1]
                assert f"{core.uri} (timed out)" in said
            finally:
                core.send(signal.SIGCONT)
            await harness.until(lambda: harness.sink.is_up)
            body.commands()
            harness.driver.send(Twist(0.1), 1, 1)
            assert (await harness.command()).is_zero
            assert adapter(harness.driver) == first
            core.send(signal.SIGSTOP)
            await harness.end()
            assert not is_running(first)
            core.send(signal.SIGCONT)

        play(RosRobot(core), story)


def test_a_message_without_an_end_fills_no_memory(roscore: RosCore) -> None:
    async def story(harness: DriverHarness, body: RosRobot) -> None:
        await drive(harness, body)
        with contextlib.closing(Liar(roscore, f"{body.namespace}/scan")) as liar:
            await harness.until(lambda: not liar.is_alive())
        status = Path(f"/proc/{adapter(harness.driver)}/status").read_text()
        peak = int(status.partition("VmHWM:")[2].split()[0])  # kB
        assert peak < 1 << 20
        known = len(harness.sink.scans)
        await harness.until(lambda: harness.sink.is_up and len(harness.sink.scans) > known)

    play(RosRobot(roscore), story)


def test_an_address_that_is_a_nodes_and_no_masters_is_said(roscore: RosCore) -> None:
    with robot(roscore) as body:
        with _master_of(roscore) as master:
            node = str(_value(master.lookupNode("/test", f"{body.namespace}/robot")))
        driver = body.make({"master": node.rstrip("/")})
        findings = asyncio.run(driver.check(4.0))
    assert [finding.is_well for finding in findings] == [False]
    assert f"{node.rstrip('/')} (" in findings[0].text
    assert "correct driver_options.master" in findings[0].text


def test_a_roscore_that_does_not_answer_leaves_nothing_behind(
    roscore: RosCore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    core, seen = RosCore(tmp_path, is_whole=False), list[int]()

    def lose_patience(condition: Callable[[], bool], what: str) -> None:
        wait_until(condition, what)
        seen.extend(children(os.getpid()))
        raise AssertionError(what)

    before = children(os.getpid())
    monkeypatch.setattr("tests.support.roscore.wait_until", lose_patience)
    with pytest.raises(AssertionError, match="answers"):
        core.start()
    started = set(seen) - set(before)
    assert started
    assert not any(is_running(pid) for pid in started)


def _master_of(core: RosCore) -> xmlrpc.client.ServerProxy:
    return xmlrpc.client.ServerProxy(core.uri)


def _port_of(core: RosCore, topic: str) -> int:
    """Where the first publisher of a topic waits for who listens."""
    with _master_of(core) as master:
        uri = str(_value(master.lookupNode("/test", core.topics()[topic][0])))
    with xmlrpc.client.ServerProxy(uri) as node:
        return int(_value(node.requestTopic("/test", topic, [["TCPROS"]]))[2])


def _value(answer: object) -> Any:
    assert isinstance(answer, list)
    return answer[2]
