"""The DDS end of `benchmarks.ros2`: a robot behind a real bridge, and a plain node that answers it.

Both are nodes in cyclonedds. The plain one does what the driver's side does: it subscribes, takes
the potential field over the rays, and publishes.
"""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from cyclonedds.domain import Domain

from benchmarks.cdr import scan
from benchmarks.ros1 import PLATFORM, field
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros import from_ros as conversion
from tests.support import ros2_types as dds
from tests.support.dds_node import DdsNode
from tests.support.ros2_bridge import LOOPBACK, Bridge, free_domain

SCAN = {"/scan": dds.LaserScan}
COMMAND = {"/cmd_vel": dds.Twist}


@contextmanager
def robot() -> Iterator[tuple[str, Callable[[], float | None]]]:
    """The bridge's endpoint and the domain, and what says a scan and waits for the command."""
    domain = free_domain()
    held = Domain(domain, LOOPBACK)  # ends when it is deleted
    node = DdsNode(domain, "base", says=SCAN, hears=COMMAND)
    message: Any = dds.LaserScan.deserialize(cdr.encode(scan()))

    def exchange() -> float | None:
        message.header.stamp.nanosec += 1
        node.heard("/cmd_vel")
        sent = time.perf_counter()
        node.say("/scan", message)
        return time.perf_counter() - sent if node.wait("/cmd_vel", 1.0) else None

    with tempfile.TemporaryDirectory() as folder, Bridge(Path(folder), domain) as bridge:
        yield f"{bridge.endpoint} {domain}", exchange
    node.close()
    del held


def answer(domain: int, until: Callable[[], str]) -> str:
    """Be the plain node until that has come, and return it."""
    said: list[str] = []
    waiting = threading.Thread(target=lambda: said.append(until()))
    waiting.start()
    held = Domain(domain, LOOPBACK)
    node = DdsNode(domain, "plain", says=COMMAND, hears=SCAN)
    while waiting.is_alive():
        message = node.wait("/scan", 0.2)
        if message is None:
            continue
        message.ranges = np.array(message.ranges)
        twist = field(conversion.scan_of(message, 1, PLATFORM.scan))
        linear, angular = dds.Vector3(x=twist.linear), dds.Vector3(z=twist.angular)
        node.say("/cmd_vel", dds.Twist(linear, angular))
    node.close()
    del held
    return said[0]
