"""One node of a robot as a process: `python -m studies.ros.node SETTINGS`, which are JSON.

The nodes are those that a TurtleBot3 starts: its base takes commands and publishes odometry, its
lidar publishes scans. A `teleop` publishes commands. A line on standard input changes what the
node does (`Faults`); its end ends the node in order. The node prints a line once it is on DDS, and
a base prints one for each command: the time (CLOCK_MONOTONIC), the linear and the angular speed.
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
    """What a node is.

    `body` is the robot of the arena to which it belongs, `folder` where the arena's sockets are.
    `is_stamped`: a base that wants a TwistStamped.
    """

    folder: str
    domain: int
    body: str
    kind: Kind
    name: str
    namespace: str
    is_stamped: bool = False


class Faults(Struct, frozen=True, kw_only=True):
    """What is wrong with a node.

    `scans`: as measured, all with the ranges of the first one (`frozen`), all rays 0 (`zeros`), or
    the same message again (`repeated`). `every`: one message of so many is published, `copies`: so
    many times, each a little later. `clock`: s by which stamps are ahead. `is_silent`: nothing is
    published.
    """

    scans: Literal["measured", "frozen", "zeros", "repeated"] = "measured"
    every: int = 1
    copies: int = 1
    clock: float = 0.0
    is_silent: bool = False


class Node:
    """The node, its socket to the arena, and its faults."""

    def __init__(self, settings: Settings) -> None:
        """It is on DDS from now on, and in `ros_discovery_info`."""
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
        threads = [threading.Thread(target=one) for one in work[self._settings.kind]]
        print("ready", flush=True)  # before the first command is
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
