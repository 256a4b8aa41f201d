"""A node of ROS 2 that drives ahead, and turns to the free side before what is near."""

from __future__ import annotations

import math
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan


class KeepDistance(Node):  # type: ignore[misc]  # rclpy has no types here
    """Subscribes to `scan` and publishes on `cmd_vel`."""

    def __init__(self) -> None:
        """Declare the parameters."""
        super().__init__("keep_distance")
        self.declare_parameters(
            "", [("speed", 0.1), ("turn", 0.8), ("distance", 0.7), ("half_width", 0.6)]
        )
        self.speed = self.get_parameter("speed").value
        self.turn = self.get_parameter("turn").value
        self.distance = self.get_parameter("distance").value
        self.half_width = self.get_parameter("half_width").value
        self.command = self.create_publisher(Twist, "cmd_vel", 10)
        self.create_subscription(LaserScan, "scan", self.on_scan, qos_profile_sensor_data)

    def on_scan(self, scan: Any) -> None:
        """Command for a scan."""
        left = math.inf
        right = math.inf
        for index, distance in enumerate(scan.ranges):
            if not 0.0 < distance <= self.distance:  # first: few rays are near
                continue
            angle = scan.angle_min + index * scan.angle_increment
            bearing = math.remainder(angle, 2.0 * math.pi)
            if abs(bearing) > self.half_width:
                continue
            if bearing > 0.0:
                left = min(left, distance)
            else:
                right = min(right, distance)
        twist = Twist()
        if min(left, right) > self.distance:
            twist.linear.x = self.speed
        else:
            twist.angular.z = self.turn if left >= right else -self.turn
        self.command.publish(twist)


def main() -> None:
    """Run the node, as `ros2 run` does."""
    rclpy.init()
    rclpy.spin(KeepDistance())
