"""The options of driver `ros1`, and the topics and types that follow from them."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from typing import Annotated, Literal

from msgspec import Meta, Struct

from swarmd.drivers import ros1_wire as wire
from swarmd.errors import ConfigError
from swarmd.layered import Layered
from swarmd.values import Value

DEFAULT_MASTER = "http://127.0.0.1:11311"
_NAME = re.compile(r"/?[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*")

Name = Annotated[str, Meta(min_length=1, max_length=200)]


class Ros1Options(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What may stand under `drivers.ros1` or in `driver_options`.

    Names without a leading slash are within `namespace`. `imu` and `battery` are not subscribed to
    unless named; they become the readings `yaw` in rad, `battery` (0 to 1) and `battery_voltage`.
    `scan_yaw_deg`: how far the sensor's frame is turned in the base's. `frame_id` is that of
    stamped commands. `master` and `ip` stand for ROS_MASTER_URI and ROS_IP, which they override.
    `shared_cmd_vel`: others may publish commands too, as behind a multiplexer of the base.
    """

    master: str | None = None
    ip: str | None = None
    namespace: str = ""
    scan: Name = "scan"
    odom: Name = "odom"
    cmd_vel: Name = "cmd_vel"
    imu: Name | None = None
    battery: Name | None = None
    command_type: Literal["Twist", "TwistStamped"] = "Twist"
    frame_id: Annotated[str, Meta(max_length=200)] = "base_link"
    scan_yaw_deg: Annotated[float, Meta(ge=-360.0, le=360.0)] = 0.0
    shared_cmd_vel: bool = False
    python: Name = "/usr/bin/python3"

    @property
    def command(self) -> wire.Kind:
        """The type of the commands."""
        return wire.TWIST if self.command_type == "Twist" else wire.TWIST_STAMPED

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

    def topic(self, name: str) -> str:
        """A topic's full name."""
        return name if name.startswith("/") else f"/{self.namespace.strip('/')}/{name}".replace(
            "//", "/"
        )  # fmt: skip


def read_options(options: Mapping[str, Value]) -> Ros1Options:
    """The options of driver `ros1`; ConfigError for those that it does not know or cannot use."""
    found = Layered(("driver ros1", options)).build(Ros1Options)
    for key in ("scan", "odom", "cmd_vel", "imu", "battery"):
        name = getattr(found, key)
        if name is not None and not _NAME.fullmatch(name):
            raise ConfigError(
                f"driver ros1: {key} is {name!r}; wanted a topic's name, such as /robot1/{key}"
            )
    if found.namespace and not _NAME.fullmatch(found.namespace.rstrip("/")):
        raise ConfigError(
            f"driver ros1: namespace is {found.namespace!r}; wanted is such as /robot1"
        )
    if not re.fullmatch(r"http://[^/:]+:\d+/?", found.master_uri):
        raise ConfigError(
            f"driver ros1: master is {found.master_uri!r}; wanted is such as {DEFAULT_MASTER}"
            " (without it, $ROS_MASTER_URI counts)"
        )
    return found
