"""Latency from a scan to its command through the ROS 2 drivers: `benchmarks.ros2`.

A robot in a process of its own, with a Zenoh router of its own, sends a 360-ray LaserScan and waits
for the command. The driver answers with a potential field over the rays (`plain_field.py`).
If zenoh-bridge-ros2dds is installed, the robot is also a ROS 2 node on DDS. Then two programs
answer: the driver through the bridge, and a plain node directly.

Robot and driver read one clock, so the time of each stage is known: from the robot to the driver's
Zenoh thread (with DDS: write, bridge, Zenoh), from that thread to the loop, decoding, the decision
of the benchmark, encoding and publishing, and back to the robot.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from unittest.mock import patch

import numpy as np
import zenoh

from benchmarks import ros2_dds
from benchmarks.cdr import scan
from benchmarks.plain_field import plain_field
from benchmarks.table import Row, print_table
from swarmd.core.events import ScanInput, SensorInput
from swarmd.drivers.latest_samples import LatestSamples
from swarmd.drivers.ros import cdr, messages
from swarmd.drivers.ros2 import dds_bridge as ros2dds
from swarmd.drivers.ros2 import rmw_zenoh
from swarmd.drivers.ros2.driver import RosDriver
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import CollectingSink
from tests.support.processes import free_endpoint
from tests.support.ros2_bridge import why_no_bridge

SECONDS = 15.0
WARM = 2.0
PERIOD = 0.05
PLATFORM = load_platform("burger")
MAKERS = {"ros2dds": ros2dds.make_driver, "rmw_zenoh": rmw_zenoh.make_driver}
PLAIN, BRIDGE = "a plain node on DDS", "ros2dds behind a bridge"
BRIDGED = (PLAIN, BRIDGE)
GOAL = "p50 1.5 x, p99 10 ms"


STAGES = ("in", "to loop", "decode", "decide", "send", "out")

Exchange = Callable[[], tuple[float, float] | None]
"""Sends one scan; when it was sent and answered, in s on a clock of all processes, None without."""


class Answering(CollectingSink):
    """Answers each scan at once. `marks`: for each scan the times at which its stages ended."""

    driver: RosDriver

    def __init__(self) -> None:
        super().__init__()
        self.marks: list[tuple[float, ...]] = []

    def take(self, input: SensorInput) -> None:
        if not isinstance(input, ScanInput):
            return
        scan, decoded = input.scan, time.perf_counter()
        twist = plain_field(scan)
        decided = time.perf_counter()
        self.driver.send(twist, scan.seq, scan.seq)
        arrived = TimedSamples.arrived, TimedSamples.taken
        self.marks.append((*arrived, decoded, decided, time.perf_counter()))


class TimedSamples(LatestSamples):
    """Records when the last sample reached the Zenoh thread, and when it reached the loop."""

    arrived = taken = 0.0

    def put(self, name: str, payload: bytes) -> None:
        TimedSamples.arrived = time.perf_counter()
        super().put(name, payload)

    def _deliver(self, name: str) -> None:
        TimedSamples.taken = time.perf_counter()
        super()._deliver(name)


def robot(name: str, seconds: float) -> None:
    """Run the robot: print its endpoint, and at the end the times of scans and answers as JSON."""
    if name in BRIDGED:
        with ros2_dds.robot() as (place, exchange):
            _tell(place, exchange, seconds)
    else:
        _on_zenoh(name, seconds)


def _on_zenoh(name: str, seconds: float) -> None:
    hub, endpoint = _hub()
    emulator = rmw_zenoh.RmwZenoh(0, "/cmd_vel") if name == "rmw_zenoh" else ros2dds.Ros2Dds()
    said = emulator.command_keys("/scan", messages.LaserScan)[0]
    heard = emulator.command_keys("/cmd_vel", messages.Twist)[0]
    answered, at = threading.Event(), 0.0

    def on_command(sample: zenoh.Sample) -> None:
        nonlocal at
        at = time.perf_counter()
        answered.set()

    hub.declare_subscriber(heard, on_command)
    message = scan()

    def exchange() -> tuple[float, float] | None:
        message.header.stamp.nanosec += 1
        payload = cdr.encode(message)
        answered.clear()
        sent = time.perf_counter()
        hub.put(said, payload, attachment=emulator.attachment())
        return (sent, at) if answered.wait(1.0) else None

    _tell(endpoint, exchange, seconds)
    hub.close()


def _tell(endpoint: str, exchange: Exchange, seconds: float) -> None:
    print(endpoint, flush=True)
    taken, begin = [], time.perf_counter()
    while (start := time.perf_counter()) < begin + WARM + seconds:
        times = exchange()
        if times is not None and start > begin + WARM:
            taken.append(times)
        time.sleep(max(0.0, PERIOD - (time.perf_counter() - start)))
    print(json.dumps(taken), flush=True)


def answers(name: str, seconds: float) -> tuple[list[float], str]:
    """Seconds from scan to command, and p50 of the stages, with the driver in this process."""
    command = [sys.executable, "-m", "benchmarks.ros2", "--robot", name, "--seconds", str(seconds)]
    sink = Answering()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        endpoint, _, domain = child.stdout.readline().strip().partition(" ")
        if name == PLAIN:
            lines = ros2_dds.answer(int(domain), child.stdout.readline, sink.marks)
        else:
            lines = asyncio.run(_drive(name, endpoint, child, sink))
    exchanges: list[tuple[float, float]] = json.loads(lines)
    return [answered - sent for sent, answered in exchanges], stages(exchanges, sink.marks)


def stages(exchanges: Sequence[tuple[float, float]], marks: Sequence[tuple[float, ...]]) -> str:
    """P50 of each stage in us. `marks`: when the stages ended, but for the last."""
    ends = np.array(marks)
    taken = []
    for sent, answered in exchanges:
        index = int(np.searchsorted(ends[:, 0], sent))
        if index < len(ends) and ends[index, -1] < answered:
            taken.append(np.diff([sent, *ends[index], answered]))
    p50 = 1e6 * np.median(taken, axis=0) if taken else ()
    return ", ".join(f"{name} {us:.0f}" for name, us in zip(STAGES, p50, strict=False)) + " us"


async def _drive(name: str, endpoint: str, child: subprocess.Popen[str], sink: Answering) -> str:
    assert child.stdout is not None
    make = MAKERS["ros2dds" if name == BRIDGE else name]
    options = {"endpoint": endpoint, "cmd_vel_type": "twist"}  # its base announces nothing
    driver = make(swarm="s", robot="r", platform=PLATFORM, options=options)
    sink.driver = driver
    running = asyncio.create_task(driver.run(sink))
    try:
        return await asyncio.to_thread(child.stdout.readline)
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


def _hub() -> tuple[zenoh.Session, str]:
    endpoint = free_endpoint()
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config), endpoint


def rows(seconds: float = SECONDS) -> Iterator[Row]:
    for name in MAKERS:
        taken, parts = answers(name, seconds)
        yield Row(f"scan to velocity, {name}", taken, GOAL, parts)
    lacks = why_no_bridge()
    if lacks:
        yield Row(f"scan to velocity, {BRIDGE}", [], note=lacks)
        return
    plain, parts = answers(PLAIN, seconds)
    yield Row(f"scan to velocity, {PLAIN}", plain, note=f"no bridge between; {parts}")
    bridged, parts = answers(BRIDGE, seconds)
    yield Row(f"scan to velocity, {BRIDGE}", bridged, note=parts)
    more = float(np.median(bridged) / np.median(plain))
    yield Row(f"{BRIDGE} beside {PLAIN}", [more], "1.5 x", "p50 to p50", unit="x")


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="benchmarks.ros2", description=__doc__)
    parser.add_argument("--robot", metavar="DRIVER", help=argparse.SUPPRESS)
    parser.add_argument("--seconds", type=float, default=SECONDS, help=argparse.SUPPRESS)
    read = parser.parse_args(arguments)
    if read.robot:
        robot(read.robot, read.seconds)
    else:
        with patch("swarmd.drivers.ros2.driver.LatestSamples", TimedSamples):
            print_table("ROS 2 on loopback", rows(read.seconds))


if __name__ == "__main__":
    main()
