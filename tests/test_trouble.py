"""The lines that docs/robots/trouble.md explains are those that the drivers say."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import pytest

from swarmd.core.errors import ConfigError
from swarmd.drivers.ros.diagnosis import Report, unheard, why_silent
from swarmd.drivers.ros.messages import LaserScan, Twist
from swarmd.drivers.ros.options import RosOptions
from swarmd.drivers.ros1.adapter import Link, State, Told
from swarmd.drivers.ros1.driver import Ros1Driver
from swarmd.drivers.ros1.options import Ros1Options
from swarmd.drivers.ros1.view import View
from swarmd.drivers.ros2.dds_bridge import Ros2Dds
from swarmd.drivers.ros2.key_scheme import Endpoint, KeyScheme
from swarmd.drivers.ros2.rmw_zenoh import RmwZenoh
from swarmd.drivers.ros2.subscriptions import Subscriptions
from swarmd.settings.driver_options import base_options
from swarmd.settings.platforms import load_platform

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "robots" / "trouble.md").read_text()
PLATFORM = load_platform("burger")
ENDPOINT = "tcp/127.0.0.1:7447"
SCAN, TWIST = "sensor_msgs/msg/LaserScan", "geometry_msgs/msg/Twist"
FOREIGN = "RIHS01_0123456789abcdef"


def report(
    hearing: Subscriptions, graph: Collection[Endpoint] = (), others: int = 0
) -> dict[str, str]:
    """What a check says of it, by subject."""
    whole = Report(
        scheme=Ros2Dds(),
        endpoint=ENDPOINT,
        is_connected=True,
        hearing=hearing,
        spec=PLATFORM.scan,
        graph=graph,
        cmd_vel="/cmd_vel",
        command=Twist,
        has_taker=False,
        others=others,
    )
    return {finding.subject: finding.text for finding in whole.findings()}


def silent(emulator: KeyScheme, *heard: tuple[str, str], domain: int | None = None) -> str:
    """Why no scan comes where these topics are announced."""
    graph = [Endpoint(True, topic, kind, "z", domain) for topic, kind in heard]
    return why_silent(Subscriptions(RosOptions(), PLATFORM).senses["scan"], graph, emulator)


def scans(stamps: Mapping[float, float]) -> Subscriptions:
    """A scan at each time, with the stamp given."""
    hearing = Subscriptions(RosOptions(), PLATFORM)
    for at, stamp in stamps.items():
        hearing.senses["scan"].hear(at, stamp, "360 rays")
    return hearing


def of_ros2() -> Iterator[str]:
    dds = Ros2Dds()
    yield unheard(dds, ENDPOINT)
    yield silent(dds)
    yield silent(RmwZenoh(0, "/cmd_vel"), ("/scan", SCAN), domain=30)
    yield silent(dds, ("/tb3_01/scan", SCAN), ("/tb3_02/scan", SCAN))
    yield silent(dds, ("/odom", "nav_msgs/msg/Odometry"), ("/battery_state", "b"))
    yield silent(dds, ("/scan", SCAN))
    yield silent(dds, ("/scan", "sensor_msgs/msg/PointCloud2"))
    hearing = Subscriptions(RosOptions(), PLATFORM)
    kind = RmwZenoh(0, "/cmd_vel")
    fault = kind.fault(f"0/scan/sensor_msgs::msg::dds_::LaserScan_/{FOREIGN}", "/scan", LaserScan)
    for at in range(12):
        hearing.senses["scan"].complain(at, fault)
    yield report(hearing)["scan"]
    stamped = Endpoint(False, "/cmd_vel", "geometry_msgs/msg/TwistStamped", "z")
    yield report(hearing, [stamped])["cmd_vel"]
    yield report(hearing)["cmd_vel"]
    yield report(hearing, others=87)["others"]
    yield report(scans({0.2 * i: 5.0 for i in range(12)}))["scan"]
    yield report(scans({0.5 * i: 0.5 * i for i in range(12)}))["scan"]


def of_ros1() -> Iterator[str]:
    view = View(Ros1Options(master="http://127.0.0.1:11311"), PLATFORM)
    view.state = State(False, "[Errno 111] Connection refused")
    yield view.missing(1.0)
    driver = Ros1Driver(swarm="s", robot="r", platform=PLATFORM, options={})
    driver.on_event(Told("fatal", "No module named 'rospy'"))
    yield driver._end
    scan, kind = "/scan", "sensor_msgs/LaserScan"
    view.state = State(True, candidates={kind: ["/tb3_01/scan"]})
    yield view.missing(1.0)
    view.state = State(True, publishers={scan: ["/lidar"]}, types={scan: kind})
    yield view.missing(1.0)
    cloud = "1158d486dd51d683ce2f1be655c3c181"
    view.on_link(Link(1, scan, "/lidar", "sensor_msgs/PointCloud2", cloud))
    yield view.missing(1.0)
    for at in range(5):
        view.senses[scan].hear(5.0, ", 360 rays", 0.2 * at)
    yield next(finding.text for finding in view.findings(1.0) if finding.subject == "scan")
    for sense in view.senses.values():
        sense.hear(1.0, "", 1.0)
    view.state = State(True)
    yield view.missing(1.0)
    view.state = State(True, listeners=["/base"], wants={"/base": "geometry_msgs/TwistStamped"})
    yield view.missing(1.0)
    view.state = State(True, others=["/teleop"])
    yield view.missing(1.0)


def of_any() -> Iterator[str]:
    with pytest.raises(ConfigError) as caught:
        base_options({"command_timeout": "none", "idle_output": "silent"}, "driver ros2dds")
    yield str(caught.value)


def explained(title: str) -> set[str]:
    """What stands in the first column of a section's table."""
    section = PAGE.split(f"## {title}\n")[1].split("\n## ")[0]
    return set(re.findall(r"^\| `(.+?)` \|", section, re.MULTILINE))


def test_lines_of_ros_2_are_those_of_its_drivers() -> None:
    assert explained("ROS 2") == set(of_ros2())


def test_lines_of_ros_1_are_those_of_its_driver() -> None:
    assert explained("ROS 1") == set(of_ros1())


def test_lines_of_any_driver_are_said() -> None:
    assert set(of_any()) <= explained("Any driver")
