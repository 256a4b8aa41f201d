"""Tables of the messages of ROS drivers, each with its cause and the remedy.

The drivers' own code makes the messages, for example robots with a fault.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from types import SimpleNamespace

import numpy as np

from swarmd.core.errors import ConfigError
from swarmd.core.values import Scan
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros.diagnosis import (
    DriverCheck,
    Graph,
    Middleware,
    also_published,
    driven,
    driven_by_others,
    unconnected,
    unlisted,
    unreachable,
)
from swarmd.drivers.ros.endpoints import Endpoint
from swarmd.drivers.ros.foreign_commands import ROS2_ACTIONS, ForeignCommands
from swarmd.drivers.ros.messages import BatteryState, LaserScan, Twist, TwistStamped
from swarmd.drivers.ros.options import TopicOptions
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.drivers.ros.to_ros import header
from swarmd.drivers.ros.topic_stats import TopicStats
from swarmd.drivers.ros1.driver import no_rospy
from swarmd.drivers.ros1.master_graph import Ros1
from swarmd.drivers.ros2.dds_bridge import Ros2Dds
from swarmd.drivers.ros2.rmw_zenoh import RmwZenoh
from swarmd.settings.driver_options import base_options
from swarmd.settings.platforms import load_platform

PLATFORM = load_platform("burger")
ENDPOINT, MASTER = "tcp/127.0.0.1:7447", "http://127.0.0.1:11311"
SCAN, ODOM, TWIST = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "geometry_msgs/msg/Twist"

Row = tuple[str, str, str]


def check(subject: str, subscriptions: Subscriptions, foreign_commands: int = 0) -> str:
    """The line of a check with the ROS 2 bridge."""
    foreign = ForeignCommands(TopicOptions(), ROS2_ACTIONS)
    foreign.counts["/cmd_vel"] += foreign_commands
    report = DriverCheck(
        graph=Graph(middleware=Ros2Dds()),
        endpoint=ENDPOINT,
        subscriptions=subscriptions,
        spec=PLATFORM.scan,
        cmd_vel="/cmd_vel",
        command_types=(Twist,),
        has_subscriber=False,
        now=0.0,
        foreign=foreign,
    )
    return next(f.text for f in report.findings() if f.subject == subject)


def scans(stamps: Mapping[float, float], distance: float = 0.42) -> Subscriptions:
    """A scan at each time, with the stamp given: every ray has that range in m."""
    found, spec = Subscriptions(TopicOptions(), PLATFORM), PLATFORM.scan
    ranges = np.full(len(spec.bearings), distance)
    for seq, (at, stamp) in enumerate(stamps.items()):
        found.topics["scan"].record(at, stamp)
        found.contents["scan"].take(
            Scan(seq, stamp, ranges, spec.bearings, spec.range_min, spec.range_max)
        )
    return found


def received(subject: str, message: object, options: TopicOptions) -> str:
    """The line of a check with the ROS 2 bridge about a topic that has one message."""
    subscriptions = Subscriptions(options, PLATFORM)
    subscriptions.read(subject, cdr.encode(message), 0.0)
    return check(subject, subscriptions)


def mirrored() -> LaserScan:
    """A scan whose header gives the angle of its last ray with the other sign."""
    spec, step = PLATFORM.scan, math.tau / 360
    return LaserScan(
        header=header(1.0, "base_scan"),
        angle_min=0.0,
        angle_max=-359 * step,
        angle_increment=step,
        time_increment=0.0,
        scan_time=0.2,
        range_min=spec.range_min,
        range_max=spec.range_max,
        ranges=np.full(360, 1.0, np.float32),
        intensities=np.empty(0, np.float32),
    )


def no_battery() -> BatteryState:
    """The message of a driver without a battery, or before its first measurement."""
    return BatteryState(
        header=header(1.0, "base_link"),
        voltage=0.0,
        temperature=0.0,
        current=0.0,
        charge=0.0,
        capacity=0.0,
        design_capacity=0.0,
        percentage=0.0,
        power_supply_status=0,
        power_supply_health=0,
        power_supply_technology=0,
        present=False,
        cell_voltage=np.empty(0, np.float32),
        cell_temperature=np.empty(0, np.float32),
        location="",
        serial_number="",
    )


def set_clock() -> str:
    """The message about a lidar whose stamps go back twice within 10 s, with one publisher."""
    subscriptions = scans({0.0: 50.0, 0.2: 50.2, 0.4: 49.0, 0.6: 48.0})
    graph = Graph(middleware=Ros2Dds(), endpoints=[Endpoint(True, "/scan", SCAN, node="/lidar")])
    return graph.unreliable(subscriptions.topics["scan"], PLATFORM.scan)


def silence(
    middleware: Middleware,
    *published: tuple[str, str],
    domain: int | None = None,
    namespace: str = "",
) -> str:
    """The message of a robot without scans, while `published` topics (name, type) are announced."""
    ends = [Endpoint(True, topic, kind, "z", domain, "/lidar") for topic, kind in published]
    options = TopicOptions(namespace=namespace)
    stats = Subscriptions(options, PLATFORM).topics["scan"]
    return Graph(middleware=middleware, endpoints=ends, options=options).silence(stats)


def subscriber(
    middleware: Middleware, *subscribers: tuple[str, str], is_there: bool = False
) -> str:
    """The message of a robot whose base gets no commands.

    `subscribers`: (node, type) of the announced subscribers. `is_there`: there is a subscriber,
    announced or not.
    """
    ends = [Endpoint(False, "/cmd_vel", kind, "z", node=node) for node, kind in subscribers]
    graph = Graph(middleware=middleware, endpoints=ends)
    return graph.no_subscriber("/cmd_vel", (Twist, TwistStamped), has_subscriber=is_there)


def action() -> str:
    """The message about an active goal of an action, which drives the base."""
    status, name = f"/dock/{ROS2_ACTIONS.status}", "/motion_control"
    foreign = ForeignCommands(TopicOptions(other_actions=("dock",)), ROS2_ACTIONS)
    goal = SimpleNamespace(status=min(ROS2_ACTIONS.active))
    foreign.take_status(status, SimpleNamespace(status_list=[goal]), 0.0)
    ends = [Endpoint(True, status, "action_msgs/msg/GoalStatusArray", node=name)]
    return driven(foreign, Graph(middleware=Ros2Dds(), endpoints=ends), 0.0)


def ros2() -> Iterator[Row]:
    """The rows of ROS 2."""
    dds, rmw = Ros2Dds(), RmwZenoh(0, "/cmd_vel")
    yield from _silent(dds, rmw)
    yield from _commands(dds)
    yield from _scans()
    yield from _nodes(dds)


def _silent(dds: Ros2Dds, rmw: RmwZenoh) -> Iterator[Row]:
    """Rows for a missing hub, a missing topic, and unreadable messages."""
    yield (
        unreachable(dds, ENDPOINT),
        "the bridge does not run, or listens elsewhere (`-l`)",
        "start it; with `rmw_zenoh` the message names `rmw_zenohd`",
    )
    yield (
        silence(dds),
        "the bridge is in another domain than the robot; or only one of them has"
        " `ROS_LOCALHOST_ONLY`; or the bridge's `ROS_DISTRO` is not the robot's; or no node runs;"
        " or `rmw_zenohd` listens there",
        "the same variables in both terminals; `--driver rmw_zenoh`",
    )
    yield (
        silence(rmw, ("/scan", SCAN), domain=30),
        "`rmw_zenoh` only: the robot's nodes have another `ROS_DOMAIN_ID`",
        "`--driver-option domain=30`",
    )
    yield (
        silence(dds, ("/tb3_01/scan", SCAN)),
        "the robot's topics are in a namespace",
        '`namespace: "{robot}"`, or the name',
    )
    yield (
        silence(dds, ("/tb3_01/scan", SCAN), ("/tb3_02/scan", SCAN)),
        "several robots, each in a namespace",
        '`namespace: "{robot}"`, or the name',
    )
    yield (
        silence(dds, ("/tb3_02/scan", SCAN), namespace="tb3_01"),
        "the nodes of this robot do not run; what others publish is not proposed",
        "start them, or correct a namespace that is misspelt",
    )
    yield (
        silence(dds, ("/odom", ODOM), ("/battery_state", "b")),
        "the base runs, its lidar does not",
        "look at the lidar's node",
    )
    yield (
        silence(dds, ("/scan", SCAN)),
        "the node runs and publishes nothing",
        "cable, motor, power of the lidar",
    )
    yield (
        silence(dds, ("/scan", "sensor_msgs/msg/PointCloud2")),
        "a topic of another type",
        "name the right one, or convert it",
    )
    hashed = "0/scan/sensor_msgs::msg::dds_::LaserScan_/RIHS01_0123456789abcdef"
    stats = TopicStats("scan", "scan", "/scan", LaserScan)
    stats.record_fault(0.0, rmw.key_fault(hashed, "/scan", LaserScan))
    yield (
        Graph(middleware=rmw).unreadable(stats),
        "`rmw_zenoh` only: another definition under this name",
        "publish the ordinary type",
    )


def _commands(dds: Ros2Dds) -> Iterator[Row]:
    """Rows for a base that takes no commands, or that another node drives."""
    yield (
        subscriber(dds, ("/base", f"{TWIST}Stamped"), ("/joy", TWIST)),
        "nodes subscribe to one topic with two types; without `cmd_vel_type` the driver sends the"
        " type that the base wants",
        "end the other node, or set the type that the base wants",
    )
    yield (
        subscriber(dds, is_there=True),
        "the node is not known to the bridge, or the driver is at a router without a bridge",
        "`cmd_vel_type: twist` or `twist_stamped`",
    )
    yield (
        subscriber(dds),
        "the base's node does not run, or its topic has another name",
        "start the base",
    )
    yield (
        check("last_word", scans({}), foreign_commands=87),
        "two publishers: a joystick, navigation, a second daemon",
        "end it, or give swarmd [the last word](last_word.md#the-last-word-on-the-command-topic)",
    )
    yield (
        action(),
        "an action of `other_actions` moves the base, or is accepted",
        "cancel it, or wait for its end",
    )


def _scans() -> Iterator[Row]:
    """Rows for sensor data that arrive but cannot be used."""
    yield (
        check("scan", scans({0.2 * i: 5.0 for i in range(12)})),
        "stamps do not advance",
        "restart the sensor's node",
    )
    yield (
        check("scan", scans({0.2 * i: float(i // 5) for i in range(16)})),
        "the stamps have whole seconds only, or the driver repeats them; of one stamp only the"
        " first scan counts, so that the robot is held now and then",
        "the driver of the lidar",
    )
    yield (
        set_clock(),
        "NTP, or a hand, sets the clock of the lidar's computer while the node runs; the run does"
        " not end as `two_scan_sources`",
        "`chronyc waitsync` before the node starts",
    )
    yield (
        received("scan", mirrored(), TopicOptions()),
        "the driver of the lidar counts the angles to one side and names the other; `describe` says"
        " so, too",
        "look which side an obstacle is on, and correct the driver of the lidar",
    )
    yield (
        check("scan", scans({0.5 * i: 0.5 * i for i in range(12)})),
        "a slower lidar than the file says, or a network that loses messages",
        "`scan.rate` of the platform, or look at the network",
    )
    steady = {0.2 * i: 0.2 * i for i in range(12)}
    yield (
        check("scan", scans(steady, 0.0)),
        "the motor of the lidar stands still, or the lidar is covered",
        "power and cable of the lidar",
    )
    yield (
        check("scan", scans(steady, 8.0)),
        "the lidar is blind, or the robot stands in the open",
        "check near a wall",
    )
    yield (
        check("scan", scans(steady)),
        "a frozen driver repeats its last scan; or a simulated lidar has no noise",
        "restart the sensor's node; let a simulated lidar add noise",
    )
    yield (
        received(
            "battery",
            no_battery(),
            TopicOptions(battery="battery_state", battery_volts=(11.0, 12.6)),
        ),
        "the message says that nothing is measured; the robot has no battery, and not an empty one;"
        " [all messages that can say so](ros.md#messages-that-say-that-they-measure-nothing)",
        "the driver of the battery",
    )


def _nodes(dds: Ros2Dds) -> Iterator[Row]:
    """Rows for several nodes in place of one, and for nodes that a bridge does not announce."""
    yield (
        conflict(True, "/lidar", "/tb3_02_lidar"),
        "two nodes publish one scan, such as robots in one domain; the robot is held with"
        " `two_scan_sources`",
        "end one, or give each robot a namespace or a `ROS_DOMAIN_ID`",
    )
    yield (
        conflict(False, "/base", "/tb3_02_base"),
        "two bases take one robot's commands; the robot is held with `two_bases`",
        "end one, or give each robot a namespace or a `ROS_DOMAIN_ID`; an estimator that takes"
        " commands belongs into `cmd_vel_listeners`",
    )
    yield (
        conflict(False, "/base", stray="/dds_reader_mover"),
        "a program without ROS, or a second bridge in the domain, takes the robot's commands from"
        " DDS; the robot is held with `two_bases`",
        "end it, or give each robot a `ROS_DOMAIN_ID`; if it only listens, name it in"
        " `cmd_vel_listeners`",
    )
    yield (
        conflict(False, "/base", "/base", since=0.0),
        "a base crashed and was started again, or two robots have equal names; after 13 s the"
        " message says which",
        "start the bridge again; or separate the robots",
    )
    yield (
        unrouted("/base"),
        "the bridge has forgotten a node that crashed and is back (1.10, its issue 702), or its"
        " configuration denies the topic",
        "start the bridge again",
    )
    yield (
        unlisted(dds),
        "the bridge does not answer on its nodes: access control, or another program; no fault, but"
        " two bases would not be noticed",
        "`ros2 topic info -v /cmd_vel` shows one subscriber",
    )


def ros1() -> Iterator[Row]:
    """The rows of ROS 1 that differ from those of ROS 2."""
    words, kind = Ros1(), "sensor_msgs/LaserScan"
    yield (
        unreachable(words, MASTER, "[Errno 111] Connection refused"),
        "the master is elsewhere or down",
        "`master: http://10.0.0.11:11311`",
    )
    yield (
        no_rospy("/usr/bin/python3", "No module named 'rospy'"),
        "rospy is not installed, or in another Python",
        "`apt-get install python3-rospy python3-sensor-msgs python3-geometry-msgs"
        " python3-nav-msgs`",
    )
    yield (silence(words), "no node of the robot runs, or it has another master", "start them")
    yield (
        silence(words, ("/tb3_01/scan", kind)),
        "the namespace or the name is wrong",
        "the message names the topics of that type",
    )
    yield (
        silence(words, ("/scan", kind)),
        "the sensor is silent, or the robot gives an address that is not reachable from here",
        "`ROS_IP` on the robot, `ip:` here",
    )
    foreign = f"{kind} (md5 1158d486dd51d683ce2f1be655c3c181, not 90c7ef2dc6895d81024acba2ac42f369)"
    yield (
        silence(words, ("/scan", foreign)),
        "another definition under this name",
        "publish the ordinary type",
    )
    yield (
        subscriber(words, is_there=True),
        "the base subscribes with any type, as `topic_tools` do",
        "`cmd_vel_type: twist` or `twist_stamped`",
    )
    yield (subscriber(words), "the base's node does not run", "start the base")
    yield (
        unconnected("/cmd_vel", ["/base"]),
        "this machine gives an address that the robot cannot reach",
        "`ip:` among the driver's options",
    )
    yield (
        also_published("/cmd_vel", ["/teleop"], is_heard=False),
        "two publishers, active or not",
        "end it, or share the base as"
        " [The last word](last_word.md#the-last-word-on-the-command-topic) shows",
    )


def conflict(is_publisher: bool, *owners: str, since: float = -math.inf, stray: str = "") -> str:
    """The message of a robot that is held because several nodes have its topic.

    `is_publisher`: the nodes `owners` publish its scan; else they subscribe to its commands.
    `stray`: a DDS reader of the commands that belongs to no node. `since`: when the nodes appeared.
    """
    topic, kind = ("/scan", SCAN) if is_publisher else ("/cmd_vel", TWIST)
    ends = [
        Endpoint(is_publisher, topic, kind, node=owner, process=str(number), since=since)
        for number, owner in enumerate(owners)
    ]
    strays = [Endpoint(False, topic, kind, node=stray)] if stray else []
    graph = Graph(middleware=Ros2Dds(), endpoints=ends, strays=strays, now=1.0)
    topics = Subscriptions(TopicOptions(), PLATFORM).topics.values()
    found = graph.conflict(topics, PLATFORM.scan)
    assert found is not None
    return found.text


def unrouted(node: str) -> str:
    """The message about a base that the bridge lists, but whose topic it does not route."""
    ends = [Endpoint(False, "/cmd_vel", TWIST, node=node, is_routed=False)]
    graph = Graph(middleware=Ros2Dds(), endpoints=ends)
    return graph.no_subscriber("/cmd_vel", (Twist,), has_subscriber=False)


def any_driver() -> Iterator[Row]:
    """The rows of every driver."""
    yield (
        "'ros2dds' needs rosbags.serde, which is not installed; run: pip install 'swarmd[ros]'",
        "installed without the extra",
        "in a clone `pip install '.[ros]'`",
    )
    yield (
        "waits for its watchdog",
        "the second process is starting; it takes less than a second",
        "if it stays, the daemon's log says why",
    )
    try:
        base_options({"command_timeout": "none", "idle_output": "silent"}, "driver ros2dds")
    except ConfigError as error:
        yield (
            str(error),
            "a joystick cannot share a base that never stops by itself",
            "one of the two",
        )


def contended() -> Iterator[str]:
    """The message of a running daemon about another publisher."""
    yield f"```\n{driven_by_others('/cmd_vel')}\n```"


def table(rows: Iterator[Row]) -> Iterator[str]:
    """A table of messages with their causes and remedies."""
    lines = [f"| `{message}` | {cause} | {remedy} |" for message, cause, remedy in rows]
    yield "\n".join(["| message | cause | remedy |", "|---|---|---|", *lines])


PARTS = {
    "messages_ros2": lambda: table(ros2()),
    "messages_contended": contended,
    "messages_ros1": lambda: table(ros1()),
    "messages_any_driver": lambda: table(any_driver()),
}
"""The parts of `docs/trouble.md`."""
