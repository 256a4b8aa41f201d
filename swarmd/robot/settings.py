"""The settings of a robot, and its identity in one life of the daemon. Values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from swarmd.core.goal import GoalRecord
from swarmd.core.host_messages import Layers
from swarmd.core.low_battery import LowBatterySettings
from swarmd.core.messages import NarrowestPassage
from swarmd.core.values import Platform, TouchZone
from swarmd.protection.compatibility import ACCEPTS_NONE, Accepts
from swarmd.protection.fence_settings import FenceSettings
from swarmd.robot.latches import LatchRecord


@dataclass(frozen=True, slots=True, eq=False)
class RobotSettings:
    """Settings of a robot beside its platform."""

    driver: str
    layers: Callable[[str], Layers]  # the configured parameters of a pattern, weakest layer first
    host: str = ""
    profile: str = "dev"
    is_secured: bool = False
    version: str = ""
    kernels: str = ""
    labels: tuple[str, ...] = ()
    touch: Mapping[str, TouchZone] = field(default_factory=dict)
    """By pattern, the part of the outline that may touch objects."""
    accepts: Accepts = ACCEPTS_NONE
    """The platforms beside which the robot may drive although its lidar misses them."""
    tells_pose: bool = False
    """The robot sends its pose in a shared frame to its peers, which compute its range and bearing
    from the pose."""
    fence: FenceSettings | None = None  # the area that the robot does not leave
    on_low_battery: LowBatterySettings | None = None  # None: a low battery changes nothing


@dataclass(frozen=True, slots=True, eq=False)
class EarlierLives:
    """The records of earlier daemon processes of a robot, from which the next process continues.

    `latches`, `goals`: the contents of their files, None without a file. `revision`: the last
    count of changes of the robot (a part of its epoch). `generation`: the number of the last load
    of a pattern.
    """

    latches: LatchRecord | None = None
    goals: GoalRecord | None = None
    revision: int = 0
    generation: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class RobotIdentity:
    """The robot that a pattern is loaded for; `instance`: the id of its daemon process."""

    robot: str
    platform: Platform
    settings: RobotSettings
    seed: int
    instance: str
    passage: NarrowestPassage | None
