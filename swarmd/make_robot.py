"""Makes a `Robot` with its steering and kin; each shell does it here: daemon, replay and lockstep.

The robot itself imports neither of both (`swarmd/robot/steering_interface.py`), since they may be
wrong.
"""

from __future__ import annotations

from swarmd.robot.kin.kin_maker import KinMaker
from swarmd.robot.robot import Robot
from swarmd.robot.setup import EarlierLives, RobotIdentity


def make_robot(
    identity: RobotIdentity,
    now: float,
    earlier: EarlierLives = EarlierLives(),  # noqa: B008  # it is frozen
) -> Robot:
    """The robot of an identity, at rest and without a run.

    `now`: s on the robot's clock. `earlier`: the records of earlier daemon processes.
    """
    from swarmd.robot.steering.steering import Steering  # 12 ms of a start

    return Robot(
        identity.robot,
        identity.platform,
        identity.setup,
        make_steering=Steering,
        make_kin=KinMaker(),
        seed=identity.seed,
        instance=identity.instance,
        now=now,
        earlier=earlier,
    )
