"""ROS 2 messages read and written: `benchmarks.cdr`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator

import numpy as np

from benchmarks.table import Row, print_table
from swarmd.core.values import Twist
from swarmd.drivers.ros import cdr, messages
from swarmd.drivers.ros import from_ros as conversion
from swarmd.settings.platforms import load_platform

RAYS = 360
ROUNDS = 300
EACH = 100


def scan() -> messages.LaserScan:
    rng = np.random.default_rng(0)
    step = 2.0 * math.pi / RAYS
    return messages.LaserScan(
        header=messages.Header(messages.Time(1_700_000_000, 5), "base_scan"),
        angle_min=0.0,
        angle_max=RAYS * step,
        angle_increment=step,
        time_increment=0.0,
        scan_time=0.2,
        range_min=0.12,
        range_max=3.5,
        ranges=rng.uniform(0.2, 3.0, RAYS).astype(np.float32),
        intensities=rng.uniform(0.0, 100.0, RAYS).astype(np.float32),
    )


def samples(work: Callable[[], object]) -> list[float]:
    """Seconds for one call, each the mean of EACH."""
    taken = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        for _ in range(EACH):
            work()
        taken.append((time.perf_counter() - start) / EACH)
    return taken


def rows() -> Iterator[Row]:
    spec = load_platform("burger").scan
    payload = cdr.encode(scan())
    twist = Twist(0.1, 0.2)

    def converted() -> object:
        return conversion.scan_of(cdr.decode(messages.LaserScan, payload), 1, spec)

    decoded = samples(lambda: cdr.decode(messages.LaserScan, payload))
    least = f"least {1e6 * min(decoded):.1f} us"
    yield Row(f"LaserScan, {RAYS} rays, read", decoded, "10 us", least)
    yield Row(f"LaserScan, {RAYS} rays, as a scan", samples(converted))
    yield Row("Twist written", samples(lambda: cdr.encode(conversion.twist_message(twist))))


def main() -> None:
    print_table("ROS 2 messages", rows())


if __name__ == "__main__":
    main()
