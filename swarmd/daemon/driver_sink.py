"""Makes inputs of the robot from what its driver measures."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from swarmd.core.clock import boottime
from swarmd.core.codec import decode_value
from swarmd.core.errors import CodecError
from swarmd.core.events import (
    DriverInput,
    HazardsInput,
    Input,
    MessageInput,
    NeighborsInput,
    OdometryInput,
    PoseInput,
    RangesInput,
    ReadingsInput,
    ScanInput,
)
from swarmd.core.hazard import Hazard
from swarmd.core.messages import Reason
from swarmd.core.values import Neighbor, Odometry, Scan, SharedPose
from swarmd.daemon.neighbors import NeighborSelection

MAX_KIND_LENGTH = 64


class DriverSink:
    """The driver's sink: makes inputs for `step`.

    `neighborhood` marks which of the sensed robots are in reach. `has_neighbors`: the driver senses
    robots itself. `drops`: unreadable inputs by kind.
    """

    def __init__(self, step: Callable[[Input], None], neighborhood: NeighborSelection) -> None:
        self._step = step
        self._neighborhood = neighborhood
        self.has_neighbors = False
        self.drops: dict[str, int] = {}

    def scan(self, scan: Scan) -> None:
        """A scan as measured."""
        self._step(ScanInput(scan))

    def ranges(self, scan: Scan) -> None:
        """A scan of the ring of range sensors, as measured."""
        self._step(RangesInput(scan))

    def odometry(self, odometry: Odometry) -> None:
        """A measured pose and twist."""
        self._step(OdometryInput(odometry))

    def neighbors(self, neighbors: tuple[Neighbor, ...]) -> None:
        """The robots that the driver senses, or whose messages it can receive."""
        self.has_neighbors = True
        self._step(NeighborsInput(self._neighborhood.select(neighbors, boottime())))

    def pose(self, pose: SharedPose) -> None:
        """The robot's own pose in a frame that robots share."""
        self._neighborhood.on_pose(pose)
        self._step(PoseInput(pose))

    def readings(self, values: Mapping[str, float]) -> None:
        """Scalar sensors by name."""
        self._step(ReadingsInput(dict(values)))

    def hazards(self, hazards: tuple[Hazard, ...]) -> None:
        """All hazards that the base senses now."""
        self._step(HazardsInput(hazards))

    def message(self, sender: str, channel: str, payload: bytes) -> None:
        """A pattern's message that the base's radio received."""
        try:
            value = decode_value(payload)
        except CodecError:
            self.dropped("message")
        else:
            self._step(MessageInput(sender, channel, value))

    def state(
        self, is_up: bool, text: str, *, hold: Reason | None = None, gets_zero: bool = False
    ) -> None:
        """The base is connected, or lost for the reason `text`; see `Sink`."""
        self._step(DriverInput(is_up, text, hold, gets_zero))

    def dropped(self, what: str) -> None:
        """Count one input that could not be read."""
        kind = f"driver/{what}"[:MAX_KIND_LENGTH]
        self.drops[kind] = self.drops.get(kind, 0) + 1
