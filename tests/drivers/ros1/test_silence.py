"""When the adapter of driver `ros1` sends zeros by itself: exactly, without ROS or a second thread.

The test replaces rospy, keeps the published commands and controls the clock; `test_life.py` has a
real roscore.
"""

from __future__ import annotations

import contextlib
import json
import struct
from collections.abc import Callable, Mapping
from inspect import signature
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest

from swarmd.core.values import Twist
from swarmd.drivers.ros1 import adapter_process as ros1_adapter
from swarmd.drivers.ros1 import serialization
from swarmd.drivers.ros1.adapter_process import COMMAND, COMMAND_HEAD, FAREWELL, ZERO_TIME, Adapter

BEGIN = 1000.0
MOVING = serialization.encode_twist(Twist(0.1, -0.2))
TURNING = serialization.encode_twist(Twist(0.0, 0.1))
ZERO = bytes(48)
KINDS = ["geometry_msgs/Twist", "geometry_msgs/TwistStamped"]


class NoMore(Exception):
    """No packet is left, or the process has ended."""


class Scene:
    """An adapter, its published commands with their times, and the packets of its daemon."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **config: Any) -> None:
        self.now = BEGIN
        self.published: list[tuple[float, bytes]] = []
        self.events: list[dict[str, str]] = []
        self.left_at: float | None = None
        self._frames: list[bytes] = []
        self._until = BEGIN
        self._to_do: dict[float, Callable[[], None]] = {}
        clock = SimpleNamespace(
            monotonic=lambda: self.now, sleep=self._sleep, time_ns=lambda: 5_000_000_007
        )
        monkeypatch.setattr(ros1_adapter, "time", clock)
        given = {"master": "http://127.0.0.1:9", "name": "swarmd_r", "topics": [], "types": [],
                 "md5sums": [], "kept_topics": [], "command_topics": ["/cmd_vel"],
                 "command_types": KINDS[:1],
                 "definitions": {kind: ["", ""] for kind in (*KINDS, "std_msgs/String")},
                 "state_topic": "/swarmd/state", "frame_id": "",
                 "is_check": False, "holds": False, **config}  # fmt: skip
        sock: Any = self
        offered = {
            "config": given,
            "sock": sock,
            "rospy": self._rospy(),
            "master": SimpleNamespace(caller="", forget=lambda: None),
        }
        wanted = signature(Adapter).parameters
        self.adapter = Adapter(**{name: offered[name] for name in wanted})
        monkeypatch.setattr(self.adapter, "_leave", self._leave)
        self.adapter._join()

    def _rospy(self) -> Any:
        impl = SimpleNamespace(
            set_queue_size=lambda size: None, acquire=lambda: None, release=lambda: None
        )

        def publisher(topic: str, kind: type, **_: Any) -> Any:
            return SimpleNamespace(publish=self._publish, impl=impl, data_class=kind)

        server = SimpleNamespace(tcp_ros_server=SimpleNamespace(inbound_handler=None))
        tcpros = SimpleNamespace(start_tcpros_server=lambda: None, _tcpros_server=server)
        return SimpleNamespace(
            AnyMsg=object,
            init_node=lambda *_, **__: None,
            get_name=lambda: "/swarmd_r_1",
            on_shutdown=lambda hook: None,
            is_shutdown=lambda: False,
            Publisher=publisher,
            impl=SimpleNamespace(tcpros_base=tcpros),
        )

    def _publish(self, message: Any) -> None:
        self.published.append((self.now, message._buff))

    def _leave(self) -> None:
        self.left_at = self.now
        raise NoMore

    def _sleep(self, seconds: float) -> None:
        self.now = round(self.now + seconds, 6)
        for moment in [moment for moment in self._to_do if moment <= self.now]:
            self._to_do.pop(moment)()
        if self.now > self._until:
            raise NoMore

    # The socket to the daemon

    def recv(self, size: int) -> bytes:
        if not self._frames:
            raise NoMore
        return self._frames.pop(0)

    def sendmsg(self, parts: tuple[bytes, ...], *_: object) -> None:
        frame = b"".join(parts)
        if frame[:1] == ros1_adapter.EVENT:
            self.events.append(json.loads(frame[1:]))

    def deliver(self, *frames: bytes) -> None:
        """Deliver packets of the daemon."""
        self._frames = list(frames)
        with contextlib.suppress(NoMore):
            self.adapter._read()

    def command(self, payload: bytes, age: float = 0.0) -> None:
        self.deliver(COMMAND_HEAD.pack(COMMAND, self.now - age) + payload)

    def pass_time(
        self, seconds: float, to_do: Mapping[float, Callable[[], None]] | None = None
    ) -> list[float]:
        """Let the adapter tick; the times of its zeros in s. `to_do`: an action for each time."""
        begun, self.published = self.now, []
        self._until = begun + seconds
        self._to_do = {begun + after: action for after, action in (to_do or {}).items()}
        with contextlib.suppress(NoMore):
            self.adapter._tick()
        return [round(at - begun, 3) for at, payload in self.published if payload[-48:] == ZERO]


@pytest.fixture
def scene(monkeypatch: pytest.MonkeyPatch) -> Scene:
    return Scene(monkeypatch)


@pytest.mark.parametrize("payload", [MOVING, TURNING])
def test_zeros_begin_after_0_4_s_of_silence_and_go_on(scene: Scene, payload: bytes) -> None:
    scene.command(payload)
    assert [payload for _, payload in scene.published] == [payload]
    zeros = scene.pass_time(10.0)
    assert 0.4 <= zeros[0] <= 0.45
    assert zeros[-1] > 9.9
    assert all(later - sooner < 0.051 for sooner, later in pairwise(zeros))
    assert scene.left_at is None, "the adapter continues: the daemon may return"


def test_commands_of_a_daemon_that_continues_are_passed_on(scene: Scene) -> None:
    scene.command(MOVING)
    zeros = scene.pass_time(4.0, {1.0 + 0.1 * i: lambda: scene.command(MOVING) for i in range(40)})
    assert all(0.4 <= zero <= 2.5 for zero in zeros), "zeros for 2 s at most"
    moving = [at - BEGIN for at, payload in scene.published if payload == MOVING]
    assert moving[0] == pytest.approx(0.4 + ZERO_TIME, abs=0.16), "zeros for 2 s come first"


def test_a_robot_that_an_earlier_adapter_drove_gets_zeros_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert Scene(monkeypatch, holds=True).pass_time(1.0)[0] == 0.0


def test_a_robot_of_an_earlier_adapter_gets_zeros_for_2_s_after_it_connects(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = Scene(monkeypatch, holds=True)

    def connect() -> None:
        scene.adapter.peer_subscribe("/cmd_vel", None, lambda message: None)

    zeros = scene.pass_time(10.0, {1.0: connect})
    assert zeros[-1] == pytest.approx(3.0, abs=0.06), "another node may drive afterwards"
    zeros = scene.pass_time(10.0, {1.0: connect})
    assert zeros[0] == pytest.approx(1.0, abs=0.06), "a base that connects later may still drive"
    assert zeros[-1] == pytest.approx(3.0, abs=0.06)
    scene.command(MOVING)
    assert scene.pass_time(10.0, {1.0: connect})[-1] > 9.9, "as after the silence of any daemon"


def test_one_zero_does_not_make_silence_harmless(scene: Scene) -> None:
    scene.command(MOVING)
    scene.command(ZERO)
    assert scene.pass_time(1.0), "that zero may have been lost"


def test_half_a_second_of_zeros_makes_silence_harmless(scene: Scene) -> None:
    scene.command(MOVING)
    idle = {0.1 * i: lambda: scene.command(ZERO) for i in range(1, 8)}
    assert len(scene.pass_time(5.0, idle)) == len(idle), "an idle daemon may be silent"


def test_a_command_that_waited_for_0_2_s_is_dropped(scene: Scene) -> None:
    scene.command(MOVING, age=0.19)
    assert len(scene.published) == 1
    scene.command(MOVING, age=0.2)
    scene.deliver(COMMAND_HEAD.pack(COMMAND, scene.now), b"?")
    assert len(scene.published) == 1


@pytest.mark.parametrize("frozen", [0.25, 0.6, 0.95])
def test_a_thawed_adapter_passes_on_what_is_younger_than_0_2_s(scene: Scene, frozen: float) -> None:
    scene.command(MOVING)
    begin = scene.now
    sent = [begin + 0.05 * i for i in range(1, round(frozen / 0.05))]
    scene.now, scene.published = begin + frozen, []
    frames = [COMMAND_HEAD.pack(COMMAND, at) + MOVING for at in sent]
    scene.deliver(*frames)
    assert len(scene.published) == sum(begin + frozen - at < 0.2 for at in sent)
    assert 3 <= len(scene.published) <= 4


def test_after_the_daemons_end_the_adapter_sends_zeros_for_2_s_and_leaves(scene: Scene) -> None:
    scene.command(MOVING)
    scene.deliver(b"")
    zeros = scene.pass_time(10.0)
    assert zeros[0] == 0.0
    assert scene.left_at == pytest.approx(BEGIN + 2.0, abs=0.051)
    assert len(zeros) >= 40


def test_a_farewell_causes_one_zero_and_the_end(scene: Scene) -> None:
    scene.command(MOVING)
    scene.deliver(FAREWELL)
    assert scene.pass_time(10.0) == [0.0]
    assert scene.left_at == BEGIN


def test_an_adapter_that_never_drove_leaves_without_a_zero(scene: Scene) -> None:
    scene.deliver(b"")
    assert scene.pass_time(10.0) == []
    assert scene.left_at == BEGIN


def test_no_command_is_passed_on_after_a_request_to_end(scene: Scene) -> None:
    scene.command(MOVING)
    scene.adapter.end(ZERO_TIME, "a signal ended the adapter")
    scene.published.clear()
    scene.command(MOVING)
    assert not scene.published
    assert scene.events[-1] == {"event": "end", "kind": "end", "text": "a signal ended the adapter"}


def test_zeros_of_its_own_are_of_the_bases_type(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(monkeypatch, command_types=KINDS[1:], frame_id="base")
    scene.command(struct.pack("<4I", 0, 1, 2, 0) + MOVING)
    scene.pass_time(0.5)
    assert scene.published[0][1] == serialization.encode_twist_stamped(
        Twist(), 0, 5_000_000_007, "base"
    )


def test_a_base_that_connects_while_it_is_driven_gets_zero_first(scene: Scene) -> None:
    given: list[bytes] = []

    def keep(message: Any) -> None:
        given.append(message._buff)

    scene.adapter.peer_subscribe("/cmd_vel", None, keep)
    assert not given, "no command has come yet: a joystick may drive"
    scene.command(MOVING)
    scene.adapter.peer_subscribe("/cmd_vel", None, keep)
    assert given == [ZERO]
