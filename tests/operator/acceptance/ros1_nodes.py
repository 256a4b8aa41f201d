"""A ROS 1 base on a block, in rospy, under the system's Python: it drives, and scans a room.

Its namespace is ROS_NAMESPACE. It prints `ready`, then its speed in m/s each PERIOD. It ends with
its standard input. With --ignores-zero it keeps its last velocity where zero is commanded.
"""

from __future__ import annotations

import argparse
import math
import random
import sys
import threading
from typing import Any

import rospy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan

PERIOD = 0.05  # s between two readings of odometry
SCAN_EVERY = 4  # periods
BRAKING = 1.0  # m/s2
RAYS = 360
SWEEP = 0.2  # s of a revolution: a scan is stamped at its oldest ray
SPAN = 2.2  # m, half of the side of the room


class LiftedBase:
    """Publishes the pose that its wheels make of the commands, and a square room with noise."""

    def __init__(self, ignores_zero: bool) -> None:
        self.wanted = self.speed = self.way = 0.0
        self.ignores_zero = ignores_zero
        self.odometry = rospy.Publisher("odom", Odometry, queue_size=5, tcp_nodelay=True)
        self.scans = rospy.Publisher("scan", LaserScan, queue_size=5, tcp_nodelay=True)
        rospy.Subscriber("cmd_vel", Twist, self.obey, queue_size=50)

    def obey(self, message: Any) -> None:
        if message.linear.x != 0.0 or not self.ignores_zero:
            self.wanted = message.linear.x

    def turn(self) -> None:
        pause, count = threading.Event(), 0
        while not pause.wait(PERIOD):
            step = BRAKING * PERIOD
            self.speed += max(-step, min(step, self.wanted - self.speed))
            self.way += PERIOD * self.speed
            self.publish_odometry()
            if count % SCAN_EVERY == 0:
                self.publish_scan()
            count += 1
            print(self.speed, flush=True)

    def publish_odometry(self) -> None:
        message = Odometry()
        message.header.stamp, message.header.frame_id = rospy.Time.now(), "odom"
        message.child_frame_id = "base_footprint"
        message.pose.pose.position.x = self.way
        message.pose.pose.orientation.w = 1.0
        message.twist.twist.linear.x = self.speed
        self.odometry.publish(message)

    def publish_scan(self) -> None:
        message = LaserScan()
        message.header.stamp = rospy.Time.now() - rospy.Duration.from_sec(SWEEP)
        message.header.frame_id = "base_scan"
        message.angle_increment = 2.0 * math.pi / RAYS
        message.angle_max = (RAYS - 1) * message.angle_increment
        message.range_min, message.range_max = 0.12, 3.5
        bearings = [message.angle_increment * ray for ray in range(RAYS)]
        message.ranges = [
            SPAN / max(abs(math.cos(one)), abs(math.sin(one))) + random.gauss(0.0, 0.005)
            for one in bearings
        ]
        self.scans.publish(message)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ignores-zero", action="store_true")
    args = parser.parse_args()
    rospy.init_node("base", argv=[], disable_signals=True, disable_rosout=True)
    base = LiftedBase(args.ignores_zero)
    print("ready", flush=True)
    threading.Thread(target=base.turn, daemon=True).start()
    sys.stdin.read()


if __name__ == "__main__":
    main()
