"""Makes the robot of a daemon from settings and files, and the head of its recordings."""

from __future__ import annotations

import socket
from importlib.metadata import version
from platform import machine

from swarmd.core.clock import boottime, clock_id
from swarmd.core.goal import GoalRecord
from swarmd.core.kernels import describe_kernels
from swarmd.core.libm import digest_of_libm
from swarmd.core.pin import how_made
from swarmd.daemon.recording.head import RecordingHead, digest_of
from swarmd.make_robot import make_robot
from swarmd.robot.latches import LatchRecord
from swarmd.robot.robot import Robot
from swarmd.robot.setup import EarlierLives, RobotIdentity, RobotSetup
from swarmd.settings.settings import DaemonSettings


def configured_robot(
    settings: DaemonSettings, instance: str, seed: int, *, latches: LatchRecord, goals: GoalRecord
) -> Robot:
    """The robot of this daemon, at rest and without a run.

    `instance`: the id of this daemon process, in hex. `seed`: the seed of the robot's random
    generator. `latches`, `goals`: emergency stops and goals that the files of an earlier daemon
    process hold.
    """
    setup = RobotSetup(
        driver=settings.file.driver,
        base=digest_of(settings.driver_options),
        host=socket.gethostname(),
        profile=settings.network.profile,
        is_secured=settings.identity is not None,
        version=version("swarmd"),
        kernels=describe_kernels(),
        labels=settings.labels,
        # Peers need the pose for their neighborhood "range", and for patterns that use places.
        tells_pose=settings.file.neighbors.neighborhood == "range"
        or "pose" in settings.platform.provides,
        parameters=settings.parameters,
        settings=settings.robot,
    )
    identity = RobotIdentity(
        robot=settings.id, platform=settings.platform, setup=setup, seed=seed, instance=instance
    )
    return make_robot(identity, boottime(), EarlierLives(latches=latches, goals=goals))


def recording_head(robot: Robot, swarm: str, now: float) -> RecordingHead:
    """The head of a recording: all values from which a replay makes the same robot.

    `robot`: the robot in its state at the begin of the recording, `now` s on its clock.
    """
    latches = LatchRecord(held=robot.aged_latches(now), cleared=tuple(robot.cleared))
    return RecordingHead(
        swarm=swarm,
        clock=clock_id(),
        machine=machine(),
        libm=digest_of_libm(),
        made=how_made(),
        identity=robot.identity,
        earlier=EarlierLives(
            latches=latches,
            goals=robot.goals,
            revision=robot.epoch.revision,
            generation=robot.generation,  # count of the loads of patterns so far
        ),
    )
