"""The interface of emulators: the robots' side of a driver's protocol, for simulated robots.

An emulator lies beside its driver, and is registered under the driver's name in the entry-point
group `swarmd.emulators`. So the simulated world needs no import of a driver.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from swarmd.core.events import SensorInput
from swarmd.core.values import Platform, Twist, Value

OnCommand = Callable[[str, Twist], None]
"""Takes a robot's id and its command; called on a thread of the network's."""


class Emulator(Protocol):
    """Simulated robots that daemons reach with a driver: publishes scans and takes commands.

    `driver_options`: the options that the robots' drivers need beside the platform's file.
    `dropped`: how many commands could not be read.
    """

    driver_options: Mapping[str, Value]
    dropped: int

    def publish(self, robot: str, input: SensorInput) -> None:
        """Publish a measurement of a robot's sensor if its driver reads this kind; never blocks.

        For a driver option with entries, such as `readings`, only the named entries are published.
        """

    def close(self) -> None:
        """Close all connections."""


class EmulatorFactory(Protocol):
    """Makes an emulator; the type of the entry points in group `swarmd.emulators`."""

    def __call__(
        self, *, robots: Mapping[str, Platform], endpoint: str, on_command: OnCommand
    ) -> Emulator:
        """An emulator that listens at `endpoint` (port 0: any free port) from now on.

        Raises ConfigError if the protocol cannot express a platform or the endpoint is malformed,
        NetworkError if the endpoint is not available.
        """
