"""Detections in the simulated world: robots, boxes and lamps within a sensor's field of view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from swarmd.core.values import MAX_DETECTIONS, Array, Detection
from swarmd.sim.world.geometry import transform
from swarmd.sim.world.light import IsClear

DETECTIONS = "detections"
"""The key of a platform's `sensors` for sensors that recognise objects."""


@dataclass(frozen=True, slots=True)
class ObjectsAround:
    """The objects that a robot may recognise."""

    pose: Array  # (3,) of the robot
    names: Sequence[tuple[str, str]]  # kind and id of each object
    places: Array  # (k, 2) in m; NaN for an absent object and for the robot itself
    extents: Array  # (k,) radius of each object in m
    is_clear: IsClear


def detections_of(sensors: Array, around: ObjectsAround) -> tuple[Detection, ...]:
    """The objects that the sensors of a robot recognise, each once, without measurement errors.

    `sensors` (s, 5): x, y, bearing, field of view and range in the base frame. An object is
    recognised if its middle is within the field of view and the range, and if the line of sight
    from the sensor to the nearest point of its extent is clear. Bearings and distances are measured
    from the axle to the middle of the object. The first MAX_DETECTIONS in the order of `around`.
    """
    # 1. The objects that any sensor recognises.
    pose, is_seen = around.pose, np.zeros(len(around.names), dtype=np.bool_)
    sensor_places = transform(sensors[:, :2], pose)
    for place, (_, _, bearing, view, reach) in zip(sensor_places, sensors, strict=True):
        offset = around.places - place
        distance = np.hypot(offset[:, 0], offset[:, 1])
        axis = pose[2] + np.nan_to_num(bearing)  # NaN: the sensor looks all around
        angle = np.arctan2(offset[:, 1], offset[:, 0]) - axis
        angle = np.abs(np.arctan2(np.sin(angle), np.cos(angle)))
        # False for an absent object, whose place is NaN.
        is_in_view = (distance <= reach) & (angle <= 0.5 * view)
        (in_view,) = np.nonzero(is_in_view & ~is_seen)
        if len(in_view):
            surface_distance = np.maximum(distance[in_view] - around.extents[in_view], 0.0)
            share = surface_distance / np.maximum(distance[in_view], 1e-9)
            nearest_points = place + offset[in_view] * share[:, None]
            starts = np.broadcast_to(place, nearest_points.shape)
            is_seen[in_view] = around.is_clear(starts, nearest_points)
    # 2. Their bearings and distances from the axle.
    seen = np.flatnonzero(is_seen)
    offset = around.places[seen] - pose[:2]
    bearings = np.arctan2(offset[:, 1], offset[:, 0]) - pose[2]
    bearings = np.arctan2(np.sin(bearings), np.cos(bearings))
    distances = np.hypot(offset[:, 0], offset[:, 1])
    objects = zip(
        (around.names[row] for row in seen.tolist()),
        bearings.tolist(),
        distances.tolist(),
        strict=True,
    )
    return tuple(
        Detection(kind, bearing, distance, name) for (kind, name), bearing, distance in objects
    )[:MAX_DETECTIONS]
