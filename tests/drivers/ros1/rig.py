"""A robot in rospy as a test's rig, and drivers for it."""

from __future__ import annotations

import itertools
import json
import math
import os
import random
import subprocess
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rosbags.typesys.stores import ros1_noetic as noetic

from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.values import Scan, Twist, Value
from swarmd.drivers.ros import messages
from swarmd.drivers.ros.from_ros import command_message
from swarmd.drivers.ros1.driver import Ros1Driver
from swarmd.drivers.ros1.serialization import definition, encode, encode_twist, type_name
from swarmd.settings.platforms import load_platform
from tests.support.processes import CAP, wait_until
from tests.support.roscore import PYTHON, RosCore

SCRIPT = Path(__file__).with_name("robot.py")
PLATFORM = load_platform("burger")
HAZARDS: dict[str, Value] = {
    "bumper": {
        "topic": "bumper",
        "type": "std_msgs/Bool",
        "means": "bump front",
        "stale_after": 0.3,
    }
}

_numbers = itertools.count(1)


class RosRobot:
    """One robot's nodes in a namespace of their own, as a child process."""

    platform = PLATFORM
    hazard = Hazard(HazardKind.BUMP, "front")
    hazard_options: Mapping[str, Value] = {"hazards": HAZARDS}

    def __init__(self, core: RosCore, *words: str, namespace: str = "") -> None:
        self.core, self._words = core, words
        self.namespace = namespace or f"/r{os.getpid()}_{next(_numbers)}"
        self.reconnect()

    def reconnect(self) -> None:
        """Start its nodes, also again, and wait until they are registered."""
        self._process = subprocess.Popen(
            [PYTHON, str(SCRIPT), *self._words],
            env={**self.core.environ, "ROS_NAMESPACE": self.namespace},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        # A queue of this process's own, without late lines of the process before.
        self._lines, self._texts, ready = list[str](), list[str](), threading.Event()
        self._thread = threading.Thread(
            target=_read, args=(self._process, self._lines, self._texts, ready), daemon=True
        )
        self._thread.start()
        try:
            wait_until(ready.is_set, "the robot's nodes are registered")
        except AssertionError:
            self.close()
            raise

    @property
    def options(self) -> dict[str, Value]:
        return {"master": self.core.uri, "ip": "127.0.0.1", "namespace": self.namespace}

    def make(self, options: Mapping[str, Value]) -> Ros1Driver:
        return Ros1Driver(
            swarm="s", robot="r-1", platform=PLATFORM, options={**self.options, **options}
        )

    def do(self, what: str, **more: object) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps({"do": what, **more}).encode() + b"\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            return

    def publish(self) -> None:
        self.do("publish")

    def commands(self) -> Sequence[Twist]:
        """The commands since the last call."""
        lines = self._lines[:]
        del self._lines[: len(lines)]
        return [_twist(line) for line in lines]

    def texts(self) -> Sequence[str]:
        """All messages of the topic that its node follows."""
        return self._texts[:]

    def publish_scan(self, scan: Scan) -> None:
        first, ranges = float(scan.bearings[0]), scan.ranges.tolist()
        self.do("scan", stamp=scan.stamp, first=first, ranges=ranges)

    def put(self, topic: str, message: object, data: bytes) -> None:
        """Publish the bytes of a message of this class."""
        kind: type = type(message)
        text, md5sum = definition(kind)
        names = {"_type": type_name(kind), "_md5sum": md5sum, "_full_text": text}
        self.do("raw", topic=topic, kind=names, bytes=data.hex())

    def command(self, topic: str, linear: float) -> None:
        message = command_message(Twist(linear), messages.Twist, "")
        self.put(topic, message, encode_twist(Twist(linear)))

    def report_goal(self, *, is_active: bool) -> None:
        time = noetic.builtin_interfaces__msg__Time(1, 0)
        goal = noetic.actionlib_msgs__msg__GoalID(time, "goal")
        goals: list[Any] = [noetic.actionlib_msgs__msg__GoalStatus(goal, 1 if is_active else 3, "")]
        header: Any = noetic.std_msgs__msg__Header(1, time, "")
        message = messages.ActionlibStatusArray(header, goals)  # of ROS 1, in the class of both
        self.put("dock/status", message, encode(message))

    @property
    def cancels(self) -> str:
        return f"rostopic pub -1 {self.namespace}/dock/cancel actionlib_msgs/GoalID"

    def other_node(self, *, has_lidar: bool) -> RosRobot:
        """Its end is a SIGKILL: the master still lists it."""
        words = [] if has_lidar else ["--no-sensors"]
        return RosRobot(self.core, "--name", "other", "--no-base", *words, namespace=self.namespace)

    def dock(self, *, is_latched: bool) -> Dock:
        words = [
            "--name",
            "dock",
            "--no-base",
            "--no-sensors",
            *(["--latch"] if is_latched else []),
        ]
        return Dock(RosRobot(self.core, *words, namespace=self.namespace))

    def publish_odometry(self) -> None:
        self.do("odometry")

    def publish_hazard(self, *, is_present: bool) -> None:
        self.do("hazard", is_present=is_present)

    def publish_garbage(self) -> None:
        """Send random bytes that are no LaserScan."""
        size = random.randrange(200)
        self.do("garble", bytes=(b"\xff" * 16 + random.randbytes(size)).hex())

    def disconnect(self) -> None:
        """Kill its nodes; the master still lists them."""
        self.close()

    def close(self) -> None:
        self._process.kill()
        self._process.wait(CAP)
        self._thread.join(CAP)
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                try:
                    pipe.close()
                except BrokenPipeError:
                    continue


class Dock:
    """A node that publishes `dock`."""

    def __init__(self, node: RosRobot) -> None:
        self._node = node

    def put(self, is_docked: bool) -> None:
        self._node.do("dock", docked=is_docked)

    def close(self) -> None:
        self._node.close()


def ros_robot(roscore: RosCore) -> RosRobot:
    """A robot as the maker of a story takes it."""
    return RosRobot(roscore)


def _read(
    process: subprocess.Popen[bytes], lines: list[str], texts: list[str], ready: threading.Event
) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        if line == b"ready\n":
            ready.set()
        elif line.startswith(b"text "):
            texts.append(line.decode().rstrip("\n").removeprefix("text "))
        else:
            lines.append(line.decode())


def _twist(line: str) -> Twist:
    linear, angular, lateral = map(float, line.split())
    assert math.isfinite(linear + angular + lateral)
    return Twist(linear, angular, lateral)
