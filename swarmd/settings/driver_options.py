"""The options common to all drivers, and the output of an idle robot.

The common options are set in the platform's file under `drivers.<name>`, or in `driver_options`.
The driver does not receive the common options.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Literal

from msgspec import Meta, Struct

from swarmd.core.errors import ConfigError
from swarmd.core.values import Twist, Value
from swarmd.driver_api.driver import Driver
from swarmd.settings.layered import Layered

IDLE_ZEROS_PERIOD = 1.0
"""Seconds of zero commands to a robot that becomes idle, with `idle_output: silent`."""

RESTING_TIMEOUT = 0.4
"""A base with a shorter command timeout, in s, keeps its robot at 20 ticks a second at rest.

`TICK_TIMEOUT` of the watchdog is as long.
"""

DEFAULT_COMMAND_TIMEOUT = 0.5
"""Seconds without a command after which a base with `command_timeout: base` stops."""

Timeout = Annotated[float, Meta(ge=0.1, le=2.0)]


class BaseOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The options common to all drivers.

    - `command_timeout`: how the base stops when commands cease. `base`: the base stops by itself.
      A number: the base stops by itself after this many s. `none`: the base never stops, so the
      watchdog sends zero. The default is `none`, and `base` for a simulated driver. A number below
      the true timeout of the base is dangerous: after the end of its daemon the robot drives on for
      longer than assumed.
    - `idle_output`: what the daemon sends to the base of an idle robot. `zeros`: zero at every
      tick, and nothing while another node drives the base. `silent`: zeros in the first second,
      then nothing, so that a joystick can drive the base, without protection; refused with
      `command_timeout: none`. A stopped, estopped or held robot gets zero in both cases.
    """

    command_timeout: Timeout | Literal["base", "none"] | None = None
    idle_output: Literal["zeros", "silent"] = "zeros"


class IdleOutputFilter:
    """Decides which commands reach the driver of an idle robot. Pure."""

    def __init__(self, kind: str) -> None:
        self._is_silent = kind == "silent"
        self._since: float | None = None

    def allows(self, twist: Twist, is_idle: bool, now: float) -> bool:
        """True if the command `twist` must be sent at `now` (s)."""
        if not self._is_silent:
            return True
        if not (is_idle and twist.is_zero):
            self._since = None
            return True
        if self._since is None:
            self._since = now
        return now - self._since < IDLE_ZEROS_PERIOD


def base_options(options: Mapping[str, Value], what: str) -> BaseOptions:
    """The common options of a driver; ConfigError, starting with `what:`, if one is wrong."""
    common = {key: options[key] for key in BaseOptions.__struct_fields__ if key in options}
    base = Layered((what, common)).build(BaseOptions)
    if base.idle_output == "silent" and base.command_timeout == "none":
        raise ConfigError(
            f"{what}: idle_output is silent, but command_timeout is none: a base that never stops"
            " by itself needs zeros; expected idle_output: zeros, or a base with a timeout"
        )
    return base


def stops_after(options: Mapping[str, Value], what: str) -> float:
    """The s after which a real base with these options stops by itself; inf if it never does.

    0.5 s is assumed for `command_timeout: base`, which gives no time.
    """
    command_timeout = base_options(options, what).command_timeout
    if command_timeout is None or command_timeout == "none":
        return math.inf
    return DEFAULT_COMMAND_TIMEOUT if command_timeout == "base" else float(command_timeout)


def effective_command_timeout(base: BaseOptions, driver: Driver) -> float | Literal["base", "none"]:
    """The command timeout, with its default: `none` for a real robot, else `base`."""
    return base.command_timeout or ("base" if driver.is_simulated else "none")


def may_rest(base: BaseOptions, driver: Driver) -> bool:
    """True if the base may get zero 10 instead of 20 times a second while its robot stands."""
    timeout = effective_command_timeout(base, driver)
    return isinstance(timeout, str) or timeout >= RESTING_TIMEOUT
