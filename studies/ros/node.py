"""One node of a robot as a process: `python -m studies.ros.node SETTINGS`, with SETTINGS in JSON.

The nodes are those of a TurtleBot3: the base takes commands and publishes odometry, and the lidar
publishes scans. A `teleop` node publishes commands of a rival. Each line on standard input sets the
faults of the node (`Faults`, in JSON). The end of standard input ends the node in order.

The node prints `ready` once it is on DDS. A base prints a line for each command: the time in s
(CLOCK_MONOTONIC), the linear and the angular speed.
"""

from __future__ import annotations

import json
import os
import socket
import sys
import threading
import time
from pathlib import Path
from typing import Any, Literal

import msgspec
from cyclonedds.domain import Domain
from msgspec import Struct

from studies.ros.robots import RIVAL_SPEED, bound
from swarmd.core.processes import die_with_parent
from tests.support import ros2_types as dds
from tests.support.dds_node import DdsNode
from tests.support.ros2_bridge import LOOPBACK

Kind = Literal["base", "lidar", "teleop"]

_WAIT = 0.1  # s until a base sends its next heartbeat, and until a thread sees that it is to end
_TELEOP_PERIOD = 0.02
_MAX_DATAGRAM = 100_000


class Settings(Struct, frozen=True, kw_only=True):
    """The settings of a node."""

    folder: str  # of the arena's sockets
    domain: int  # of DDS
    body: str  # the robot of the arena to which the node belongs
    kind: Kind
    name: str  # of the ROS node; empty: no ROS node
    namespace: str
    is_stamped: bool = False  # a base that takes TwistStamped


class Faults(Struct, frozen=True, kw_only=True):
    """The faults of a node; by default none."""

    scans: Literal["measured", "frozen", "zeros", "repeated"] = "measured"
    """`frozen`: new stamps, but the ranges of the first scan; `zeros`: all rays are 0; `repeated`:
    the first message again and again."""
    every: int = 1  # only each n-th message is published
    copies: int = 1  # each message is published n times, 0.1 s apart
    clock: float = 0.0  # s by which stamps are ahead
    is_silent: bool = False  # no message is published


class Node:
    """A node on DDS that exchanges datagrams with the arena."""

    def __init__(self, settings: Settings) -> None:
        """Join DDS, with an entry in `ros_discovery_info`."""
        self._settings, self.faults = settings, Faults()
        self._command = dds.TwistStamped if settings.is_stamped else dds.Twist
        space = settings.namespace.rstrip("/")
        self._topics = {name: f"{space}/{name}" for name in ("cmd_vel", "odom", "scan")}
        published: dict[Kind, tuple[str, Any]] = {
            "base": ("odom", dds.Odometry),
            "lidar": ("scan", dds.LaserScan),
            "teleop": ("cmd_vel", self._command),
        }
        self._topic, self._type = published[settings.kind]
        self._held = Domain(settings.domain, LOOPBACK)
        self._node = DdsNode(
            settings.domain,
            settings.name,
            {self._topics[self._topic]: self._type},
            {self._topics["cmd_vel"]: self._command} if settings.kind == "base" else {},
            namespace=settings.namespace,
        )
        self._ending = threading.Event()
        self._kept: Any = None

    def run(self) -> None:
        """Publish and take commands until standard input ends."""
        work = {"base": (self._sense, self._obey), "lidar": (self._sense,), "teleop": (self._rule,)}
        threads = [threading.Thread(target=loop) for loop in work[self._settings.kind]]
        print("ready", flush=True)  # before the line of the first command
        for thread in threads:
            thread.start()
        for line in sys.stdin:
            self.faults = msgspec.json.decode(line, type=Faults)
            self._kept = None
        self._ending.set()
        for thread in threads:
            thread.join()
        self._node.close()
        del self._held

    def _sense(self) -> None:
        """Publish what the arena measures."""
        path = Path(self._settings.folder) / f"{self._settings.body}.{self._settings.kind}"
        with bound(path) as inbox:
            inbox.settimeout(_WAIT)
            count = 0
            while not self._ending.is_set():
                try:
                    payload = inbox.recv(_MAX_DATAGRAM)
                except TimeoutError:
                    continue
                count += 1
                faults = self.faults
                if not faults.is_silent and count % faults.every == 0:
                    self._publish(self._changed(self._type.deserialize(payload)), faults)

    def _publish(self, message: Any, faults: Faults) -> None:
        for copy in range(faults.copies):
            if copy:
                self._ending.wait(_WAIT)
                _advance(message, _WAIT)
                message.ranges = [value * (1.0 + 1e-4 * copy) for value in message.ranges]
            self._node.publish(self._topics[self._topic], message)

    def _changed(self, message: Any) -> Any:
        faults = self.faults
        if self._kept is None:
            self._kept = message
        if faults.scans == "repeated":
            return self._kept
        if faults.scans == "frozen":
            message.ranges = self._kept.ranges
        elif faults.scans == "zeros":
            message.ranges = [0.0] * len(message.ranges)
        _advance(message, faults.clock)
        return message

    def _obey(self) -> None:
        """Hand each command to the arena, which moves the body; a heartbeat at least each 0.1 s."""
        body, address = self._settings.body, str(Path(self._settings.folder) / "arena")
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
            while not self._ending.is_set():
                message = self._node.wait(self._topics["cmd_vel"], _WAIT)
                if message is None:
                    link.sendto(json.dumps(["heartbeat", body, []]).encode(), address)
                    continue
                twist = message.twist if self._settings.is_stamped else message
                speeds = (twist.linear.x, twist.angular.z)
                link.sendto(json.dumps(["command", body, speeds]).encode(), address)
                print(json.dumps([time.monotonic(), *speeds]), flush=True)

    def _rule(self) -> None:
        twist = dds.Twist(dds.Vector3(RIVAL_SPEED))
        while not self._ending.wait(_TELEOP_PERIOD):
            self._node.publish(self._topics["cmd_vel"], twist)


def _advance(message: Any, seconds: float) -> None:
    stamp = message.header.stamp
    message.header = dds.stamped(
        stamp.sec + 1e-9 * stamp.nanosec + seconds, message.header.frame_id
    )


if __name__ == "__main__":
    die_with_parent(os.getppid())
    Node(msgspec.json.decode(sys.argv[1], type=Settings)).run()
