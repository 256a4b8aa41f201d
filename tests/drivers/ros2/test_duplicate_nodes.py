"""A base that crashed and restarted, listed by the bridge before it removes the routes."""

from __future__ import annotations

import json

import pytest
import zenoh

from swarmd.core.values import Twist
from swarmd.drivers.ros2.duplicate_nodes import duplicate_of
from swarmd.testing.driver_contract import DriverHarness, play
from tests.drivers.ros2.harness import reported
from tests.drivers.ros2.robots import BridgedRobot

BASE = json.dumps(
    {"publishers": [], "subscribers": [{"name": "/cmd_vel", "type": "geometry_msgs/msg/Twist"}]}
).encode()
CAMERA = json.dumps({"publishers": [{"name": "/image", "type": "x"}], "subscribers": []}).encode()


@pytest.mark.parametrize(
    ("known", "wanted"),
    [
        ({}, ""),
        ({"@/ab/ros2/node/01/base": BASE, "@/ab/ros2/node/02/lidar": BASE}, ""),
        ({"@/ab/ros2/node/01/base": BASE, "@/ab/ros2/node/02/base": BASE}, "/base"),
        ({"@/ab/ros2/node/01/r/base": BASE, "@/ab/ros2/node/02/r/base": BASE}, "/r/base"),
        ({"@/ab/ros2/node/01/base": BASE, "@/cd/ros2/node/02/base": BASE}, ""),
        ({"@/ab/ros2/node/01/base": BASE, "@/ab/ros2/node/02/base": CAMERA}, ""),
        ({"@/ab/ros2/node/01/eye": CAMERA, "@/ab/ros2/node/02/eye": CAMERA}, ""),
        *(
            ({"@/ab/ros2/node/01/base": junk, "@/ab/ros2/node/02/base": junk}, "")
            for junk in (b"", b"\xff", b"[]", b"{}", b'{"subscribers": [{"name": 1}]}', b"[" * 9999)
        ),
        ({"@": BASE, "@/ros2": BASE}, ""),
    ],
)
@pytest.mark.parametrize("topic", ["/cmd_vel", "/tb3_01/cmd_vel"])
def test_a_node_that_takes_commands_and_is_there_twice_is_found(
    known: dict[str, bytes], wanted: str, topic: str
) -> None:
    assert duplicate_of(known, topic) == wanted


def test_a_base_that_crashed_and_is_back_is_stopped_while_it_can_be() -> None:
    robot = BridgedRobot()
    where = f"@/{robot.hub.zid()}/ros2/node"
    known = {f"{where}/01/base": BASE}

    def on_query(query: zenoh.Query) -> None:
        for key, payload in dict(known).items():
            query.reply(key, payload)

    robot.hub.declare_queryable(f"{where}/**", on_query)

    async def story(harness: DriverHarness) -> None:
        taken: list[Twist] = []

        def is_stopped(*, wanted: bool) -> bool:
            taken.extend(robot.commands())
            return bool(taken) and taken[-1].is_zero == wanted

        for _ in range(2):
            harness.driver.send(Twist(0.1), 1, 1)
        await harness.until(lambda: is_stopped(wanted=False))
        known[f"{where}/02/base"] = BASE
        await harness.until(lambda: not harness.sink.is_up, publishing=True)
        assert reported(harness, "/base crashed and is back", is_up=False)
        await harness.until(lambda: is_stopped(wanted=True))
        del known[f"{where}/01/base"]
        await harness.until(lambda: harness.sink.is_up, publishing=True)

    play(robot, story)
