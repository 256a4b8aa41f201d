"""One pattern step, and one potential field beside a plain-Python loop, at 360 rays.

Budget: 100 us for the median step in a hot loop.
"""

from __future__ import annotations

import math
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the pattern host

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import cycle

import numpy as np

from swarmd.fields import potential_field
from swarmd.loading import Finder
from swarmd.plugins import pattern_names
from swarmd.settings import load_platform
from swarmd.testing.pattern_contract import Subject
from swarmd.testing.scans import Disc, scan_from, scan_of
from swarmd.values import Inputs, Platform, Pose, Scan

BUDGET_US = 100.0
CALLS = 5000
WARM = 500
PAPER: Mapping[str, str] = {"law": "paper"}
LAWS: Mapping[str, Sequence[Mapping[str, str]]] = {
    "attraction": ({}, PAPER),
    "dispersion": ({}, PAPER),
}


def loop_field(scan: Scan, *, range_max: float, bias: float = 2.0) -> tuple[float, float]:
    """The yardstick: the repulsive field ray by ray, as one would write it without numpy."""
    x = y = 0.0
    for distance, bearing in zip(scan.ranges.tolist(), scan.bearings.tolist(), strict=True):
        if math.isnan(distance) or distance >= range_max:
            continue
        weight = 1.0 - max(distance, scan.range_min) / range_max
        x += weight * math.cos(bearing)
        y += weight * math.sin(bearing)
    return bias - x, -y


def vector_field(scan: Scan, *, range_max: float, bias: float = 2.0) -> object:
    return potential_field(
        scan.ranges,
        scan.bearings,
        range_max=range_max,
        range_min=scan.range_min,
        bias=bias,
        ray_threshold=5,
    )


def measure(call: Callable[[], object]) -> tuple[float, float]:
    """Median and 99th percentile in us."""
    times = np.empty(CALLS)
    for _ in range(WARM):
        call()
    for index in range(CALLS):
        start = time.perf_counter_ns()
        call()
        times[index] = time.perf_counter_ns() - start
    p50, p99 = np.percentile(times, [50, 99]) / 1e3
    return float(p50), float(p99)


def show(name: str, timing: tuple[float, float], remark: str) -> None:
    print(f"{name:<34} p50 {timing[0]:7.1f} us   p99 {timing[1]:7.1f} us   {remark}")


def steps(scans: Sequence[Scan]) -> Iterator[Inputs]:
    """A new scan at every second step, 10 Hz."""
    for tick, scan in enumerate(cycle([scan for scan in scans for _ in range(2)])):
        yield Inputs(now=0.1 * tick, dt=0.1, scan=scan, is_new_scan=tick % 2 == 0)


def measure_patterns(scans: Sequence[Scan]) -> None:
    found = pattern_names(None)
    finder = Finder({name: (origin.value, origin.is_file) for name, origin in found.items()})
    platform = load_platform("waffle_pi")
    for name in found:
        for params in LAWS.get(name, ({},)):
            step = Subject(finder(name), platform, params).make().step
            timing = measure(map(step, steps(scans)).__next__)
            remark = f"budget {BUDGET_US:.0f} us, {timing[0] / BUDGET_US:4.0%} of it"
            show(" ".join((name, *params.values())), timing, remark)


def measure_fields(scans: Sequence[Scan], range_max: float, what: str) -> None:
    loop = measure(map(partial(loop_field, range_max=range_max), cycle(scans)).__next__)
    fast = measure(map(partial(vector_field, range_max=range_max), cycle(scans)).__next__)
    show(f"field, {what}, plain loop", loop, "yardstick")
    show(f"field, {what}, numpy", fast, f"{loop[0] / fast[0]:.0f} times faster")


def in_an_arena(platform: Platform, count: int) -> list[Scan]:
    """What seven robots see of each other in a room of 6 m, from random places."""
    rng = np.random.default_rng(0)
    scans = []
    for seq in range(count):
        (x, y), *others = rng.uniform(-2.5, 2.5, (7, 2)).tolist()
        discs = [Disc(left, up, 0.05) for left, up in others]
        yaw = float(rng.uniform(-math.pi, math.pi))
        pose = Pose(x, y, yaw)
        scans.append(scan_of(platform, discs, room=6.0, pose=pose, seq=seq, noise=0.01, rng=rng))
    return scans


def main() -> None:
    platform = load_platform("waffle_pi")
    scans = in_an_arena(platform, 100)
    print(f"{CALLS} calls each, {len(scans[0].ranges)} rays, seven robots in a room of 6 m")
    measure_patterns(scans)
    measure_fields(scans, 0.5, "few rays near")
    everywhere = np.random.default_rng(0).uniform(0.2, 3.4, 360)
    measure_fields([scan_from(platform, everywhere, platform.scan.bearings)], 3.5, "all rays near")


if __name__ == "__main__":
    main()
