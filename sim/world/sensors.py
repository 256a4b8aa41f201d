"""What the robots of a world measure and when, as inputs, for lockstep and real time.

Odometry, which lockstep hands over to all robots at once, and neighbors, which the radio gives, are
not among them.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from swarmd.core.events import (
    DetectionsInput,
    PoseInput,
    RangesInput,
    ReadingsInput,
    ScanInput,
    SensorInput,
)
from swarmd.sim.world.detector import DETECTIONS, detections_of
from swarmd.sim.world.geometry import Indices
from swarmd.sim.world.scalar_fields import READINGS_RATE
from swarmd.sim.world.world import World

POSE_RATE = 20.0
Rows = Sequence[int] | Indices


class Sensor(NamedTuple):
    """A sensor beside lidar and range sensors: one row of SENSORS.

    `measure` gives the input of a robot, by its row and the stamp in s, or None without such a
    sensor. `need`: a pattern that does not need this gets `unwanted` in place of a measurement.
    """

    rate: float
    is_there: Callable[[World], bool]
    measure: Callable[[World, int, float], SensorInput | None]
    need: str = ""
    unwanted: SensorInput | None = None


def detections(world: World, row: int, stamp: float) -> DetectionsInput | None:
    """The robots, boxes and lamps that a robot recognises; None without a sensor for them."""
    sensors = world.platforms[row].sensors.get(DETECTIONS)
    if sensors is None:
        return None
    return DetectionsInput(detections_of(sensors, world.objects_around(row)))


SENSORS = (
    Sensor(
        READINGS_RATE,
        lambda world: world.has_readings,
        lambda world, row, stamp: ReadingsInput(dict(world.readings(row))),
    ),
    # Detections cost a third of a run.
    Sensor(
        READINGS_RATE,
        lambda world: any(DETECTIONS in platform.sensors for platform in world.platforms),
        detections,
        DETECTIONS,
        DetectionsInput(None),
    ),
    Sensor(
        POSE_RATE,
        lambda world: bool(world.posed),
        lambda world, row, stamp: (
            PoseInput(world.shared_pose(row, stamp)) if row in world.posed else None
        ),
    ),
)


ALL_NEEDS = frozenset(sensor.need for sensor in SENSORS)
"""Of a pattern that may need any sensor."""


class DueTimes(Protocol):
    """When a sensor of each robot measures."""

    def due(self, now: float) -> Rows:
        """The rows due by `now` s."""


@dataclass(frozen=True, slots=True)
class SensorTimes:
    """The schedules of scans, of rings by their number in `World.rings`, and of other sensors."""

    scans: DueTimes
    rings: DueTimes
    others: Sequence[tuple[Sensor, DueTimes]]


def sensors_due(
    world: World,
    times: SensorTimes,
    needs: Callable[[int], Container[str] | None],
    *,
    stamp: float,
    own: Callable[[Any], Rows] = lambda rows: rows,
) -> Iterator[tuple[int, SensorInput]]:
    """What sensors measure at the world's time: the row of each robot, and its input.

    `needs`: what the pattern of a robot needs; None: nothing takes its inputs. `own` selects the
    rows whose scans this process makes. `stamp` in s: of poses.
    """
    now = world.time
    rows = own(times.scans.due(now))
    if len(rows):
        world.begin_scans(np.asarray(rows, dtype=np.intp))
    for row, scan in world.arrived_scans():
        yield row, ScanInput(scan)
    for ring in times.rings.due(now):
        row = world.rings[ring]
        if needs(row) is not None:
            yield row, RangesInput(world.ring_scan(row))
    for sensor, schedule in times.others:
        for due in schedule.due(now):
            row = int(due)
            needed = needs(row)
            if needed is None:
                continue
            is_wanted = not sensor.need or sensor.need in needed
            input = sensor.measure(world, row, stamp) if is_wanted else sensor.unwanted
            if input is not None:
                yield row, input
