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
    """The robot for the life `instance` of the daemon; `latches` and `goals` come from files."""

    def layers(pattern: str) -> Layers:
        return settings.pattern_layers(pattern, robot.labels)  # labels may change during a life

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
            tells_pose=settings.neighbors.neighborhood == "range",
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
    """The head of a recording: all that a replay needs to make the same robot.

    `pushed`: the names of the pushed patterns.
    """
    names = {*pattern_names(settings.plugin_dir), *pushed}
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
        revision=robot.epoch.revision,
        generation=robot.generation,
        latches=robot.latches,
        cleared=tuple(robot.cleared),
        goals=robot.goals,
    )
