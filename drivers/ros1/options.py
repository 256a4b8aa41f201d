"""The options of driver `ros1`, and the topics and types that follow from them."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from swarmd.core.errors import ConfigError
from swarmd.core.values import Value
from swarmd.drivers.ros.options import check_ring, check_topics
from swarmd.drivers.ros1 import wire
from swarmd.settings.layered import Layered

DEFAULT_MASTER = "http://127.0.0.1:11311"
_NAME = re.compile(r"/?[A-Za-z][A-Za-z0-9_]*(/[A-Za-z0-9_]+)*")

Name = Annotated[str, Meta(min_length=1, max_length=200)]


class Ros1Options(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What may stand under `drivers.ros1` or in `driver_options`.

    Names without a leading slash are within `namespace`, in which `{robot}` is the robot's id with
    `_` for `-`. `imu` and `battery` are not subscribed to unless named; they become the readings
    `yaw` in rad, `battery` (0 to 1) and `battery_voltage`. `ranges` makes one scan of several
    `sensor_msgs/Range` in place of `scan`: topic to bearing in degrees, or to bearing and the
    sensor's distance in m from the scan's origin. `scan_yaw_deg`: where the sensor's own zero
    looks, from the base's front to the left; `scan_upside_down`: it hangs, and so turns the other
    way round. `cmd_vel_frame` is that of stamped commands. `master` and `ip` stand for
    ROS_MASTER_URI and ROS_IP, which they override. `shared_cmd_vel`: others may publish commands
    too, as behind a multiplexer of the base.
    """

    master: str | None = None
    ip: str | None = None
    namespace: str = ""
    scan: Name = "scan"
    odometry: Name = "odom"
    cmd_vel: Name = "cmd_vel"
    imu: Name | None = None
    battery: Name | None = None
    ranges: dict[str, float | tuple[float, float]] = {}
    cmd_vel_type: Literal["twist", "twist_stamped"] = "twist"
    cmd_vel_frame: Annotated[str, Meta(max_length=200)] = "base_link"
    scan_yaw_deg: Annotated[float, Meta(ge=-360.0, le=360.0)] = 0.0
    scan_upside_down: bool = False
    shared_cmd_vel: bool = False
    python: Name = "/usr/bin/python3"

    @property
    def command(self) -> wire.Kind:
        """The type of the commands."""
        return wire.TWIST if self.cmd_vel_type == "twist" else wire.TWIST_STAMPED

    @property
    def master_uri(self) -> str:
        """Where the master is."""
        return self.master or os.environ.get("ROS_MASTER_URI") or DEFAULT_MASTER

    @property
    def environ(self) -> dict[str, str]:
        """The adapter's environment."""
        mine = {"ROS_MASTER_URI": self.master_uri, **({"ROS_IP": self.ip} if self.ip else {})}
        found = {**os.environ, **mine}
        if self.ip:
            found.pop("ROS_HOSTNAME", None)  # it would win
        return found

    @property
    def placed(self) -> dict[str, tuple[float, float]]:
        """Bearing in degrees and distance in m of each sensor of `ranges`."""
        return {
            name: place if isinstance(place, tuple) else (place, 0.0)
            for name, place in self.ranges.items()
        }

    def topic(self, name: str) -> str:
        """A topic's full name."""
        namespace = self.namespace.strip("/")
        if name.startswith("/") or not namespace:
            return f"/{name.strip('/')}"
        return f"/{namespace}/{name}"


def read_options(options: Mapping[str, Value], robot: str) -> Ros1Options:
    """The options of driver `ros1`; ConfigError for those that it does not know or cannot use."""
    found = Layered(("driver ros1", options)).build(Ros1Options)
    namespace = found.namespace.replace("{robot}", re.sub(r"[^A-Za-z0-9_]", "_", robot))
    found = msgspec.structs.replace(found, namespace=namespace)
    names = {key: getattr(found, key) for key in ("scan", "odometry", "cmd_vel", "imu", "battery")}
    names |= {f"ranges.{name}": name for name in found.ranges}
    for key, name in names.items():
        if name is not None and not _NAME.fullmatch(name):
            raise ConfigError(
                f"driver ros1: {key} is {name!r}; wanted a topic's name, such as /robot1/scan"
            )
    if found.ranges:
        del names["scan"]
    check_topics({key: found.topic(n) for key, n in names.items() if n is not None}, "ros1")
    if namespace.rstrip("/") and not _NAME.fullmatch(namespace.rstrip("/")):
        raise ConfigError(
            f"driver ros1: namespace is {found.namespace!r}; wanted is such as /robot1"
        )
    if not re.fullmatch(r"http://[^/:]+:\d+/?", found.master_uri):
        raise ConfigError(
            f"driver ros1: master is {found.master_uri!r}; wanted is such as {DEFAULT_MASTER}"
            " (without it, $ROS_MASTER_URI counts)"
        )
    check_ring(found.ranges, "ros1")
    return found
