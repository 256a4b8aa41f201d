"""What may stand in `driver_options` of the ROS 2 drivers, read and checked."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Annotated, Literal, TypeVar

import msgspec
from msgspec import Meta, Struct

from swarmd.core.errors import ConfigError
from swarmd.core.values import Value
from swarmd.settings.layered import Layered

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"

_ENDPOINT = re.compile(r"(tcp|tls|quic|udp)/(\[[0-9a-fA-F:.]+\]|[^/:#?\s]+):\d{1,5}([?#]\S*)?")
_TOPIC = re.compile(r"/?[A-Za-z0-9_]+(/[A-Za-z0-9_]+)*")
_ROBOT = "{robot}"
_TURN, _REACH = 360.0, 10.0

Degrees = Annotated[float, Meta(ge=-360.0, le=360.0)]


class RosOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the robot is on the network, and how its topics are called.

    `namespace` stands before every topic that does not begin with a slash; `{robot}` in it is the
    robot's id, with `_` for `-`. `ranges` makes one scan of several `sensor_msgs/Range`: topic to
    bearing in degrees, or to bearing and the sensor's distance in m from the scan's origin;
    `scan` is not listened to then. `scan_yaw_deg`: where the lidar's own zero looks, from the
    base's front to the left; `scan_upside_down`: it hangs, and so turns the other way round.
    """

    endpoint: str = DEFAULT_ENDPOINT
    namespace: str = ""
    scan: str = "scan"
    odometry: str = "odom"
    cmd_vel: str = "cmd_vel"
    imu: str | None = None
    battery: str | None = None
    cmd_vel_type: Literal["twist", "twist_stamped"] = "twist"
    cmd_vel_frame: str = "base_link"
    scan_yaw_deg: Degrees = 0.0
    scan_upside_down: bool = False
    # Unbounded here: msgspec 0.22 crashes on a union of a bounded number and a tuple of such.
    ranges: dict[str, float | tuple[float, float]] = {}


class RmwOptions(RosOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Those of rmw_zenoh: `domain` is ROS_DOMAIN_ID on the robot."""

    domain: Annotated[int, Meta(ge=0, le=232)] = 0


O = TypeVar("O", bound=RosOptions)  # noqa: E741


def read_options(kind: type[O], options: Mapping[str, Value], driver: str, robot: str) -> O:
    """The options, `{robot}` filled in; ConfigError names the one that is wrong."""
    read = Layered((f"driver {driver}", options)).build(kind)
    filled = msgspec.structs.replace(
        read, namespace=read.namespace.replace(_ROBOT, robot.replace("-", "_"))
    )
    _check(filled, driver)
    return filled


def topic(options: RosOptions, name: str) -> str:
    """The full name of a topic, such as `/tb3_01/scan`."""
    namespace = options.namespace.strip("/")
    if name.startswith("/") or not namespace:
        return f"/{name.strip('/')}"
    return f"/{namespace}/{name}"


def ring_of(options: RosOptions) -> tuple[tuple[str, float, float], ...]:
    """Topic, bearing in rad and distance in m of each sensor of `ranges`."""
    placed = (
        (name, place if isinstance(place, tuple) else (place, 0.0))
        for name, place in options.ranges.items()
    )
    return tuple((name, math.radians(degrees), distance) for name, (degrees, distance) in placed)


def _check(options: RosOptions, driver: str) -> None:
    if _ENDPOINT.fullmatch(options.endpoint) is None:
        raise ConfigError(
            f"driver {driver}: endpoint is {options.endpoint!r}; wanted is such as"
            f" {DEFAULT_ENDPOINT}"
        )
    check_ring(options.ranges, driver)
    named = {
        "namespace": options.namespace.strip("/") or None,
        "scan": options.scan,
        "odometry": options.odometry,
        "cmd_vel": options.cmd_vel,
        "imu": options.imu,
        "battery": options.battery,
        **{f"ranges.{name}": name for name in options.ranges},
    }
    for key, name in named.items():
        if name is not None and _TOPIC.fullmatch(name) is None:
            raise ConfigError(
                f"driver {driver}: {key} is {name!r}; wanted is a ROS name such as tb3_01 or"
                " front/scan (letters, digits, _ and /)"
            )
    del named["namespace"]
    if options.ranges:
        del named["scan"]
    check_topics({key: topic(options, n) for key, n in named.items() if n is not None}, driver)


def check_topics(topics: Mapping[str, str], driver: str) -> None:
    """ConfigError if two of the options name one topic: what comes there is of one type.

    `topics`: the full names by option.
    """
    keys: dict[str, str] = {}
    for key, full in topics.items():
        if full in keys:
            raise ConfigError(
                f"driver {driver}: {keys[full]} and {key} are both {full}; wanted is a topic each"
            )
        keys[full] = key


def check_ring(ranges: Mapping[str, float | tuple[float, float]], driver: str) -> None:
    """ConfigError unless each has a bearing in degrees and a distance in m that can be."""
    for name, place in ranges.items():
        degrees, distance = place if isinstance(place, tuple) else (place, 0.0)
        if not (abs(degrees) <= _TURN and 0.0 <= distance <= _REACH):
            raise ConfigError(
                f"driver {driver}: ranges.{name} is {place}; wanted is a bearing in degrees, or"
                f" [bearing, distance] with 0 to {_REACH:g} m"
            )
