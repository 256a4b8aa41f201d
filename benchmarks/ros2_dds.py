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

from benchmarks.cdr import scan as whole_scan
from benchmarks.ros1 import PLATFORM, field
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros import from_ros as conversion
from tests.support import ros2_types as dds
from tests.support.dds_node import DdsNode
from tests.support.ros2_bridge import LOOPBACK, Bridge, free_domain

SCAN = {"/scan": dds.LaserScan}
COMMAND = {"/cmd_vel": dds.Twist}


@contextmanager
def robot() -> Iterator[tuple[str, Callable[[], tuple[float, float] | None]]]:
    """The bridge's endpoint and domain, and a function that sends a scan and awaits the command."""
    domain = free_domain()
    held = Domain(domain, LOOPBACK)  # ends when it is deleted
    node = DdsNode(domain, "base", published=SCAN, subscribed=COMMAND)
    message: Any = dds.LaserScan.deserialize(cdr.encode(whole_scan()))

    def exchange() -> tuple[float, float] | None:
        message.header.stamp.nanosec += 1
        node.take("/cmd_vel")
        sent = time.perf_counter()
        node.publish("/scan", message)
        return (sent, time.perf_counter()) if node.wait("/cmd_vel", 1.0) else None

    with tempfile.TemporaryDirectory() as folder, Bridge(Path(folder), domain) as bridge:
        yield f"{bridge.endpoint} {domain}", exchange
    node.close()
    del held


def answer(domain: int, until: Callable[[], str], marks: list[tuple[float, ...]]) -> str:
    """Act as the plain node until `until` returns; its text.

    `marks` gets for each scan the times at which it was there, read, decided and published; it has
    no loop of its own.
    """
    found: list[str] = []
    waiting = threading.Thread(target=lambda: found.append(until()))
    waiting.start()
    held = Domain(domain, LOOPBACK)
    node = DdsNode(domain, "plain", published=COMMAND, subscribed=SCAN)
    while waiting.is_alive():
        message = node.wait("/scan", 0.2)
        if message is None:
            continue
        there = time.perf_counter()
        message.ranges = np.array(message.ranges)
        scan = conversion.scan_of(message, 1, PLATFORM.scan)
        read = time.perf_counter()
        twist = field(scan)
        decided = time.perf_counter()
        linear, angular = dds.Vector3(x=twist.linear), dds.Vector3(z=twist.angular)
        node.publish("/cmd_vel", dds.Twist(linear, angular))
        marks.append((there, there, read, decided, time.perf_counter()))
    node.close()
    del held
    return found[0]
