"""Makes the driver of a daemon, runs it, sends it the safe commands and takes its inputs."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Protocol

from swarmd.core import events
from swarmd.core.clock import boottime
from swarmd.core.codec import decode_value
from swarmd.core.errors import CodecError, ConfigError, SwarmError
from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Twist
from swarmd.daemon.neighbors import NeighborSelection
from swarmd.driver_api.driver import Driver, Sink, ZeroSenderProvider
from swarmd.driver_api.watchdog import watchdog_name
from swarmd.driver_api.watchdog_client import WatchedDriver
from swarmd.plugins import load_driver
from swarmd.robot.actions import Actions
from swarmd.settings.driver_options import (
    BaseOptions,
    IdleOutputFilter,
    base_options,
    effective_command_timeout,
)
from swarmd.settings.settings import DaemonSettings

log = logging.getLogger(__name__)
MAX_KIND_LENGTH = 64  # characters of the kind of a dropped input


def make_bare_driver(settings: DaemonSettings) -> Driver:
    """The driver that the settings name, not yet connected, without a watchdog.

    Raises SwarmError if the driver or its options are wrong.
    """
    common = BaseOptions.__struct_fields__
    driver: Driver = load_driver(settings.file.driver)(
        swarm=settings.network.swarm,
        robot=settings.id,
        platform=settings.platform,
        options={k: v for k, v in settings.driver_options.items() if k not in common},
    )
    return driver


def make_driver(settings: DaemonSettings) -> Driver:
    """The daemon's driver, not yet connected, with a watchdog process if the base needs one.

    A base with a command timeout stops by itself when commands cease. For a base without a command
    timeout (command_timeout: none) a watchdog process sends zero if the daemon hangs or is killed.
    Raises SwarmError if the driver or its options are wrong, ConfigError if the base would have
    neither a command timeout nor a watchdog.
    """
    base = base_options(settings.driver_options, f"driver {settings.file.driver}")
    driver = make_bare_driver(settings)
    if effective_command_timeout(base, driver) != "none":
        return driver
    return _with_watchdog(driver, base, settings)


def _with_watchdog(driver: Driver, base: BaseOptions, settings: DaemonSettings) -> Driver:
    """The driver of a base without a command timeout, with a process that sends zero.

    Raises ConfigError if the driver cannot have such a process.
    """
    name = settings.file.driver
    # The base needs zeros also while its robot is idle. `base_options` refuses idle_output silent
    # with command_timeout none, so here command_timeout is not given.
    if base.idle_output == "silent":
        raise ConfigError(
            f"driver {name}: idle_output is silent, but command_timeout counts as none where it"
            " is not given; add command_timeout: base, or its seconds"
        )
    if not isinstance(driver, ZeroSenderProvider):
        raise ConfigError(
            f"driver {name}: command_timeout is none, and this driver has no watchdog;"
            " give command_timeout: base, or its seconds, if this base stops by itself"
        )
    spec = driver.zero_sender()  # how the watchdog process sends zero to the base
    if spec is None:  # the driver has a process of its own that sends zero: no second watchdog
        return driver
    watchdog = watchdog_name(settings.network.swarm, settings.id)
    return WatchedDriver(driver, spec, name=watchdog, tie=settings.die_with_parent)


RETRY_PERIOD = 1.0  # s between the end of a driver and its next start


class DriverOutput:
    """Runs the driver called `name`, and sends commands to the base through it.

    `idle_output`: what the base of an idle robot gets: `zeros`, or `silent` (zeros in the first
    second, then nothing). `on_crash` takes an exception that the driver raised for a command;
    `command` itself never raises.
    """

    def __init__(
        self, driver: Driver, name: str, idle_output: str, on_crash: Callable[[Exception], None]
    ) -> None:
        self._driver = driver
        self._name = name
        self._idle = IdleOutputFilter(idle_output)
        # The last command, its `is_stopped`, and the scans of its decision if they count.
        self._sent: tuple[Twist, bool, tuple[int, int] | None] | None = None
        self._on_crash = on_crash

    async def run(self, sink: Sink) -> None:
        """Run the driver forever; after a SwarmError, restart it after RETRY_PERIOD."""
        while True:
            try:
                await self._driver.run(sink)
            except SwarmError as error:
                log.warning("driver %s: %s", self._name, error)
                sink.state(False, str(error))
            await asyncio.sleep(RETRY_PERIOD)

    def command(self, actions: Actions, now: float, *, may_repeat: bool = True) -> None:
        """Send the command of `actions`, unless `idle_output` keeps an idle robot silent.

        `may_repeat` False: a command that equals the last command is not sent. A simulated base
        waits for a command after each scan. So commands to a simulated base also differ if they
        were decided by different scans, unless the robot is idle or stopped, and commands zero.
        """
        stands = (actions.is_idle or actions.is_stopped) and actions.twist.is_zero
        is_by_scan = self._driver.is_simulated and not stands
        scans = (actions.decision.scan_seq, actions.requested_scan_seq) if is_by_scan else None
        command = actions.twist, actions.is_stopped, scans
        if command == self._sent and not may_repeat:
            return
        if self._idle.allows(actions.twist, actions.is_idle, now):
            self._sent = command
            self._send(
                actions.twist,
                actions.decision.scan_seq,
                actions.requested_scan_seq,
                is_stopped=actions.is_stopped,
            )

    def send_zero(self) -> None:
        """Send the command zero, whatever was sent before."""
        self._sent = None
        self._send(ZERO, -1, -1)

    def _send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        try:
            self._driver.send(twist, scan_seq, requested_scan_seq, is_stopped=is_stopped)
        except Exception as error:  # a driver may raise anything
            log.exception("driver %s: a command could not be sent", self._name)
            self._on_crash(error)


class InputStep(Protocol):
    """Hands an input, which arrived `age` s ago, to the robot."""

    def __call__(self, input: events.Input, *, age: float = 0.0) -> None:
        """Hand over the input."""


class DriverSink:
    """Takes the measurements of the driver, and hands them as inputs to `step`.

    `neighborhood` marks those sensed robots whose messages the pattern may hear. `has_neighbors`:
    the driver itself senses other robots. `drops`: counts of unreadable inputs by kind.
    """

    def __init__(self, step: InputStep, neighborhood: NeighborSelection) -> None:
        self._step = step
        self._neighborhood = neighborhood
        self.has_neighbors = False
        self.drops: dict[str, int] = {}

    def take(self, input: events.SensorInput) -> None:
        """Hand on an input of a sensor; neighbors are first marked as in reach or not."""
        if isinstance(input, events.NeighborsInput):
            self.has_neighbors = True
            selected = self._neighborhood.select(input.neighbors, boottime())
            input = events.NeighborsInput(selected)
        self._step(input)

    def take_late(self, input: events.OdometryInput, age: float) -> None:
        """Hand on a reading of odometry that arrived `age` s ago."""
        self._step(input, age=age)

    def message(self, sender: str, channel: str, payload: bytes) -> None:
        """Take a pattern's message that the base received by radio."""
        try:
            value = decode_value(payload)
        except CodecError:
            self.dropped("message")
        else:
            self._step(events.MessageInput(sender, channel, value, size=len(payload)))

    def state(
        self, is_up: bool, text: str, *, hold: Reason | None = None, gets_zero: bool = False
    ) -> None:
        """Take the connection state of the base; the arguments are as in `Sink.state`."""
        self._step(events.DriverInput(is_up, text, hold, gets_zero))

    def dropped(self, what: str) -> None:
        """Count an input that could not be decoded; `what` names its kind."""
        kind = f"driver/{what}"[:MAX_KIND_LENGTH]
        self.drops[kind] = self.drops.get(kind, 0) + 1
