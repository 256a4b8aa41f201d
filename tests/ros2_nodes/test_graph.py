"""Timers, queues, services and parameters of nodes, in the order and at the times of rclpy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from swarmd.core.errors import ConfigError, PluginError
from swarmd.core.values import Inputs, Odometry, Pose, Twist
from swarmd.ros2_nodes.launch_file import is_for
from swarmd.ros2_nodes.robot_nodes import RobotNodes
from tests.support.ros2_nodes import launched, node_with, scan, steps

LOG = """
seen = []
class One(Node):
    def __init__(self):
        super().__init__("one")
        self.timers_ = []
        self.begin()
    def note(self, *what):
        now = round(self.get_clock().now().nanoseconds / 1e9, 6)
        seen.append((now, *what))
"""


def seen(robot: RobotNodes) -> list[Any]:
    """What the node's module has noted."""
    found: list[Any] = robot.modules[0].load("one").__dict__["seen"]
    return found


def begin(*lines: str) -> str:
    return f"{LOG}    def begin(self):\n" + "".join(f"        {line}\n" for line in lines)


def test_timers_are_called_at_their_own_times_between_steps(tmp_path: Path) -> None:
    """Two timers in steps of 0.25 s, in the order in which they are due."""
    text = begin(
        "self.create_timer(0.1, lambda: self.note('a'))",
        "self.create_timer(0.15, lambda: self.note('b'))",
    )
    robot = node_with(tmp_path, text)
    steps(robot, [50.0, 50.25, 50.5])
    at = [(0.1, "a"), (0.15, "b"), (0.2, "a"), (0.3, "a"), (0.3, "b"), (0.4, "a"), (0.45, "b")]
    assert seen(robot) == [*at, (0.5, "a")]


def test_a_timer_that_is_due_at_a_step_comes_after_the_scan_of_the_step(tmp_path: Path) -> None:
    text = begin(
        "from sensor_msgs.msg import LaserScan",
        "self.create_subscription(LaserScan, 'scan', lambda m: self.note('scan'), 1)",
        "self.create_timer(0.5, lambda: self.note('timer'))",
    )
    robot = node_with(tmp_path, text)
    robot.step(Inputs(now=7.0, dt=0.0))
    robot.step(Inputs(now=7.5, dt=0.5, scan=scan({}), is_new_scan=True))
    assert seen(robot) == [(0.5, "scan"), (0.5, "timer")]


def test_a_timer_makes_up_for_no_pause(tmp_path: Path) -> None:
    """rcl leaves whole periods out; here those that are more than 0.5 s late."""
    robot = node_with(tmp_path, begin("self.create_timer(0.2, lambda: self.note())"))
    steps(robot, [0.0, 0.2, 3600.0])
    times = [at for (at,) in seen(robot)]
    assert times[:2] == [0.2, 0.4]
    assert len(times) <= 6
    assert all(at > 3599.4 for at in times[2:])


def test_a_timer_can_be_cancelled_and_reset(tmp_path: Path) -> None:
    text = begin(
        "self.one = self.create_timer(0.1, lambda: (self.note('one'), self.one.cancel()))",
        "self.two = self.create_timer(0.25, self.one.reset)",
    )
    robot = node_with(tmp_path, text)
    steps(robot, [0.0, 0.3, 0.6, 0.7])
    assert seen(robot) == [(0.1, "one"), (0.35, "one"), (0.6, "one")]


def test_messages_are_handled_in_the_order_in_which_they_were_published(tmp_path: Path) -> None:
    text = begin(
        "from std_msgs.msg import Int32",
        "self.a = self.create_publisher(Int32, 'a', 10)",
        "self.b = self.create_publisher(Int32, 'b', 10)",
        "def on_a(m):",
        "    self.note('a', m.data)",
        "    if m.data == 1: self.b.publish(Int32(data=9))",
        "self.create_subscription(Int32, 'a', on_a, 10)",
        "self.create_subscription(Int32, 'b', lambda m: self.note('b', m.data), 10)",
        "self.create_timer(0.1, lambda: [p.publish(Int32(data=n)) for p, n in"
        " ((self.a, 1), (self.b, 2), (self.a, 3))])",
    )
    robot = node_with(tmp_path, text)
    steps(robot, [0.0, 0.1])
    assert [what for _, *what in seen(robot)] == [["a", 1], ["b", 2], ["a", 3], ["b", 9]]


def test_a_subscription_keeps_the_newest_of_its_depth(tmp_path: Path) -> None:
    text = begin(
        "from std_msgs.msg import Int32",
        "self.a = self.create_publisher(Int32, 'a', 10)",
        "self.create_subscription(Int32, 'a', lambda m: self.note(m.data), 2)",
        "self.create_timer(0.1, lambda: [self.a.publish(Int32(data=n)) for n in range(5)])",
    )
    robot = node_with(tmp_path, text)
    steps(robot, [0.0, 0.1])
    assert seen(robot) == [(0.1, 3), (0.1, 4)]


def test_a_latched_message_reaches_a_later_subscription(tmp_path: Path) -> None:
    text = begin(
        "from rclpy.qos import QoSProfile, DurabilityPolicy",
        "from std_msgs.msg import Int32",
        "for name, kind in (('kept', DurabilityPolicy.TRANSIENT_LOCAL),"
        " ('lost', DurabilityPolicy.VOLATILE)):",
        "    qos = QoSProfile(depth=1, durability=kind)",
        "    self.create_publisher(Int32, name, qos).publish(Int32(data=4))",
        "    self.create_subscription(Int32, name, lambda m, n=name: self.note(n, m.data), qos)",
    )
    robot = node_with(tmp_path, text)
    assert seen(robot) == [(0.0, "kept", 4)]


def test_a_latched_message_is_the_one_that_was_published(tmp_path: Path) -> None:
    text = begin(
        "from rclpy.qos import QoSProfile, DurabilityPolicy",
        "from std_msgs.msg import Int32",
        "qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)",
        "message = Int32(data=4)",
        "self.create_publisher(Int32, 'kept', qos).publish(message)",
        "message.data = 5",
        "def take(m):",
        "    self.note(m.data)",
        "    m.data = 6",
        "for _ in range(2): self.create_subscription(Int32, 'kept', take, qos)",
    )
    assert seen(node_with(tmp_path, text)) == [(0.0, 4), (0.0, 4)]


def test_nodes_find_what_rclpy_has_beside_nodes(tmp_path: Path) -> None:
    """Preset profiles with their depths, arguments without those of ROS, values of parameters."""
    text = begin(
        "from rclpy.constants import S_TO_NS",
        "from rclpy.parameter import parameter_value_to_python",
        "from rclpy.qos import QoSPresetProfiles",
        "from rclpy.utilities import remove_ros_args",
        "self.note(QoSPresetProfiles.SENSOR_DATA.value.depth, S_TO_NS)",
        "self.note(remove_ros_args(args=['a', '--fast']))",
        "gain = self.declare_parameter('gain', 0.5).get_parameter_value()",
        "self.note(parameter_value_to_python(gain))",
    )
    found = [one[1:] for one in seen(node_with(tmp_path, text))]
    assert found == [(5, 1_000_000_000), (["a", "--fast"],), (0.5,)]


def test_a_topic_has_one_type(tmp_path: Path) -> None:
    text = begin(
        "from std_msgs.msg import Int32, Float32",
        "self.a = self.create_publisher(Int32, 'a', 10)",
        "self.create_subscription(Float32, 'a', print, 10)",
        "self.create_timer(0.1, lambda: self.a.publish(Int32()))",
    )
    with pytest.raises(PluginError, match="Int32"):
        steps(node_with(tmp_path, text), [0.0, 0.1])


def test_a_published_message_can_be_used_again(tmp_path: Path) -> None:
    """Two subscriptions, and the publisher, have a message each."""
    text = begin(
        "from std_msgs.msg import Int32",
        "kept = []",
        "def take(m):",
        "    kept.append(m)",
        "    m.data += 100",
        "    self.note([one.data for one in kept])",
        "self.message = Int32(data=1)",
        "self.a = self.create_publisher(Int32, 'a', 10)",
        "for _ in range(2): self.create_subscription(Int32, 'a', take, 10)",
        "def again():",
        "    self.a.publish(self.message)",
        "    self.message.data = 5",
        "self.create_timer(0.1, again)",
    )
    robot = node_with(tmp_path, text)
    steps(robot, [0.0, 0.1])
    assert seen(robot) == [(0.1, [101]), (0.1, [101, 101])]


def test_a_service_answers_a_client_of_the_same_robot(tmp_path: Path) -> None:
    text = begin(
        "from std_srvs.srv import SetBool",
        "def answer(request, response):",
        "    response.success = not request.data",
        "    return response",
        "self.create_service(SetBool, 'flip', answer)",
        "client = self.create_client(SetBool, 'flip')",
        "assert client.wait_for_service(timeout_sec=1.0)",
        "future = client.call_async(SetBool.Request(data=True))",
        "future.add_done_callback(lambda f: self.note(f.result().success))",
        "rclpy.spin_until_future_complete(self, future)",
        "self.note(future.done(), client.call(SetBool.Request()).success)",
    )
    assert seen(node_with(tmp_path, text)) == [(0.0, False), (0.0, True, True)]


def test_the_clock_begins_with_the_nodes_and_python_has_the_same(tmp_path: Path) -> None:
    text = begin(
        "import time, datetime",
        "from datetime import datetime as dt",
        "from rclpy.time import Time",
        "def now():",
        "    start = Time(seconds=0.25)",
        "    gone = self.get_clock().now() - start",
        "    self.note(time.time(), time.monotonic(), gone.nanoseconds, dt.now().microsecond,",
        "              datetime.datetime.now().timestamp() > 0,",
        "              self.get_clock().now().to_msg().nanosec)",
        "self.create_timer(0.5, now)",
    )
    robot = node_with(tmp_path, text)
    steps(robot, [900.0, 900.5])
    assert seen(robot) == [(0.5, 0.5, 0.5, 250_000_000, 500_000, True, 500_000_000)]


def test_odometry_and_readings_come_as_messages(tmp_path: Path) -> None:
    """A yaw of 90 degrees is the quaternion (0, 0, sin 45, cos 45)."""
    text = begin(
        "from nav_msgs.msg import Odometry",
        "from sensor_msgs.msg import Temperature",
        "from tf_transformations import euler_from_quaternion",
        "def odom(m):",
        "    q = m.pose.pose.orientation",
        "    yaw = euler_from_quaternion([q.x, q.y, q.z, q.w])[2]",
        "    self.note(m.pose.pose.position.x, round(q.z, 6), round(yaw, 6),"
        " m.twist.twist.linear.x, m.header.frame_id)",
        "self.create_subscription(Odometry, '/odom', odom, 1)",
        "self.create_subscription(Temperature, 'warm', lambda m: self.note(m.temperature), 1)",
    )
    node_with(tmp_path, text)
    launch = "nodes: [{run: 'one:One'}]\ntopics: {readings: {temperature: warm}}"
    robot = launched(tmp_path, launch)
    assert robot.needs == {"odometry", "reading:temperature"}
    odometry = Odometry(0.0, Pose(1.5, 0.0, 1.5707963267948966), Twist(0.2))
    robot.step(Inputs(now=0.0, dt=0.0, odometry=odometry, readings={"temperature": 21.5}))
    assert seen(robot) == [(0.0, 1.5, 0.707107, 1.570796, 0.2, "odom"), (0.0, 21.5)]


def test_the_charge_of_a_battery_is_its_percentage(tmp_path: Path) -> None:
    """sensor_msgs/BatteryState: 0 to 1, and NaN is not measured; temperature comes before it."""
    text = begin(
        "from sensor_msgs.msg import BatteryState",
        "self.create_subscription(BatteryState, 'battery_state', lambda m: self.note("
        "round(m.percentage, 6), m.temperature == m.temperature, m.voltage == m.voltage,"
        " m.present), 1)",
    )
    node_with(tmp_path, text)
    launch = "nodes: [{run: 'one:One'}]\ntopics: {readings: {battery: battery_state}}"
    robot = launched(tmp_path, launch)
    assert robot.needs == {"reading:battery"}
    robot.step(Inputs(now=0.0, dt=0.0, readings={"battery": 0.75}))
    assert seen(robot) == [(0.0, 0.75, False, False, True)]


def test_a_buffer_of_tf2_has_the_frames_of_the_base(tmp_path: Path) -> None:
    """A Burger at x = 1.5 m that looks along y: its lidar is 0.032 m behind the axle."""
    text = begin(
        "from rclpy.time import Time",
        "from tf2_ros import TransformException",
        "from tf2_ros.buffer import Buffer",
        "from tf2_ros.transform_listener import TransformListener",
        "self.buffer = Buffer()",
        "self.listener = TransformListener(self.buffer, self)",
        "def look():",
        "    for target, source in (('odom', 'base_scan'), ('base_link', 'odom'),"
        " ('map', 'base_footprint')):",
        "        try:",
        "            t = self.buffer.lookup_transform(target, source, Time()).transform",
        "            self.note(round(t.translation.x, 6), round(t.translation.y, 6),"
        " round(t.rotation.z, 6))",
        "        except TransformException as error:",
        "            self.note(type(error).__name__)",
        "self.create_timer(0.1, look)",
    )
    robot = node_with(tmp_path, text)
    assert robot.needs == {"odometry"}
    odometry = Odometry(0.0, Pose(1.5, 0.0, 1.5707963267948966), Twist(0.2))
    steps(robot, [0.0])
    robot.step(Inputs(now=0.1, dt=0.1, odometry=odometry))
    assert seen(robot) == [
        (0.1, 1.5, -0.032, 0.707107),
        (0.1, 0.0, 1.5, -0.707107),
        (0.1, "LookupException"),
    ]


def test_a_buffer_of_tf2_has_the_shared_frame_of_a_robot_that_knows_its_pose(
    tmp_path: Path,
) -> None:
    """At (3, 4, 90 deg) in `map` and (1, 0, 0) in `odom`: the origin of odom is at (3, 3)."""
    text = begin(
        "from tf2_ros import Buffer, TransformListener",
        "self.buffer = Buffer()",
        "self.listener = TransformListener(self.buffer, self)",
        "def look():",
        "    t = self.buffer.lookup_transform('map', 'odom').transform.translation",
        "    self.note(round(t.x, 6), round(t.y, 6))",
        "self.create_timer(0.1, look)",
    )
    node_with(tmp_path, text)
    robot = launched(tmp_path, "nodes: [{run: 'one:One'}]\ntopics: {pose: pose}")
    odometry = Odometry(0.0, Pose(1.0, 0.0, 0.0), Twist())
    pose = Pose(3.0, 4.0, 1.5707963267948966)
    for now in (0.0, 0.1):
        robot.step(Inputs(now=now, dt=0.1, odometry=odometry, pose=pose))
    assert seen(robot) == [(0.1, 3.0, 3.0)]


def test_a_broadcaster_of_tf2_reaches_a_listener(tmp_path: Path) -> None:
    text = begin(
        "from geometry_msgs.msg import TransformStamped",
        "from tf2_ros import Buffer, TransformListener, StaticTransformBroadcaster",
        "made = TransformStamped()",
        "made.header.frame_id, made.child_frame_id = 'odom', 'goal'",
        "made.transform.translation.x = 2.0",
        "StaticTransformBroadcaster(self).sendTransform(made)",
        "self.buffer = Buffer()",
        "self.listener = TransformListener(self.buffer, self)",
        "self.create_timer(0.1, lambda: self.note(self.buffer.can_transform('goal', 'odom'),"
        " self.buffer.can_transform('goal', 'home')))",
    )
    robot = node_with(tmp_path, text)
    steps(robot, [0.0, 0.1])
    assert seen(robot) == [(0.1, True, False)]


# Parameters


@pytest.mark.parametrize(
    ("pattern", "node", "is_meant"),
    [
        ("/**", "/a/b/follower", True),
        ("/**/follower", "/a/b/follower", True),
        ("/**/follower", "/follower", True),
        ("/*/follower", "/a/follower", True),
        ("/*/follower", "/a/b/follower", False),
        ("/a/follower", "/a/follower", True),
        ("/a/follower", "/b/follower", False),
        ("follower", "/follower", True),
        ("follower", "/a/follower", False),
        ("/a/**", "/b/follower", False),
    ],
)
def test_a_name_in_a_parameter_file_means_nodes(pattern: str, node: str, is_meant: bool) -> None:
    assert is_for(pattern, node) is is_meant


PARAMETERS = """
/**:
  ros__parameters: {a: 1, deep: {b: 2.5}}
/tb3_07/one:
  ros__parameters: {c: [1, 2], names: [x, y]}
/tb3_08/one:
  ros__parameters: {a: 8}
tb3_07:
  one:
    ros__parameters: {d: true}
"""


def test_parameters_come_from_files_and_then_from_the_launch_file(tmp_path: Path) -> None:
    text = begin(
        "self.declare_parameters('', [('a', 0), ('deep.b', 0.0), ('c', [0]), ('d', False),"
        " ('names', ['']), ('e', 'robot')])",
        "self.note(*(self.get_parameter(n).value for n in"
        " ('a', 'deep.b', 'c', 'd', 'names', 'e')))",
        "self.note(self.get_parameters_by_prefix('deep')['b'].get_parameter_value().double_value)",
    )
    node_with(tmp_path, text)
    (tmp_path / "p.yaml").write_text(PARAMETERS)
    launch = "nodes: [{run: 'one:One', parameters: [p.yaml, {e: 'of {robot} {number}'}]}]"
    robot = launched(tmp_path, launch, "tb3-07")
    assert seen(robot) == [(0.0, 1, 2.5, [1, 2], True, ["x", "y"], "of tb3_07 7"), (0.0, 2.5)]


@pytest.mark.parametrize(
    ("declared", "given", "named"),
    [
        ("0.5", "1", "1.0"),
        ("0.5", "fast", "DOUBLE"),
        ("1", "1.5", "INTEGER"),
        ("True", "1", "BOOL"),
        ("[0.5]", "[a]", "DOUBLE_ARRAY"),
    ],
)
def test_a_parameter_of_another_type_is_refused_as_by_rclpy(
    tmp_path: Path, declared: str, given: str, named: str
) -> None:
    node_with(tmp_path, begin(f"self.declare_parameter('x', {declared})"))
    with pytest.raises(PluginError) as caught:
        launched(tmp_path, f"nodes: [{{run: 'one:One', parameters: {{x: {given}}}}}]")
    assert named in str(caught.value)
    assert "'x'" in str(caught.value)


def test_a_node_sets_its_parameters_within_their_bounds(tmp_path: Path) -> None:
    text = begin(
        "from rclpy.parameter import Parameter",
        "from rcl_interfaces.msg import ParameterDescriptor, FloatingPointRange,"
        " SetParametersResult",
        "bounds = [FloatingPointRange(from_value=0.0, to_value=1.0, step=0.0)]",
        "self.declare_parameter('x', 0.5, ParameterDescriptor(floating_point_range=bounds))",
        "self.declare_parameter('fixed', 1, ParameterDescriptor(read_only=True))",
        "self.add_on_set_parameters_callback(",
        "    lambda ps: SetParametersResult(successful=all(p.value != 0.25 for p in ps)))",
        "for name, value in (('x', 0.75), ('x', 2.0), ('x', 0.25), ('x', 'a'), ('fixed', 2)):",
        "    result = self.set_parameters([Parameter(name, value=value)])[0]",
        "    self.note(result.successful, self.get_parameter(name).value)",
    )
    assert [what for _, *what in seen(node_with(tmp_path, text))] == [
        [True, 0.75], [False, 0.75], [False, 0.75], [False, 0.75], [False, 1],
    ]  # fmt: skip


def test_names_are_expanded_and_remapped(tmp_path: Path) -> None:
    text = begin(
        "self.note(self.get_name(), self.get_namespace())",
        "for name in ('scan', '/scan', '~/state', 'old'):",
        "    self.note(self.resolve_topic_name(name))",
    )
    node_with(tmp_path, text)
    launch = """
namespace: /robots/{robot}
nodes: [{run: 'one:One', name: two, namespace: arm, remap: {old: /new, '~/state': state}}]
"""
    assert [what for _, *what in seen(launched(tmp_path, launch))] == [
        ["two", "/robots/tb3_01/arm"],
        ["/robots/tb3_01/arm/scan"],
        ["/scan"],
        ["/robots/tb3_01/arm/state"],
        ["/new"],
    ]


@pytest.mark.parametrize(
    ("launch", "named"),
    [
        ("", "nodes"),
        ("nodes: []", "nodes"),
        ("nodes: [{rum: a}]", "run"),
        ("nodes: [{run: one}]\nshred: [/a]", "shared"),
        ("nodes: [{run: one}]\ntopics: {hold: -1}", "hold"),
        ("nodes: [{run: one}]\npath: [nowhere]", "nowhere"),
        ("nodes: [{run: one}]\npath: [..]", ".."),
        ("nodes: [{run: one}]\npath: [/usr/lib]", "/usr/lib"),
        ("{nodes: [{run: one}]}", "nodes:"),
        ("nodes: [{run: 'one:One', parameters: none.yaml}]", "none.yaml"),
        ("nodes: [{run: 'one:One', parameters: one.py}]", "one.py"),
        ("nodes: [{run: 'one:One'}]\nstart: [{topic: a, type: std_msgs/Int9}]", "Int"),
        (
            "nodes: [{run: 'one:One'}]\nstart: [{topic: a, type: std_msgs/Int8, values: {x: 1}}]",
            "x",
        ),
        (
            "nodes: [{run: 'one:One'}]\n"
            "start: [{topic: a, type: std_msgs/Int8, values: {data: 300}}]",
            "300",
        ),
    ],
)
def test_a_wrong_launch_file_is_named_in_one_line(tmp_path: Path, launch: str, named: str) -> None:
    (tmp_path / "one.py").write_text(f"from rclpy.node import Node\n{begin('pass')}")
    with pytest.raises((ConfigError, PluginError)) as caught:
        launched(tmp_path, launch)
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_message_is_published_at_the_start(tmp_path: Path) -> None:
    text = begin(
        "from geometry_msgs.msg import PointStamped",
        "self.create_subscription(PointStamped, '/go', lambda m: self.note(m.point.x, m.header"
        ".frame_id), 1)",
    )
    node_with(tmp_path, text)
    launch = """
nodes: [{run: 'one:One'}]
start:
  - topic: /go
    type: geometry_msgs/PointStamped
    values: {point: {x: 2}, header: {frame_id: '{robot}'}}
"""
    assert seen(launched(tmp_path, launch)) == [(0.0, 2.0, "tb3_01")]


def test_lines_of_nodes_have_robot_node_and_severity(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = begin(
        "self.get_logger().info('hello')",
        "self.get_logger().debug('not this')",
        "for _ in range(3): self.get_logger().warn('once', once=True)",
        "for _ in range(3): self.get_logger().error('late', throttle_duration_sec=1.0)",
        "print('a', 1)",
    )
    node_with(tmp_path, text)
    assert capsys.readouterr().err.splitlines() == [
        "tb3-01 one [info]: hello",
        "tb3-01 one [warn]: once",
        "tb3-01 one [error]: late",
        "tb3-01 print [info]: a 1",
    ]


def test_lines_of_nodes_are_bounded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    node_with(tmp_path, begin("for n in range(1000): self.get_logger().info(str(n))"))
    assert len(capsys.readouterr().err.splitlines()) == 50


def test_pose_and_neighbors_come_as_messages(tmp_path: Path) -> None:
    """A robot 2 m ahead, one 1 m to the left, and one of no known place."""
    from swarmd.core.values import Neighbor  # used here alone

    text = begin(
        "from geometry_msgs.msg import PoseArray, PoseStamped",
        "self.create_subscription(PoseStamped, 'here', lambda m: self.note(m.pose.position.y), 1)",
        "self.create_subscription(PoseArray, 'others', lambda m: self.note("
        "*[(round(p.position.x, 6), round(p.position.y, 6)) for p in m.poses]), 1)",
    )
    node_with(tmp_path, text)
    launch = "nodes: [{run: 'one:One'}]\ntopics: {pose: here, neighbors: others}"
    robot = launched(tmp_path, launch)
    assert robot.needs == {"pose", "neighbors.distance", "neighbors.bearing"}
    neighbors = (
        Neighbor("c", 0.0, 1.0, 1.5707963267948966),
        Neighbor("b", 0.0),
        Neighbor("a", 0.0, 2.0, 0.0),
    )
    robot.step(Inputs(now=0.0, dt=0.0, pose=Pose(0.0, 3.0), neighbors=neighbors))
    assert seen(robot) == [(0.0, 3.0), (0.0, (2.0, 0.0), (0.0, 1.0))]
