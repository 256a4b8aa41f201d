"""The chain: an arena, the robots' nodes on DDS, one bridge, a daemon per robot, an operator."""

from __future__ import annotations

import contextlib
import json
import math
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Self

import msgspec

from studies.ros.node import Faults, Kind, Settings
from studies.ros.robots import (
    BASE,
    CONTACTS,
    LIDAR,
    PLATFORM,
    RIVAL_SPEED,
    ROBOTS,
    bound,
    namespace,
)
from swarmd.core.codec import Decoder
from swarmd.core.messages import Status
from swarmd.core.verbs import ResetRequest, RunRequest
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from tests.support.processes import CAP, DaemonProcess, run_command, unique_swarm, wait_until
from tests.support.ros2_bridge import NAME, Bridge, free_domain

ROOT = Path(__file__).parents[2]
PATTERN = "random_walk"

_MAX_DATAGRAM = 1000
_PAUSE = 0.1
_CARRIED = 0.2  # m between two poses; a larger step means that the robot was carried
_status = Decoder(Status)


@dataclass(frozen=True, slots=True)
class Command:
    """A command that a base took."""

    at: float  # s of CLOCK_MONOTONIC
    linear: float  # m/s
    angular: float  # rad/s

    @property
    def is_zero(self) -> bool:
        """True if the command does not move the base."""
        return self.linear == 0.0 and self.angular == 0.0


class NodeProcess:
    """A ROS node in a process of its own."""

    def __init__(self, settings: Settings, commands: list[Command], log: Path) -> None:
        """Start the node; returns once it is on DDS.

        `commands`: the list to which the commands that a base takes are appended.
        """
        with log.open("a") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "studies.ros.node", msgspec.json.encode(settings).decode()],
                cwd=ROOT,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
            )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n", log.read_text()
        self._thread = threading.Thread(target=self._read, args=(commands,))
        self._thread.start()

    def set(self, faults: Faults) -> None:
        """Set the faults of the node from now on."""
        assert self._process.stdin is not None
        print(msgspec.json.encode(faults).decode(), file=self._process.stdin, flush=True)

    def end(self) -> None:
        """End the node in order, so that it leaves DDS."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._finish()

    def kill(self) -> None:
        """End the node by SIGKILL."""
        self._process.kill()
        self._finish()

    def _finish(self) -> None:
        self._process.wait(CAP)
        self._thread.join()
        for stream in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(BrokenPipeError):
                assert stream is not None
                stream.close()

    def _read(self, commands: list[Command]) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            commands.append(Command(*json.loads(line)))


class Chain:
    """Three robots that drive in one arena; a context manager that leaves no process behind.

    - `statuses`: by robot, (s of CLOCK_MONOTONIC at reception, status).
    - `poses`: by body, (s of CLOCK_MONOTONIC, x, y, yaw) of ground truth.
    - `commands`: by body, the commands that its base took.
    - `contacts`: how often robots have touched each other, and walls.
    - `usual`: the driver's text in the status of a robot without a fault.
    """

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder, self._seed = folder, seed
        self.swarm = unique_swarm()
        self.domain = free_domain()
        self.bridge = Bridge(folder, self.domain)
        self.usual = f"{NAME} at {self.bridge.endpoint}"
        self.nodes: dict[tuple[str, str], NodeProcess] = {}
        self.daemons: dict[str, DaemonProcess] = {}
        self.statuses: dict[str, list[tuple[float, Status]]] = {}
        self.poses: dict[str, list[tuple[float, float, float, float]]] = {}
        self.commands: dict[str, list[Command]] = {}
        self.contacts = (0, 0)
        self._load: list[subprocess.Popen[bytes]] = []
        self._left = contextlib.ExitStack()

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as left:
            left.callback(self.set_load, 0)
            left.enter_context(self._truth())
            left.enter_context(self._arena())
            left.callback(self._end_nodes)
            left.enter_context(self.bridge)
            for robot in ROBOTS:
                self.start_node(robot, "base")
                self.start_node(robot, "lidar")
            left.callback(self._end_daemons)
            for robot in ROBOTS:
                self.start_daemon(robot)
            for daemon in self.daemons.values():
                daemon.wait_ready()
            network = NetworkSettings(swarm=self.swarm)
            self.operator = left.enter_context(Operator(network, name="study@bench"))
            self.operator.watch("status", self._on_status)
            self.look()
            self._left = left.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._left.close()

    # Parts

    def start_node(
        self,
        robot: str,
        kind: Kind,
        *,
        body: str = "",
        name: str | None = None,
        at: str | None = None,
        is_stamped: bool = False,
    ) -> NodeProcess:
        """Start a node of a robot.

        `body` of the arena, node `name` and namespace `at` are by default the robot's own. With an
        empty name the process publishes on DDS without a ROS node.
        """
        usual = {"base": BASE, "lidar": LIDAR, "teleop": "teleop_keyboard"}[kind]
        body = body or robot
        settings = Settings(
            folder=str(self.folder),
            domain=self.domain,
            body=body,
            kind=kind,
            name=usual if name is None else name,
            namespace=namespace(robot) if at is None else at,
            is_stamped=is_stamped,
        )
        commands = self.commands.setdefault(body, [])
        node = NodeProcess(settings, commands, self.folder / "nodes.log")
        self.nodes[body, kind] = node
        return node

    def start_daemon(self, robot: str, at: str = "{robot}") -> DaemonProcess:
        """Start a robot's daemon; `at`: the namespace in the options of its driver."""
        self.daemons[robot] = daemon = DaemonProcess(
            self.folder,
            swarm=self.swarm,
            robot=robot,
            endpoint="",
            platform=PLATFORM,
            options={
                "driver": "ros2dds",
                "driver_options": {"endpoint": self.bridge.endpoint, "namespace": at},
            },
        )
        return daemon

    def restart_bridge(self, domain: int | None = None) -> None:
        """Kill the bridge and start it again, in DDS domain `domain`; None: the robots' domain."""
        self.bridge.kill()
        self.bridge.domain = self.domain if domain is None else domain
        self.bridge.start()

    def restart_daemon(self, robot: str, at: str = "{robot}") -> None:
        """End a robot's daemon in order, and start it again; `at` as of `start_daemon`."""
        self.daemons[robot].terminate()
        self.start_daemon(robot, at).wait_ready()
        self.look()

    def look(self) -> None:
        """Find the daemons, so that the operator receives their statuses from then on."""
        for robot, member in self.operator.members(timeout=1.0).members.items():
            if member.status is not None:
                self._take(robot, member.status)

    # An operator

    def swarmctl(self, *words: str) -> tuple[int, float, str]:
        """Run `swarmctl`: its exit code, duration in s and output."""
        begun = time.monotonic()
        done = run_command("swarmctl", *words, cwd=self.folder, SWARM=self.swarm)
        return done.returncode, time.monotonic() - begun, done.stdout + done.stderr

    def run(self, robot: str) -> None:
        """Make one request to a robot that is not running: reset if it has latches, else run."""
        view = self.operator.members(timeout=1.0)
        member = view.members.get(robot)
        if member is None or member.status is None or member.status.state == "running":
            return
        if member.status.latches:
            latches = tuple(member.status.latches)
            self.operator.request(ResetRequest, {robot: member.epoch}, ids=latches, timeout=1.0)
            return
        self.operator.request(RunRequest, {robot: member.epoch}, pattern=PATTERN, timeout=2.0)

    def status(self, robot: str) -> Status | None:
        """The latest status of a robot; None before the first one."""
        known = self.statuses.get(robot)
        return known[-1][1] if known else None

    def set_load(self, count: int) -> None:
        """Keep `count` busy processes beside the chain."""
        for process in self._load:
            process.kill()
            process.wait()
        busy = [sys.executable, "-c", "while True: pass"]
        self._load = [subprocess.Popen(busy) for _ in range(count)]

    def carry(self, robot: str, pose: tuple[float, float, float]) -> None:
        """Put a robot down at x, y in m and yaw in rad; its odometry jumps."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
            link.sendto(json.dumps(["carry", robot, pose]).encode(), str(self.folder / "arena"))

    def describe(self) -> str:
        """A line for each robot with pose, speed and status, for logs."""
        lines = []
        for robot in ROBOTS:
            if (status := self.status(robot)) is not None:
                _, x, y, yaw = self.poses[robot][-1]
                lines.append(
                    f"{robot} at {x:.2f} {y:.2f} {yaw:.2f}, {self.speed(robot):.2f} m/s:"
                    f" {status.state} {status.reason} {status.detail} {status.health.driver}"
                    f" {status.findings} {status.decision}"
                )
        return "\n".join(lines)

    # What really happens

    def path(self, body: str, since: float, until: float = math.inf) -> float:
        """The length in m of a body's path between two times, without steps by `carry`."""
        places = [pose[1:3] for pose in self.poses.get(body, [])[:] if since <= pose[0] <= until]
        steps = (math.dist(a, b) for a, b in pairwise(places))
        return sum(step for step in steps if step < _CARRIED)

    def speed(self, body: str, within: float = 0.5) -> float:
        """The mean speed in m/s of a body in the last `within` s."""
        return self.path(body, time.monotonic() - within) / within

    def moving_commands(self, body: str, since: float, until: float = math.inf) -> list[float]:
        """The times of swarmd's commands to move that a body took between two times."""
        taken = [c for c in self.commands.get(body, [])[:] if since <= c.at <= until]
        return [c.at for c in taken if not c.is_zero and c.linear != RIVAL_SPEED]

    def standing(self, body: str, since: float) -> float:
        """The time of a body's last motion, in s after `since`; inf if it still moves."""
        last = since
        for a, b in pairwise([pose for pose in self.poses.get(body, [])[:] if pose[0] >= since]):
            if math.dist(a[1:3], b[1:3]) > 0.001 or abs(a[3] - b[3]) > 0.005:
                last = b[0]
        return math.inf if time.monotonic() - last < 2.0 * _PAUSE else last - since

    # How it starts and ends

    @contextlib.contextmanager
    def _arena(self) -> Iterator[None]:
        command = [sys.executable, "-m", "studies.ros.arena", str(self.folder), str(self._seed)]
        with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            try:
                yield
            finally:
                process.send_signal(signal.SIGTERM)

    @contextlib.contextmanager
    def _truth(self) -> Iterator[None]:
        over = threading.Event()
        with bound(self.folder / "truth") as inbox:
            inbox.settimeout(_PAUSE)

            def receive() -> None:
                while not over.is_set():
                    with contextlib.suppress(TimeoutError):
                        name, *values = json.loads(inbox.recv(_MAX_DATAGRAM))
                        if name == CONTACTS:
                            robots, walls = values
                            self.contacts = (robots, walls)
                        else:
                            self.poses.setdefault(name, []).append(tuple(values))

            thread = threading.Thread(target=receive)
            thread.start()
            try:
                yield
            finally:
                over.set()
                thread.join()

    def _end_nodes(self) -> None:
        for node in self.nodes.values():
            node.kill()

    def _end_daemons(self) -> None:
        for daemon in self.daemons.values():
            daemon.thaw()
            daemon.__exit__()

    def _on_status(self, robot: str, payload: bytes) -> None:
        self._take(robot, _status(payload))

    def _take(self, robot: str, status: Status) -> None:
        self.statuses.setdefault(robot, []).append((time.monotonic(), status))


def wait(condition: Callable[[], bool], cap: float) -> float:
    """Seconds until a condition holds; inf if it does not within `cap` s."""
    begun = time.monotonic()
    with contextlib.suppress(AssertionError):
        wait_until(condition, "it", cap)
        return time.monotonic() - begun
    return math.inf
