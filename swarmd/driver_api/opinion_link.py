"""Opinions of voting patterns, exchanged with robots that do not run swarmd, such as ROS robots."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeAlias, runtime_checkable

from swarmd.driver_api.driver import Driver, unwrapped


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


@runtime_checkable
class OpinionLink(Protocol):
    """The extension of a driver that exchanges opinions with robots without swarmd.

    While `exchanges_opinions`, the daemon calls `hear_opinions` once, before `run`.
    """

    exchanges_opinions: bool

    def hear_opinions(self, hear: HearOpinion) -> None:
        """Hand each opinion to `hear` from now on, on the loop."""

    def publish_opinion(self, opinion: int) -> None:
        """Publish the opinion of the own pattern; never blocks, dropped while lost."""


def opinion_link(driver: Driver) -> OpinionLink | None:
    """The driver, or the driver that it wraps, if it exchanges opinions."""
    bare = unwrapped(driver)
    return bare if isinstance(bare, OpinionLink) and bare.exchanges_opinions else None
