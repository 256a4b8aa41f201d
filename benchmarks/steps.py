"""One pattern step, and one potential field beside a plain-Python loop, at 360 rays, hot."""

from __future__ import annotations

import math
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the pattern host

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import cycle
from statistics import median

import numpy as np

from benchmarks.table import Row, print_table
from swarmd.fields import potential_field
from swarmd.loading import Finder
from swarmd.plugins import pattern_names
from swarmd.settings import load_platform
from swarmd.testing.pattern_contract import Subject
from swarmd.testing.scans import Disc, scan_from, scan_of
from swarmd.values import Inputs, Platform, Pose, Scan

BUDGET = "p50 100 us"
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


def measure(call: Callable[[], object]) -> Sequence[float]:
    """Seconds of each of many calls in a row."""
    times = np.empty(CALLS)
    for _ in range(WARM):
        call()
    for index in range(CALLS):
        start = time.perf_counter_ns()
        call()
        times[index] = time.perf_counter_ns() - start
    seconds: Sequence[float] = (times / 1e9).tolist()
    return seconds


def steps(scans: Sequence[Scan]) -> Iterator[Inputs]:
    """A new scan at every second step, 10 Hz."""
    for tick, scan in enumerate(cycle([scan for scan in scans for _ in range(2)])):
        yield Inputs(now=0.1 * tick, dt=0.1, scan=scan, is_new_scan=tick % 2 == 0)


def pattern_rows(scans: Sequence[Scan]) -> Iterator[Row]:
    found = pattern_names(None)
    finder = Finder({name: (origin.value, origin.is_file) for name, origin in found.items()})
    platform = load_platform("waffle_pi")
    for name in found:
        for params in LAWS.get(name, ({},)):
            step = Subject(finder(name), platform, params).make().step
            timing = measure(map(step, steps(scans)).__next__)
            yield Row(" ".join(("step of", name, *params.values())), timing, BUDGET)


def field_rows(scans: Sequence[Scan], range_max: float, what: str) -> Iterator[Row]:
    loop = measure(map(partial(loop_field, range_max=range_max), cycle(scans)).__next__)
    fast = measure(map(partial(vector_field, range_max=range_max), cycle(scans)).__next__)
    ratio = median(loop) / median(fast)
    yield Row(f"field, {what}, plain loop", loop, note="yardstick")
    yield Row(f"field, {what}, numpy", fast, note=f"{ratio:.0f} times as fast, in the median")


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


def rows() -> Iterator[Row]:
    platform = load_platform("waffle_pi")
    scans = in_an_arena(platform, 100)
    yield from pattern_rows(scans)
    yield from field_rows(scans, 0.5, "few rays near")
    everywhere = np.random.default_rng(0).uniform(0.2, 3.4, 360)
    near = [scan_from(platform, everywhere, platform.scan.bearings)]
    yield from field_rows(near, 3.5, "all rays near")


def main() -> None:
    print_table("Pattern steps and fields, 360 rays, hot", rows())


if __name__ == "__main__":
    main()
