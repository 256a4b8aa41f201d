"""The allowed options, and the names of topics that follow from them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from contextlib import nullcontext

import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Platform, Value
from swarmd.drivers.ros.options import (
    DEFAULT_ENDPOINT,
    RmwOptions,
    Ros1Options,
    TopicOptions,
    read_options,
)
from swarmd.drivers.ros2.session import open_session
from swarmd.link.settings import FIELD_PORT
from swarmd.settings.driver_options import BaseOptions
from swarmd.settings.platforms import load_platform, platform_names
from tests.support.range_ring import with_ring

ReadAny = Callable[[Mapping[str, Value]], TopicOptions]


def read(options: Mapping[str, Value], robot: str = "tb3-01") -> RmwOptions:
    return read_options(RmwOptions, options, "rmw_zenoh", robot)


def read_ros1(options: Mapping[str, Value]) -> Ros1Options:
    return read_options(Ros1Options, options, "ros1", "tb3-01")


both = pytest.mark.parametrize("read_any", [read, read_ros1], ids=["rmw_zenoh", "ros1"])


@pytest.mark.parametrize(
    ("name", "in_ros1", "in_ros2"),
    [
        ("front/scan_2", True, True),
        ("front/2d_scan", True, False),
        ("front__scan", True, False),
        ("2d_scan", False, False),
        ("front//scan", False, False),
        ("front-scan", False, False),
    ],
)
@pytest.mark.parametrize("option", ["scan", "namespace"])
def test_names_that_no_node_of_the_version_can_have_are_refused(
    name: str, in_ros1: bool, in_ros2: bool, option: str
) -> None:
    """ROS 2: https://design.ros2.org/articles/topic_and_service_names.html."""
    for read_any, is_taken in ((read_ros1, in_ros1), (read, in_ros2)):
        with (
            nullcontext() if is_taken else pytest.raises(ConfigError, match=f"{option} is '{name}'")
        ):
            read_any({option: name})


def test_the_default_endpoint_is_not_the_port_of_the_field_profile() -> None:
    assert not DEFAULT_ENDPOINT.endswith(f":{FIELD_PORT}")


@both
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
def test_the_namespace_precedes_relative_names(
    read_any: ReadAny, namespace: str, name: str, wanted: str
) -> None:
    assert read_any({"namespace": namespace}).topic(name) == wanted


def test_a_ring_of_ranges_is_by_topic() -> None:
    options = read({"ranges": {"left": 90, "front": [0.0, 0.08]}})
    assert options.ring() == (("left", math.pi / 2.0, 0.0), ("front", 0.0, 0.08))


@both
@pytest.mark.parametrize(
    ("options", "subject"),
    [
        ({"namspace": "a"}, "'namespace'"),
        ({"cmd_vel_type": "stamped"}, "cmd_vel_type"),
        ({"scan": "sc*an"}, "scan is"),
        ({"scan": "front scan"}, "scan is"),
        ({"scan": "1scan"}, "scan is"),
        ({"scan": ""}, "scan is"),
        ({"namespace": "a//b"}, "namespace is"),
        ({"namespace": "robot-1"}, "namespace is"),
        ({"namespace": "**"}, "namespace is"),
        ({"imu": "@x"}, "imu is"),
        ({"scan_yaw_deg": 400}, "scan_yaw_deg"),
        ({"ranges": {"a b": 1.0}}, "ranges.a b"),
        ({"ranges": {"a": 400.0}}, "ranges.a"),
        ({"ranges": {"a": [0.0, -1.0]}}, "ranges.a"),
        ({"ranges": {"a": [0.0]}}, "ranges"),
        ({"ranges": {"a": "far"}}, "ranges.a"),
        ({"namespace": "a", "imu": "/a/odom"}, "odometry and imu"),
        ({"battery_volts": [12.6, 11.0]}, "battery_volts"),
        ({"battery_volts": [math.nan, 11.0]}, "battery_volts"),
        ({"battery_volts": 12.6}, "battery_volts"),
        ({"battery_percentage": "volts"}, "battery_percentage"),
        ({"cmd_vel": "scan"}, "scan and cmd_vel"),
        ({"other_commands": ["a b"]}, "other_commands[0] is"),
        ({"other_commands": ["x", "cmd_vel"]}, "cmd_vel and other_commands[1]"),
        ({"other_actions": ["dock it"]}, "other_actions[0] is"),
        ({"other_commands": ["swarmd/stop"]}, "other_commands[0] is /swarmd/stop"),
        ({"namespace": "a", "cmd_vel": "/a/swarmd/estop"}, "cmd_vel is /a/swarmd/estop"),
        ({"shared_pose": "swarmd/pose"}, "shared_pose is /swarmd/pose"),
        ({"hazards": {"b": {"topic": "swarmd/state", "means": {}}}}, "hazards.b"),
        ({"scan": "a", "ranges": {"a": 1.0}}, "scan and ranges.a"),
        ({"ranges": {"ir": 0, "/ir": 90}}, "ranges.ir and ranges./ir"),
    ],
)
def test_a_wrong_option_is_named(
    read_any: ReadAny, options: Mapping[str, Value], subject: str
) -> None:
    with pytest.raises(ConfigError, match=re.escape(subject)) as caught:
        read_any(options)
    assert str(caught.value).startswith("driver r")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("read_any", "options", "subject"),
    [
        (read, {"domain": 233}, "domain"),
        (read, {"domain": "0"}, "domain"),
        (read, {"endpoint": "127.0.0.1:7447"}, "endpoint"),
        (read, {"endpoint": 7447}, "endpoint"),
        (read_ros1, {"mastre": "http://127.0.0.1:1"}, "'master'"),
        (read_ros1, {"master": "127.0.0.1:11311"}, "master"),
    ],
)
def test_a_wrong_place_is_named(
    read_any: ReadAny, options: Mapping[str, Value], subject: str
) -> None:
    with pytest.raises(ConfigError, match=subject):
        read_any(options)


@both
def test_scan_beside_ranges_needs_a_platform_that_describes_both(read_any: ReadAny) -> None:
    def reading(platform: Platform, **options: Value) -> None:
        read_options(type(read_any({})), options, "ros", "r", platform)

    burger, ring = load_platform("burger"), with_ring("burger")
    reading(ring, scan="scan", ranges={"a": 1.0})
    reading(ring, ranges={"a": 1.0})
    reading(burger, scan="scan")
    reading(burger, ranges={"a": 1.0})
    with pytest.raises(ConfigError, match="beside ranges"):
        reading(burger, scan="scan", ranges={"a": 1.0})
    with pytest.raises(ConfigError, match="ranges is missing"):
        reading(ring, scan="scan")


@pytest.mark.parametrize(
    "name", [name for name in platform_names() if "ros1" in load_platform(name).drivers]
)
def test_the_ros_1_options_of_every_platform_are_valid(name: str) -> None:
    given = load_platform(name).drivers["ros1"]
    assert given["command_timeout"]
    read_ros1({key: given[key] for key in given.keys() - BaseOptions.__struct_fields__})


def test_an_endpoint_that_zenoh_cannot_parse_gives_no_session() -> None:
    assert open_session("tcp/127.0.0.1:9?rel=x;;=", within=0.1) is None
