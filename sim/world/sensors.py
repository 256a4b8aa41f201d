"""The due measurements of a world's robots as inputs, for lockstep and real time.

Odometry and neighbors are not included: lockstep hands odometry to all robots at once, and the
radio model finds the neighbors.
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
    """A sensor beside lidar and range sensors: one row of SENSORS."""

    rate: float  # Hz
    is_there: Callable[[World], bool]
    measure: Callable[[World, int, float], SensorInput | None]
    """The input of a robot, by its row and the stamp in s; None without such a sensor."""
    need: str = ""
    """The need of patterns that use this sensor; "": the sensor measures for every pattern."""
    unwanted: SensorInput | None = None
    """The input in place of a measurement for a pattern without this need; None: no input."""


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
"""The needs of a pattern that may use any sensor."""


class DueTimes(Protocol):
    """The schedule of one sensor of all robots."""

    def due(self, now: float) -> Rows:
        """The rows whose measurement is due by `now` s."""


@dataclass(frozen=True, slots=True)
class SensorTimes:
    """The schedules of scans, of rings (by index in `World.rings`), and of other sensors."""

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
    """Yield the row and the input of each measurement that is due at the world's time.

    `needs(row)`: the needs of the pattern that robot `row` runs; None: nothing takes the inputs of
    this robot, and only its scans are measured. `own`: selects from rows those whose scans this
    process simulates. `stamp`: the stamp of poses in s.
    """
    now = world.time
    # 1. Scans that are due begin now, and arrive when they are complete.
    scanning_rows = own(times.scans.due(now))
    if len(scanning_rows):
        world.begin_scans(np.asarray(scanning_rows, dtype=np.intp))
    for row, scan in world.arrived_scans():
        yield row, ScanInput(scan)
    # 2. Rings of range sensors.
    for ring in times.rings.due(now):
        row = world.rings[ring]
        if needs(row) is not None:
            yield row, RangesInput(world.ring_scan(row))
    # 3. All other sensors. A sensor with a `need` is measured only for patterns with this need; all
    # other patterns get the input `unwanted` of the sensor.
    for sensor, schedule in times.others:
        for due_row in schedule.due(now):
            row = int(due_row)
            pattern_needs = needs(row)
            if pattern_needs is None:
                continue
            is_for_every_pattern = not sensor.need
            is_wanted = is_for_every_pattern or sensor.need in pattern_needs
            input = sensor.measure(world, row, stamp) if is_wanted else sensor.unwanted
            if input is not None:
                yield row, input
