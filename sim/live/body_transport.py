"""How bodies of a real-time world speak: over the `hw/*` keys, or in the dialect of a driver."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from swarmd.core.values import Neighbor, Odometry, Platform, Scan, Twist
from swarmd.driver_api.emulator import RobotSide, RobotSideFactory
from swarmd.driver_api.hw_codec import (
    encode_neighbors,
    encode_odometry,
    encode_readings,
    encode_scan,
)
from swarmd.sim.live.link import WorldLink

DRIVER = "simulated"
"""The driver of daemons whose bodies speak no dialect."""


@dataclass(frozen=True, slots=True)
class Command:
    """The newest command of a robot, and when it came. `scan_seq`: the sweep it rests on, if told.

    -1: it rests on none.
    """

    twist: Twist
    arrival: float
    scan_seq: int | None = None


class BodyTransport(Protocol):
    """Says what bodies sense, and hears what they are told."""

    @property
    def dropped(self) -> int:
        """How many commands could not be read."""

    def scan(self, robot: str, scan: Scan) -> None:
        """A sweep."""

    def odometry(self, robot: str, odometry: Odometry) -> None:
        """A measured pose and twist."""

    def neighbors(self, robot: str, heard: tuple[Neighbor, ...]) -> None:
        """The robots within hearing, where the language has a word for it."""

    def readings(self, robot: str, values: Mapping[str, float]) -> None:
        """Scalar sensors, where the language has a word for them."""

    def take_commands(self) -> Mapping[str, Command]:
        """The newest command of each robot since the last call."""


class HwTransport:
    """The `hw/*` keys, on the world's own link."""

    dropped = 0  # the link counts them itself

    def __init__(self, link: WorldLink) -> None:
        self._link = link

    def scan(self, robot: str, scan: Scan) -> None:
        """A sweep."""
        self._link.publish(robot, "scan", encode_scan(scan))

    def odometry(self, robot: str, odometry: Odometry) -> None:
        """A measured pose and twist."""
        self._link.publish(robot, "odometry", encode_odometry(odometry))

    def neighbors(self, robot: str, heard: tuple[Neighbor, ...]) -> None:
        """The robots within hearing."""
        self._link.publish(robot, "neighbors", encode_neighbors(heard))

    def readings(self, robot: str, values: Mapping[str, float]) -> None:
        """Scalar sensors."""
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
    """The dialect of a driver. `side` is the hub that the daemons' drivers dial."""

    def __init__(
        self,
        factory: RobotSideFactory,
        robots: Mapping[str, Platform],
        endpoint: str,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Opens at once; errors as those of the factory."""
        self._clock = clock
        self._lock = threading.Lock()
        self._commands: dict[str, Command] = {}
        self.side: RobotSide = factory(
            robots=robots, endpoint=endpoint, on_command=self._on_command
        )

    @property
    def dropped(self) -> int:
        """How many commands could not be read."""
        return self.side.dropped

    def scan(self, robot: str, scan: Scan) -> None:
        """A sweep."""
        self.side.scan(robot, scan)

    def odometry(self, robot: str, odometry: Odometry) -> None:
        """A measured pose and twist."""
        self.side.odometry(robot, odometry)

    def neighbors(self, robot: str, heard: tuple[Neighbor, ...]) -> None:
        """No robot says whom it hears."""

    def readings(self, robot: str, values: Mapping[str, float]) -> None:
        """No topic carries them."""

    def take_commands(self) -> Mapping[str, Command]:
        """The newest command of each robot since the last call."""
        with self._lock:
            commands, self._commands = self._commands, {}
        return commands

    def close(self) -> None:
        """End the hub."""
        self.side.close()

    def _on_command(self, robot: str, twist: Twist) -> None:
        command = Command(twist, self._clock())
        with self._lock:
            self._commands[robot] = command
