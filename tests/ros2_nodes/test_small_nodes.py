"""Three small nodes, as many write them, run as they do on a robot: a timer, a scan, a vote."""

from __future__ import annotations

import random
import sys
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.values import Inputs, Message, Twist
from tests.support.ros2_nodes import launched, node_with, scan, steps, written


@pytest.fixture
def nodes(tmp_path: Path) -> Path:
    return written(tmp_path)


@pytest.mark.parametrize("run", ["timer_driver:TimerDriver", "timer_driver", "timer_driver.py"])
def test_a_timer_drives_from_its_first_period_on(nodes: Path, run: str) -> None:
    """A class, the `main()` of a module, and a script, which ends in `finally: shutdown()`."""
    robot = launched(nodes, f"nodes: [{{run: '{run}', parameters: {{speed: 0.2}}}}]")
    outputs = steps(robot, [100.0, 100.2, 100.3, 100.5, 100.7])
    assert [one.twist for one in outputs] == [
        None,
        None,
        Twist(0.2, 1.0),
        Twist(0.2, 2.0),
        Twist(0.2, 2.0),
    ]


def test_a_constructor_may_spin_itself(nodes: Path) -> None:
    text = (
        "class One(Node):\n"
        "    def __init__(self):\n"
        "        super().__init__('one')\n"
        "        self.out = self.create_publisher(Twist, 'cmd_vel', 1)\n"
        "        self.create_timer(0.1, lambda: self.out.publish(Twist()))\n"
        "        rclpy.spin(self)\n"
    )
    assert steps(node_with(nodes, text), [0.0, 0.1])[-1].twist == Twist()


IDLE = "import rclpy\nfrom rclpy.node import Node\n"


@pytest.mark.parametrize(
    "text",
    [
        "if __name__ == '__main__':\n    rclpy.init()\n    rclpy.spin(Node('one'))\n",
        "rclpy.init()\nrclpy.spin(Node('one'))\n",
        "def main():\n    node = Node('one')\n    try:\n        rclpy.spin(node)\n"
        "    except:\n        pass\n    node.destroy_node()\n    rclpy.shutdown()\n",
        "import argparse, sys\ndef main():\n    argparse.ArgumentParser().parse_args()\n"
        "    assert sys.argv == ['deep/one.py']\n    rclpy.spin(Node('one'))\n",
        "import helper\ndef main():\n    rclpy.spin(Node(helper.NAME))\n",
        "from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor\n"
        "def main(args=None):\n    try:\n        with rclpy.init(args=args):\n"
        "            node = Node('one')\n            rclpy.spin(node)\n"
        "    except (KeyboardInterrupt, ExternalShutdownException):\n        pass\n",
        "from rclpy.executors import SingleThreadedExecutor\nfrom rclpy.node import Publisher\n"
        "def main():\n    with rclpy.init() as context, Node('one', context=context) as node:\n"
        "        with SingleThreadedExecutor() as executor:\n"
        "            executor.add_node(node)\n            executor.spin()\n",
        "import os, sys\nsys.path.append(os.path.join(os.path.dirname(__file__), '..', 'more'))\n"
        "import beside\nrclpy.spin(Node(beside.NAME))\n",
    ],
    ids=[
        "guard",
        "no-guard",
        "bare-except",
        "arguments",
        "helper-beside",
        "with-init",
        "with-all",
        "sys-path",
    ],
)
def test_a_script_runs_as_it_does_by_itself(tmp_path: Path, text: str) -> None:
    before = (list(sys.path), list(sys.argv))
    helper = "NAME = 'one'\n"
    written(
        tmp_path,
        {"deep/one.py": IDLE + text, "deep/helper.py": helper, "more/beside.py": helper},
    )
    robot = launched(tmp_path, "nodes: [{run: deep/one.py}]")
    assert steps(robot, [0.0, 0.1])[-1].report == {"nodes": 1}
    assert (sys.path, sys.argv) == before
    assert not {"helper", "beside"} & {*sys.modules}


def test_a_class_may_hold_a_node_instead_of_being_one(tmp_path: Path) -> None:
    text = "class One:\n    def __init__(self):\n        self.node = rclpy.create_node('inner')\n"
    assert steps(node_with(tmp_path, text), [0.0])[-1].report == {"nodes": 1}


def test_two_robots_of_a_process_share_no_class_attribute(nodes: Path) -> None:
    first, second = (
        launched(nodes, "nodes: [{run: timer_driver}]", robot) for robot in ("a-1", "a-2")
    )
    steps(first, [0.0, 0.3, 0.6])
    assert steps(second, [0.0, 0.3])[-1].twist == Twist(0.1, 1.0)


def test_a_command_counts_for_its_time(nodes: Path) -> None:
    """`hold`: 1 s without another word; 0 for ever, as on a TurtleBot."""
    once = (
        "class One(Node):\n"
        "    def __init__(self):\n"
        "        super().__init__('one')\n"
        "        self.out = self.create_publisher(Twist, '/cmd_vel', 1)\n"
        "        self.timer = self.create_timer(0.1, self.once)\n"
        "    def once(self):\n"
        "        self.timer.cancel()\n"
        "        self.out.publish(Twist())\n"
        "        twist = Twist()\n"
        "        twist.linear.x = 0.1\n"
        "        self.out.publish(twist)\n"
    )
    times = [0.0, 0.1, 1.0, 1.2]
    drive = Twist(0.1)
    outputs = steps(node_with(nodes, once), times)
    assert [one.twist for one in outputs] == [None, drive, drive, Twist()]
    for_ever = launched(nodes, "nodes: [{run: 'one:One'}]\ntopics: {hold: 0}")
    assert steps(for_ever, times)[-1].twist == drive


def test_a_topic_of_commands_may_have_the_name_of_the_robot(nodes: Path) -> None:
    launch = """
nodes: [{run: timer_driver.py, remap: {cmd_vel: '/tb3_01/drive'}}]
topics: {command: '/{robot}/drive'}
"""
    robot = launched(nodes, launch, "tb3-01")
    assert steps(robot, [0.0, 0.3])[-1].twist == Twist(0.1, 1.0)


def test_a_generator_without_a_seed_draws_from_the_run(nodes: Path) -> None:
    chance = (
        "import random\n"
        "from geometry_msgs.msg import Twist\n"
        "from rclpy.node import Node\n"
        "class One(Node):\n"
        "    def __init__(self):\n"
        "        super().__init__('one')\n"
        "        twist = Twist()\n"
        "        twist.angular.z = random.Random().random()\n"
        "        twist.linear.x = random.Random(7).random()\n"
        "        self.create_publisher(Twist, 'cmd_vel', 1).publish(twist)\n"
    )
    twists = [
        steps(node_with(nodes, chance, seed=seed), [0.0, 0.1])[-1].twist for seed in (1, 1, 2)
    ]
    assert twists[0] == twists[1] != twists[2]
    assert twists[0] is not None
    assert twists[0].linear == random.Random(7).random()


def test_a_follower_turns_to_the_wall_by_its_parameters(nodes: Path) -> None:
    """0.9 m to the left, 0.6 m wanted by the file: 2 * 0.3 rad/s, at the speed of the launch."""
    launch = """
nodes:
  - run: walls.scan_follower:ScanFollower
    parameters: [follower.yaml, {speed: 0.08, noise: 0.0}]
"""
    robot = launched(nodes, launch)
    assert robot.needs == {"scan"}
    robot.step(Inputs(now=5.0, dt=0.0))
    outputs = robot.step(Inputs(now=5.1, dt=0.1, scan=scan({90: 0.9}), is_new_scan=True))
    assert outputs.twist is not None
    assert outputs.twist.linear == 0.08
    assert outputs.twist.angular == pytest.approx(0.6, abs=1e-6)  # a range has 32 bits


def test_a_scan_is_given_once(nodes: Path) -> None:
    robot = launched(nodes, "nodes: [{run: 'walls.scan_follower:ScanFollower'}]")
    seen = scan({90: 0.9})
    first = robot.step(Inputs(now=0.0, dt=0.0, scan=seen, is_new_scan=True)).twist
    again = robot.step(Inputs(now=2.0, dt=0.1, scan=seen, is_new_scan=False)).twist
    assert first is not None
    assert first.angular != 0.0
    assert again == Twist()  # the command is older than `hold`


def test_a_vote_goes_to_the_other_robots_and_settles(nodes: Path) -> None:
    robots = {
        name: launched(nodes, "nodes: [{run: 'vote:Vote'}]\nshared: [/votes]", name, seed)
        for seed, name in enumerate(("tb3-01", "tb3-02", "tb3-03"))
    }
    waiting: list[Message] = []
    turns: dict[str, float] = {}
    for step in range(100):
        sent: list[Message] = []
        for name, robot in robots.items():
            heard = tuple(message for message in waiting if message.sender != name)
            outputs = robot.step(Inputs(now=0.1 * step, dt=0.1, messages=heard))
            sent += [Message(name, key, value, 0.0) for key, value in outputs.messages.items()]
            if outputs.twist is not None:
                turns[name] = outputs.twist.angular
        waiting = sent
    assert len(set(turns.values())) == 1
    assert len(turns) == 3


def test_what_a_vote_sends_is_the_number_of_the_topic_and_its_fields(nodes: Path) -> None:
    robot = launched(
        nodes, "nodes: [{run: 'vote:Vote'}]\nshared: [/other, /votes]\nnamespace: /r_{number}"
    )
    sent = steps(robot, [0.0, 1.0])[-1].messages
    topics: Any = sent["topics"]
    (message,) = topics
    assert message[0] == 1
    assert message[1][0] == "/r_1"
    assert message[1][1] in (0, 1, 2)


@pytest.mark.parametrize(
    "value",
    [
        [[0, ["/r", "word"]]], [[0, ["/r"]]], [[5, ["/r", 1]]], [[-1, ["/r", 1]]], [3], [[]],
        [[0, None]], [[0, ["/r", 2**70]]], [["0", ["/r", 1]]], [{}],
    ],
)  # fmt: skip
def test_a_message_that_does_not_fit_is_counted_and_dropped(nodes: Path, value: object) -> None:
    robot = launched(nodes, "nodes: [{run: 'vote:Vote'}]\nshared: [/votes]")
    hostile = Message("tb3-02", "topics", value, 0.0)  # type: ignore[arg-type]
    (outputs,) = steps(robot, [0.0], [hostile])
    assert outputs.report["messages_refused"] == 1


def test_a_message_for_others_is_bounded_in_size(nodes: Path) -> None:
    body = (
        "from std_msgs.msg import String\n"
        "class One(Node):\n"
        "    def __init__(self):\n"
        "        super().__init__('one')\n"
        "        self.out = self.create_publisher(String, '/far', 1)\n"
        "        self.create_timer(0.1, lambda: self.out.publish(String(data='x' * 2000)))\n"
    )
    node_with(nodes, body)
    robot = launched(nodes, "nodes: [{run: 'one:One'}]\nshared: [/far]")
    with pytest.raises(Exception, match="/far") as caught:
        steps(robot, [0.0, 0.1])
    assert "bytes" in str(caught.value)


def test_more_messages_than_fit_go_in_later_steps_and_the_oldest_are_lost(nodes: Path) -> None:
    """Each takes some 210 bytes of 1024: four a step. 64 wait at most, and 100 are published."""
    body = (
        "from std_msgs.msg import String\n"
        "class One(Node):\n"
        "    def __init__(self):\n"
        "        super().__init__('one')\n"
        "        self.out = self.create_publisher(String, '/far', 1)\n"
        "        self.timer = self.create_timer(0.1, self.many)\n"
        "    def many(self):\n"
        "        self.timer.cancel()\n"
        "        for number in range(100):\n"
        "            self.out.publish(String(data=f'{number:200d}'))\n"
    )
    node_with(nodes, body)
    robot = launched(nodes, "nodes: [{run: 'one:One'}]\nshared: [/far]")
    outputs = steps(robot, [0.1 * n for n in range(30)])
    groups: list[Any] = [out.messages.get("topics", []) for out in outputs]
    sent = [int(fields[0]) for group in groups for _, fields in group]
    assert sent == list(range(36, 100))
    assert outputs[-1].report["messages_lost"] == 36
