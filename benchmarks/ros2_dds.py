"""The DDS side of `benchmarks.ros2`: a robot behind a real bridge, and a plain node that answers.

Both are nodes in cyclonedds. The plain node does the work of the driver's side: it subscribes to
scans, computes the potential field over the rays, and publishes a command.
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
from benchmarks.plain_field import plain_field
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros import from_ros as conversion
from swarmd.settings.platforms import load_platform
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
    """Run the plain node until `until` returns; the text of `until`.

    For each scan, appends to `marks` the times in s of arrival (twice, since the node has no event
    loop), decoding, decision and publication.
    """
    spec = load_platform("burger").scan
    texts: list[str] = []
    waiting = threading.Thread(target=lambda: texts.append(until()))
    waiting.start()
    held = Domain(domain, LOOPBACK)
    node = DdsNode(domain, "plain", published=COMMAND, subscribed=SCAN)
    while waiting.is_alive():
        message = node.wait("/scan", 0.2)
        if message is None:
            continue
        there = time.perf_counter()
        message.ranges = np.array(message.ranges)
        scan = conversion.scan_of(message, 1, spec)
        read = time.perf_counter()
        twist = plain_field(scan)
        decided = time.perf_counter()
        linear, angular = dds.Vector3(x=twist.linear), dds.Vector3(z=twist.angular)
        node.publish("/cmd_vel", dds.Twist(linear, angular))
        marks.append((there, there, read, decided, time.perf_counter()))
    node.close()
    del held
    return texts[0]
