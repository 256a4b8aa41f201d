"""ROS 1 nodes for the benchmark of driver `ros1`, under the system's Python.

`robot NAMESPACE...` sends a scan of 360 rays to each namespace in turn. The first range of a scan
is the number of the scan. The node prints `namespace seconds`: the time from a scan to its first
command. `plain` is a node in rospy alone: it subscribes, computes a potential field, and publishes.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from typing import Any

import rospy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan

from benchmarks.plain_field import RANGE_MAX, RAYS, plain_field

PAUSE = 0.02
PATIENCE = 1.0


class Robot:
    """The robot's end towards one namespace."""

    def __init__(self, namespace: str) -> None:
        self.namespace = namespace
        self._scans = rospy.Publisher(f"{namespace}/scan", LaserScan, queue_size=1)
        self._odometry = rospy.Publisher(f"{namespace}/odom", Odometry, queue_size=1)
        rospy.Subscriber(
            f"{namespace}/cmd_vel", Twist, self._on_command, queue_size=10, tcp_nodelay=True
        )
        self._answered = threading.Event()
        self._number = 0
        self._at = 0.0
        self._scan = LaserScan(angle_increment=2.0 * math.pi / RAYS, range_max=RANGE_MAX)
        self._scan.ranges = [1.0 + 0.5 * math.sin(0.1 * i) for i in range(RAYS)]
        self._scan.intensities = [0.0] * RAYS

    def ask(self) -> float:
        """Seconds from a scan to its command; NaN if none came."""
        self._number += 1
        self._scan.header.stamp = rospy.Time.now()
        self._scan.ranges[0] = 1.0 + self._number % 1000 / 1000.0
        self._odometry.publish(self._pose())
        time.sleep(PAUSE)
        self._answered.clear()
        begin = time.perf_counter()
        self._scans.publish(self._scan)
        if not self._answered.wait(PATIENCE):
            return math.nan
        return self._at - begin

    def _pose(self) -> Any:
        odometry = Odometry()
        odometry.header.stamp = rospy.Time.now()
        odometry.pose.pose.orientation.w = 1.0
        return odometry

    def _on_command(self, message: Any) -> None:
        self._at = time.perf_counter()
        self._answered.set()


def robot(namespaces: list[str]) -> None:
    """Ask all in turn until killed."""
    robots = [Robot(namespace) for namespace in namespaces]
    while True:
        for one in robots:
            print(one.namespace, one.ask(), flush=True)


def plain() -> None:
    """Answer each scan with the command that the potential field gives."""
    commands = rospy.Publisher("/plain/cmd_vel", Twist, queue_size=1, tcp_nodelay=True)

    def on_scan(scan: Any) -> None:
        command = Twist()
        command.linear.x, command.angular.z = plain_field(scan.ranges)
        commands.publish(command)

    rospy.Subscriber("/plain/scan", LaserScan, on_scan, queue_size=1, tcp_nodelay=True)
    rospy.spin()


if __name__ == "__main__":
    rospy.init_node(sys.argv[1], argv=[], disable_signals=True, disable_rosout=True)
    if sys.argv[1] == "robot":
        robot(sys.argv[2:])
    else:
        plain()
