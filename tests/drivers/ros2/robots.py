"""A robot that a test controls: a Zenoh session that publishes as one of the ROS 2 middlewares."""

from __future__ import annotations

import contextlib
import json
import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import zenoh
import zenoh.ext

from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.values import Scan, Twist, Value
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros.messages import dds_name
from swarmd.drivers.ros2 import dds_bridge as ros2dds
from swarmd.drivers.ros2 import rmw_zenoh
from swarmd.drivers.ros2.driver import RosDriver
from swarmd.link.carriers.session import has_subscriber
from swarmd.settings.platforms import load_platform
from tests.support import ros2_types as dds
from tests.support.processes import free_endpoint

PLATFORM = load_platform("burger")
LASER = "sensor_msgs/msg/LaserScan"
RAYS = 360
CLOCKS_APART = 1000.0
"""Seconds between odometry and scans: their stamps advance by count, so no delay is measured."""
HAZARDS: dict[str, Value] = {
    "bumper": {
        "topic": "bumper",
        "type": "std_msgs/Bool",
        "means": "bump front",
        "stale_after": 0.3,
    }
}


def open_session(mode: str, path: str, endpoint: str) -> zenoh.Session:
    """`router`, as zenoh-bridge-ros2dds and rmw_zenohd are, or `peer`, as a node of rmw_zenoh."""
    config = zenoh.Config()
    for key, value in {
        "mode": mode,
        "listen/endpoints": [] if mode == "router" else ["tcp/127.0.0.1:0"],
        path: [endpoint],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


class Robot:
    """A hub with one robot at it; silent at first."""

    platform = PLATFORM
    hazard = Hazard(HazardKind.BUMP, "front")
    hazard_options: Mapping[str, Value] = {"hazards": HAZARDS}
    server: tuple[str, str, str]  # the announcement of the server of action `dock`

    def __init__(self, *, is_stamped: bool = False) -> None:
        self.endpoint = free_endpoint()
        self.is_stamped = is_stamped
        self._published_count = 0
        self.reconnect()

    def make(self, options: Mapping[str, Value]) -> RosDriver:
        raise NotImplementedError

    def command_key(self) -> str:
        raise NotImplementedError

    def put(self, topic: str, message: Any) -> None:
        raise NotImplementedError

    def reconnect(self) -> None:
        self.hub = open_session("router", "listen/endpoints", self.endpoint)
        self.tokens: list[zenoh.LivelinessToken] = []
        # A queue of this hub's own: what still arrives from before a reconnect is not in it.
        self._commands = commands = list[zenoh.Sample]()
        self.hub.declare_subscriber(self.command_key(), commands.append)

    def disconnect(self) -> None:
        self.hub.close()

    def publish(self) -> None:
        self.put("scan", scan(self._stamp()))
        self.put("odom", odometry(CLOCKS_APART + self._stamp()))

    def publish_scan(self, given: Scan) -> None:
        n = len(given.ranges)
        first, step = float(given.bearings[0]), 2.0 * math.pi / n
        fields = {"angle_min": first, "angle_increment": step, "angle_max": first + (n - 1) * step}
        self.put("scan", scan(given.stamp + 1000.0, given.ranges.tolist(), **fields))

    def publish_odometry(self) -> None:
        self.put("odom", odometry(CLOCKS_APART + self._stamp()))

    def publish_hazard(self, *, is_present: bool) -> None:
        self.put("bumper", dds.Bool(data=is_present))

    def publish_garbage(self) -> None:
        whole = scan(self._stamp()).serialize()
        for topic, valid in (("scan", whole), ("odom", odometry(1.0).serialize())):
            for payload in (b"", b"\xff" * 80, valid[: len(valid) // 2], valid + bytes(99)):
                self.put(topic, payload)

    def announce(
        self, what: str, topic: str, kind: str, domain: int = 0, zid: str = ""
    ) -> zenoh.LivelinessToken:
        """Announce a publisher (MP) or a subscription (MS) of its node, as its hub does.

        `zid`: another session's, for an end of another node.
        """
        token = self.token(what, topic, kind, domain, zid or str(self.hub.zid()))
        self.tokens.append(self.hub.liveliness().declare_token(token))
        return self.tokens[-1]

    def token(self, what: str, topic: str, kind: str, domain: int, zid: str) -> str:
        raise NotImplementedError

    def dock(self, *, is_latched: bool) -> Any:
        return Dock(self, is_latched=is_latched)

    def other_node(self, *, has_lidar: bool = False) -> Any:
        return OtherNode(self, has_lidar=has_lidar)

    def samples(self) -> list[zenoh.Sample]:
        taken = self._commands[:]
        del self._commands[: len(taken)]
        return taken

    def commands(self) -> Sequence[Twist]:
        return [twist(sample.payload.to_bytes(), self.is_stamped) for sample in self.samples()]

    def close(self) -> None:
        self.hub.close()

    def options(self, given: Mapping[str, Value]) -> Mapping[str, Value]:
        kind: Value = "twist_stamped" if self.is_stamped else "twist"  # it need not announce it
        return {"endpoint": self.endpoint, "cmd_vel_type": kind, **given}

    def _stamp(self) -> float:
        self._published_count += 1
        return 100.0 + 0.1 * self._published_count


class BridgedRobot(Robot):
    """Through zenoh-bridge-ros2dds: raw CDR on the topic's name.

    `listed`: what `list_nodes` makes its admin space answer, payload by key.
    """

    server = "AS", "dock", "irobot_create_msgs/action/Dock"
    listed: dict[str, bytes]

    def list_nodes(self, namespace: str = "/") -> None:
        """From now on answer as the bridge's admin space does; `listed` has no node yet."""
        zid = self.hub.zid()
        config = {"namespace": namespace, "nodename": "zenoh_bridge_ros2dds", "domain": 0}
        self.listed = {f"@/{zid}/ros2/config": json.dumps(config).encode()}

        def on_query(query: zenoh.Query) -> None:
            for key, payload in dict(self.listed).items():
                if query.key_expr.intersects(zenoh.KeyExpr(key)):
                    query.reply(key, payload)

        self._space = self.hub.declare_queryable(f"@/{zid}/ros2/**", on_query)

    def list_node(
        self,
        participant: str,
        name: str,
        published: Mapping[str, str] | None = None,
        subscribed: Mapping[str, str] | None = None,
    ) -> str:
        """List a node, such as `base` or `tb3_01/base`, with topics and types; its key."""
        key = f"@/{self.hub.zid()}/ros2/node/{participant}/{name}"
        ends = {
            what: [{"name": topic, "type": kind} for topic, kind in (given or {}).items()]
            for what, given in (("publishers", published), ("subscribers", subscribed))
        }
        self.listed[key] = json.dumps(ends).encode()
        return key

    def list_reader(self, participant: str) -> str:
        """List a reader of the commands in DDS; its key."""
        return self._list_end(participant, "reader", "cmd_vel", "geometry_msgs::msg::dds_::Twist_")

    def list_writer(self, participant: str) -> str:
        """List a writer of scans in DDS; its key."""
        kind = "sensor_msgs::msg::dds_::LaserScan_"
        return self._list_end(participant, "writer", "scan", kind)

    def _list_end(self, participant: str, end: str, topic: str, kind: str) -> str:
        key = f"@/{self.hub.zid()}/ros2/dds/{participant}/{end}/{participant}04/rt/{topic}"
        told = {"topic_name": f"rt/{topic}", "type_name": kind, "qos": {}}
        self.listed[key] = json.dumps(told).encode()
        return key

    def token(self, what: str, topic: str, kind: str, domain: int, zid: str) -> str:
        key, typed = topic.replace("/", "§"), kind.replace("/", "§")
        return f"@/{zid}/@ros2_lv/{what}/{key}/{typed}" + ("/:::1,5" if what[0] == "M" else "")

    def make(self, options: Mapping[str, Value]) -> RosDriver:
        return ros2dds.make_driver(
            swarm="s", robot="r", platform=self.platform, options=self.options(options)
        )

    def command_key(self) -> str:
        return "cmd_vel"

    def put(self, topic: str, message: Any) -> None:
        payload = message if isinstance(message, bytes) else message.serialize()
        self.hub.put(topic, payload)


HASHES = {  # published: the reference of rmw_zenoh, and REP 2016
    "LaserScan": "RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
    "Twist": "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    "TwistStamped": "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    "Odometry": "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
}
PACKAGES = {
    "GoalStatusArray": "action_msgs",
    "Bool": "std_msgs",
    "Empty": "std_msgs",
    "Float64": "std_msgs",
    "String": "std_msgs",
    "Odometry": "nav_msgs",
    "Twist": "geometry_msgs",
    "TwistStamped": "geometry_msgs",
}


class ZenohRobot(Robot):
    """Through rmw_zenoh: a node is a peer of the router; the key contains type and hash."""

    server = "MP", "dock/_action/status", "action_msgs/msg/GoalStatusArray"

    def __init__(
        self, *, domain: int = 0, is_humble: bool = False, is_stamped: bool = False
    ) -> None:
        self.domain, self.is_humble = domain, is_humble
        self._sent_count = 0
        super().__init__(is_stamped=is_stamped)

    def make(self, options: Mapping[str, Value]) -> RosDriver:
        return rmw_zenoh.make_driver(
            swarm="s",
            robot="r",
            platform=self.platform,
            options={"domain": self.domain, **self.options(options)},
        )

    def token(self, what: str, topic: str, kind: str, domain: int, zid: str) -> str:
        end = f"{what}/%/%/base/%{topic.replace('/', '%')}/{dds_name(kind)}/RIHS01_x/::,7:,:,:,,"
        return f"@ros2_lv/{domain}/{zid}/0/10/{end}"

    def key(self, topic: str, kind: str) -> str:
        package = PACKAGES.get(kind, "sensor_msgs")
        own = HASHES.get(kind) or cdr.type_hash(cdr.store().types[f"{package}/msg/{kind}"])
        hashed = "TypeHashNotSupported" if self.is_humble else own
        return f"{self.domain}/{topic}/{package}::msg::dds_::{kind}_/{hashed}"

    def command_key(self) -> str:
        return self.key("cmd_vel", "TwistStamped" if self.is_stamped else "Twist")

    def put(self, topic: str, message: Any) -> None:
        if isinstance(message, bytes):
            kind = {"scan": "LaserScan", "odom": "Odometry", "cmd_vel": "Twist"}[topic]
            self.put_on(self.key(topic, kind), message)
        else:
            self.put_on(self.key(topic, type(message).__name__), message.serialize())

    def put_on(self, key: str, payload: bytes) -> None:
        self._sent_count += 1
        self.hub.put(
            key, payload, attachment=struct.pack("<qqB16s", self._sent_count, 1, 16, b"g" * 16)
        )


class Dock:
    """A node that publishes `dock` on change at a robot's hub.

    `is_latched`: with durability TRANSIENT_LOCAL, so that a cache has the last message.
    """

    def __init__(self, robot: Robot, *, is_latched: bool = False) -> None:
        key = robot.key("dock", "Bool") if isinstance(robot, ZenohRobot) else "dock"
        cache = zenoh.ext.CacheConfig(1) if is_latched else None
        self._publisher = zenoh.ext.declare_advanced_publisher(robot.hub, key, cache=cache)
        self._token = robot.announce("MP", "dock", "std_msgs/msg/Bool")
        self._probe = robot.hub.declare_publisher(key)  # it knows of subscribers

    def put(self, is_docked: bool) -> None:
        self._publisher.put(dds.Bool(data=is_docked).serialize())

    def is_heard(self) -> bool:
        return has_subscriber(self._probe)

    def close(self) -> None:
        with contextlib.suppress(zenoh.ZError):  # its session has been closed
            self._token.undeclare()
            self._publisher.undeclare()


class OtherNode:
    """A node of its own at a robot's hub."""

    cancels = "/dock/_action/cancel_goal"

    def __init__(self, robot: Robot, *, has_lidar: bool) -> None:
        self._robot, self._tokens = robot, [robot.announce(*robot.server)]
        if has_lidar:
            robot.announce("MP", "scan", LASER)
            self._tokens.append(robot.announce("MP", "scan", LASER, zid="0123456789abcdef" * 2))

    def command(self, topic: str, linear: float) -> None:
        self._robot.put(topic, command(linear))

    def report_goal(self, *, is_active: bool) -> None:
        status = dds.GoalStatus(status=2 if is_active else 4)
        self._robot.put("dock/_action/status", dds.GoalStatusArray([status]))

    def close(self) -> None:
        while self._tokens:
            self._tokens.pop().undeclare()


def scan(stamp: float, ranges: Sequence[float] | None = None, **angles: float) -> dds.LaserScan:
    # Scans that repeat are those of a frozen sensor, also where some in between are lost.
    noisy = 2.0 + 0.009 * math.modf(6.18034 * stamp)[0]
    values = [noisy] * RAYS if ranges is None else list(ranges)
    step = 2.0 * math.pi / max(len(values), 1)
    fields = {"angle_min": 0.0, "angle_max": 2.0 * math.pi, "angle_increment": step, **angles}
    return dds.LaserScan(
        header=dds.stamped(stamp, "base_scan"), range_max=100.0, ranges=values, **fields
    )


def odometry(stamp: float, x: float = 0.5, yaw: float = 0.0, speed: float = 0.1) -> dds.Odometry:
    pose = dds.Pose(dds.Vector3(x=x), dds.Quaternion(z=math.sin(0.5 * yaw), w=math.cos(0.5 * yaw)))
    moving = dds.Twist(dds.Vector3(x=speed, y=0.02), dds.Vector3(z=0.3))
    return dds.Odometry(
        dds.stamped(stamp, "odom"),
        "base_footprint",
        dds.PoseWithCovariance(pose),
        dds.TwistWithCovariance(moving),
    )


def twist(payload: bytes, is_stamped: bool) -> Twist:
    message = (
        dds.TwistStamped.deserialize(payload).twist
        if is_stamped
        else dds.Twist.deserialize(payload)
    )
    return Twist(message.linear.x, message.angular.z, message.linear.y)


def command(linear: float) -> dds.Twist:
    return dds.Twist(linear=dds.Vector3(x=linear))
