"""From a scan to the command it leads to through the ROS 2 drivers: `benchmarks.ros2`.

A robot in a process of its own, at its own Zenoh router, sends a 360-ray LaserScan and waits for
the command; the driver answers with a potential field over the rays, as `benchmarks.ros1` has it
done over ROS 1 and by a plain node in rospy. Where there is a zenoh-bridge-ros2dds, also a ROS 2
node on DDS behind it, from before it writes the scan until it has read the command.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import zenoh

from benchmarks.cdr import scan
from benchmarks.ros1 import field
from benchmarks.table import Row, print_table
from swarmd.drivers import rmw_zenoh, ros2dds
from swarmd.drivers.ros import cdr, messages
from swarmd.drivers.ros.driver import RosDriver
from swarmd.platforms import load_platform
from swarmd.testing.driver_contract import Heard
from swarmd.testing.ros2_bridge import LOOPBACK, Bridge, free_domain, why_no_bridge
from swarmd.values import Scan

SECONDS = 15.0
WARM = 2.0
PERIOD = 0.05
PLATFORM = load_platform("burger")
BRIDGED = "ros2dds, real bridge"
MAKERS = {
    "ros2dds": ros2dds.make_driver,
    BRIDGED: ros2dds.make_driver,
    "rmw_zenoh": rmw_zenoh.make_driver,
}


class Answering(Heard):
    """Answers each scan at once."""

    driver: RosDriver

    def scan(self, scan: Scan) -> None:
        self.driver.send(field(scan), scan.seq, scan.seq)


def robot(name: str, seconds: float) -> None:
    """Print the endpoint, then, in the end, what each answer took in s, as JSON."""
    (on_dds if name == BRIDGED else on_zenoh)(name, seconds)


def on_zenoh(name: str, seconds: float) -> None:
    """The robot is a Zenoh session."""
    hub, endpoint = _hub()
    dialect = rmw_zenoh.RmwZenoh(0, "/cmd_vel") if name == "rmw_zenoh" else ros2dds.Ros2Dds()
    said = dialect.command_keys("/scan", messages.LaserScan)[0]
    heard = dialect.command_keys("/cmd_vel", messages.Twist)[0]
    answered, at = threading.Event(), 0.0

    def on_command(sample: zenoh.Sample) -> None:
        nonlocal at
        at = time.perf_counter()
        answered.set()

    hub.declare_subscriber(heard, on_command)
    message = scan()

    def exchange() -> float | None:
        message.header.stamp.nanosec += 1
        payload = cdr.encode(message)
        answered.clear()
        sent = time.perf_counter()
        hub.put(said, payload, attachment=dialect.attachment())
        return at - sent if answered.wait(1.0) else None

    _tell(endpoint, exchange, seconds)
    hub.close()


def on_dds(name: str, seconds: float) -> None:
    """The robot is a ROS 2 node on DDS, behind a bridge."""
    # For development alone, as the bridge is: not everyone has it.
    from cyclonedds.domain import Domain

    from swarmd.testing import dds_types
    from swarmd.testing.dds_node import DdsNode

    domain = free_domain()
    held = Domain(domain, LOOPBACK)
    node = DdsNode(domain, "base", {"/scan": dds_types.LaserScan}, {"/cmd_vel": dds_types.Twist})
    message: Any = dds_types.LaserScan.deserialize(cdr.encode(scan()))

    def exchange() -> float | None:
        message.header.stamp.nanosec += 1
        node.heard("/cmd_vel")
        sent = time.perf_counter()
        node.say("/scan", message)
        return time.perf_counter() - sent if node.wait("/cmd_vel", 1.0) else None

    with tempfile.TemporaryDirectory() as folder, Bridge(Path(folder), domain) as bridge:
        _tell(bridge.endpoint, exchange, seconds)
    node.close()
    del held


def _tell(endpoint: str, exchange: Callable[[], float | None], seconds: float) -> None:
    print(endpoint, flush=True)
    taken, begin = [], time.perf_counter()
    while (start := time.perf_counter()) < begin + WARM + seconds:
        took = exchange()
        if took is not None and start > begin + WARM:
            taken.append(took)
        time.sleep(max(0.0, PERIOD - (time.perf_counter() - start)))
    print(json.dumps(taken), flush=True)


def answers(name: str) -> list[float]:
    """Seconds from scan to command, with the driver in this process."""
    command = [sys.executable, "-m", "benchmarks.ros2", "--robot", name]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        endpoint = child.stdout.readline().strip()
        lines = asyncio.run(_drive(name, endpoint, child))
    taken: list[float] = json.loads(lines)
    return taken


async def _drive(name: str, endpoint: str, child: subprocess.Popen[str]) -> str:
    assert child.stdout is not None
    driver = MAKERS[name](swarm="s", robot="r", platform=PLATFORM, options={"endpoint": endpoint})
    sink = Answering()
    sink.driver = driver
    running = asyncio.create_task(driver.run(sink))
    try:
        return await asyncio.to_thread(child.stdout.readline)
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


def _hub() -> tuple[zenoh.Session, str]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config), endpoint


def rows() -> Iterator[Row]:
    for name in MAKERS:
        lacks = why_no_bridge() if name == BRIDGED else ""
        if lacks:
            yield Row(f"scan to velocity, {name}", [], note=lacks)
            continue
        note = "from DDS to DDS" if name == BRIDGED else "beside rospy: see ros1"
        yield Row(f"scan to velocity, {name}", answers(name), note=note)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="benchmarks.ros2", description=__doc__)
    parser.add_argument("--robot", metavar="DIALECT", help=argparse.SUPPRESS)
    parser.add_argument("--seconds", type=float, default=SECONDS, help=argparse.SUPPRESS)
    read = parser.parse_args(arguments)
    if read.robot:
        robot(read.robot, read.seconds)
    else:
        print_table("ROS 2 on loopback", rows())


if __name__ == "__main__":
    main()
