"""A base in a process of its own, to be killed; it publishes scans and prints changed commands.

python -m tests.drivers.ros2.dds_base DOMAIN
"""

from __future__ import annotations

import itertools
import math
import sys
import time

from cyclonedds.domain import Domain

from tests.support import ros2_types as dds
from tests.support.dds_node import DdsNode
from tests.support.ros2_bridge import LOOPBACK


def main(number: int) -> None:
    domain = Domain(number, LOOPBACK)
    node = DdsNode(number, "base", {"/scan": dds.LaserScan}, {"/cmd_vel": dds.Twist})
    last: float | None = None
    for count in itertools.count(100):
        header = dds.Header(dds.Time(count, 0), "base_scan")
        ranges, step = [2.0] * 360, 2.0 * math.pi / 360
        node.publish("/scan", dds.LaserScan(header, angle_increment=step, ranges=ranges))
        for command in node.take("/cmd_vel"):
            if command.linear.x != last:
                last = command.linear.x
                print(last, flush=True)
        time.sleep(0.05)
    del domain


if __name__ == "__main__":
    main(int(sys.argv[1]))
