"""A ROS 2 robot on DDS behind the real zenoh-bridge-ros2dds, controlled by a test."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from cyclonedds.core import Qos
from cyclonedds.domain import Domain

from swarmd.core.values import Twist, Value
from tests.drivers.ros2.robots import BridgedRobot, open_session
from tests.support import ros2_types as dds
from tests.support.dds_node import DdsNode
from tests.support.fast_dds import FastDdsNode
from tests.support.ros2_bridge import LOOPBACK, Bridge, free_domain

SENSES: Mapping[str, Any] = {"scan": dds.LaserScan, "odom": dds.Odometry}


class DdsRobot(BridgedRobot):
    """A node that publishes scans and odometry and takes velocities, with a bridge of its own.

    `namespace`, such as `/front`, is the node's. `at` is the bridge's, which precedes it.
    `published`: the type of each topic. `distro`: the bridge's setting; the robot is of Jazzy.
    `is_elsewhere`: the bridge is in another domain. `qos`: by topic, where it is not the usual one.
    `actions` are the names of actions that the node serves. With `is_on` False the node begins with
    `start`: a node that ends while the bridge starts may leave the bridge deaf to later nodes.
    `make_node`: another library's node, in place of CycloneDDS.
    `stop` ends the node, `disconnect` the bridge.
    """

    def __init__(
        self,
        *,
        namespace: str = "",
        at: str = "",
        is_stamped: bool = False,
        published: Mapping[str, Any] = SENSES,
        distro: str = "jazzy",
        is_elsewhere: bool = False,
        qos: Mapping[str, Qos] | None = None,
        actions: Sequence[str] = (),
        is_on: bool = True,
        make_node: Callable[..., DdsNode | FastDdsNode] = DdsNode,
    ) -> None:
        self.namespace, self.at = namespace, at
        self._published, self._qos, self._actions = published, qos or {}, actions
        self._make_node = make_node
        self._folder = tempfile.TemporaryDirectory()
        self.domain = free_domain()
        self._held = Domain(self.domain, LOOPBACK)  # ends, with all in it, when it is deleted
        folder, domain = Path(self._folder.name), free_domain() if is_elsewhere else self.domain
        self.bridge = Bridge(folder, domain, namespace=at or "/", distro=distro)
        self.node: DdsNode | FastDdsNode | None = None
        super().__init__(is_stamped=is_stamped)
        self.endpoint = self.bridge.endpoint
        if is_on:
            self.start()

    def name(self, topic: str) -> str:
        return f"{self.namespace}/{topic}"

    def start(self) -> None:
        published = {self.name(topic): kind for topic, kind in self._published.items()}
        command = dds.TwistStamped if self.is_stamped else dds.Twist
        subscribed = {self.name("cmd_vel"): command}
        qos = {self.name(topic): one for topic, one in self._qos.items()}
        actions = [self.name(action) for action in self._actions]
        self.node = self._make_node(
            self.domain, "base", published, subscribed, qos=qos, actions=actions
        )

    def stop(self) -> None:
        """End the node in order; the bridge continues."""
        if self.node is not None:
            self.node.close()
            self.node = None

    def reconnect(self) -> None:
        self.bridge.start()

    def disconnect(self) -> None:
        self.bridge.kill()

    def put(self, topic: str, message: Any) -> None:
        """Publish over DDS; bytes, which no DDS node would write, go to the bridge."""
        if isinstance(message, bytes):
            key = f"{self.at}{self.name(topic)}".removeprefix("/")
            session = open_session("client", "connect/endpoints", self.endpoint)
            with contextlib.closing(session):
                session.put(key, message)
        elif self.node is not None and topic in self._published:
            kind = self._published[topic]
            is_usual = kind is SENSES.get(topic)
            converted = kind.deserialize(message.serialize()) if is_usual else message
            assert isinstance(converted, kind)
            self.node.publish(self.name(topic), converted)

    def commands(self) -> Sequence[Twist]:
        received = [] if self.node is None else self.node.take(self.name("cmd_vel"))
        twists = [message.twist if self.is_stamped else message for message in received]
        # The watchdog's zero for either type is 5e-324 m/s to the side as a Twist: below any wheel.
        sides = [one.linear.y if abs(one.linear.y) > 1e-300 else 0.0 for one in twists]
        return [
            Twist(one.linear.x, one.angular.z, side)
            for one, side in zip(twists, sides, strict=True)
        ]

    def options(self, given: Mapping[str, Value]) -> Mapping[str, Value]:
        whole = f"{self.at}{self.namespace}"
        names: dict[str, Value] = {"namespace": whole} if whole else {}
        return super().options({"cmd_vel_type": "auto", **names, **given})

    def dock(self, *, is_latched: bool) -> DdsDock:
        return DdsDock(self.domain, is_latched=is_latched)

    def other_node(self, *, has_lidar: bool = False) -> OtherDdsNode:
        return OtherDdsNode(self.domain, has_lidar=has_lidar, make_node=self._make_node)

    def close(self) -> None:
        self.bridge.kill()
        self.stop()
        del self._held
        self._folder.cleanup()


class DdsDock:
    """A node that publishes `dock` on change."""

    def __init__(self, domain: int, *, is_latched: bool) -> None:
        latched = ["/dock"] if is_latched else []
        self._node = DdsNode(domain, "dock", {"/dock": dds.Bool}, latched=latched)

    def put(self, is_docked: bool) -> None:
        self._node.publish("/dock", dds.Bool(data=is_docked))

    def is_heard(self) -> bool:
        return self._node.is_heard("/dock")

    def close(self) -> None:
        self._node.close()


class OtherDdsNode:
    """A node beside the robot's own one."""

    cancels = "/dock/_action/cancel_goal"

    def __init__(
        self,
        domain: int,
        *,
        has_lidar: bool,
        make_node: Callable[..., DdsNode | FastDdsNode] = DdsNode,
    ) -> None:
        published = {f"/{topic}": dds.Twist for topic in ("cmd_vel", "cmd_vel_joy")}
        lidar = {"/scan": dds.LaserScan} if has_lidar else {}
        self._node: DdsNode | FastDdsNode | None = make_node(
            domain, "other", {**published, **lidar}, actions=["/dock"]
        )

    def command(self, topic: str, linear: float) -> None:
        assert self._node is not None
        self._node.publish(f"/{topic}", dds.Twist(dds.Vector3(linear)))

    def report_goal(self, *, is_active: bool) -> None:
        assert self._node is not None
        self._node.goals("/dock", 2 if is_active else 4)

    def close(self) -> None:
        if self._node is not None:
            self._node.close()
            self._node = None
