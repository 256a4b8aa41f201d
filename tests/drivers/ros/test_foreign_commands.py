"""Commands and goals of other nodes, without links."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from swarmd.core.values import Twist
from swarmd.drivers.ros import cdr, messages
from swarmd.drivers.ros.diagnosis import Graph, driven
from swarmd.drivers.ros.endpoints import Endpoint
from swarmd.drivers.ros.foreign_commands import (
    ROS1_ACTIONS,
    ROS2_ACTIONS,
    YIELD_TIME,
    ActionProtocol,
    ForeignCommands,
)
from swarmd.drivers.ros.from_ros import command_message
from swarmd.drivers.ros.options import Ros1Options, RosOptions
from swarmd.drivers.ros1 import serialization
from swarmd.drivers.ros2.dds_bridge import Ros2Dds

GIVEN: dict[str, Any] = {
    "namespace": "tb",
    "other_commands": ("cmd_vel_joy", "/cmd_vel_nav"),
    "other_actions": ("dock",),
}
STATUS = "/tb/dock/_action/status"
PENDING, EXECUTING, CANCELING, SUCCEEDED = 0, 2, 3, 4


def foreign(protocol: ActionProtocol = ROS2_ACTIONS, **more: Any) -> ForeignCommands:
    return ForeignCommands(RosOptions(**GIVEN), protocol, **more)


def states(*given: int) -> Any:
    return SimpleNamespace(status_list=[SimpleNamespace(status=state) for state in given])


def test_topics_and_actions_are_in_the_robots_namespace() -> None:
    known = foreign()
    assert known.topics == ("/tb/cmd_vel", "/tb/cmd_vel_joy", "/cmd_vel_nav")
    assert known.actions == {STATUS: "/tb/dock"}
    of_ros1 = ForeignCommands(Ros1Options(**GIVEN), ROS1_ACTIONS)
    assert of_ros1.actions == {"/tb/dock/status": "/tb/dock"}


@pytest.mark.parametrize("kind", [messages.Twist, messages.TwistStamped])
@pytest.mark.parametrize(
    ("twist", "moves"),
    [
        (Twist(), False),
        (Twist(-0.0, -0.0), False),
        (Twist(0.0, 1e-9), True),
        (Twist(0.0, 0.0, -0.1), True),
        (Twist(math.nan), True),
    ],
)
def test_a_command_of_either_type_is_zero_or_drives(kind: type, twist: Twist, moves: bool) -> None:
    message = command_message(twist, kind, "base_link")
    assert foreign().take_command("/cmd_vel_nav", cdr.encode(message), (), 0.0) is moves
    if kind is messages.Twist:
        assert foreign().take_command("/x", serialization.encode_twist(twist), (), 0.0) is moves
    else:
        stamped = serialization.encode_twist_stamped(twist, 1, 2, "base")
        assert foreign().take_command("/x", stamped, (), 0.0) is moves


@pytest.mark.parametrize(
    ("payload", "types"),
    [(b"", ()), (bytes(47), ()), (bytes(52), ("std_msgs/msg/Float64MultiArray",))],
    ids=["of another type", "too short", "announced as another type"],
)
def test_what_is_no_twist_drives(payload: bytes, types: tuple[str, ...]) -> None:
    assert foreign().take_command("/cmd_vel_nav", payload, types, 0.0)


def test_a_command_counts_for_2_s() -> None:
    known = foreign()
    assert known.source(0.0) == ""
    known.take_command("/cmd_vel_nav", b"", (), 10.0)
    assert known.source(10.0 + YIELD_TIME - 0.01) == "/cmd_vel_nav"
    assert known.source(10.0 + YIELD_TIME) == ""
    assert known.counts == {"/cmd_vel_nav": 1}


def test_commands_on_a_shared_topic_are_counted_and_do_not_drive() -> None:
    known = foreign(is_cmd_vel_shared=True)
    assert known.take_command("/tb/cmd_vel", b"", (), 0.0)
    assert known.source(0.0) == ""
    assert known.take_command("/cmd_vel_nav", b"", (), 0.0)
    assert known.source(0.0) == "/cmd_vel_nav"


@pytest.mark.parametrize(
    ("state", "drives"),
    [(1, True), (EXECUTING, True), (CANCELING, True), (SUCCEEDED, False), (5, False), (6, False)],
)
def test_an_active_goal_drives_for_as_long_as_it_is_active(state: int, drives: bool) -> None:
    known = foreign()
    assert known.take_status(STATUS, states(SUCCEEDED, state), 0.0) is drives
    assert bool(known.source(1e6)) is drives
    known.take_status(STATUS, states(SUCCEEDED, SUCCEEDED), 1e6)
    assert bool(known.source(1e6 + YIELD_TIME - 0.01)) is drives
    assert known.source(1e6 + YIELD_TIME) == ""


def test_a_goal_ends_with_its_server() -> None:
    known = foreign()
    known.take_status(STATUS, states(EXECUTING), 0.0)
    known.end_goals(STATUS, 10.0)
    assert known.source(10.0) == STATUS
    assert known.source(10.0 + YIELD_TIME) == ""


def test_a_goal_of_ros1_ends_when_its_status_does_not_come_again() -> None:
    known = ForeignCommands(Ros1Options(**GIVEN), ROS1_ACTIONS)
    assert not known.take_status("/tb/dock/status", states(PENDING), 0.0)
    assert known.take_status("/tb/dock/status", states(1), 0.0)
    assert known.source(1.9) == "/tb/dock/status"
    assert known.source(2.0) == ""


def test_an_action_is_named_before_a_command_with_the_way_to_cancel_it() -> None:
    known = foreign()
    ends = [
        Endpoint(True, STATUS, "action_msgs/msg/GoalStatusArray", node="/motion_control"),
        Endpoint(True, "/cmd_vel_nav", "geometry_msgs/msg/Twist", node="/nav"),
    ]
    graph = Graph(middleware=Ros2Dds(), endpoints=ends)
    assert driven(known, graph, 0.0) == ""
    known.take_command("/cmd_vel_nav", b"", (), 0.0)
    text = driven(known, graph, 0.0)
    assert text.startswith("someone else drives: ")
    assert "/cmd_vel_nav" in text
    assert "/nav;" in text
    known.take_status(STATUS, states(EXECUTING), 0.0)
    text = driven(known, graph, 0.0)
    assert text.startswith("someone else drives: action /tb/dock of /motion_control")
    assert "/tb/dock/_action/cancel_goal" in text


@pytest.mark.parametrize("lasting", [True, False])
def test_zeros_that_do_not_end_are_known(lasting: bool) -> None:
    known = foreign()
    for tenth in range(40 if lasting else 20):  # a watchdog sends 2 s of them
        known.take_command("/tb/cmd_vel", bytes(52), (), 0.1 * tenth)
    assert known.has_lasting_zeros(0.1 * tenth) is lasting
    assert not known.has_lasting_zeros(100.0)
