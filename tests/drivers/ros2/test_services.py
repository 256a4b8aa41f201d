"""The services by which ROS runs and resets a robot, called as each middleware's clients call."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zenoh
import zenoh.ext

from swarmd.core.errors import ConfigError
from swarmd.core.messages import Code, Reply, State, Status
from swarmd.core.refusal import Refusal
from swarmd.core.values import Value
from swarmd.daemon.driver_commands import MAX_COMMAND_AGE
from swarmd.driver_api.command_source import Answer, DriverCommand, command_source
from swarmd.drivers.ros.endpoints import Endpoint
from swarmd.drivers.ros.options import Ros1Options, RosOptions, read_options
from swarmd.drivers.ros.stop_topics import CALL_BURST, CALL_RATE
from swarmd.drivers.ros2.dds_bridge import Ros2Dds
from swarmd.drivers.ros2.request_age import SETTLE_TIME
from swarmd.drivers.ros2.services import MAX_MESSAGE, CommandServices
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.testing.driver_contract import DriverHarness
from tests.drivers.ros2.harness import check
from tests.drivers.ros2.robots import BridgedRobot, Robot, ZenohRobot, scan
from tests.drivers.ros2.service_calls import CALL, EMPTY, Call
from tests.drivers.ros2.stops import ESTOP, STATE, STOP, Empty
from tests.support import ros2_types as dds
from tests.support.drive_daemon import ROBOT
from tests.support.processes import DaemonProcess, unique_swarm, wait_until
from tests.support.ros2_types import TriggerResponse
from tests.support.stories import story
from tests.support.swarmctl import heard_statuses

pytestmark = pytest.mark.long

SERVICES: dict[str, Value] = {
    "operator": "ros",
    "runs": {"go": {"pattern": "drive", "params": {"speed": 0.1}, "seconds": 600.0}},
}
DOUBT = "age of this call is unknown"


class Door:
    """The daemon's side: keeps the commands, and answers each at once."""

    def __init__(self, harness: DriverHarness, code: Code = Code.APPLIED, text: str = "so") -> None:
        self.commands: list[DriverCommand] = []
        self._reply = Reply(
            id="i",
            robot="r",
            code=code,
            refusal=None if code is Code.APPLIED else Refusal.BUSY,
            text=text,
        )
        source = command_source(harness.driver)
        assert source is not None
        source.serve(self._take)

    def _take(self, command: DriverCommand, answer: Answer) -> None:
        self.commands.append(command)
        answer(self._reply)


async def called(harness: DriverHarness, robot: Robot, service: str, **changes: Any) -> Call:
    """A call that has ended."""
    call = Call(robot, service, **changes)
    await harness.until(lambda: call.has_ended, publishing=True)
    return call


async def settled(harness: DriverHarness, robot: Robot, door: Door) -> None:
    """Call until the age of a call is known: the hub must have answered for a while."""
    while True:
        await called(harness, robot, "swarmd/run/go")
        if door.commands and door.commands.pop().age is not None:
            return
        await asyncio.sleep(2.0 / CALL_RATE)


@story(BridgedRobot, ZenohRobot, lambda: ZenohRobot(domain=3, is_humble=True), services=SERVICES)
async def test_each_service_is_a_command_and_its_reply_the_answer(
    harness: DriverHarness, robot: Robot
) -> None:
    door = Door(harness)
    await settled(harness, robot, door)
    for service in ("swarmd/reset", "swarmd/run/go"):
        call = await called(harness, robot, service)
        assert [(one.success, one.message) for one in call.answers] == [(True, "so")]
        command = door.commands.pop()
        verb = service.split("/")[1]
        assert (command.verb, command.operator, command.source) == (
            verb,
            "ros",
            f"ROS service /{service}",
        )
        assert command.age is not None
        assert 0.0 <= command.age <= MAX_COMMAND_AGE
        assert (command.run is None) == (verb != "run")
    assert command.run is not None
    assert (command.run.pattern, command.run.params["speed"]) == ("drive", 0.1)
    if isinstance(robot, ZenohRobot):
        reply = call.replies[0].ok
        assert reply is not None
        assert reply.attachment is not None
        sequence, _, _, gid = CALL.unpack(reply.attachment.to_bytes())
        assert (sequence, gid) == (7, b"c" * 16)


@story(BridgedRobot, services=SERVICES)
async def test_a_refusal_is_no_success_and_a_long_text_is_cut(
    harness: DriverHarness, robot: Robot
) -> None:
    Door(harness, Code.REFUSED, "ö" * 3000)
    call = await called(harness, robot, "swarmd/reset")
    (answer,) = call.answers
    assert not answer.success
    assert answer.message.startswith("busy: ö")
    assert len(answer.message) == MAX_MESSAGE


@story(BridgedRobot, services=SERVICES)
async def test_a_run_of_a_robot_whose_base_is_lost_is_no_success(
    harness: DriverHarness, robot: Robot
) -> None:
    Door(harness, text="runs drive; held: driver_lost: no scan and no odometry")
    await harness.until(lambda: not harness.sink.is_up)  # the base is silent
    call = Call(robot, "swarmd/run/go")
    await harness.until(lambda: call.has_ended)
    (answer,) = call.answers
    assert (answer.success, "driver_lost" in answer.message) == (False, True)


@story(ZenohRobot, services=SERVICES)
async def test_the_node_announces_its_services(harness: DriverHarness, robot: ZenohRobot) -> None:
    def tokens() -> list[list[str]]:
        replies = robot.hub.liveliness().get("@ros2_lv/**")
        found = [str(reply.ok.key_expr).split("/") for reply in replies if reply.ok is not None]
        return [parts for parts in found if parts[5] == "SS"]

    await harness.until(lambda: bool(tokens()), publishing=True)
    assert {parts[9].replace("%", "/") for parts in tokens()} == {
        "/swarmd/reset",
        "/swarmd/run/go",
    }


@story(BridgedRobot, ZenohRobot, services=SERVICES)
async def test_the_age_of_a_call_is_unknown_at_first(harness: DriverHarness, robot: Robot) -> None:
    door = Door(harness)
    source: Any = harness.driver
    source._services._age._steady_since = float("inf")  # the hub has not answered yet
    await called(harness, robot, "swarmd/run/go")
    (command,) = door.commands
    assert command.age is None
    assert DOUBT in command.doubt


@story(BridgedRobot, ZenohRobot, services=SERVICES)
async def test_the_age_of_a_call_is_unknown_after_the_link_was_lost(
    harness: DriverHarness, robot: Robot
) -> None:
    """A probe without a hub ends at once, and is no answer."""
    door = Door(harness)
    await settled(harness, robot, door)
    robot.disconnect()
    await harness.until(lambda: not harness.sink.is_up)
    await asyncio.sleep(SETTLE_TIME)
    robot.reconnect()
    while not door.commands:  # until the driver has a link again
        await called(harness, robot, "swarmd/run/go")
    assert door.commands[0].age is None


@story(ZenohRobot, services=SERVICES)
@pytest.mark.parametrize("stamped_ago", [30.0, -30.0])
async def test_a_call_whose_stamp_is_far_off_has_no_age(
    harness: DriverHarness, robot: Robot, stamped_ago: float
) -> None:
    door = Door(harness)
    await settled(harness, robot, door)
    await called(harness, robot, "swarmd/run/go", stamped_ago=stamped_ago)
    (command,) = door.commands
    assert command.age is None
    assert "clocks" in command.doubt


ODD = {
    "a wildcard": {"key": "**", "target": zenoh.QueryTarget.ALL},
    "no payload": {"payload": None},
    "a payload with fields": {"payload": EMPTY + b"\1"},
    "a long payload": {"payload": EMPTY + bytes(100)},
    "text": {"payload": b"stop"},
    "no attachment": {"attachment": None},
    "a short attachment": {"attachment": b"rqh"},
    "a long attachment": {"attachment": bytes(4000)},
}


@story(BridgedRobot, ZenohRobot, services=SERVICES)
@pytest.mark.parametrize("changes", ODD.values(), ids=ODD)
async def test_what_is_no_call_of_a_client_is_no_command(
    harness: DriverHarness, robot: Robot, changes: dict[str, Any]
) -> None:
    door = Door(harness)
    call = await called(harness, robot, "swarmd/run/go", **changes)
    assert not call.answers
    await harness.until(lambda: "services:refused" in harness.sink.lost, publishing=True)
    assert not door.commands
    await called(harness, robot, "swarmd/reset")
    assert len(door.commands) == 1


@story(BridgedRobot, services=SERVICES)
async def test_a_flood_of_calls_is_cut_and_delays_no_other_call(
    harness: DriverHarness, robot: Robot
) -> None:
    door = Door(harness)
    calls = [Call(robot, "swarmd/run/go") for _ in range(300)]
    reset = Call(robot, "swarmd/reset")
    await harness.until(lambda: all(call.has_ended for call in (*calls, reset)), publishing=True)
    runs = [command for command in door.commands if command.verb == "run"]
    assert reset.answer().success
    assert CALL_BURST <= len(runs) < 150


@story(BridgedRobot, ZenohRobot, services=SERVICES)
async def test_a_flood_of_what_is_no_call_delays_no_call(
    harness: DriverHarness, robot: Robot
) -> None:
    Door(harness)
    calls = [Call(robot, "swarmd/reset", payload=b"stop") for _ in range(300)]
    reset = Call(robot, "swarmd/reset")
    await harness.until(lambda: all(call.has_ended for call in (*calls, reset)), publishing=True)
    assert reset.answer().success


@story(BridgedRobot, ZenohRobot)
async def test_without_the_option_no_service_exists(harness: DriverHarness, robot: Robot) -> None:
    call = await called(harness, robot, "swarmd/reset")
    assert not call.answers


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"operator": "Ros 1"}, "services.operator"),
        ({"role": "viewer"}, "'role'"),
        ({"runs": {"go on": {"pattern": "drive"}}}, "go on"),
        ({"runs": {"go": {"pattern": "drive", "sconds": 1.0}}}, "sconds"),
        ({"runs": {"go": {"pattern": "drive", "seconds": -1.0}}}, "seconds"),
        ({"runs": {"go": {"pattern": "drive", "until": ["nearr 1"]}}}, "services.runs.go.until"),
        ({"reset": "some"}, "services.reset"),
    ],
)
def test_a_wrong_option_is_refused(changes: dict[str, Value], part: str) -> None:
    with pytest.raises(ConfigError, match=part):
        read_options(RosOptions, {"services": {**SERVICES, **changes}}, "ros2dds", "r")


def test_the_driver_of_ros_1_refuses_the_option() -> None:
    with pytest.raises(ConfigError, match="services"):
        read_options(Ros1Options, {"services": SERVICES}, "ros1", "r")


def test_a_check_names_the_services() -> None:
    robot = BridgedRobot()
    finding = check(robot, robot.publish, namespace="tb3_01", services=SERVICES)["services"]
    assert "/tb3_01/swarmd/run/go" in finding.text
    assert "(ros)" in finding.text


def test_a_check_warns_of_nodes_whose_calls_the_bridge_drops() -> None:
    """By the vendor's id, of DDSI-RTPS: 0x010f is Fast DDS, 0x0110 CycloneDDS."""
    options = read_options(RosOptions, {"services": SERVICES}, "ros2dds", "r")
    services = CommandServices(Ros2Dds(), options, lambda: False)
    nodes = [
        Endpoint(True, "/scan", "t", node=f"/{name}", process=f"{vendor}9f{name}")
        for name, vendor in (("fast", "010f"), ("cyclone", "0110"), ("unknown", ""))
    ]
    (warned,) = services.findings(nodes)
    assert (warned.subject, warned.is_well) == ("services", False)
    assert warned.text.endswith(": /fast")
    (well,) = services.findings(nodes[1:])
    assert well.is_well


@pytest.mark.integration
@pytest.mark.parametrize("make", [BridgedRobot, ZenohRobot])
def test_a_daemon_is_run_by_services_and_stopped_by_topics(
    make: Callable[[], Robot], tmp_path: Path
) -> None:
    robot = make()
    driver = "rmw_zenoh" if isinstance(robot, ZenohRobot) else "ros2dds"
    given = dict(robot.options({"services": SERVICES}))
    if isinstance(robot, ZenohRobot):
        given["domain"] = robot.domain
    options: dict[str, Any] = {
        "driver": driver,
        "driver_options": {**given, "command_timeout": "base"},
    }
    swarm, is_done = unique_swarm(), threading.Event()

    def keep_scanning() -> None:
        """Without scans for 2 s a run ends; without odometry the robot counts as resting."""
        count = 0
        while not is_done.wait(0.05):
            count += 1
            robot.put("scan", scan(100.0 + 0.1 * count))

    def answer(service: str) -> TriggerResponse:
        call = Call(robot, service)
        wait_until(lambda: call.has_ended, service)
        return call.answers[0] if call.answers else TriggerResponse()  # not yet, or too often

    def later_answer(service: str) -> TriggerResponse:
        """The first answer that says neither that the robot nor that the hub has just changed."""
        answers: list[TriggerResponse] = []

        def is_other() -> bool:
            answers.append(answer(service))
            message = answers[-1].message
            return bool(message) and "stale_epoch" not in message and DOUBT not in message

        wait_until(is_other, service)
        return answers[-1]

    shown = list[zenoh.Sample]()
    keys = {
        topic: robot.key(topic, "String") if isinstance(robot, ZenohRobot) else topic
        for topic in (ESTOP, STATE)
    }
    robot.hub.declare_subscriber(keys[STATE], shown.append)
    cache = zenoh.ext.CacheConfig(1)
    retained = zenoh.ext.declare_advanced_publisher(robot.hub, keys[ESTOP], cache=cache)

    def text() -> str:
        return str(dds.String.deserialize(shown[-1].payload.to_bytes()).data)

    daemon = DaemonProcess(
        tmp_path, swarm=swarm, robot=ROBOT, endpoint="", platform="burger", options=options
    )
    scanning = threading.Thread(target=keep_scanning)
    scanning.start()
    try:
        with daemon, Operator(NetworkSettings(swarm=swarm), name="anna") as operator:
            daemon.wait_ready()

            def told() -> Status:
                return heard_statuses(operator, [ROBOT])[ROBOT]

            def is_running() -> bool:
                """The age of a call is unknown at first, and the robot has no scan yet."""
                if not answer("swarmd/run/go").success:
                    return False
                now = told()  # a stall of the daemon has ended the run, if it does not run
                return (now.state, now.pattern) == (State.RUNNING, "drive")

            wait_until(is_running, "it runs")
            robot.put(STOP, Empty())
            wait_until(lambda: len(shown) == 1, "it has told that it stands")
            assert text().startswith("stopped: commanded zero")
            now = told()
            assert (now.state, now.detail) == (State.STOPPED, "by ros")

            # A publisher that keeps its message for later subscribers: it stops once.
            retained.put(dds.String("smoke").serialize())
            wait_until(lambda: len(shown) == 2, "it has told of the emergency stop")
            assert text().startswith("estopped: commanded zero")
            assert "by ros: smoke" in told().detail
            assert later_answer("swarmd/reset").success
            wait_until(is_running, "it runs again")
            robot.put(ESTOP, dds.String("fire"))
            wait_until(lambda: len(shown) == 3, "it has told of the second emergency stop")
            # A run that may have been issued before the stop is refused for that at first.
            refused = later_answer("swarmd/run/go")
            assert not refused.success
            assert refused.message.startswith("estopped")
            operator.send_stop("estop", names=[ROBOT], timeout=10.0)
            refused = later_answer("swarmd/reset")
            assert not refused.success
            assert refused.message.startswith("estopped")
            assert "anna" in refused.message
            assert not any(twist.linear for twist in robot.commands()[-3:])
            assert daemon.terminate() == 0  # the audit log is written by then

        log = next(tmp_path.rglob("audit.jsonl")).read_text().splitlines()
        entries = [json.loads(line) for line in log]
        by_ros = [entry for entry in entries if entry["operator"] == "ros"]
        assert {entry["source"] for entry in by_ros} == {
            *(f"ROS service /swarmd/{name}" for name in ("run/go", "reset")),
            *(f"ROS topic /swarmd/{name}" for name in ("stop", "estop")),
        }
        assert [entry["verb"] for entry in by_ros].count("estop") == 2
        assert {entry["verb"] for entry in by_ros} == {"run", "stop", "estop", "reset"}
    finally:
        is_done.set()
        scanning.join()
        robot.close()
