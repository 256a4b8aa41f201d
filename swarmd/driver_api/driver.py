"""The driver's contract: the only code that knows its robot, and the sink that it feeds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from swarmd.core.errors import ConfigError
from swarmd.core.events import SensorInput
from swarmd.core.finding import Finding
from swarmd.core.messages import Motion, Reason, ShownPose, Status
from swarmd.core.values import Platform, Twist, Value


class Sink(Protocol):
    """Receives what a driver's base sends; called on the loop's thread only."""

    def take(self, input: SensorInput) -> None:
        """What a sensor has measured; the caller does not change it afterwards.

        Each input replaces the last of its kind; `swarmd.core.events` says what each kind means,
        and what a kind that is never handed over means.
        """

    def message(self, sender: str, channel: str, payload: bytes) -> None:
        """A pattern's message that the base's own radio received; see `MessageCarrier`."""

    def state(
        self, is_up: bool, text: str, *, hold: Reason | None = None, gets_zero: bool = False
    ) -> None:
        """The base is connected, or lost and why.

        `hold`: why the robot must not move although its base is connected. `gets_zero`: the base is
        lost, but the zeros of a stopped robot are sent to it, or the driver moves no base at all.
        """

    def dropped(self, what: str) -> None:
        """Count one input that could not be read."""


class Driver(Protocol):
    """Talks to one robot's base. `run` reconnects by itself and ends only when cancelled."""

    is_simulated: bool

    async def run(self, sink: Sink) -> None:
        """Feed the sink until cancelled; sends zero on the way out."""

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        """Hand over a safe command: never blocks, keeps no queue, drops while the base is lost.

        The first command after a (re)connect is zero: see `CommandGate`. `is_stopped`: the robot is
        stopped, estopped or faulted, so a base that others may command is sent zero although it is
        lost, with each call and at once when another's command is heard.
        """

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """What the driver finds out about the robot within `seconds`; moves nothing."""


@dataclass(frozen=True, slots=True)
class ZeroSenderSpec:
    """How the watchdog's process makes its ZeroSender: `maker`, `module:callable`, and keywords.

    JSON must be able to carry the options.
    """

    maker: str
    options: Mapping[str, Value]


class ZeroSender(Protocol):
    """A second connection to a base, which sends nothing but zero.

    It lives in the watchdog's process (`watchdog.py`), which has no event loop. A sender whose
    `open` may return before it is connected also has `is_connected`; while that is false the
    daemon's commands are zero. A sender that a driver's `zero_hint` concerns has `take_hint(hint)`.
    """

    def open(self) -> None:
        """Connect, and stay connected from then on; SwarmError if that is impossible."""

    def send_zero(self) -> None:
        """Send zero once, now; never blocks for longer than a tick."""

    def close(self) -> None:
        """Disconnect; sends nothing."""


@runtime_checkable
class ZeroSenderProvider(Protocol):
    """What a driver also offers if its base may lack a command timeout.

    A driver that finds out what zero its base understands tells that in the attribute `zero_hint`,
    a word of at most 15 ASCII characters, empty while it is unknown. Each tick carries it to the
    watchdog, where it outlives the daemon.
    """

    def zero_sender(self) -> ZeroSenderSpec | None:
        """How the watchdog sends zero to this base.

        None: the driver has a process of its own for it, which outlives the daemon.
        """


@runtime_checkable
class MessageCarrier(Protocol):
    """What a driver also offers if its base has a radio for the messages of patterns.

    While `carries_messages`, the daemon hands messages to the driver and not to its own network.
    """

    carries_messages: bool

    def send_message(self, channel: str, payload: bytes) -> None:
        """Send an encoded value to all robots in reach: never blocks; dropped while lost."""


@runtime_checkable
class Gripper(Protocol):
    """What a driver also offers if its base has a gripper.

    A daemon with any other driver takes `gripper` away from what its platform provides, so that the
    robot refuses patterns that need one.
    """

    def grip(self, is_closed: bool) -> None:
        """Close or open the gripper, called with each step of a pattern that says so: never blocks.

        Dropped while the base is lost.
        """


@runtime_checkable
class StateDisplay(Protocol):
    """What a driver also offers if it can show the state of its robot to others.

    While `shows_state`, the daemon calls `show`; protection and commands do not depend on it.
    """

    shows_state: bool

    def show(self, status: Status | None, motion: Motion | None, pose: ShownPose | None) -> None:
        """Take the newest state, called on the loop, at most 10 Hz: never blocks, never raises.

        `status`: on each change and once a second, else None. `motion`, `pose`: None if not known.
        """


def message_carrier(driver: Driver) -> MessageCarrier | None:
    """The driver, or the driver that it wraps, if its base carries messages."""
    bare = _unwrapped(driver)
    return bare if isinstance(bare, MessageCarrier) and bare.carries_messages else None


def gripper_of(driver: Driver) -> Gripper | None:
    """The driver, or the driver that it wraps, if its base has a gripper."""
    bare = _unwrapped(driver)
    return bare if isinstance(bare, Gripper) else None


def state_display(driver: Driver) -> StateDisplay | None:
    """The driver, or the driver that it wraps, if it is to show the state of its robot."""
    bare = _unwrapped(driver)
    return bare if isinstance(bare, StateDisplay) and bare.shows_state else None


def _unwrapped(driver: Driver) -> Driver:
    while hasattr(driver, "wrapped"):
        driver = driver.wrapped
    return driver


class DriverFactory(Protocol):
    """Makes a driver; the type of the entry points in group `swarmd.drivers`."""

    def __call__(
        self, *, swarm: str, robot: str, platform: Platform, options: Mapping[str, Value]
    ) -> Driver:
        """A driver that has not connected yet; ConfigError for unknown options."""


def check_protected(platform: Platform, driver: Driver, name: str) -> None:
    """ConfigError if protection is off and driver `name` moves a real base."""
    if platform.protection["mode"] == "off" and not driver.is_simulated:
        raise ConfigError(
            f"platform {platform.name}: protection.mode is off, and driver {name} moves a real"
            " robot; expected barrier, potential_field or stop_zone: change the platform's file"
        )


class NullSink:
    """A sink that keeps nothing."""

    def _ignore(self, *args: Any, **kwargs: Any) -> None:
        pass

    take = message = state = dropped = _ignore
