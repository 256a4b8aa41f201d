"""Makes the robot of a daemon from settings and files, and the head of its recordings."""

from __future__ import annotations

import socket
from collections.abc import Iterable
from importlib.metadata import version
from platform import machine

from swarmd.core.clock import boottime, clock_id
from swarmd.core.goal import GoalRecord
from swarmd.core.host_messages import Layers
from swarmd.core.kernels import describe_kernels
from swarmd.plugins import pattern_names
from swarmd.recording.head import RecordingHead
from swarmd.robot.latches import LatchRecord
from swarmd.robot.robot import Robot
from swarmd.robot.settings import EarlierLives, RobotSettings
from swarmd.settings.settings import DaemonSettings


def make_robot(
    settings: DaemonSettings, instance: str, seed: int, *, latches: LatchRecord, goals: GoalRecord
) -> Robot:
    """The robot of this daemon, at rest and without a run.

    `instance`: the id of this daemon process, in hex. `seed`: the seed of the robot's random
    generator. `latches`, `goals`: emergency stops and goals that the files of an earlier daemon
    process hold.
    """

    def layers(pattern: str) -> Layers:
        """The layers of parameters of a pattern. Labels change, so each call reads them anew."""
        return settings.pattern_layers(pattern, robot.labels)

    robot = Robot(
        settings.id,
        settings.platform,
        RobotSettings(
            driver=settings.driver,
            layers=layers,
            host=socket.gethostname(),
            profile=settings.network.profile,
            is_secured=settings.identity is not None,
            version=version("swarmd"),
            kernels=describe_kernels(),
            labels=settings.labels,
            touch=settings.touch_zones,
            accepts=settings.accepts,
            # Peers whose neighborhood is "range" need the pose, to compute the distance.
            tells_pose=settings.neighbors.neighborhood == "range",
            fence=settings.fence,
            on_low_battery=settings.on_low_battery,
        ),
        seed=seed,
        instance=instance,
        now=boottime(),
        earlier=EarlierLives(latches, goals),
    )
    return robot


def recording_head(
    settings: DaemonSettings, robot: Robot, instance: str, seed: int, pushed: Iterable[str]
) -> RecordingHead:
    """The head of a recording: all values from which a replay makes the same robot.

    `robot`: the robot in its state at the begin of the recording. `instance`: the id of this daemon
    process. `seed`: the seed of the robot's random generator. `pushed`: the names of the pushed
    patterns.
    """
    names = {*pattern_names(settings.plugin_dir), *pushed}
    # The layers of parameters of each pattern; patterns without own parameters are left out.
    layers = {name: settings.pattern_layers(name, robot.labels) for name in sorted(names)}
    return RecordingHead(
        robot=settings.id,
        swarm=settings.network.swarm,
        driver=settings.driver,
        clock=clock_id(),
        instance=instance,
        seed=seed,
        version=version("swarmd"),
        kernels=describe_kernels(),
        machine=machine(),
        platform=settings.platform,
        labels=robot.labels,
        layers={name: values for name, values in layers.items() if values},
        touch=settings.touch_zones,
        accepts=settings.accepts,
        fence=settings.fence,
        on_low_battery=settings.on_low_battery,
        revision=robot.epoch.revision,
        generation=robot.generation,  # count of the loads of patterns so far
        latches=robot.aged_latches(boottime()),
        cleared=tuple(robot.cleared),  # ids of latches that were reset
        goals=robot.goals,
    )
