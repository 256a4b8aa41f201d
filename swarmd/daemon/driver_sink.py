"""Receives what the driver measures and hands it to the robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from swarmd.core.clock import boottime
from swarmd.core.codec import decode_value
from swarmd.core.errors import CodecError
from swarmd.core.hazard import Hazard
from swarmd.core.messages import Reason
from swarmd.core.values import Neighbor, Odometry, Scan, SharedPose
from swarmd.daemon.neighbors import NeighborSelection
from swarmd.robot.actions import Actions
from swarmd.robot.robot import Robot

MAX_KIND_LENGTH = 64


class DriverSink:
    """The driver's sink. `carry_out` is called with the actions that follow from an input.

    `neighborhood` marks which of the sensed robots are in reach. `has_neighbors`: the driver senses
    robots itself. `dropped`: unreadable inputs by kind.
    """

    def __init__(
        self,
        robot: Robot,
        carry_out: Callable[[Actions], None],
        neighborhood: NeighborSelection,
    ) -> None:
        self._robot = robot
        self._carry_out = carry_out
        self._neighborhood = neighborhood
        self.has_neighbors = False
        self.drops: dict[str, int] = {}

    def scan(self, scan: Scan) -> None:
        """A scan as measured."""
        self._carry_out(self._robot.on_scan(scan, boottime()))

    def ranges(self, scan: Scan) -> None:
        """A scan of the ring of range sensors, as measured."""
        self._carry_out(self._robot.on_ranges(scan, boottime()))

    def odometry(self, odometry: Odometry) -> None:
        """A measured pose and twist."""
        self._robot.on_odometry(odometry, boottime())

    def neighbors(self, neighbors: tuple[Neighbor, ...]) -> None:
        """The robots that the driver senses, or whose messages it can receive."""
        self.has_neighbors = True
        now = boottime()
        self._robot.on_neighbors(self._neighborhood.select(neighbors, now), now)

    def pose(self, pose: SharedPose) -> None:
        """The robot's own pose in a frame that robots share."""
        self._neighborhood.on_pose(pose)
        self._robot.on_pose(pose, boottime())

    def readings(self, values: Mapping[str, float]) -> None:
        """Scalar sensors by name."""
        self._robot.on_readings(values)

    def hazards(self, hazards: tuple[Hazard, ...]) -> None:
        """All hazards that the base senses now."""
        self._carry_out(self._robot.on_hazards(hazards, boottime()))

    def message(self, sender: str, channel: str, payload: bytes) -> None:
        """A pattern's message that the base's radio received."""
        try:
            value = decode_value(payload)
            is_accepted = self._robot.on_message(sender, channel, value, boottime())
        except CodecError:
            self.dropped("message")
            return
        if not is_accepted:
            self.dropped("message:not_a_neighbor")

    def state(
        self, is_up: bool, text: str, *, hold: Reason | None = None, gets_zero: bool = False
    ) -> None:
        """The base is connected, or lost for the reason `text`; see `Sink`."""
        now = boottime()
        self._carry_out(self._robot.on_driver(is_up, text, now, hold=hold, gets_zero=gets_zero))

    def dropped(self, what: str) -> None:
        """Count one input that could not be read."""
        kind = f"driver/{what}"[:MAX_KIND_LENGTH]
        self.drops[kind] = self.drops.get(kind, 0) + 1
