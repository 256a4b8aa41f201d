"""The robots of the study, and the arena that they share."""

from __future__ import annotations

import socket
from pathlib import Path

PLATFORM = "burger"
ROBOTS = ("tb3-01", "tb3-02", "tb3-03")
STRANGER = "tb3-04"
"""A fourth robot without a daemon: a fault starts its nodes, under names that are those of tb3-01
or wrong in another way."""
BODIES = (*ROBOTS, STRANGER)
ARENA = "9x9"
CONTACTS = "contacts"
"""The name of a datagram with how often robots have touched each other, and walls."""
LAYOUT = "list:-2:-2:0,2:-2:90,2:2:180,-3:3:0"
BASE, LIDAR = "turtlebot3_node", "hlds_laser_publisher"
"""The names of a robot's nodes."""
RIVAL_SPEED = 0.123
"""m/s that another node commands; no command of the pattern has it."""


def namespace(robot: str) -> str:
    """The namespace of a robot's nodes, such as `/tb3_01`."""
    return "/" + robot.replace("-", "_")


def bound(path: Path) -> socket.socket:
    """A datagram socket at a path, in place of that of an earlier process."""
    path.unlink(missing_ok=True)
    made = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    made.bind(str(path))
    return made
