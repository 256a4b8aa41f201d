"""The share of time for which a stopped robot has a rival's command: `benchmarks.ros2_rival`.

The rival is a node that publishes a command to move at 50 Hz on DDS. The driver of the stopped
robot answers each command with zero, through a real bridge, and on request over a delayed link.
Base, rival and driver are processes of their own.

A base that acts on each message has the rival's command from its arrival until the arrival of the
next zero. A base that samples its newest command at 50 Hz has the rival's command for a whole
period if the command is the newest at the sample. On average both shares are equal. But since rival
and base have equal rates, the share of a sampling base depends on the phase between them, which may
stay constant for minutes.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from itertools import pairwise
from pathlib import Path

import numpy as np
from cyclonedds.domain import Domain

from benchmarks.cdr import scan
from swarmd.core.values import ZERO
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros2.dds_bridge import make_driver
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import CollectingSink
from tests.support import ros2_types as dds
from tests.support.dds_node import DdsNode
from tests.support.ros2_bridge import LOOPBACK, Bridge, free_domain, why_no_bridge

SECONDS = 20.0
RIVAL_PERIOD = BASE_PERIOD = 0.02
SCAN_PERIOD, TICK = 0.2, 0.05
RIVAL_SPEED = 0.3


def rival(domain: int, seconds: float) -> None:
    """Publish a command at 50 Hz."""
    held = Domain(domain, LOOPBACK)
    node = DdsNode(domain, "rival", {"/cmd_vel": dds.Twist})
    begin = time.perf_counter()
    for count in range(round(seconds / RIVAL_PERIOD)):
        time.sleep(max(0.0, begin + count * RIVAL_PERIOD - time.perf_counter()))
        node.publish("/cmd_vel", dds.Twist(linear=dds.Vector3(x=RIVAL_SPEED)))
    node.close()
    del held


def base(domain: int, seconds: float) -> None:
    """Publish scans and take commands; print (time in s, speed) of each command as JSON."""
    held = Domain(domain, LOOPBACK)
    node = DdsNode(domain, "base", {"/scan": dds.LaserScan}, {"/cmd_vel": dds.Twist})
    message = dds.LaserScan.deserialize(cdr.encode(scan()))
    arrivals: list[tuple[float, float]] = []
    end = time.perf_counter() + seconds
    scan_at = 0.0
    while (now := time.perf_counter()) < end:
        if now >= scan_at:
            scan_at = now + SCAN_PERIOD
            message.header.stamp.nanosec += 1
            node.publish("/scan", message)
        command = node.wait("/cmd_vel", 0.05)
        if command is not None:
            arrivals.append((time.perf_counter(), command.linear.x))
    node.close()
    print(json.dumps(arrivals), flush=True)
    del held


def _start(role: str, domain: int, seconds: float) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "benchmarks.ros2_rival", "--role", role]
    more = ["--domain", str(domain), "--seconds", str(seconds)]
    return subprocess.Popen([*command, *more], stdout=subprocess.PIPE, text=True)


async def _stand(endpoint: str, until: asyncio.Task[str]) -> str:
    """Run the driver of a stopped robot until the task `until` is done; the task's text."""
    options = {"endpoint": endpoint}
    driver = make_driver(swarm="s", robot="r", platform=load_platform("burger"), options=options)
    running = asyncio.create_task(driver.run(CollectingSink()))
    try:
        while not until.done():
            driver.send(ZERO, 0, 0, is_stopped=True)
            await asyncio.sleep(TICK)
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
    return until.result()


async def measure(seconds: float, delay: float) -> Sequence[tuple[float, float]]:
    """The base's commands as (time in s, speed). `delay`: of the link in s, one way."""
    domain = free_domain()
    with (
        tempfile.TemporaryDirectory() as folder,
        Bridge(Path(folder), domain) as bridge,
        _start("base", domain, seconds + 3.0) as taking,
        _start("rival", domain, seconds + 6.0) as rival,
    ):
        assert taking.stdout is not None
        text = asyncio.create_task(asyncio.to_thread(taking.stdout.read))
        async with _delayed(bridge.endpoint, delay) as endpoint:
            arrivals = json.loads(await _stand(endpoint, text))
        rival.kill()
    begin = arrivals[-1][0] - seconds
    return [arrival for arrival in arrivals if arrival[0] >= begin]


@asynccontextmanager
async def _delayed(endpoint: str, delay: float) -> AsyncIterator[str]:
    """An endpoint that forwards to `endpoint` with a delay; `endpoint` itself without a delay."""
    if not delay:
        yield endpoint
        return
    host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
    loop = asyncio.get_running_loop()

    async def forward(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(65536):
            loop.call_later(delay, writer.write, data)

    async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there_reader, there = await asyncio.open_connection(host, int(port))
        await asyncio.gather(forward(reader, there), forward(there_reader, writer))

    async with await asyncio.start_server(connected, "127.0.0.1", 0) as server:
        yield f"tcp/127.0.0.1:{server.sockets[0].getsockname()[1]}"


def shares(arrivals: Sequence[tuple[float, float]]) -> list[float]:
    """The share of samples at 50 Hz that find the rival's command, for each of 40 phases."""
    times, values = np.array(arrivals).T
    phases = []
    for phase in np.arange(40) / 40.0 * BASE_PERIOD:
        at = np.arange(times[0] + phase, times[-1], BASE_PERIOD)
        phases.append(float(np.mean(values[np.searchsorted(times, at, side="right") - 1] != 0.0)))
    return phases


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="benchmarks.ros2_rival", description=__doc__)
    parser.add_argument("--role", choices=["base", "rival"], help=argparse.SUPPRESS)
    parser.add_argument("--domain", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--delay-ms", type=float, default=0.0, help="of the link, each way")
    read = parser.parse_args(arguments)
    if read.role:
        {"base": base, "rival": rival}[read.role](read.domain, read.seconds)
    elif lacks := why_no_bridge():
        print(lacks)
    else:
        arrivals = asyncio.run(measure(read.seconds, 1e-3 * read.delay_ms))
        times = [b[0] - a[0] for a, b in pairwise(arrivals) if a[1]]
        share = sum(times) / (arrivals[-1][0] - arrivals[0][0])
        rivals, zeros = (
            sum(bool(arrival[1]) for arrival in arrivals),
            sum(not arrival[1] for arrival in arrivals),
        )
        print(f"{rivals} commands of another node, {zeros} zeros")
        print(f"a base that acts on each message has the other's for {100 * share:.1f} %,")
        print(f"  {1e3 * np.median(times):.2f} ms each (p50), {1e3 * max(times):.1f} ms at most")
        of_phases = shares(arrivals)
        print(
            f"a base that samples at 50 Hz has it for {100 * np.mean(of_phases):.1f} % on average,"
        )
        print(f"  {100 * max(of_phases):.0f} % at the worst phase to the other node")


if __name__ == "__main__":
    main()
