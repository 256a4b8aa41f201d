"""When driver `ros1` sends commands, and which one first: exactly, with a fake adapter.

`test_adapter.py` has a real process, `test_driver.py` ROS as well.
"""

from __future__ import annotations

import asyncio
import os
import socket
import struct
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import pytest
from msgspec.structs import replace

from swarmd.core.values import ZERO, Twist, Value
from swarmd.drivers.ros.options import Ros1Options, read_options
from swarmd.drivers.ros1 import adapter as ros1_child
from swarmd.drivers.ros1 import adapter_process as ros1_adapter
from swarmd.drivers.ros1 import driver as ros1
from swarmd.drivers.ros1.adapter import AdapterEnd, ForeignMessage, MasterState
from swarmd.drivers.ros1.driver import Ros1Driver
from swarmd.drivers.ros1.serialization import encode_twist
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import CollectingSink
from tests.support import hand_clock as handclock
from tests.support.stories import Tell, Test, as_test

MOVING = Twist(0.1, -0.2)
FIRST = [encode_twist(Twist()), encode_twist(MOVING)]
WELL = MasterState(
    master=True,
    publishers={"/scan": ["/lidar"], "/odom": ["/base"]},
    listeners=["/base"],
    connected=1,
    command_type="geometry_msgs/Twist",
)
HEADER = struct.pack("<4I", 1, 5, 250_000_000, 0)


def scan(*ranges: float) -> bytes:
    angles = struct.pack("<7f", 0.0, 3.0, 1.0, 0.0, 0.0, 0.1, 3.5)
    floats = struct.pack(f"<I{len(ranges)}fI", len(ranges), *ranges, 0)
    return HEADER + angles + floats


def odometry(x: float = 0.5) -> bytes:
    pose = struct.pack("<7d", x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    return HEADER + bytes(4) + pose + bytes(288) + struct.pack("<6d", *[0.1] * 6) + bytes(288)


class Adapter:
    """Passes on the events of the test, and keeps the commands that it receives."""

    def __init__(self, *given: Any) -> None:
        self.config, self.listener = given[2], given[4]
        self.pid = 1
        self.sent: list[bytes] = []
        self.is_closed_politely: bool | None = None
        self.is_dead = False

    def send(self, command: bytes) -> None:
        self.sent.append(command)

    async def until_end(self, seconds: float) -> bool:
        await asyncio.sleep(seconds)
        return self.is_dead

    async def close(self, *, politely: bool) -> str:
        self.is_closed_politely = politely
        return "died"


class Scene:
    """A driver that runs, and the adapters that it has started."""

    def __init__(self, driver: Ros1Driver, started: list[Adapter]) -> None:
        self.driver, self.started, self.sink = driver, started, CollectingSink()
        self.task = asyncio.create_task(driver.run(self.sink))

    @property
    def adapter(self) -> Adapter:
        return self.started[-1]

    def report(self, state: MasterState = WELL) -> None:
        self.adapter.listener.on_event(state)

    def connect(self, state: MasterState = WELL) -> None:
        """The master, the base and all needed messages arrive."""
        self.report(state)
        for topic, data in enumerate((scan(1.0), odometry())):
            self.adapter.listener.on_message(topic, data)

    def is_moved(self) -> bool:
        """Whether two commands to move cause a motion."""
        return any(data != FIRST[0] for data in self.command())

    def command(self) -> list[bytes]:
        """The commands that reach the adapter after two commands to move."""
        self.adapter.sent.clear()
        for _ in range(2):
            self.driver.send(MOVING, 1, 1)
        return self.adapter.sent


def playing(**options: Value) -> Callable[[Tell], Test]:
    """A test of a story with a driver; the story takes `scene` and fixtures."""

    def of(tell: Tell) -> Test:
        def run(told: Tell, given: Mapping[str, Any]) -> None:
            started: list[Adapter] = []

            def start(*args: Any) -> Adapter:
                started.append(Adapter(*args))
                return started[-1]

            patch: pytest.MonkeyPatch = given["monkeypatch"]
            patch.setattr(ros1, "AdapterProcess", start)
            given_options = {"master": "http://127.0.0.1:9", **options}
            handclock.run(_played(told, started, given_options, patch))

        return as_test(tell, run, ("scene",), ("monkeypatch",))

    return of


async def _played(
    told: Tell, started: list[Adapter], options: Mapping[str, Value], patch: pytest.MonkeyPatch
) -> None:
    loop = asyncio.get_running_loop()
    clock = SimpleNamespace(monotonic=loop.time, time_ns=lambda: round(1e9 * loop.time()))
    patch.setattr(ros1, "time", clock)
    driver = Ros1Driver(swarm="s", robot="r", platform=load_platform("burger"), options=options)
    scene = Scene(driver, started)
    await asyncio.sleep(0.01)
    try:
        await told(scene=scene)
    finally:
        scene.task.cancel()
        await asyncio.gather(scene.task, return_exceptions=True)
    assert scene.adapter.is_closed_politely, "a clean end sends zero"


@pytest.mark.parametrize(
    "lost",
    [
        MasterState(master=False, text="refused"),
        replace(WELL, others=["/teleop"]),
        replace(WELL, listeners=[], connected=0),
        AdapterEnd("end", "ROS has shut it down"),
    ],
    ids=["master", "other publisher", "no base", "end"],
)
@playing()
async def test_the_loss_of_the_base_ends_commands_at_once(scene: Scene, lost: Any) -> None:
    scene.connect()
    scene.command()
    scene.report(lost)
    assert not scene.sink.is_up
    assert not scene.is_moved()
    if isinstance(lost, MasterState):
        scene.report()
        assert scene.command() == FIRST


@playing()
async def test_one_cause_of_a_loss_is_one_line_in_the_log(
    scene: Scene, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(40):
        scene.report(replace(WELL, publishers={}))
        await asyncio.sleep(0.1)
    texts = [record.getMessage() for record in caplog.records]
    (line,) = [text for text in texts if "no /scan" in text]
    assert "driver_options" in line


@playing()
async def test_the_base_is_lost_2_and_a_half_s_after_a_topic_falls_silent(scene: Scene) -> None:
    scene.connect()
    await asyncio.sleep(2.45)
    assert scene.sink.is_up
    scene.adapter.listener.on_message(0, scan(1.0))
    await asyncio.sleep(0.2)
    assert not scene.sink.is_up, "scans come, odometry does not"
    assert not scene.is_moved()


@playing()
async def test_an_adapter_that_was_connected_is_replaced_after_the_first_pause(
    scene: Scene,
) -> None:
    assert not scene.adapter.config["holds"]
    for count in range(1, 8):
        scene.connect()
        assert scene.command() == FIRST
        scene.adapter.is_dead = True
        await asyncio.sleep(ros1.MIN_RESTART_DELAY + 0.01)
        assert not scene.sink.is_up
        scene.driver.send(MOVING, 1, 1)
        await asyncio.sleep(0.19)
        assert len(scene.started) == count + 1, "the pause does not grow"
        assert scene.adapter.config["holds"], "the robot was driven"
        assert not scene.is_moved()


@playing()
async def test_an_adapter_without_a_base_is_replaced_after_growing_pauses(scene: Scene) -> None:
    for pause in (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0):
        known = len(scene.started)
        scene.adapter.is_dead = True
        await asyncio.sleep(pause - 0.01)
        assert len(scene.started) == known
        await asyncio.sleep(0.22)
        assert len(scene.started) == known + 1


@playing()
async def test_unreadable_messages_and_other_types_are_counted_and_no_sign_of_life(
    scene: Scene,
) -> None:
    scene.report()
    listener = scene.adapter.listener
    listener.on_event(ForeignMessage("/odom", "/base", "nav_msgs/Odometry", "0" * 32))
    listener.on_message(0, scan(1.0)[:-1])
    listener.on_message(5, odometry())  # behind the commands, stop and estop
    assert scene.sink.lost == ["ros1/type", "ros1/scan", "ros1/garbage"]
    assert not scene.sink.is_up


@playing(cmd_vel_frame="base")
async def test_stamped_commands_are_numbered_and_in_the_frame_asked_for(scene: Scene) -> None:
    scene.connect(replace(WELL, command_type="geometry_msgs/TwistStamped"))
    for count, data in enumerate(scene.command(), 1):
        assert struct.unpack_from("<I", data)[0] == count
        assert data[12:20] == b"\x04\0\0\0base"


@pytest.mark.integration
def test_of_waiting_messages_only_the_newest_of_each_topic_is_delivered(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 1000.0
    received: list[tuple[int, bytes]] = []
    dropped: list[str] = []
    listener = SimpleNamespace(
        on_message=lambda topic, data: received.append((topic, data)),
        on_dropped=dropped.append,
        on_event=lambda event: None,
    )

    async def run() -> None:
        child = ros1_child.AdapterProcess(
            "-", "/bin/cat", {"kept_topics": [5]}, os.environ, listener
        )
        monkeypatch.setattr(ros1_child, "time", SimpleNamespace(monotonic=lambda: now))
        near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        near.setblocking(False)
        for topic, age, data in (
            (1, 0.3, b"first"), (1, 0.1, b"newest"), (2, 0.49, b"late"), (3, 0.5, b"history"),
            (4, -0.5, b"of a clock to come"), (5, 9.0, b"a stop"),
        ):  # fmt: skip
            far.send(ros1_adapter.DATA_HEAD.pack(ros1_adapter.DATA, topic, now - age) + data)
        with near, far:
            child._socket, own = near, child._socket
            child._on_readable()
            child._socket = own
        await child.close(politely=False)

    asyncio.run(run())
    assert received == [(1, b"newest"), (2, b"late"), (5, b"a stop")]
    assert dropped == ["overtaken"] * 3


CONTENDED = replace(WELL, others=["/teleop"])
COMMAND_INDEX = 2  # after scan and odometry


@playing()
async def test_a_stopped_robot_gets_zero_at_once_after_each_command_of_another(
    scene: Scene,
) -> None:
    scene.connect()
    scene.command()
    scene.driver.send(ZERO, 2, 2, is_stopped=True)
    scene.report(CONTENDED)
    assert not scene.sink.is_up
    for foreign in (encode_twist(MOVING), b"", b"of another type"):
        scene.adapter.sent.clear()
        scene.adapter.listener.on_message(COMMAND_INDEX, foreign)
        assert scene.adapter.sent == FIRST[:1]
    assert scene.sink.gets_zero
    scene.report(CONTENDED)
    assert scene.sink.states[-1][1].startswith("someone else drives: ")
    scene.adapter.sent.clear()
    scene.adapter.listener.on_message(COMMAND_INDEX, encode_twist(ZERO))
    assert not scene.adapter.sent, "zeros do no harm"


@playing()
async def test_zeros_are_not_promised_without_a_base(scene: Scene) -> None:
    scene.connect()
    scene.report(replace(WELL, listeners=[], connected=0))
    assert (scene.sink.is_up, scene.sink.gets_zero) == (False, False)


@pytest.mark.parametrize("listener", ["/record_1609459200123456789", "/ekf"])
@playing(cmd_vel_listeners=["ekf"])
async def test_a_node_that_records_commands_holds_nothing_and_is_no_base(
    scene: Scene, listener: str
) -> None:
    scene.connect()
    scene.report(replace(WELL, listeners=[*WELL.listeners, listener], connected=2))
    assert scene.sink.hold is None
    assert scene.is_moved()
    scene.report(replace(WELL, listeners=[listener], connected=1))
    assert not scene.sink.is_up
    assert f"only {listener} takes /cmd_vel" in scene.sink.states[-1][1]


def test_the_adapters_environment_is_that_of_the_options(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_MASTER_URI", "http://robot:11311")
    monkeypatch.setenv("ROS_HOSTNAME", "desk")
    usual = read_options(Ros1Options, {}, "ros1", "r")
    assert (usual.master_uri, usual.environ["ROS_HOSTNAME"]) == ("http://robot:11311", "desk")
    given = {"master": "http://127.0.0.1:9", "ip": "10.0.0.7"}
    environ = read_options(Ros1Options, given, "ros1", "r").environ
    assert (environ["ROS_MASTER_URI"], environ["ROS_IP"]) == ("http://127.0.0.1:9", "10.0.0.7")
    assert "ROS_HOSTNAME" not in environ, "it would have priority over ROS_IP"
