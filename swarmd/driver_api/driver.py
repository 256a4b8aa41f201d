"""The interfaces of drivers: `Driver` (the only code that knows its robot), sink, extensions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, runtime_checkable

from swarmd.core.errors import ConfigError
from swarmd.core.events import OdometryInput, SensorInput
from swarmd.core.finding import Finding
from swarmd.core.messages import Motion, Reason, ShownPose, Status
from swarmd.core.values import Platform, Twist, Value


class Sink(Protocol):
    """Takes the inputs of a driver; called only on the loop's thread."""

    def take(self, input: SensorInput) -> None:
        """Take a measurement of a sensor; the caller must not change it afterwards.

        Each input replaces the last input of its kind. `swarmd.core.events` defines each kind, and
        the meaning of a kind that a driver never hands over.
        """

    def message(self, sender: str, channel: str, payload: bytes) -> None:
        """Take a pattern's message that the base's own radio received, of robot `sender`."""

    def state(
        self, is_up: bool, text: str, *, hold: Reason | None = None, gets_zero: bool = False
    ) -> None:
        """Take the state of the driver's connection: `is_up`, or in `text` why the base is lost.

        `hold`: why the robot must not move although its base is connected. `gets_zero`: the zero
        command of a stopped robot reaches the base even while the base counts as lost. A driver
        that moves no base also passes True: it has no base that a stop might not reach.
        """

    def dropped(self, what: str) -> None:
        """Count an input that could not be decoded; `what` names its kind."""


class Driver(Protocol):
    """Talks to one robot's base. `run` reconnects by itself and ends only when cancelled."""

    is_simulated: bool

    async def run(self, sink: Sink) -> None:
        """Feed the sink until cancelled; sends zero on the way out."""

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        """Send a safe command. Never blocks, keeps no queue, drops commands to a lost base.

        The first command after each (re)connect is zero. `is_stopped`: the robot is stopped,
        estopped or faulted. In these states a driver whose base other nodes may command sends zero
        even to a lost base: with each call, and at once when a command of another node is heard.
        """

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """Check the connection and the robot for up to `seconds`; moves nothing."""


@dataclass(frozen=True, slots=True)
class ZeroSenderSpec:
    """How the watchdog's process makes its connection to the base, a ZeroSender.

    `maker`: `module:callable`. `options`: keyword arguments of the callable, as valid JSON.
    """

    maker: str
    options: Mapping[str, Value]


class ZeroSender(Protocol):
    """A second connection to a base, which sends nothing but zero.

    The sender lives in the watchdog's process (`watchdog.py`), which has no event loop. Some
    senders have more than the methods below:

    - `is_connected`, an attribute, if `open` may return before the connection is made. While it is
      False the daemon's commands are zero.
    - `take_hint(hint)`, if the base understands only one form of zero, and the driver learns this
      form in operation (`ZeroSenderProvider`).
    """

    def open(self) -> None:
        """Connect, and reconnect by itself from then on; SwarmError if that is impossible."""

    def send_zero(self) -> None:
        """Send zero once, now; never blocks for longer than a tick."""

    def close(self) -> None:
        """Disconnect; sends nothing."""


@runtime_checkable
class ZeroSenderProvider(Protocol):
    """The extension of a driver whose base may lack a command timeout.

    A driver that learns which form of zero its base understands puts it into the attribute
    `zero_hint`: a word of at most 15 ASCII characters, empty while unknown. Each tick carries the
    hint to the watchdog, which keeps it after the end of the daemon.
    """

    def zero_sender(self) -> ZeroSenderSpec | None:
        """The connection by which the watchdog sends zero to this base.

        None: a process of the driver itself, which outlives the daemon, sends zero.
        """


@runtime_checkable
class MessageCarrier(Protocol):
    """The extension of a driver whose base has a radio for the messages of patterns.

    While `carries_messages`, the daemon sends messages by the driver and not by its own network.
    """

    carries_messages: bool

    def send_message(self, channel: str, payload: bytes) -> None:
        """Send an encoded value to all robots in reach: never blocks; dropped while lost."""


@runtime_checkable
class Gripper(Protocol):
    """The extension of a driver whose base has a gripper.

    With any other driver the daemon removes `gripper` from `provides` of the platform, so that the
    robot refuses patterns that need a gripper.
    """

    def grip(self, is_closed: bool) -> None:
        """Close or open the gripper; never blocks, does nothing while the base is lost.

        Called after each step of a pattern whose outputs set `grip`.
        """


@runtime_checkable
class StateDisplay(Protocol):
    """The extension of a driver that can show the state of its robot, for instance in RViz.

    While `shows_state`, the daemon calls `show`; protection and commands do not depend on it.
    """

    shows_state: bool

    def show(self, status: Status | None, motion: Motion | None, pose: ShownPose | None) -> None:
        """Show the newest state; called on the loop, at most at 10 Hz. Never blocks, never raises.

        `status`: on each change and once a second, else None. `motion`, `pose`: None if unknown.
        """


TakeLate: TypeAlias = Callable[[OdometryInput, float], None]
"""Takes a reading of odometry that arrived some s ago."""


@runtime_checkable
class GatheringDriver(Protocol):
    """The extension of a driver that can leave odometry in its socket until a decision needs it.

    A reading that wakes the daemon costs 300 us of processor time, 20 times a second.
    """

    def gather(self, take_late: TakeLate) -> None:
        """Leave odometry in the socket until `read` or a scan, then hand it to `take_late`.

        The daemon calls this once, before `run`, when nothing has arrived. So the driver decides
        with each input whether readings may wait. Each reading that has waited is handed over, in
        order, and before a scan that was read with it.
        """

    def read(self) -> None:
        """Hand over the measurements that have arrived; the daemon calls it before a decision."""


def gathering_driver(driver: Driver) -> GatheringDriver | None:
    """The bare driver, if the driver can leave odometry in its socket."""
    bare = unwrapped(driver)
    return bare if isinstance(bare, GatheringDriver) else None


def message_carrier(driver: Driver) -> MessageCarrier | None:
    """The driver, or the driver that it wraps, if its base carries messages."""
    bare = unwrapped(driver)
    return bare if isinstance(bare, MessageCarrier) and bare.carries_messages else None


def gripper_of(driver: Driver) -> Gripper | None:
    """The driver, or the driver that it wraps, if its base has a gripper."""
    bare = unwrapped(driver)
    return bare if isinstance(bare, Gripper) else None


def state_display(driver: Driver) -> StateDisplay | None:
    """The driver, or the driver that it wraps, if it shows the state of its robot."""
    bare = unwrapped(driver)
    return bare if isinstance(bare, StateDisplay) and bare.shows_state else None


def unwrapped(driver: Driver) -> Driver:
    """The driver itself, without the watchdog that wraps it."""
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

    take = _ignore
    message = _ignore
    state = _ignore
    dropped = _ignore
