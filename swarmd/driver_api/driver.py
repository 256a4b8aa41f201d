"""What a driver is: the only code that knows its robot.

A sink for who only looks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from swarmd.core.errors import ConfigError
from swarmd.core.values import Neighbor, Odometry, Platform, Scan, Twist, Value


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of `swarmd --check`: what was looked at, whether it is well, and the next step."""

    subject: str
    is_well: bool
    text: str


class Sink(Protocol):
    """Where a driver puts what it hears; called on the loop's thread only."""

    def scan(self, scan: Scan) -> None:
        """A sweep as the sensor gave it; the core conditions it."""

    def odometry(self, odometry: Odometry) -> None:
        """A measured pose and twist."""

    def neighbors(self, neighbors: tuple[Neighbor, ...]) -> None:
        """The robots within hearing, if the body knows; never called means all members."""

    def readings(self, values: Mapping[str, float]) -> None:
        """Scalar sensors by name."""

    def state(self, is_up: bool, text: str) -> None:
        """The base is there, or is lost and why."""

    def dropped(self, what: str) -> None:
        """Count one input that could not be read."""


class Driver(Protocol):
    """Talks to one robot's base. `run` reconnects by itself and ends only when cancelled."""

    is_simulated: bool

    async def run(self, sink: Sink) -> None:
        """Feed the sink until cancelled; sends zero on the way out."""

    def send(self, twist: Twist, scan_seq: int, requested_scan_seq: int) -> None:
        """Hand over a safe command: never blocks, keeps no queue, drops while the base is lost.

        The first command after a reconnect is zero.
        """

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """What can be seen of the robot within `seconds`; moves nothing."""


@dataclass(frozen=True, slots=True)
class ZeroSenderSpec:
    """How the stopper's process makes its ZeroSender: `maker`, `module:callable`, by keywords.

    The options must be what JSON can carry.
    """

    maker: str
    options: Mapping[str, Value]


class ZeroSender(Protocol):
    """A second connection to a base, which can say nothing but zero.

    It lives in the stopper's process (`stopper.py`), with no loop. One whose `open` may return
    before there is a connection also has `is_connected`; as long as that is false the guardian
    says zero.
    """

    def open(self) -> None:
        """Connect, and keep connected from then on; SwarmError if that can never be."""

    def send_zero(self) -> None:
        """Command zero once, now; never blocks for longer than a tick."""

    def close(self) -> None:
        """Disconnect; commands nothing."""


@runtime_checkable
class ZeroSenderProvider(Protocol):
    """What a driver also offers if it may drive a base that never stops by itself."""

    def zero_sender(self) -> ZeroSenderSpec | None:
        """How a stopper says zero to this base.

        None: the driver arranges it, with a process of its own that outlives the guardian.
        """


class DriverFactory(Protocol):
    """How a driver is made; its entry point in group `swarmd.drivers` is one of these."""

    def __call__(
        self, *, swarm: str, robot: str, platform: Platform, options: Mapping[str, Value]
    ) -> Driver:
        """A driver that has not connected yet; ConfigError for options it does not know."""


def check_protected(platform: Platform, driver: Driver, name: str) -> None:
    """ConfigError if nothing would stand between a pattern and a real base: driver `name`'s."""
    if platform.protection["mode"] == "off" and not driver.is_simulated:
        raise ConfigError(
            f"platform {platform.name}: protection.mode is off, and driver {name} moves a real"
            " robot; wanted barrier, potential_field or stop_zone: change the platform's file"
        )


class NullSink:
    """Takes everything and keeps nothing."""

    def scan(self, scan: Scan) -> None:
        """It is not kept."""

    def odometry(self, odometry: Odometry) -> None:
        """It is not kept."""

    def neighbors(self, neighbors: tuple[Neighbor, ...]) -> None:
        """They are not kept."""

    def readings(self, values: Mapping[str, float]) -> None:
        """They are not kept."""

    def state(self, is_up: bool, text: str) -> None:
        """It is not kept."""

    def dropped(self, what: str) -> None:
        """It is not counted."""
