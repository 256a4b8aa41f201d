"""The robots' side of a driver's language, so that a body that is no real robot can speak it.

It lives beside its driver and is found under the driver's name by entry-point group
`swarmd.emulators`: the simulated world imports no driver.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from swarmd.core.values import Odometry, Platform, Scan, Twist, Value

OnCommand = Callable[[str, Twist], None]
"""Takes a robot's id and what it is told; called on a thread of the network's."""


class Emulator(Protocol):
    """Robots that daemons reach with a driver: says what they sense, hears what they are told.

    `driver_options`: what the driver of each of them must be told beside its platform's file.
    `dropped`: how many commands could not be read.
    """

    driver_options: Mapping[str, Value]
    dropped: int

    def scan(self, robot: str, scan: Scan) -> None:
        """Say a sweep, as that robot's sensor gave it; never blocks."""

    def odometry(self, robot: str, odometry: Odometry) -> None:
        """Say a measured pose and twist; never blocks."""

    def close(self) -> None:
        """Say and hear nothing any more."""


class EmulatorFactory(Protocol):
    """How a robots' side is made; its entry point in group `swarmd.emulators` is one of these."""

    def __call__(
        self, *, robots: Mapping[str, Platform], endpoint: str, on_command: OnCommand
    ) -> Emulator:
        """Listening at `endpoint` (port 0: a free one) from now on.

        ConfigError if a platform cannot be spoken for in this language, or the endpoint is none;
        NetworkError if it cannot be had.
        """
