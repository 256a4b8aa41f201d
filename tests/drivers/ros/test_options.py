"""What may stand in the options, and how topics are named with them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Value
from swarmd.drivers.ros.options import (
    DEFAULT_ENDPOINT,
    RmwOptions,
    RosOptions,
    read_options,
)
from swarmd.drivers.ros2.session import open_session
from swarmd.network.settings import FIELD_PORT


def read(options: Mapping[str, Value], robot: str = "tb3-01") -> RmwOptions:
    return read_options(RmwOptions, options, "rmw_zenoh", robot)


def test_defaults_are_those_of_a_bridge_on_this_machine() -> None:
    options = read_options(RosOptions, {}, "ros2dds", "r")
    assert options.endpoint == "tcp/127.0.0.1:7447"
    assert options.topic(options.scan) == "/scan"


def test_the_default_endpoint_is_not_the_port_of_the_field_profile() -> None:
    assert not DEFAULT_ENDPOINT.endswith(f":{FIELD_PORT}")


@pytest.mark.parametrize(
    ("namespace", "name", "wanted"),
    [
        ("", "scan", "/scan"),
        ("/", "scan", "/scan"),
        ("bot1", "scan", "/bot1/scan"),
        ("/bot1", "front/scan", "/bot1/front/scan"),
        ("bot1", "/scan", "/scan"),
        ("{robot}", "odom", "/tb3_01/odom"),
        ("lab/{robot}", "odom", "/lab/tb3_01/odom"),
    ],
)
def test_the_namespace_stands_before_relative_names(namespace: str, name: str, wanted: str) -> None:
    assert read({"namespace": namespace}).topic(name) == wanted


def test_a_ring_of_ranges_is_by_topic() -> None:
    options = read({"ranges": {"left": 90, "front": [0.0, 0.08]}})
    assert options.ring() == (("left", math.pi / 2.0, 0.0), ("front", 0.0, 0.08))


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"namspace": "a"}, "did you mean 'namespace'"),
        ({"domain": 233}, "domain is 233; wanted a whole number of at least 0 and up to 232"),
        ({"domain": "0"}, "domain is '0'; wanted a whole number"),
        ({"endpoint": "127.0.0.1:7447"}, "endpoint is '127.0.0.1:7447'; wanted is such as tcp/"),
        ({"endpoint": 7447}, "endpoint is 7447; wanted text"),
        ({"cmd_vel_type": "stamped"}, "is 'stamped'; wanted twist or twist_stamped"),
        ({"scan": "sc*an"}, "scan is 'sc.an'; wanted is a ROS name"),
        ({"scan": ""}, "scan is ''; wanted"),
        ({"namespace": "a//b"}, "namespace is 'a//b'"),
        ({"namespace": "**"}, "namespace is"),
        ({"imu": "@x"}, "imu is '@x'"),
        ({"scan_yaw_deg": 400}, "scan_yaw_deg is 400; wanted a number .* up to 360"),
        ({"ranges": {"a b": 1.0}}, "ranges.a b is 'a b'"),
        ({"ranges": {"a": 400.0}}, "ranges.a is 400"),
        ({"ranges": {"a": [0.0, -1.0]}}, "ranges.a is"),
        ({"ranges": {"a": [0.0]}}, "ranges"),
        ({"namespace": "a", "imu": "/a/odom"}, "odometry and imu are both /a/odom; wanted is a to"),
        ({"cmd_vel": "scan"}, "scan and cmd_vel are both /scan; wanted is a topic each"),
        ({"ranges": {"ir": 0, "/ir": 90}}, "ranges.ir and ranges./ir are both /ir; wanted is"),
    ],
)
def test_what_is_wrong_is_named(options: Mapping[str, Value], complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint) as caught:
        read(options)
    assert str(caught.value).startswith("driver rmw_zenoh: ")
    assert "\n" not in str(caught.value)


def test_an_endpoint_that_zenoh_cannot_parse_gives_no_session() -> None:
    assert open_session("tcp/127.0.0.1:9?rel=x;;=", within=0.1) is None
