"""When a ROS 2 driver reports its robot as lost, and its commands then: exactly, without Zenoh.

The test controls the session and the clock; `test_dds_bridge.py` has real sessions.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from swarmd.core.values import Platform, Twist, Value
from swarmd.driver_api.command_source import DriverCommand
from swarmd.drivers.ros2 import dds_bridge as ros2dds
from swarmd.drivers.ros2 import driver as ros_driver
from swarmd.drivers.ros2.command_credit import MAX_HELD_TIME
from swarmd.drivers.ros2.driver import RosDriver
from swarmd.testing.driver_contract import CollectingSink
from tests.drivers.ros2 import robots
from tests.support import hand_clock as handclock
from tests.support import ros2_types as dds
from tests.support.stories import Tell, Test, as_test

MOVING = Twist(0.1)


class Session:
    """A Zenoh session to a hub with one robot; it keeps what is put on a key."""

    def __init__(self) -> None:
        self.is_linked = True
        self.hub = "hub"
        self.is_closed = False
        self.sent: list[tuple[str, Twist]] = []
        self.origins: list[object] = []
        self.tokens: list[str] = []
        self.on_graph_query: Callable[[Any], None] = lambda answer: answer.drop()
        self._subscribers: dict[str, Callable[[Any], None]] = {}
        self.info = SimpleNamespace(
            zid=lambda: "ab",
            routers_zid=lambda: [self.hub] if self.is_linked else [],
            peers_zid=lambda: [],
        )

    def declare_publisher(self, key: str, **_: object) -> Any:
        def put(payload: bytes, *, attachment: bytes | None) -> None:
            self.sent.append((key, robots.twist(payload, is_stamped=False)))

        return SimpleNamespace(put=put, matching_status=SimpleNamespace(matching=True))

    def declare_subscriber(
        self, key: str, take: Callable[[Any], None], *, allowed_origin: object
    ) -> None:
        self._subscribers[key] = take
        self.origins.append(allowed_origin)

    def subscribe_with_history(self, key: str, take: Callable[[Any], None]) -> None:
        """No publisher has kept a message."""
        self._subscribers[key] = take

    def liveliness(self) -> Any:
        return SimpleNamespace(
            declare_subscriber=lambda key, take, *, history: None,
            declare_token=self.tokens.append,
            get=lambda key, answer, *, timeout: self.on_graph_query(answer),
        )

    def get(self, selector: str, take: Callable[[Any], None], *, timeout: float) -> None:
        """There is no answer."""

    def close(self) -> None:
        self.is_closed = True

    def publish(self, topic: str, message: Any, key: str | None = None) -> None:
        """The robot publishes on a topic, or on another key that the subscriber matches."""
        payload = message if isinstance(message, bytes) else message.serialize()
        sample = SimpleNamespace(
            key_expr=key or topic, payload=SimpleNamespace(to_bytes=lambda: payload)
        )
        self._subscribers[topic](sample)

    def moves(self, stamp: float = 1.0) -> None:
        self.publish("odom", robots.odometry(stamp))

    def taken(self) -> list[Twist]:
        """The commands since the last call."""
        found, self.sent = self.sent, []
        return [twist for _, twist in found]


class Scene:
    """A driver that runs, the session that it has opened, and its sink."""

    def __init__(self, driver: RosDriver, session: Session) -> None:
        self.driver, self.session, self.sink = driver, session, CollectingSink()
        self.task = asyncio.create_task(driver.run(self.sink))

    @property
    def is_up(self) -> bool:
        return self.sink.is_up

    def command(self) -> list[Twist]:
        """The commands that reach the base after two commands to move."""
        for _ in range(2):
            self.driver.send(MOVING, 1, 1)
        return self.session.taken()

    async def move(self) -> None:
        self.session.moves()
        await handclock.settle()

    async def pass_time(self, seconds: float, *, moving: bool = False) -> None:
        """Pass the time and a little more, since the driver checks ten times per second."""
        begun = asyncio.get_running_loop().time()
        while asyncio.get_running_loop().time() - begun < seconds + 0.005:
            if moving:
                self.session.moves()
            await asyncio.sleep(0.01)

    async def end(self) -> None:
        self.task.cancel()
        await asyncio.gather(self.task, return_exceptions=True)

    async def restart(self) -> None:
        await self.end()
        self.task = asyncio.create_task(self.driver.run(self.sink))


def playing(tell: Tell) -> Test:
    """A test of a story with a driver; the story takes `scene` and fixtures.

    The scans come at the `rate` of a parameter, or as often as the platform's do. A parameter
    `actions` is the option `other_actions`.
    """

    def run(told: Tell, given: Mapping[str, Any]) -> None:
        session = Session()
        patch = given["monkeypatch"].setattr
        patch(ros_driver, "open_session", lambda endpoint, within: session)
        patch(ros_driver, "subscribe_with_history", Session.subscribe_with_history)
        platform = slow(given["rate"]) if "rate" in given else robots.PLATFORM
        handclock.run(_played(told, make(platform, given.get("actions", [])), session))

    return as_test(tell, run, ("scene",), ("monkeypatch",))


async def _played(told: Tell, driver: RosDriver, session: Session) -> None:
    scene = Scene(driver, session)
    await scene.pass_time(0.0)
    try:
        await told(scene=scene)
    finally:
        await scene.end()
    assert session.is_closed


def make(platform: Platform, actions: list[Value]) -> RosDriver:
    given: Mapping[str, Value] = {"cmd_vel_type": "twist", "other_actions": actions}
    return ros2dds.make_driver(swarm="s", robot="r", platform=platform, options=given)


def slow(rate: float) -> Platform:
    return replace(robots.PLATFORM, scan=replace(robots.PLATFORM.scan, rate=rate))


@pytest.mark.parametrize(("rate", "seconds"), [(5.0, 1.0), (1.0, 3.5)])
@playing
async def test_a_base_is_lost_after_1_s_of_silence_or_3_and_a_half_scans(
    scene: Scene, rate: float, seconds: float
) -> None:
    await scene.move()
    await scene.pass_time(seconds - 0.02)
    assert scene.is_up
    await scene.pass_time(0.12)  # it looks every 0.1 s
    assert not scene.is_up
    assert "no scan and no odometry" in scene.sink.states[-1][1]


@playing
async def test_a_link_that_is_cut_is_a_lost_base_at_once(scene: Scene) -> None:
    await scene.move()
    scene.command()
    scene.session.is_linked = False
    await scene.pass_time(0.12, moving=True)
    lost = [text for is_up, text in scene.sink.states if not is_up]
    assert lost[-1].startswith("nothing answers at tcp/")
    assert scene.session.taken()[0] == Twist()


@playing
async def test_a_hub_that_restarts_instantly_gets_zeros_for_2_s(scene: Scene) -> None:
    await scene.pass_time(3.0, moving=True)
    scene.command()
    scene.session.hub = "another"  # which may know the base only in a while
    await scene.pass_time(1.9)
    taken = scene.session.taken()
    assert not scene.is_up
    assert len(taken) > 15
    assert all(twist.is_zero for twist in taken)


@playing
async def test_another_nodes_command_stops_the_driver_for_2_s(scene: Scene) -> None:
    await scene.move()
    scene.command()
    scene.session.publish("cmd_vel", robots.command(0.2))
    await handclock.settle()
    assert not scene.is_up
    assert scene.session.taken() == [Twist()]
    await scene.pass_time(1.96, moving=True)
    assert not scene.is_up
    assert not scene.command()
    await scene.pass_time(0.05, moving=True)
    assert scene.is_up
    assert scene.command() == [Twist(), MOVING]


@playing
async def test_a_command_that_waits_does_not_leave_once_a_second_base_is_found(
    scene: Scene,
) -> None:
    await scene.move()
    scene.command()
    await scene.pass_time(0.1)
    for stamp in (5.0, 3.0, 4.0, 2.0):  # as of two bases that publish one odometry
        scene.session.moves(stamp)
        await handclock.settle()
    await scene.pass_time(0.02)
    scene.session.on_graph_query = lambda answer: None
    scene.driver.send(MOVING, 1, 1)  # it waits for a sign of life of the hub
    waiting_since = asyncio.get_running_loop().time()
    while scene.sink.hold is None:
        await scene.pass_time(0.005)
    scene.session.taken()
    scene.session.moves(6.0)
    await handclock.settle()
    assert asyncio.get_running_loop().time() - waiting_since < MAX_HELD_TIME
    assert all(twist.is_zero for twist in scene.session.taken())


@pytest.mark.parametrize(
    ("message", "key", "is_lost"),
    [
        (robots.command(0.0), None, False),
        (robots.command(-0.001), None, True),
        (dds.Twist(angular=dds.Vector3(z=0.1)), None, True),
        (b"\x00\x01\x00\x00no twist", None, True),
        (robots.command(0.0), "**", True),
    ],
    ids=["zero", "backwards", "a turn", "unreadable", "on every key"],
)
@playing
async def test_any_command_but_zero_counts_as_driving(
    scene: Scene, message: Any, key: str | None, is_lost: bool
) -> None:
    await scene.move()
    scene.session.publish("cmd_vel", message, key)
    await handclock.settle()
    assert scene.is_up != is_lost


@pytest.mark.parametrize("hub", ["hub", "another"])
@playing
async def test_a_base_is_lost_until_its_hub_has_listed_its_nodes(scene: Scene, hub: str) -> None:
    answers: list[Any] = []
    scene.session.on_graph_query = answers.append
    if hub == "hub":
        await scene.restart()
    else:
        await scene.pass_time(0.2, moving=True)
        assert scene.is_up
        scene.session.hub = hub
    await scene.pass_time(2.5, moving=True)
    (answer,) = answers
    assert not scene.is_up
    assert "has not listed its nodes yet" in scene.sink.states[-1][1]
    answer.callback(SimpleNamespace(err="Timeout"))
    answer.drop()
    await scene.pass_time(0.1, moving=True)
    assert not scene.is_up
    assert len(answers) == 2
    answers[-1].drop()
    await scene.pass_time(0.1, moving=True)
    assert scene.is_up


@playing
async def test_unreadable_samples_and_other_keys_are_counted_and_no_sign_of_life(
    scene: Scene,
) -> None:
    scene.session.publish("scan", b"\x00\x01\x00\x00rubbish")
    scene.session.publish("odom", robots.odometry(1.0), "**")
    await handclock.settle()
    assert sorted(scene.sink.lost) == ["odometry:type", "scan"]
    assert not scene.is_up
    assert scene.sink.order.count("odometry") == 0


@pytest.mark.parametrize("later", [("**", b"x"), ("swarmd/estop", b"")], ids=["every key", "empty"])
@playing
async def test_a_stop_that_waits_outlasts_samples_that_are_no_stop(
    scene: Scene, later: tuple[str, bytes]
) -> None:
    """Neither do these samples use up the ten stops that a topic takes at once."""
    commands: list[DriverCommand] = []
    scene.driver.command_source.serve(lambda command, answer: commands.append(command))
    key, payload = later
    for reason in ("smoke", "fire"):
        for k in range(50):  # the loop does not run meanwhile
            scene.session.publish("swarmd/estop", payload, key)
            if k == 25:
                scene.session.publish("swarmd/estop", dds.String(reason))
        await handclock.settle()
    assert [(one.verb, one.reason) for one in commands] == [("estop", "smoke"), ("estop", "fire")]
    assert scene.sink.lost.count("/swarmd/estop:refused") == 100


@pytest.mark.parametrize("actions", [["dock"]])
@playing
async def test_the_state_of_a_goal_that_waits_outlasts_a_sample_on_every_key(
    scene: Scene, actions: list[Value]
) -> None:
    await scene.move()
    assert actions == ["dock"]
    topic = "dock/_action/status"
    scene.session.publish(topic, dds.GoalStatusArray([dds.GoalStatus(status=2)]))
    scene.session.publish(topic, b"x", "**")
    await handclock.settle()
    assert not scene.is_up
    assert "action" in scene.sink.states[-1][1]


@playing
async def test_a_stop_that_waits_before_any_bytes_still_stops(scene: Scene) -> None:
    commands: list[DriverCommand] = []
    scene.driver.command_source.serve(lambda command, answer: commands.append(command))
    for verb in ("stop", "estop"):
        scene.session.publish(f"swarmd/{verb}", dds.String("smoke"))
        scene.session.publish(f"swarmd/{verb}", b"\xff")
    await handclock.settle()
    assert [one.verb for one in commands] == ["stop", "estop"]
