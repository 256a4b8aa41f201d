"""What is true of a base whichever driver speaks to it: what it does when commands end.

Every driver's options may hold these keys, in the platform's file under `drivers.<name>` or in
`driver_options`; the core takes them out before the driver sees the rest.
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
"""Seconds of zeros to a robot that has just become idle, before it is left alone."""

DEFAULT_COMMAND_TIMEOUT = 0.5
"""Seconds without a command after which most bases that stop by themselves do."""

Timeout = Annotated[float, Meta(ge=0.1, le=2.0)]


class BaseOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The keys common to all drivers.

    `deadman`: how the base stops when commands end: `base`, by itself; a number, by itself after
    so many s; `none`, never, so a stopper must say zero. Not told: `none`, of a simulated driver
    `base`. `idle_output`: whether an idle robot is told `zeros` again and again, or is left
    `silent` so that a joystick can have it. `record`: a file for all that is heard and commanded.
    """

    command_timeout: Timeout | Literal["base", "none"] | None = None
    idle_output: Literal["zeros", "silent"] = "zeros"
    record: str | None = None


class IdleOutputFilter:
    """Which commands reach the driver of an idle robot; pure, time handed in."""

    def __init__(self, kind: str) -> None:
        self._is_silent = kind == "silent"
        self._since: float | None = None

    def allows(self, twist: Twist, is_idle: bool, now: float) -> bool:
        """True if this command is to be sent at `now` (s)."""
        if not self._is_silent:
            return True
        if not (is_idle and twist.is_zero):
            self._since = None
            return True
        if self._since is None:
            self._since = now
        return now - self._since < IDLE_ZEROS_PERIOD


def base_options(options: Mapping[str, Value], what: str) -> BaseOptions:
    """The common keys among a driver's options; ConfigError, after `what:`, if one is wrong."""
    common = {key: options[key] for key in BaseOptions.__struct_fields__ if key in options}
    found = Layered((what, common)).build(BaseOptions)
    if found.idle_output == "silent" and found.command_timeout == "none":
        raise ConfigError(
            f"{what}: idle_output is silent, but deadman is none: a base that never stops by itself"
            " must be told; wanted is idle_output: zeros, or a base with a timeout"
        )
    return found


def stops_after(options: Mapping[str, Value], what: str) -> float:
    """Seconds after which a real base with these options stops by itself; inf if it never does.

    `base` says that it does, not when: 0.5 s.
    """
    command_timeout = base_options(options, what).command_timeout
    if command_timeout is None or command_timeout == "none":
        return math.inf
    return DEFAULT_COMMAND_TIMEOUT if command_timeout == "base" else float(command_timeout)


def effective_command_timeout(base: BaseOptions, driver: Driver) -> float | Literal["base", "none"]:
    """The deadman in force: of a real robot none, unless its platform says otherwise."""
    return base.command_timeout or ("base" if driver.is_simulated else "none")
