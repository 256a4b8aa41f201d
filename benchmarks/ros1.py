"""Latency from a scan to its command over ROS 1: through the driver, and by a plain rospy node.

Both subscribe to scans, compute a potential field over 360 rays with the same code, and publish a
command, on loopback with a real roscore. Two more rows are through the driver: with the potential
field of patterns, and with the robot's core, which conditions scans and protects.

The robot's node sends a scan to each of the four in turn, so that all are measured under the same
load. Times include waits for a busy processor, unless the benchmark runs with `chrt -f 5`.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.plain_field import plain_field
from benchmarks.table import Row, print_table
from swarmd.core.clock import boottime
from swarmd.core.events import DriverInput, ScanInput, SensorInput
from swarmd.core.kernels import load_kernel
from swarmd.core.values import Scan, Twist
from swarmd.drivers.ros.messages import LaserScan
from swarmd.drivers.ros1 import serialization
from swarmd.drivers.ros1.driver import Ros1Driver
from swarmd.robot.robot import Robot
from swarmd.robot.setup import RobotSetup
from swarmd.sensing.potential_field import field_twist, potential_field
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import CollectingSink
from tests.support.roscore import PYTHON, RosCore, why_no_ros1

NODES = [PYTHON, "-m", "benchmarks.ros1_nodes"]
SECONDS = 60.0
WARM = 5.0
DECODED = 20_000
STEERING = load_kernel("swarmd.steering.steering").Steering
PLATFORM = load_platform("burger")

Answer = Callable[[Scan], Twist]


class Answering(CollectingSink):
    """Answers each scan at once."""

    def __init__(self, driver: Ros1Driver, answer: Answer) -> None:
        super().__init__()
        self._driver, self._answer = driver, answer

    def take(self, input: SensorInput) -> None:
        if isinstance(input, ScanInput):
            scan = input.scan
            self._driver.send(self._answer(scan), scan.seq, scan.seq)


def field(scan: Scan) -> Twist:
    """The command of the plain node."""
    return Twist(*plain_field(scan.ranges.tolist()))


def patterns_field(scan: Scan) -> Twist:
    """The command of the potential field that patterns use, for rays at any bearings."""
    potential = potential_field(
        scan.ranges,
        scan.bearings,
        range_max=scan.range_max,
        range_min=scan.range_min,
        bias=2.0,
        ray_threshold=5,
    )
    return field_twist(potential.vector, 0.1, 1.0)


def core() -> Answer:
    """A robot's core without a pattern: its safe command, which is zero."""
    settings = RobotSetup(driver="ros1")
    robot = Robot(
        "r", PLATFORM, settings, make_steering=STEERING, seed=1, instance="bench", now=boottime()
    )
    robot.step(DriverInput(True, ""), boottime())

    def answer(scan: Scan) -> Twist:
        robot.step(ScanInput(scan), boottime())
        return robot.decision.safe

    return answer


async def answer_all(master: str, answers: Mapping[str, Answer]) -> None:
    """A driver for each namespace, until killed."""
    async with asyncio.TaskGroup() as group:
        for namespace, answer in answers.items():
            driver = Ros1Driver(
                swarm="bench",
                robot=namespace.strip("/"),
                platform=PLATFORM,
                options={"master": master, "ip": "127.0.0.1", "namespace": namespace},
            )
            group.create_task(driver.run(Answering(driver, answer)))


def measured(seconds: float) -> dict[str, list[float]]:
    """Seconds from scan to command, by namespace."""
    times: dict[str, list[float]] = {"/plain": [], "/driver": [], "/patterns": [], "/core": []}
    with tempfile.TemporaryDirectory() as folder, RosCore(Path(folder)) as master:
        ours = [sys.executable, "-m", "benchmarks.ros1", "--answer", master.uri]
        commands = (ours, [*NODES, "plain"], [*NODES, "robot", *times])
        children = [
            subprocess.Popen(command, env=master.environ, stdout=subprocess.PIPE, text=True)
            for command in commands
        ]
        try:
            lines = children[-1].stdout
            assert lines is not None
            # Until all answer, and a little longer.
            missing = set(times)
            while missing:
                if any(child.poll() is not None for child in children):
                    sys.exit("a process of the benchmark has ended")
                namespace, value = next(lines).split()
                if not math.isnan(float(value)):
                    missing.discard(namespace)
            begin = time.monotonic()
            for line in lines:
                passed = time.monotonic() - begin
                namespace, value = line.split()
                if passed > WARM:
                    times[namespace].append(float(value))
                if passed > WARM + seconds:
                    break
        finally:
            for child in children:
                child.kill()
                child.communicate()
            time.sleep(3.0)  # the adapters send their zeros and leave
    return times


def latencies(seconds: float) -> Iterator[Row]:
    lacks = why_no_ros1()
    if lacks:
        yield Row("scan to velocity over ROS 1", [], note=lacks)
        return
    times = measured(seconds)
    plain = float(np.nanmedian(times["/plain"]))
    for namespace, what in (
        ("/plain", "a node in rospy: subscribe, potential field, publish"),
        ("/driver", "through the driver, the same potential field"),
        ("/patterns", "through the driver, the potential field of patterns"),
        ("/core", "through the driver, conditioned and protected"),
    ):
        samples = [value for value in times[namespace] if not math.isnan(value)]
        lost = len(times[namespace]) - len(samples)
        note = f"p50 {np.median(samples) / plain:.2f} x that of the node"
        if lost:
            note += f"; {lost} without a command"
        goal = "p50 1.5 x, p99 10 ms" if namespace == "/driver" else ""
        yield Row(what, samples, goal, note)


def decoding() -> Iterator[Row]:
    """A 360-ray LaserScan with intensities, 2.9 kB."""
    head = np.array([1, 2, 3, 4], "<u4").tobytes() + b"base" + np.zeros(7, "<f4").tobytes()
    many = np.array([360], "<u4").tobytes() + np.linspace(0.2, 3.0, 360, dtype="<f4").tobytes()
    data = head + many + many
    samples = []
    for _ in range(DECODED):
        begin = time.perf_counter()
        serialization.decode(LaserScan, data)
        samples.append(time.perf_counter() - begin)
    yield Row("decode of a 360-ray LaserScan", samples, "p50 10 us")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--answer", metavar="MASTER", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.answer:
        answers = {"/driver": field, "/patterns": patterns_field, "/core": core()}
        asyncio.run(answer_all(options.answer, answers))
        return
    print_table("ROS 1: scan to velocity", latencies(options.seconds))
    print_table("ROS 1: decoding", decoding())


if __name__ == "__main__":
    main()
