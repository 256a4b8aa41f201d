"""Receives what the driver measures and hands it to the robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from swarmd.core.clock import boottime
from swarmd.core.messages import Reason
from swarmd.core.values import Neighbor, Odometry, Scan, SharedPose
from swarmd.daemon.recorder import Recorder
from swarmd.robot.actions import Actions
from swarmd.robot.robot import Robot

MAX_KIND_LENGTH = 64


class DriverSink:
    """The driver's sink. `carry_out` is called with an input's name and the actions that follow.

    `has_neighbors`: the driver measures neighbors itself. `dropped`: unreadable inputs by kind.
    """

    def __init__(
        self, robot: Robot, recorder: Recorder, carry_out: Callable[[str, Actions], None]
    ) -> None:
        self._robot = robot
        self._recorder = recorder
        self._carry_out = carry_out
        self.has_neighbors = False
        self.drops: dict[str, int] = {}

    def scan(self, scan: Scan) -> None:
        """A scan as measured."""
        self._recorder.scan(scan)
        self._carry_out("scan", self._robot.on_scan(scan, boottime()))

    def odometry(self, odometry: Odometry) -> None:
        """A measured pose and twist."""
        self._recorder.odometry(odometry)
        self._robot.on_odometry(odometry, boottime())

    def neighbors(self, neighbors: tuple[Neighbor, ...]) -> None:
        """The robots within communication range, as the driver measures them."""
        self._recorder.neighbors(neighbors)
        self.has_neighbors = True
        self._robot.on_neighbors(neighbors, boottime())

    def pose(self, pose: SharedPose) -> None:
        """The robot's own pose in a frame that robots share."""
        self._recorder.pose(pose)
        self._robot.on_pose(pose, boottime())

    def readings(self, values: Mapping[str, float]) -> None:
        """Scalar sensors by name."""
        self._recorder.readings(values)
        self._robot.on_readings(values)

    def state(
        self, is_up: bool, text: str, *, hold: Reason | None = None, gets_zero: bool = False
    ) -> None:
        """The base is connected, or lost for the reason `text`; see `Sink`."""
        self._recorder.driver(is_up, text, hold=hold, gets_zero=gets_zero)
        now = boottime()
        actions = self._robot.on_driver(is_up, text, now, hold=hold, gets_zero=gets_zero)
        self._carry_out("driver", actions)

    def dropped(self, what: str) -> None:
        """Count one input that could not be read."""
        kind = f"driver/{what}"[:MAX_KIND_LENGTH]
        self.drops[kind] = self.drops.get(kind, 0) + 1
