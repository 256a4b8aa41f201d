"""Writes trouble.md: the drivers' diagnoses of example robots, each with its cause and the remedy.

python docs/robots/trouble.py
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from swarmd.core.errors import ConfigError
from swarmd.drivers.ros.diagnosis import (
    Endpoint,
    Graph,
    Middleware,
    Report,
    driven_by_others,
    unconnected,
    unreachable,
)
from swarmd.drivers.ros.messages import LaserScan, Twist
from swarmd.drivers.ros.options import TopicOptions
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.drivers.ros.topic_stats import TopicStats
from swarmd.drivers.ros1.driver import no_rospy
from swarmd.drivers.ros1.master_graph import Ros1
from swarmd.drivers.ros2.dds_bridge import Ros2Dds
from swarmd.drivers.ros2.rmw_zenoh import RmwZenoh
from swarmd.settings.driver_options import base_options
from swarmd.settings.platforms import load_platform

PAGE = Path(__file__).with_suffix(".md")
PLATFORM = load_platform("burger")
ENDPOINT, MASTER = "tcp/127.0.0.1:7447", "http://127.0.0.1:11311"
SCAN, ODOM, STAMPED = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "TwistStamped"

HEAD = """\
# Usual problems

<!-- Written by docs/robots/trouble.py from the drivers' own messages. -->

`swarmd ... --check` reports what it finds within 5 s and moves nothing; `members` and `describe`
report the same of a running daemon, under `driver lost`. Meanwhile the robot is held at zero.
The tables list the messages of one robot; `FAIL` and the subject precede each.

Check before the daemon is started: a check counts the commands of a running daemon, and after a
crash those of its watchdog, as commands of another node.
"""

CONTENDED = """\
A running daemon reports another publisher as

```
{}
```

What follows depends on the state of the robot. A stopped, estopped or faulted robot is sent zero
20 times per second, and at once after each command of the other node. To an idle or running robot
the driver sends nothing for 2 s; its first command afterwards is zero. A running robot is held, and
stopped after 2 s. Zeros of other nodes do not count. [The last word](last_word.md) shows how to
share a base.
"""

Row = tuple[str, str, str]


def check(subject: str, subscriptions: Subscriptions, foreign_commands: int = 0) -> str:
    """The line of a check with the ROS 2 bridge."""
    report = Report(
        graph=Graph(middleware=Ros2Dds()),
        endpoint=ENDPOINT,
        subscriptions=subscriptions,
        spec=PLATFORM.scan,
        cmd_vel="/cmd_vel",
        command_type=Twist,
        has_subscriber=False,
        now=0.0,
        foreign_commands=foreign_commands,
    )
    return next(f.text for f in report.findings() if f.subject == subject)


def scans(stamps: Mapping[float, float]) -> Subscriptions:
    """A scan at each time, with the stamp given."""
    found = Subscriptions(TopicOptions(), PLATFORM)
    for at, stamp in stamps.items():
        found.topics["scan"].record(at, stamp, "360 rays")
    return found


def silence(middleware: Middleware, *published: tuple[str, str], domain: int | None = None) -> str:
    """Why no scan arrives where these topics are announced."""
    ends = [Endpoint(True, topic, kind, "z", domain, "/lidar") for topic, kind in published]
    stats = Subscriptions(TopicOptions(), PLATFORM).topics["scan"]
    return Graph(middleware=middleware, endpoints=ends).silence(stats)


def subscriber(middleware: Middleware, kind: str) -> str:
    """Why a base that subscribes with this type gets no command."""
    ends = [Endpoint(False, "/cmd_vel", kind, "z", node="/base")] if kind else []
    graph = Graph(middleware=middleware, endpoints=ends)
    return graph.no_subscriber("/cmd_vel", Twist, has_subscriber=False)


def ros2() -> Iterator[Row]:
    """The rows of ROS 2."""
    dds, rmw = Ros2Dds(), RmwZenoh(0, "/cmd_vel")
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
        silence(dds, ("/tb3_01/scan", SCAN), ("/tb3_02/scan", SCAN)),
        "the robot's topics are in a namespace",
        '`namespace: "{robot}"`, or the name',
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
    yield (
        subscriber(dds, f"geometry_msgs/msg/{STAMPED}"),
        "newer TurtleBot3s and Jackals",
        "as the message says",
    )
    yield (
        subscriber(dds, ""),
        "the base's node does not run, or its topic has another name",
        "start the base",
    )
    yield (
        check("last_word", scans({}), foreign_commands=87),
        "two publishers: a joystick, navigation, a second daemon",
        "end it, or give swarmd [the last word](last_word.md)",
    )
    yield (
        check("scan", scans({0.2 * i: 5.0 for i in range(12)})),
        "stamps do not advance",
        "restart the sensor's node",
    )
    yield (
        check("scan", scans({0.5 * i: 0.5 * i for i in range(12)})),
        "a slower lidar than the file says, or a network that loses messages",
        "`scan.rate` of the platform, or look at the network",
    )
    yield (
        conflict("/lidar", "/tb3_02_lidar"),
        "two nodes publish one scan, such as robots in one domain; the robot is held with"
        " `two_scan_sources`",
        "end one, or give each robot a namespace",
    )


def ros1() -> Iterator[Row]:
    """The rows of ROS 1, but for those that are as in ROS 2."""
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
        subscriber(words, f"geometry_msgs/{STAMPED}"),
        "stamped velocities",
        "`cmd_vel_type: twist_stamped`",
    )
    yield (subscriber(words, ""), "the base's node does not run", "start the base")
    yield (
        unconnected("/cmd_vel", ["/base"]),
        "this machine gives an address that the robot cannot reach",
        "`ip:` among the driver's options",
    )
    yield (
        driven_by_others("/cmd_vel", ["/teleop"], is_heard=False),
        "two publishers, active or not",
        "end it, or share the base as [The last word](last_word.md) shows",
    )


def conflict(*owners: str) -> str:
    """Why a robot does not run on the scans of these nodes."""
    stats = Subscriptions(TopicOptions(), PLATFORM).topics["scan"]
    ends = [Endpoint(True, "/scan", SCAN, node=owner) for owner in owners]
    return Graph(middleware=Ros2Dds(), endpoints=ends).rival(stats)


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


def page() -> str:
    """The whole page."""
    parts = [HEAD, _section("ROS 2", ros2()), CONTENDED.format(driven_by_others("/cmd_vel"))]
    return "\n".join([*parts, _section("ROS 1", ros1()), _section("Any driver", any_driver())])


def _section(title: str, rows: Iterator[Row]) -> str:
    lines = [f"| `{message}` | {cause} | {remedy} |" for message, cause, remedy in rows]
    return "\n".join(
        [f"## {title}", "", "| message | cause | remedy |", "|---|---|---|", *lines, ""]
    )


if __name__ == "__main__":
    PAGE.write_text(page())
