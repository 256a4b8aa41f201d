"""Sensor data and commands of a live world: over the `hw/*` keys, or emulating a ROS driver."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from swarmd.core.values import Neighbor, Odometry, Platform, Scan, Twist
from swarmd.driver_api.emulator import Emulator, EmulatorFactory
from swarmd.driver_api.hw_codec import (
    encode_neighbors,
    encode_odometry,
    encode_readings,
    encode_scan,
)
from swarmd.sim.live.link import WorldLink

DRIVER = "simulated"
"""The driver of daemons whose robots are not emulated."""


@dataclass(frozen=True, slots=True)
class Command:
    """The newest command of a robot and its time of arrival.

    `scan_seq`: the scan behind the decision; -1: no scan, None: unknown.
    """

    twist: Twist
    arrival: float
    scan_seq: int | None = None


class BodyTransport(Protocol):
    """Publishes sensor data and receives commands of all robots."""

    @property
    def dropped(self) -> int:
        """The number of malformed commands."""

    def scan(self, robot: str, scan: Scan) -> None:
        """Publish a scan."""

    def odometry(self, robot: str, odometry: Odometry) -> None:
        """Publish a measured pose and twist."""

    def neighbors(self, robot: str, neighbors: tuple[Neighbor, ...]) -> None:
        """Publish the robots in radio contact, if the transport supports it."""

    def readings(self, robot: str, values: Mapping[str, float]) -> None:
        """Publish scalar readings, if the transport supports them."""

    def take_commands(self) -> Mapping[str, Command]:
        """The newest command of each robot since the last call."""


class HwTransport:
    """The `hw/*` keys on the world's link."""

    dropped = 0  # the link counts them

    def __init__(self, link: WorldLink) -> None:
        self._link = link

    def scan(self, robot: str, scan: Scan) -> None:
        """Publish a scan."""
        self._link.publish(robot, "scan", encode_scan(scan))

    def odometry(self, robot: str, odometry: Odometry) -> None:
        """Publish a measured pose and twist."""
        self._link.publish(robot, "odometry", encode_odometry(odometry))

    def neighbors(self, robot: str, neighbors: tuple[Neighbor, ...]) -> None:
        """Publish the robots in radio contact."""
        self._link.publish(robot, "neighbors", encode_neighbors(neighbors))

    def readings(self, robot: str, values: Mapping[str, float]) -> None:
        """Publish scalar readings."""
        self._link.publish(robot, "readings", encode_readings(values))

    def take_commands(self) -> Mapping[str, Command]:
        """The newest command of each robot since the last call."""
        return {
            robot: Command(
                Twist(wire.linear, wire.angular, wire.lateral), arrival, scan_seq=wire.scan_seq
            )
            for robot, (wire, arrival) in self._link.take_commands().items()
        }


class EmulatorTransport:
    """The emulator of a driver's robots. `side` is the hub to which the daemons connect."""

    def __init__(
        self,
        factory: EmulatorFactory,
        robots: Mapping[str, Platform],
        endpoint: str,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Open the hub; raises what the factory raises."""
        self._clock = clock
        self._lock = threading.Lock()
        self._commands: dict[str, Command] = {}
        self.side: Emulator = factory(robots=robots, endpoint=endpoint, on_command=self._on_command)

    @property
    def dropped(self) -> int:
        """The number of malformed commands."""
        return self.side.dropped

    def scan(self, robot: str, scan: Scan) -> None:
        """Publish a scan."""
        self.side.scan(robot, scan)

    def odometry(self, robot: str, odometry: Odometry) -> None:
        """Publish a measured pose and twist."""
        self.side.odometry(robot, odometry)

    def neighbors(self, robot: str, neighbors: tuple[Neighbor, ...]) -> None:
        """Ignored: emulated robots do not publish neighbors."""

    def readings(self, robot: str, values: Mapping[str, float]) -> None:
        """Ignored: no topic carries readings."""

    def take_commands(self) -> Mapping[str, Command]:
        """The newest command of each robot since the last call."""
        with self._lock:
            commands, self._commands = self._commands, {}
        return commands

    def close(self) -> None:
        """Close the hub."""
        self.side.close()

    def _on_command(self, robot: str, twist: Twist) -> None:
        command = Command(twist, self._clock())
        with self._lock:
            self._commands[robot] = command
