"""Commands to one robot that its driver receives from the robot's own system, such as ROS.

The daemon treats such a command as the request of an operator for this one robot.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias, runtime_checkable

from swarmd.core.messages import Reply
from swarmd.core.values import Scalar
from swarmd.driver_api.driver import Driver, unwrapped


@dataclass(frozen=True, slots=True)
class DeclaredRun:
    """A run that the options of the driver declare; the fields are those of `RunRequest`."""

    pattern: str
    params: Mapping[str, Scalar | None]
    seconds: float | None
    until: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverCommand:
    """A command from the robot's own system."""

    verb: Literal["run", "stop", "estop", "reset"]
    operator: str
    """The operator that the options of the driver name for its commands"""
    source: str
    """For the audit log, such as `ROS topic /tb3_01/swarmd/stop`"""
    reason: str = ""
    """Of an emergency stop"""
    run: DeclaredRun | None = None
    """Only with verb `run`"""
    resets_others: bool = False
    """A reset also clears the emergency stops of other operators"""
    age: float | None = None
    """The command was issued at most so many s ago; None: no bound is known"""
    doubt: str = ""
    """Why no bound of the age is known"""


Answer: TypeAlias = Callable[[Reply], None]
TakeCommand: TypeAlias = Callable[[DriverCommand, Answer], None]
"""Takes a command on the loop, and calls `Answer` once, at once or later, on the loop.

The text of the answer to a stop begins with the state of the robot, such as `stopped: `.
"""


class CommandSource(Protocol):
    """Receives the commands to one robot. The daemon calls `serve` once, before the driver runs."""

    @property
    def runs(self) -> Mapping[str, DriverCommand]:
        """The commands that the options declare, by a name for `swarmd --check`."""

    def serve(self, take: TakeCommand) -> None:
        """Hand each command to `take` from now on."""


@runtime_checkable
class CommandingDriver(Protocol):
    """The extension of a driver that may receive commands to its robot."""

    command_source: CommandSource | None
    """None while an option of the driver turns it off"""


def command_source(driver: Driver) -> CommandSource | None:
    """What receives commands in the driver, or in the driver that it wraps; None without it."""
    bare = unwrapped(driver)
    return bare.command_source if isinstance(bare, CommandingDriver) else None
