"""Small nodes of ROS 2 in the style of three common ones, and a robot that runs nodes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from swarmd.core.values import Inputs, Message, Outputs, Scan
from swarmd.ros2_nodes.robot_nodes import RobotNodes
from swarmd.settings.settings import load_platform

TIMER_DRIVER = """
import rclpy
from geometry_msgs.msg import Twist
from rclpy.node import Node


class TimerDriver(Node):
    calls = 0

    def __init__(self):
        super().__init__("timer_driver")
        self.declare_parameter("speed", 0.1)
        self.publisher = self.create_publisher(Twist, "cmd_vel", 10)
        self.create_timer(0.25, self.on_timer)

    def on_timer(self):
        TimerDriver.calls += 1
        twist = Twist()
        twist.linear.x = self.get_parameter("speed").value
        twist.angular.z = float(TimerDriver.calls)
        self.publisher.publish(twist)


def main(args=None):
    rclpy.init(args=args)
    node = TimerDriver()
    try:
        rclpy.spin(node)
    finally:
        node.destroy_node()
        rclpy.shutdown()


if __name__ == "__main__":
    main()
"""
SCAN_FOLLOWER = """
import math
import random

import numpy as np
from geometry_msgs.msg import TwistStamped
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan

from .gains import GAIN


class ScanFollower(Node):
    def __init__(self):
        super().__init__("scan_follower")
        about = ParameterDescriptor(description="m to the wall on the left")
        self.declare_parameter("distance", 0.5, about)
        self.declare_parameters("", [("speed", 0.05), ("noise", 0.0)])
        self.distance = self.get_parameter("distance").get_parameter_value().double_value
        self.publisher = self.create_publisher(TwistStamped, "cmd_vel", 10)
        self.create_subscription(LaserScan, "scan", self.on_scan, qos_profile_sensor_data)

    def on_scan(self, scan):
        left = round(math.radians(90.0) / scan.angle_increment)
        side = min(scan.ranges[left], 2.0)
        noise = self.get_parameter("noise").value
        out = TwistStamped()
        out.header.stamp = self.get_clock().now().to_msg()
        out.twist.linear.x = self.get_parameter("speed").value
        out.twist.angular.z = float(
            GAIN * (side - self.distance)
            + noise * (random.random() - 0.5)
            + noise * (np.random.rand() - 0.5)
        )
        self.publisher.publish(out)
"""
GAINS = "GAIN = 2.0\n"
VOTE = '''
import random
from collections import Counter

import rclpy
from geometry_msgs.msg import Twist
from rclpy.node import Node
from votes.msg import Opinion


class Vote(Node):
    """Takes the opinion of most of the others every second."""

    def __init__(self):
        super().__init__("vote")
        self.opinion = random.randint(0, 2)
        self.heard = {}
        self.message = Opinion(robot=self.get_namespace())  # used again for each message
        self.publisher = self.create_publisher(Opinion, "/votes", 10)
        self.command = self.create_publisher(Twist, "cmd_vel", 10)
        self.create_subscription(Opinion, "/votes", self.on_vote, 10)
        self.create_timer(1.0, self.on_timer)

    def on_vote(self, vote):
        if vote.robot != self.get_namespace():
            self.heard[vote.robot] = vote

    def on_timer(self):
        counted = Counter(vote.opinion for vote in self.heard.values())
        if counted:
            most = max(counted.values())
            self.opinion = random.choice(sorted(o for o, n in counted.items() if n == most))
        self.heard.clear()
        self.message.opinion = self.opinion
        self.publisher.publish(self.message)
        twist = Twist()
        twist.angular.z = 0.1 * self.opinion
        self.command.publish(twist)
'''
OPINION = "string robot\nint64 opinion\n"
NODES = {
    "timer_driver.py": TIMER_DRIVER,
    "walls/__init__.py": "",
    "walls/gains.py": GAINS,
    "walls/scan_follower.py": SCAN_FOLLOWER,
    "vote.py": VOTE,
    "votes/msg/Opinion.msg": OPINION,
    "follower.yaml": "/**:\n  ros__parameters:\n    distance: 0.6\n    noise: 0.2\n",
    "all.yaml": """
nodes:
  - run: walls.scan_follower:ScanFollower
    parameters: [follower.yaml, {speed: 0.08}]
  - run: vote:Vote
    remap: {cmd_vel: unused}
shared: [/votes]
""",
}
BURGER = load_platform("burger")


def written(folder: Path, files: Mapping[str, str] = NODES) -> Path:
    """The folder, with these files in it."""
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


def launched(folder: Path, launch: str, robot: str = "tb3-01", seed: int = 0) -> RobotNodes:
    """The nodes of a launch file with this text, beside the files of a folder."""
    path = folder / "nodes.yaml"
    path.write_text(launch)
    return RobotNodes(path, robot, BURGER, np.random.default_rng(seed))


def node_with(folder: Path, body: str, robot: str = "tb3-01", seed: int = 0) -> RobotNodes:
    """The node of a module that begins with the usual imports, and has a class `One`."""
    (folder / "one.py").write_text(
        "import rclpy\nfrom rclpy.node import Node\nfrom geometry_msgs.msg import Twist\n" + body
    )
    return launched(folder, "nodes: [{run: 'one:One'}]", robot, seed)


def steps(
    nodes: RobotNodes, seconds: Iterable[float], messages: Iterable[Message] = ()
) -> list[Outputs]:
    """The outputs of a step at each of these times, s on the robot's clock; without scans."""
    given = tuple(messages)
    return [nodes.step(Inputs(now=at, dt=0.1, messages=given)) for at in seconds]


def scan(near: Mapping[int, float], seq: int = 0) -> Scan:
    """A scan of a Burger: 3 m, but for the ranges by the degree of their direction."""
    ranges = np.full(360, 3.0)
    for degree, distance in near.items():
        ranges[degree % 360] = distance
    bearings = np.radians(np.arange(360.0))
    bearings[bearings > math.pi] -= 2.0 * math.pi
    return Scan(seq, 0.0, ranges, bearings, 0.12, 3.5)
