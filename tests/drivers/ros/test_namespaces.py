"""What a robot's missing topic is said to be: never another robot's. Both ROS, without links."""

from __future__ import annotations

import pytest

from swarmd.drivers.ros import messages
from swarmd.drivers.ros.diagnosis import Graph, Middleware
from swarmd.drivers.ros.endpoints import Endpoint, is_listener
from swarmd.drivers.ros.options import TopicOptions
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.drivers.ros1.master_graph import Ros1
from swarmd.drivers.ros2.dds_bridge import Ros2Dds
from swarmd.settings.platforms import load_platform

BURGER = load_platform("burger")
WHOLE = ("scan", "odom", "cmd_vel")
both = pytest.mark.parametrize("middleware", [Ros1(), Ros2Dds()], ids=["ros1", "ros2"])
KINDS = {"scan": messages.LaserScan, "odom": messages.Odometry, "cmd_vel": messages.Twist}


def ends(middleware: Middleware, topics: list[str]) -> list[Endpoint]:
    """Endpoints of these topics; the last part tells the type, and what is no sensor is taken."""
    found = []
    for topic in topics:
        kind = KINDS.get(topic.rpartition("/")[2], messages.Imu)
        is_publisher = kind is not messages.Twist
        found.append(Endpoint(is_publisher, topic, middleware.type_name(kind), node="/n"))
    return found


def robot(namespace: str, *topics: str) -> list[str]:
    return [f"{namespace}/{topic}" for topic in topics or WHOLE]


def explained(
    middleware: Middleware, topics: list[str], heard: tuple[str, ...] = (), namespace: str = ""
) -> tuple[str, str]:
    """Why no scan comes, and why no base takes the commands."""
    read = TopicOptions(namespace=namespace)
    stats = Subscriptions(read, BURGER).topics["scan"]
    stats.count = int(stats.topic in heard)
    graph = Graph(
        middleware=middleware, endpoints=ends(middleware, topics), options=read, heard=heard
    )
    taken = graph.no_subscriber(graph.command_topic, read.command_types, has_subscriber=False)
    return graph.silence(stats), taken


@both
def test_the_one_robot_that_is_there_is_proposed_to_one_without_a_namespace(
    middleware: Middleware,
) -> None:
    scan, taken = explained(middleware, robot("/tb3_01"))
    assert "but /tb3_01/scan of that type; correct driver_options.namespace" in scan
    assert "but to /tb3_01/cmd_vel; correct driver_options.namespace" in taken


@both
@pytest.mark.parametrize(
    "topics",
    [
        robot("/tb3_01") + robot("/tb3_02"),
        robot("/tb3_01", "odom", "cmd_vel") + robot("/tb3_02"),  # whose lidar is off
        robot("/fleet/tb3_01") + robot("/fleet/tb3_02"),
    ],
)
def test_of_several_robots_the_namespaces_are_listed_and_none_is_proposed(
    middleware: Middleware, topics: list[str]
) -> None:
    for text in explained(middleware, topics):
        assert "more than one namespace is in use: " in text
        assert "tb3_01, /" in text
        assert "set driver_options.namespace to this robot's own" in text


@both
@pytest.mark.parametrize("here", [[], ["/tb3_01/imu"], ["/tb3_01/odom"], ["/tb3_01/cmd_vel"]])
@pytest.mark.parametrize("others", [["/tb3_02"], ["/tb3_02", "/tb3_03"], [""], ["/other/tb3_01"]])
def test_with_a_namespace_no_topic_beside_it_is_proposed(
    middleware: Middleware, here: list[str], others: list[str]
) -> None:
    topics = [*here, *(topic for other in others for topic in robot(other))]
    scan, taken = explained(middleware, topics, namespace="tb3_01")
    words = {word.strip(",;") for word in f"{scan} {taken}".split()}
    assert not words & (set(topics) - set(here))
    is_unknown = not here
    assert ("nothing of namespace /tb3_01 is there" in scan) == is_unknown


@both
def test_topics_of_the_own_namespace_are_proposed(middleware: Middleware) -> None:
    topics = [*robot("/tb3_01", "front/scan", "odom", "cmd_vel"), *robot("/tb3_02")]
    scan, _ = explained(middleware, topics, namespace="tb3_01")
    assert scan.startswith("no /tb3_01/scan, but /tb3_01/front/scan of that type; correct ")


@both
def test_a_topic_that_was_heard_is_missing_and_not_misnamed(middleware: Middleware) -> None:
    for namespace, topic in (("", "/scan"), ("tb3_01", "/tb3_01/scan")):
        scan, taken = explained(middleware, robot("/tb3_02"), (topic,), namespace=namespace)
        assert scan == f"no {topic} any more, which was heard before; start its node again"
        assert "tb3_02" not in taken


@both
def test_a_robot_without_a_namespace_whose_lidar_is_off_is_not_led_to_another(
    middleware: Middleware,
) -> None:
    scan, _ = explained(middleware, [*robot("", "odom", "cmd_vel"), *robot("/tb3_02")])
    assert scan == "no /scan among /odom; start the sensor, or correct driver_options.scan"
    _, taken = explained(middleware, [*robot("", "odom", "scan"), *robot("/tb3_02")])
    assert (
        taken == "no node subscribes to /cmd_vel; start the base, or correct driver_options.cmd_vel"
    )


@both
@pytest.mark.parametrize(
    ("topics", "wanted"),
    [
        (["/front/scan", "/odom", "/cmd_vel"], "but /front/scan of that type"),
        (
            ["/front/scan", "/diff_drive/odom", "/diff_drive/cmd_vel", "/joy/cmd_vel"],
            "but /front/scan of that type",
        ),
    ],
)
def test_a_sensor_in_a_namespace_of_its_own_is_proposed(
    middleware: Middleware, topics: list[str], wanted: str
) -> None:
    assert wanted in explained(middleware, topics)[0]


@both
def test_the_base_of_a_controller_with_its_own_namespace_is_proposed(
    middleware: Middleware,
) -> None:
    _, taken = explained(middleware, ["/scan", *robot("/diff_drive", "odom", "cmd_vel")])
    assert "but to /diff_drive/cmd_vel; correct" in taken


@pytest.mark.parametrize(
    ("node", "wanted"),
    [
        ("/record_1609459200123456789", True),
        ("/rostopic_4711_1609459200123", True),
        ("/rviz_1609459200", True),
        ("/r1/rqt_gui_py_node_1", True),
        ("/swarmd_r1_77_1609", True),
        ("/record_player", False),
        ("/base", False),
        ("/rosbag2_recorder/base", False),
    ],
)
def test_tools_that_only_listen_are_known_by_their_names(node: str, wanted: bool) -> None:
    assert is_listener(node) is wanted
