"""A robot's nodes in rospy, under the system's Python; it reads orders on standard input.

Its namespace is ROS_NAMESPACE. Each line is a JSON object: `{"do": "publish"}` publishes a scan and
an odometry with the next stamp, `{"do": "ranges", "ranges": [...]}` the same with these ranges, and
`{"do": "rate", "hz": 5}` publishes at this rate; `Robot.obey` has the other orders. With --latch
the dock is a latched topic. It prints `ready`, and each command that arrives as `linear angular
lateral`. Each message of a topic that it follows is a line `text` and the text.
"""

from __future__ import annotations

import argparse
import io
import json
import math
import random
import sys
import threading
from typing import Any

import rospy
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import BatteryState, Imu, LaserScan, Range
from std_msgs.msg import Bool, Empty, String

RAYS = 360
CLOCKS_APART = rospy.Duration(1000)  # stamps advance by count, so no delay is to be measured


class Robot:
    """All nodes of one robot as one node."""

    def __init__(self, args: argparse.Namespace) -> None:
        self._args = args
        self._count = 0
        self._rate = 0.0
        self._lock = threading.Lock()
        kind = Range if args.scan_type == "Range" else LaserScan
        if not args.no_sensors:
            self._scans = raw_publisher("scan", kind)
            self._odometry = raw_publisher("odom", Odometry)
        self._raws: dict[str, Any] = {}
        self._bumper = rospy.Publisher("bumper", Bool, queue_size=5)
        self._imu = rospy.Publisher("imu", Imu, queue_size=5)
        self._dock = rospy.Publisher("dock", Bool, queue_size=5, latch=args.latch)
        self._battery = rospy.Publisher("battery", BatteryState, queue_size=5)
        if not args.no_base:
            stamped = args.command_type == "TwistStamped"
            rospy.Subscriber(
                "cmd_vel", TwistStamped if stamped else Twist, self._on_command, queue_size=50
            )
        threading.Thread(target=self._publish_at_rate, daemon=True).start()

    def obey_lines(self) -> None:
        """Print `ready`, and obey standard input to its end."""
        with self._lock:  # a command may arrive already, and its line would part this one
            print("ready", flush=True)
        for line in sys.stdin:
            self.obey(json.loads(line))

    def obey(self, order: dict[str, Any]) -> None:
        if order["do"] == "rate":
            self._rate = order["hz"]
        elif order["do"] == "ranges":
            self.publish(order["ranges"])
        elif order["do"] == "publish":
            self.publish([random.gauss(1.0, 0.01)] * RAYS)  # equal scans: a frozen sensor
        elif order["do"] == "scan":
            stamp = rospy.Time.from_sec(order["stamp"])
            send(self._scans, bytes_of(self._scan(stamp, order["ranges"], order["first"])))
        elif order["do"] == "odometry":
            self.publish_odometry()
        elif order["do"] == "garble":
            self._garble(bytes.fromhex(order["bytes"]))
        elif order["do"] == "hazard":
            self._bumper.publish(Bool(order["is_present"]))
        elif order["do"] == "extras":
            self._extras()
        elif order["do"] == "raw":
            topic = order["topic"]
            if topic not in self._raws:
                self._raws[topic] = raw_publisher(topic, type("Kind", (), order["kind"]))
            send(self._raws[topic], bytes.fromhex(order["bytes"]))
        elif order["do"] == "latch":
            self._latch(order["topic"], order["kind"], order.get("text", ""))
        elif order["do"] == "follow":
            rospy.Subscriber(order["topic"], String, self._on_text)
        elif order["do"] == "dock":
            self._dock.publish(Bool(order["docked"]))

    def publish(self, ranges: list[float]) -> None:
        send(self._scans, bytes_of(self._scan(self._stamp(), ranges)))
        self.publish_odometry()

    def publish_odometry(self) -> None:
        send(self._odometry, bytes_of(self._pose()))

    def _pose(self) -> Any:
        odometry = Odometry()
        odometry.header.stamp = self._stamp() + CLOCKS_APART
        odometry.header.frame_id = "odom"
        odometry.child_frame_id = "base_footprint"
        odometry.pose.pose.position.x = 0.5
        odometry.pose.pose.orientation.z = math.sin(0.3)
        odometry.pose.pose.orientation.w = math.cos(0.3)
        odometry.twist.twist.linear.x, odometry.twist.twist.angular.z = 0.1, -0.2
        return odometry

    def _stamp(self) -> Any:
        with self._lock:
            self._count += 1
            return rospy.Time.from_sec(1000.0 + 0.1 * self._count)

    def _scan(self, stamp: Any, ranges: list[float], first: float = 0.0) -> Any:
        if self._args.scan_type == "Range":
            return Range()
        scan = LaserScan()
        scan.header.stamp, scan.header.frame_id = stamp, "base_scan"
        scan.angle_min, scan.angle_increment = first, 2.0 * math.pi / max(len(ranges), 1)
        scan.angle_max = first + scan.angle_increment * (len(ranges) - 1)
        scan.range_min, scan.range_max = 0.0, 100.0
        scan.ranges = ranges
        scan.intensities = [47.0] * len(ranges)
        return scan

    def _garble(self, garbage: bytes) -> None:
        for publisher, message in (
            (self._scans, self._scan(self._stamp(), [1.0] * RAYS)),
            (self._odometry, self._pose()),
        ):
            send(publisher, garbage)
            send(publisher, bytes_of(message)[: -1 - len(garbage)])

    def _extras(self) -> None:
        imu = Imu()
        imu.orientation.z, imu.orientation.w = math.sin(0.25), math.cos(0.25)
        self._imu.publish(imu)
        self._battery.publish(BatteryState(voltage=12.0, percentage=0.75))

    def _latch(self, topic: str, kind: str, text: str) -> None:
        """Publish a message that each later subscriber gets, too, as `rostopic pub` does."""
        if topic not in self._raws:
            types = {"Empty": Empty, "String": String}
            self._raws[topic] = rospy.Publisher(topic, types[kind], queue_size=5, latch=True)
        self._raws[topic].publish(Empty() if kind == "Empty" else String(text))

    def _on_text(self, message: Any) -> None:
        with self._lock:
            print(f"text {message.data}", flush=True)

    def _on_command(self, message: Any) -> None:
        twist = getattr(message, "twist", message)
        with self._lock:  # each publisher has a thread of its own
            print(twist.linear.x, twist.angular.z, twist.linear.y, flush=True)

    def _publish_at_rate(self) -> None:
        pause = threading.Event()
        while True:
            if self._rate:
                self.publish([2.0 + random.gauss(0.0, 0.01) for _ in range(RAYS)])
            pause.wait(1.0 / (self._rate or 20.0))


def raw_publisher(topic: str, kind: Any) -> Any:
    """A publisher that announces `kind` and sends any bytes."""
    names = ("_type", "_md5sum", "_full_text")
    raw = type("Raw", (rospy.AnyMsg,), {name: getattr(kind, name) for name in names})
    return rospy.Publisher(topic, raw, queue_size=5, tcp_nodelay=True)


def send(publisher: Any, data: bytes) -> None:
    message = publisher.data_class()
    message._buff = data
    publisher.publish(message)


def bytes_of(message: Any) -> bytes:
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--name", default="robot")
    parser.add_argument("--scan-type", default="LaserScan")
    parser.add_argument("--command-type", default="Twist")
    parser.add_argument("--no-base", action="store_true")
    parser.add_argument("--no-sensors", action="store_true")
    parser.add_argument("--latch", action="store_true")
    args = parser.parse_args()
    rospy.init_node(args.name, argv=[], disable_signals=True, disable_rosout=True)
    Robot(args).obey_lines()


if __name__ == "__main__":
    main()
