"""What a robot is made of: its setup, the records of earlier lives, and its identity. Values."""

from __future__ import annotations

from msgspec import Struct

from swarmd.core.goal import GoalRecord
from swarmd.core.values import Platform
from swarmd.robot.latches import LatchRecord
from swarmd.settings.robot_settings import PatternParameters, RobotSettings


class RobotSetup(Struct, frozen=True, kw_only=True):
    """All that is configured of a robot beside its platform, and facts of its program.

    A recording holds the setup, so that a replay makes the same robot.

    - `labels`: those of the swarm file.
    - `base`: a digest of the options of the driver, which hold the address of the base, if any.
    - `tells_pose`: the robot sends its pose in a shared frame to its peers, which compute
      distance, bearing and heading from the pose.
    """

    driver: str
    base: str = ""
    host: str = ""
    profile: str = "dev"
    is_secured: bool = False
    version: str = ""
    kernels: str = ""
    labels: tuple[str, ...] = ()
    tells_pose: bool = False
    parameters: PatternParameters = PatternParameters()
    settings: RobotSettings = RobotSettings()


class EarlierLives(Struct, frozen=True):
    """The records of earlier daemon processes of a robot, from which the next process continues.

    `latches`, `goals`: the contents of their files, None without a file. `revision`: the last
    count of changes of the robot (a part of its epoch). `generation`: the number of the last load
    of a pattern.
    """

    latches: LatchRecord | None = None
    goals: GoalRecord | None = None
    revision: int = 0
    generation: int = 0


class RobotIdentity(Struct, frozen=True, eq=False, kw_only=True):
    """What a robot is made of: the robot that a pattern is loaded for, and that is recorded.

    `seed`: of its random generator. `instance`: the id of its daemon process.
    """

    robot: str
    platform: Platform
    setup: RobotSetup
    seed: int
    instance: str
