"""The options of driver `ros1`."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping

from swarmd.core.errors import ConfigError
from swarmd.core.values import Value
from swarmd.drivers.ros import options as ros
from swarmd.drivers.ros.options import Name, TopicOptions

DEFAULT_MASTER = "http://127.0.0.1:11311"
_MASTER = re.compile(r"http://[^/:]+:\d+/?")


class Ros1Options(TopicOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What `drivers.ros1` of a platform and `driver_options` may hold.

    `master` and `ip` override ROS_MASTER_URI and ROS_IP. `shared_cmd_vel`: other nodes may publish
    commands too, as behind a multiplexer of the base. `python`: an interpreter that has rospy.
    """

    master: str | None = None
    ip: str | None = None
    shared_cmd_vel: bool = False
    python: Name = "/usr/bin/python3"

    @property
    def master_uri(self) -> str:
        """Where the master is."""
        return self.master or os.environ.get("ROS_MASTER_URI") or DEFAULT_MASTER

    @property
    def environ(self) -> dict[str, str]:
        """The adapter's environment."""
        own = {"ROS_MASTER_URI": self.master_uri, **({"ROS_IP": self.ip} if self.ip else {})}
        environ = {**os.environ, **own}
        if self.ip:
            environ.pop("ROS_HOSTNAME", None)  # it would win
        return environ


def read_options(options: Mapping[str, Value], robot: str) -> Ros1Options:
    """The options of driver `ros1`; ConfigError names the option that is wrong."""
    read = ros.read_options(Ros1Options, options, "ros1", robot)
    if _MASTER.fullmatch(read.master_uri) is None:
        raise ConfigError(
            f"driver ros1: master is {read.master_uri!r}; wanted is such as {DEFAULT_MASTER}"
            " (without it, $ROS_MASTER_URI counts)"
        )
    return read
