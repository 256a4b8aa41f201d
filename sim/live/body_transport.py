"""Commands to the robots of a live world, and the transport of robots that emulate a ROS driver."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from swarmd.core.values import Platform, Twist
from swarmd.driver_api.emulator import Emulator, EmulatorFactory

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


class EmulatorTransport:
    """The emulator of a driver's robots, in place of the `hw/*` keys of the world's link.

    `side` is the hub to which the daemons connect.
    """

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

    def send(self, robot: str, name: str, value: Any) -> None:
        """Publish a measurement; emulated robots publish no neighbors and no shared poses."""
        if name in ("scan", "odometry", "readings"):
            getattr(self.side, name)(robot, value)

    def take_commands(self) -> Mapping[str, Command]:
        """The newest command of each robot since the last call."""
        with self._lock:
            commands, self._commands = self._commands, {}
        return commands

    def _on_command(self, robot: str, twist: Twist) -> None:
        command = Command(twist, self._clock())
        with self._lock:
            self._commands[robot] = command
