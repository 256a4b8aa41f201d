"""Opinions of voting patterns, exchanged with robots that do not run swarmd, such as ROS robots."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeAlias, runtime_checkable

from swarmd.driver_api.driver import Driver, unwrapped

_NUMBER = re.compile(r"\d{1,9}$")


def number_of(robot: str) -> int | None:
    """The number at the end of a robot's name, which ROS2swarm's messages have; None without."""
    digits = _NUMBER.search(robot)
    return None if digits is None else int(digits[0])


class HeardOpinion(NamedTuple):
    """The opinion of a robot without swarmd. Nothing proves its sender.

    `name`: the name of the robot in its own system. `number`: the number of the robot, if its
    messages have a number in place of a name. `is_declared`: the driver's options name the robot.
    """

    name: str
    opinion: int
    number: int | None
    is_declared: bool


HearOpinion: TypeAlias = Callable[[HeardOpinion], None]


class OpinionLink(Protocol):
    """Exchanges opinions with robots without swarmd. The daemon calls `hear` once, first."""

    def hear(self, hear: HearOpinion) -> None:
        """Hand each opinion to `hear` from now on, on the loop."""

    def publish(self, opinion: int) -> None:
        """Publish the opinion of the own pattern; never blocks, dropped while lost."""


@runtime_checkable
class VotingDriver(Protocol):
    """The extension of a driver that may exchange opinions with robots without swarmd."""

    opinion_link: OpinionLink | None
    """None while an option of the driver turns it off"""


def opinion_link(driver: Driver) -> OpinionLink | None:
    """What exchanges opinions in the driver, or in the driver that it wraps; None without it."""
    bare = unwrapped(driver)
    return bare.opinion_link if isinstance(bare, VotingDriver) else None
