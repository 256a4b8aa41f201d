"""One step of each pattern at 360 rays, hot."""

from __future__ import annotations

import argparse
import math
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the pattern host

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import cycle, islice

import numpy as np

from benchmarks.table import Row, print_table
from swarmd.core.values import (
    Inputs,
    Message,
    Neighbor,
    Odometry,
    Platform,
    Pose,
    Scan,
    Twist,
    Value,
)
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import pattern_names
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import Subject
from swarmd.testing.scans import Disc, scan_of

GOAL = "p50 100 us"
CALLS = 5000
SECONDS = 100
"""Seconds of a robot whose processor time is measured; the first does not count."""
WARM = 500
PAPER: Mapping[str, str] = {"law": "paper"}
SENSING: Sequence[Mapping[str, str]] = ({"sensing": "neighbors"}, {"sensing": "lidar"})
WINDOWS: Sequence[Mapping[str, str]] = ({}, {"windows": "sliding"}, {"windows": "rounds"})
LAWS: Mapping[str, Sequence[Mapping[str, str]]] = {
    "attraction": ({}, PAPER),
    "circle_formation": SENSING,
    "dispersion": ({}, PAPER),
    "flocking": ({}, PAPER),
    "line_formation": SENSING,
    "majority_rule": WINDOWS,
    "random_walk": ({}, PAPER),
    "voter_model": WINDOWS,
}
READINGS: Mapping[str, float] = {"quality_0": 1.0, "quality_1": 0.5, "stimulus": 3.0}
OTHERS = tuple(f"tb3-{number:02}" for number in range(2, 8))


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


def per_step_of_a_scan(times: Sequence[float]) -> Sequence[float]:
    """The mean of each two steps in a row, of which one has a new scan (`steps`).

    Half of the steps of a pattern are dear and half cheap, so that the median of single steps lies
    between both: by chance it is that of a dear one or of a cheap one. `ros2_nodes` gave .026 to
    .053 of the yardstick with equal code.
    """
    return [0.5 * (one + other) for one, other in zip(times[::2], times[1::2], strict=True)]


def said(channel: str, kind: type, count: int, k: int) -> Value:
    """What robot k says for the `count`-th time."""
    if channel == "hops":
        return [1, OTHERS[0], k, count]
    if channel == "flash":
        return [count, 0.05]
    return [count, k % 3, k % 3] if kind is list else kind(k % 3)


def steps(scans: Sequence[Scan], channels: Mapping[str, type]) -> Iterator[Inputs]:
    """A new scan each second step, 10 Hz; six others, sensed twice and heard once a second."""
    for tick, scan in enumerate(cycle([scan for scan in scans for _ in range(2)])):
        now = 0.1 * tick
        turn = 2.0 * math.pi / len(OTHERS)
        yield Inputs(
            now=now,
            dt=0.1,
            scan=scan,
            is_new_scan=tick % 2 == 0,
            odometry=Odometry(now, Pose(0.01 * tick, 0.0, 0.001 * tick), Twist(0.1)),
            neighbors=tuple(
                Neighbor(sender, 0.1, 1.0 + 0.3 * k + 0.01 * (tick // 5 % 5), turn * k)
                for k, sender in enumerate(OTHERS)
            ),
            messages=tuple(
                Message(sender, channel, said(channel, kind, tick // 10, k), 0.0)
                for k, sender in enumerate(OTHERS)
                if tick % 10 == k
                for channel, kind in channels.items()
            ),
            readings=READINGS,
        )


def pattern_rows(scans: Sequence[Scan]) -> Iterator[Row]:
    known = pattern_names(None)
    finder = PatternLoader({name: (origin.value, origin.is_file) for name, origin in known.items()})
    platform = load_platform("waffle_pi")
    provides = platform.provides | {"neighbors.distance", "neighbors.bearing"}
    for name in known:
        for params in LAWS.get(name, ({},)):
            senses = replace(platform, provides=provides | finder(name).needs)
            pattern = Subject(finder(name), senses, params).make()
            inputs = cycle(tuple(islice(steps(scans, pattern.channels), CALLS + WARM)))
            timing = per_step_of_a_scan(measure(map(pattern.step, inputs).__next__))
            yield Row(" ".join(("step of", name, *params.values())), timing, GOAL)


def second_rows(scans: Sequence[Scan], launch: str = "") -> Iterator[Row]:
    """Processor time of ten steps, of which five have a new scan: what a robot takes in a second.

    Of the example of `ros2_nodes` and of native patterns, or of the nodes of `launch` beside them.
    """
    known = pattern_names(None)
    finder = PatternLoader({name: (origin.value, origin.is_file) for name, origin in known.items()})
    platform = load_platform("waffle_pi")
    shown: dict[str, tuple[str, Mapping[str, str]]] = {
        "nodes of the launch file" if launch else "ros2_nodes, its example": (
            "ros2_nodes",
            {"launch": launch},
        ),
        "attraction, law paper": ("attraction", PAPER),
        "attraction": ("attraction", {}),
        "dispersion": ("dispersion", {}),
    }
    for title, (name, params) in shown.items():
        pattern = Subject(finder(name), platform, params).make()
        inputs = steps(scans, pattern.channels)
        times = np.empty(SECONDS)
        for index in range(SECONDS):
            second = tuple(islice(inputs, 10))
            start = time.process_time_ns()
            for one in second:
                pattern.step(one)
            times[index] = time.process_time_ns() - start
        yield Row(title, (times[1:] / 1e9).tolist())


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


def main(launch: str = "") -> None:
    scans = in_an_arena(load_platform("waffle_pi"), 100)
    if not launch:
        print_table("Pattern steps, 360 rays, hot", pattern_rows(scans))
    title = "A robot-second: ten steps, five of them with a new scan, in processor time"
    print_table(title, second_rows(scans, launch))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m benchmarks.steps", description=__doc__)
    parser.add_argument("--launch", default="", help="the robot-second of these nodes of ROS 2")
    main(parser.parse_args().launch)
