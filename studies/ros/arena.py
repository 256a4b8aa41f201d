"""The arena as a process: `python -m studies.ros.arena FOLDER SEED`.

The process simulates the bodies of all robots, and exchanges datagrams with the robots' nodes
(`node.py`), which are processes of their own. Sockets in FOLDER: `arena` receives commands and
heartbeats of bases, and requests to carry a robot; `<robot>.base` receives odometry,
`<robot>.lidar` receives scans, and `truth` receives every true pose and how often bodies have
touched.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path

from msgspec import structs
from msgspec.structs import replace

from studies.ros.robots import ARENA, BODIES, CONTACTS, LAYOUT, PLATFORM, bound
from swarmd.core.events import OdometryInput, ScanInput, SensorInput
from swarmd.core.processes import die_with_parent
from swarmd.core.values import ZERO, Odometry, Platform, Twist, Value
from swarmd.driver_api.emulator import OnCommand
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros.options import RosOptions
from swarmd.drivers.ros.to_ros import LaserScanEncoder, odometry_message
from swarmd.settings.platforms import load_platform
from swarmd.sim.live.link import EmulatorTransport, WorldLink
from swarmd.sim.live.realtime import RealTimeWorld
from swarmd.sim.live.recording import LiveRecorder
from swarmd.sim.live.state import WorldOptions
from swarmd.sim.world.arena import parse_arena
from swarmd.sim.world.layouts import parse_layout
from swarmd.sim.world.lidar import LidarModel
from swarmd.sim.world.realism import REALISTIC
from swarmd.sim.world.world import World

HEARTBEAT_TIMEOUT = 0.5
"""Seconds without a heartbeat of its node after which the firmware of a base stops the motors."""

_MAX_DATAGRAM = 1000


class Nodes:
    """The robots' nodes as an `Emulator`: each datagram is lost if its node does not read."""

    def __init__(self, folder: Path, robots: Mapping[str, Platform], on_command: OnCommand) -> None:
        """`folder` is where the sockets are."""
        self.dropped = 0
        self.driver_options: Mapping[str, Value] = {}
        self.world: World | None = None
        self.recorder: LiveRecorder | None = None
        self._folder, self._on_command = folder, on_command
        self._begun = time.time()
        self._encoders = {
            robot: LaserScanEncoder(RosOptions(), platform) for robot, platform in robots.items()
        }
        self._carried: deque[tuple[str, list[float]]] = deque()
        self._rows = {robot: row for row, robot in enumerate(robots)}
        self._socket = bound(folder / "arena")
        self._socket.settimeout(HEARTBEAT_TIMEOUT / 5.0)
        self._sender = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._sender.setblocking(False)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._receive, name="commands")
        self._thread.start()

    def publish(self, robot: str, input: SensorInput) -> None:
        """Hand a scan to the node of the lidar and odometry to that of the base."""
        if isinstance(input, ScanInput):
            stamped = replace(input.scan, stamp=input.scan.stamp + self._begun)
            (message,) = self._encoders[robot].encode(stamped)
            self._send(f"{robot}.lidar", cdr.encode(message))
        elif isinstance(input, OdometryInput):
            self._odometry(robot, input.odometry)

    def _odometry(self, robot: str, odometry: Odometry) -> None:
        """Hand odometry to the node of the base, and the true pose to the study."""
        stamped = structs.replace(odometry, stamp=odometry.stamp + self._begun)
        self._send(f"{robot}.base", cdr.encode(odometry_message(stamped)))
        if self.world is not None:
            while self._carried:
                carried, to = self._carried.popleft()
                _put_down(self.world, self._rows[carried], to)
            pose = self.world.poses()[self._rows[robot]].tolist()
            self._send("truth", json.dumps([robot, time.monotonic(), *pose]).encode())
        if self.recorder is not None:
            counts = self.recorder.contacts, self.recorder.arena_contacts
            self._send("truth", json.dumps([CONTACTS, *counts]).encode())

    def close(self) -> None:
        """End the thread."""
        self._ending.set()
        self._thread.join()
        self._socket.close()
        self._sender.close()

    def _send(self, name: str, payload: bytes) -> None:
        # The node has ended, or does not read.
        with contextlib.suppress(FileNotFoundError, ConnectionRefusedError, BlockingIOError):
            self._sender.sendto(payload, str(self._folder / name))

    def _receive(self) -> None:
        """Receive datagrams until `close`; a base without heartbeats gets a zero command."""
        beats: dict[str, float] = {}
        while not self._ending.is_set():
            with contextlib.suppress(TimeoutError):
                kind, robot, values = json.loads(self._socket.recv(_MAX_DATAGRAM))
                if kind == "carry":
                    self._carried.append((robot, values))
                    continue
                beats[robot] = time.monotonic()
                if kind == "command":
                    self._on_command(robot, Twist(*values))
            for robot, at in list(beats.items()):
                if time.monotonic() - at > HEARTBEAT_TIMEOUT:
                    del beats[robot]
                    self._on_command(robot, ZERO)


def _put_down(world: World, row: int, pose: list[float]) -> None:
    """Put a robot at rest at x, y in m and yaw in rad."""
    place = slice(3 * row, 3 * row + 3)
    world.data.qpos[place] = pose
    world.data.qvel[place] = 0.0


def main(folder: Path, seed: int) -> None:
    """Simulate until SIGTERM."""
    over = threading.Event()
    signal.signal(signal.SIGTERM, lambda number, frame: over.set())
    platform = load_platform(PLATFORM)
    robots = dict.fromkeys(BODIES, platform)
    arena = parse_arena(ARENA)
    starts = parse_layout(LAYOUT, [platform.footprint] * len(robots), arena, seed=seed)
    world = World(
        robots, arena, starts, realism=REALISTIC, seed=seed, lidars=LidarModel(sectors=100)
    )
    link = WorldLink("arena", robots, "tcp/127.0.0.1:0")
    nodes: list[Nodes] = []

    def make(*, robots: Mapping[str, Platform], endpoint: str, on_command: OnCommand) -> Nodes:
        nodes.append(Nodes(Path(endpoint), robots, on_command))
        return nodes[0]

    transport = EmulatorTransport(make, robots, str(folder))
    nodes[0].world = world
    recorder = LiveRecorder(world, WorldOptions(swarm="arena"), {})
    nodes[0].recorder = recorder
    live = RealTimeWorld(
        world,
        link,
        recorder,
        emulated=transport,
        command_timeouts=[float("inf")] * len(robots),
        seed=seed,
    )
    print("ready", flush=True)
    try:
        live.run(over.is_set)
    finally:
        nodes[0].close()
        link.close()


if __name__ == "__main__":
    die_with_parent(os.getppid())
    main(Path(sys.argv[1]), int(sys.argv[2]))
