"""What a node may not do in a pattern: one line that names it, also where the node catches it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError, PluginError
from swarmd.core.host_messages import Load, Loaded, LoadRefused, PatternFailed, Step, Stepped
from swarmd.core.values import Inputs
from swarmd.pattern_host.executor import PatternExecutor
from swarmd.patterns.ros2_nodes.pattern import Ros2Nodes
from tests.support.ros2_nodes import BURGER, launched, node_with, steps

NODE = """
class One(Node):
    def __init__(self):
        super().__init__("one")
        self.out = self.create_publisher(Twist, "cmd_vel", 1)
        self.create_timer(0.1, self.on_timer)
    def on_timer(self):
"""


def body(*lines: str, begin: str = "") -> str:
    """A node whose timer does this."""
    return f"{begin}{NODE}" + "".join(f"        {line}\n" for line in lines)


def fault(folder: Path, text: str) -> str:
    """The error of the node's second step."""
    with pytest.raises(PluginError) as caught:
        steps(node_with(folder, text), [0.0, 0.1])
    line = str(caught.value)
    assert "\n" not in line
    return line


@pytest.mark.parametrize(
    ("begin", "line", "named"),
    [
        ("import time\n", "time.sleep(1.0)", "time.sleep"),
        ("from time import sleep\n", "sleep(1.0)", "time.sleep"),
        ("", "self.create_rate(10)", "create_rate"),
        ("import threading\n", "threading.Thread(target=print).start()", "threading.Thread"),
        ("from threading import Timer\n", "Timer(1.0, print)", "threading.Timer"),
        ("import socket\n", "socket.socket()", "socket.socket"),
        ("import subprocess\n", "subprocess.run(['ls'])", "subprocess.run"),
        ("import os\n", "os.system('ls')", "os.system"),
        ("import os\n", "os.listdir('.')", "os.listdir"),
        ("import multiprocessing as mp\n", "mp.Process()", "multiprocessing.Process"),
        ("import asyncio\n", "asyncio.run(None)", "asyncio.run"),
        ("", "open('/tmp/swarmd_x', 'w')", "open"),
        ("", "open('/etc/hostname')", "open"),
        ("", "input()", "input"),
        ("import _thread\n", "_thread.start_new_thread(print, ())", "_thread.start_new_thread"),
        ("import importlib\n", "importlib.import_module('time').sleep(1)", "time.sleep"),
        ("import importlib\n", "importlib.import_module('/etc/x')", "ModuleNotFoundError"),
        ("import sys\n", "sys.modules['time'].sleep(1)", "time.sleep"),
        ("import secrets\n", "secrets.token_hex()", "secrets.token_hex"),
        ("import random\n", "random.SystemRandom()", "random.SystemRandom"),
        ("", "self.get_clock().sleep_for(None)", "sleep_for"),
        ("", "rclpy.spin_once(self)", "spin_once"),
        ("", "rclpy.spin(self)", "rclpy.spin"),
        ("from rclpy.action import ActionClient\n", "ActionClient(self, 1, 'x')", "ActionClient"),
        ("import tf2_ros\n", "tf2_ros.Buffer().transform(1, 'odom')", "Buffer.transform"),
        ("import tf2_geometry_msgs as g\n", "g.do_transform_pose(1, 2)", "do_transform_pose"),
    ],
)
def test_a_call_is_refused_by_its_name(tmp_path: Path, begin: str, line: str, named: str) -> None:
    text = fault(tmp_path, body(line, begin=begin))
    assert text.startswith("one: ")
    assert named in text


def test_a_refusal_that_a_node_catches_is_one_all_the_same(tmp_path: Path) -> None:
    text = body("try:", "    time.sleep(1)", "except Exception:", "    pass", begin="import time\n")
    assert "time.sleep" in fault(tmp_path, text)


def test_names_that_are_not_used_are_imported(tmp_path: Path) -> None:
    """A module of many helpers is common: what nobody calls does no harm."""
    begin = (
        "import subprocess, socket, threading\nfrom rclpy.action import ActionServer\n"
        "from tf2_ros import TransformException\nfrom tf2_ros.buffer import Buffer\n"
    )
    steps(node_with(tmp_path, body("pass", begin=begin)), [0.0, 0.1])


@pytest.mark.parametrize(
    ("lines", "named"),
    [
        (("while rclpy.ok():", "    pass"), "rclpy.ok"),
        (
            (
                "from std_srvs.srv import Empty",
                "client = self.create_client(Empty, 'reset')",
                "while not client.wait_for_service(timeout_sec=1.0):",
                "    pass",
            ),
            "reset",
        ),
    ],
)
def test_a_loop_that_waits_for_others_ends(
    tmp_path: Path, lines: tuple[str, ...], named: str
) -> None:
    assert named in fault(tmp_path, body(*lines))


@pytest.mark.parametrize(
    ("run", "text", "named"),
    [
        ("one:One", "import cv3\n", "cv3"),
        ("one:One", "from geometry_msgs.msg import Twits\n", "Twist"),
        ("one:One", "raise ValueError('no port')\n", "no port"),
        ("one:Two", "", "Two"),
        ("shutil:rmtree", "", "shutil"),
        ("code", "", "code"),
        ("../one.py", "", "one.py"),
        ("two:Two", "", "two"),
        ("two.py", "", "two.py"),
        ("one", "", "main"),
        ("one", "def main():\n    rclpy.init()\n", "main"),
        ("one", "def main():\n    Node('a')\n", "rclpy.spin"),
        ("one", "def main():\n    while True:\n        rclpy.spin_once(Node('a'))\n", "spin_once"),
        ("one", "import sys\nsys.exit(3)\n", "3"),
        ("one", "def main():\n    raise KeyboardInterrupt\n", "KeyboardInterrupt"),
        ("one:One", "class One(Node):\n  def __init__(self):\n    pass\n", "no node"),
        ("one:One", "import rclpy.nodes\n", "rclpy.nodes"),
    ],
)
def test_what_cannot_start_is_refused_when_the_run_is_loaded(
    tmp_path: Path, run: str, text: str, named: str
) -> None:
    (tmp_path / "one.py").write_text(f"import rclpy\nfrom rclpy.node import Node\n{text}")
    with pytest.raises(PluginError) as caught:
        launched(tmp_path, f"nodes: [{{run: '{run}'}}]")
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("lines", "named"),
    [
        (("raise RuntimeError('no')",), "RuntimeError"),
        (("raise GeneratorExit",), "GeneratorExit"),
        (("1 / 0",), "one.py"),
        (("self.out.publish(1.0)",), "geometry_msgs/msg/Twist"),
        (("msg = Twist()", "msg.linear.x = 1"), "float"),
        (("msg = Twist()", "msg.speed = 1.0"), "speed"),
        (("self.get_parameter('speeed')",), "speeed"),
        (("self.create_timer(0.0, print)",), "period"),
        (
            ("self.create_subscription(Twist, 'cmd_vel', self.again, 1)",),
            "again",
        ),
    ],
)
def test_a_node_that_raises_is_named_with_its_error(
    tmp_path: Path, lines: tuple[str, ...], named: str
) -> None:
    line = fault(tmp_path, body(*lines))
    assert line.startswith("one: ")
    assert named in line


def test_a_spin_in_a_callback_that_the_node_catches_does_not_mute_it(tmp_path: Path) -> None:
    """Else what it publishes later, a stop among it, would have no effect."""
    text = body("try:", "    rclpy.spin(self)", "except:", "    pass")
    assert "rclpy.spin in a callback" in fault(tmp_path, text)


def test_a_module_lies_below_the_launch_file(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    base = tmp_path / "base"
    for folder in (elsewhere, base):
        folder.mkdir()
    (elsewhere / "one.py").write_text(f"from rclpy.node import Node\n{NODE}        pass\n")
    for name in (f"{elsewhere}/one", "../elsewhere/one", "", "."):
        with pytest.raises(PluginError, match="no name of a module"):
            launched(base, f"nodes: [{{run: '{name}:One'}}]")


def test_a_node_that_floods_itself_is_stopped(tmp_path: Path) -> None:
    text = body(
        "if self.get_parameter_or('begun') is not None:",
        "    self.create_subscription(Twist, 'cmd_vel', self.out.publish, 1)",
        "    self.out.publish(Twist())",
    )
    assert "callbacks" in fault(tmp_path, text)


def test_a_node_that_floods_another_one_is_stopped(tmp_path: Path) -> None:
    text = body(
        "self.create_subscription(Twist, 'cmd_vel', print, 10)",
        "while True:",
        "    self.out.publish(Twist())",
    )
    assert "wait" in fault(tmp_path, text)


def test_a_node_that_makes_a_timer_in_each_call_is_stopped(tmp_path: Path) -> None:
    text = body("while True:", "    self.create_timer(1.0, print)")
    assert "timers" in fault(tmp_path, text)


# In the executor, as the pattern host and lockstep have it


def executor_with(folder: Path, text: str) -> tuple[PatternExecutor, object]:
    folder.joinpath("one.py").write_text(
        "import rclpy\nfrom rclpy.node import Node\nfrom geometry_msgs.msg import Twist\n" + text
    )
    path = folder / "nodes.yaml"
    path.write_text("nodes: [{run: 'one:One'}]")
    executor = PatternExecutor(lambda name: Ros2Nodes)
    layers = (("request", {"launch": str(path)}),)
    return executor, executor.handle(Load(1, "ros2_nodes", layers, "r1", BURGER, 1))


def answers(executor: PatternExecutor) -> list[Any]:
    return [executor.handle(Step(1, Inputs(now=at, dt=0.1))) for at in (0.0, 0.1)]


def test_a_bad_node_is_what_a_bad_pattern_is(tmp_path: Path) -> None:
    _, refused = executor_with(tmp_path, "raise ValueError('no port')\n")
    assert isinstance(refused, LoadRefused)
    assert "no port" in refused.text

    executor, loaded = executor_with(tmp_path, body("raise ValueError('no ray')"))
    assert isinstance(loaded, Loaded)
    stepped, failed = answers(executor)
    assert isinstance(stepped, Stepped)
    assert isinstance(failed, PatternFailed)
    assert "no ray" in failed.text


def test_a_command_that_is_no_number_goes_on_as_that_of_any_pattern(tmp_path: Path) -> None:
    """Protection answers it, as it does for a pattern (tests/robot, tests/robot/protection)."""
    lines = ("msg = Twist()", "msg.linear.x = float('nan')", "self.out.publish(msg)")
    executor, _ = executor_with(tmp_path, body(*lines))
    stepped = answers(executor)[1]
    assert isinstance(stepped, Stepped)
    assert stepped.outputs.twist is not None
    assert np.isnan(stepped.outputs.twist.linear)


@pytest.mark.parametrize(
    ("begin", "line"),
    [
        ("", "rclpy.shutdown()"),
        ("import sys\n", "sys.exit(0)"),
        ("", "raise SystemExit"),
        ("", "raise KeyboardInterrupt"),
    ],
)
def test_a_node_that_ends_itself_ends_the_run_at_rest(
    tmp_path: Path, begin: str, line: str
) -> None:
    move = ("msg = Twist()", "msg.linear.x = 0.1", "self.out.publish(msg)", line)
    outputs = steps(node_with(tmp_path, body(*move, begin=begin)), [0.0, 0.1])[1]
    assert outputs.done is not None
    assert outputs.done.startswith("one ")
    assert outputs.twist is not None
    assert outputs.twist.is_zero


ODD_NAMES = ("a\0b", "a\nb", "a\x1b[2J", "a\u2028b", "a" * 5000, "../" * 2000, "~" * 300)


@pytest.mark.parametrize("odd", ODD_NAMES)
@pytest.mark.parametrize(
    "entry",
    [
        {"run": 0}, {"parameters": 0}, {"parameters": [0]}, {"remap": {"a": 0}},
        {"remap": {0: "a"}}, {"name": 0}, {"namespace": 0},
    ],
)  # fmt: skip
def test_an_odd_name_of_an_entry_is_one_line(
    tmp_path: Path, entry: dict[str, Any], odd: str
) -> None:
    """0 stands for the odd name. Names that are long alone are names of nodes and topics."""
    node_with(tmp_path, body("pass"))
    text = json.dumps({"nodes": [{"run": "one:One"} | _with(entry, odd)]})
    refusal = _refusal(tmp_path, f"nodes: {text[10:-1]}")
    is_file = not {"remap", "name", "namespace"} & entry.keys()
    assert refusal.isprintable()
    assert bool(refusal) or not is_file


@pytest.mark.parametrize("odd", ODD_NAMES)
@pytest.mark.parametrize(
    "more",
    [
        {"path": [0]}, {"namespace": 0}, {"shared": [0]}, {"topics": {"scan": 0}},
        {"topics": {"scan": {"topic": 0}}}, {"topics": {"readings": {0: "a"}}},
        {"topics": {"command": 0}}, {"start": [{"topic": 0, "type": "std_msgs/Int8"}]},
        {"start": [{"topic": "a", "type": 0}]}, {0: 1},
    ],
)  # fmt: skip
def test_an_odd_name_of_a_launch_file_is_one_line(
    tmp_path: Path, more: dict[Any, Any], odd: str
) -> None:
    node_with(tmp_path, body("pass"))
    text = json.dumps(_with(more, odd))
    assert _refusal(tmp_path, f"nodes: [{{run: 'one:One'}}]\n{text[1:-1]}\n").isprintable()


@pytest.mark.parametrize(
    "text",
    [
        b"\0", b"\xff\xfe", b"- 1", b"a: 1", b"/**: {ros__parameters: 1}", b"[" * 5000, b"&a [*a]",
        b"/**: {ros__parameters: " + b"{a: " * 400 + b"1" + b"}" * 401,
        b"{a: " * 400 + b"{ros__parameters: {a: 1}}" + b"}" * 400,
        b"/**: {ros__parameters: {speed: 1}}", b"/**: {ros__parameters: {speed: [1, a]}}",
        b"/**: {ros__parameters: {speed: 99999999999999999999999999}}",
        b"/**: {ros__parameters: {speed: {x: 1}, speed.x: 2}}",
        b"/**: {ros__parameters: {speed: 2026-11-30}}", b'/**: {ros__parameters: {speed: "a\\0b"}}',
        b"/" + b"**/*/" * 200 + b"**/x: {ros__parameters: {speed: 1.0}}",
    ],
)  # fmt: skip
def test_an_odd_parameter_file_is_one_line_or_none(tmp_path: Path, text: bytes) -> None:
    lines = ("self.get_logger().info(str(self.get_parameter('speed').value))",)
    begin = "NAMES = '/'.join('ab' * 20)\n"
    node = body(*lines, begin=begin).replace(
        'super().__init__("one")',
        "super().__init__('one', namespace=NAMES); self.declare_parameter('speed', 0.5)",
    )
    (tmp_path / "odd.yaml").write_bytes(text)
    (tmp_path / "one.py").write_text(
        "import rclpy\nfrom rclpy.node import Node\nfrom geometry_msgs.msg import Twist\n" + node
    )
    assert _refusal(tmp_path, "nodes: [{run: 'one:One', parameters: odd.yaml}]").isprintable()


def _with(value: Any, odd: str) -> Any:
    if isinstance(value, dict):
        return {_with(key, odd): _with(one, odd) for key, one in value.items()}
    if isinstance(value, list):
        return [_with(one, odd) for one in value]
    return odd if value == 0 and value is not False else value


def _refusal(folder: Path, launch: str) -> str:
    """Why a launch file is refused; empty if it runs."""
    try:
        launched(folder, launch)
    except (PluginError, ConfigError) as error:
        return str(error)
    return ""
