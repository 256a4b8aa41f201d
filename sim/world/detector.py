"""Detections in the simulated world: robots, boxes and lamps within a sensor's field of view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from swarmd.core.values import MAX_DETECTIONS, Array, Detection
from swarmd.sim.world.geometry import Indices, transform
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

    `sensors` (s, 5): x, y, bearing, field of view and range in the base frame. The bearing NaN
    means ahead. A sensor recognises an object if the object's middle is within the field of view
    and the range, and if the line of sight from the sensor to the nearest point of the object is
    clear. Bearings and distances are measured from the axle to the middle of the object. If there
    are more than MAX_DETECTIONS, the last objects of `around` are left out.
    """
    pose = around.pose
    is_seen = np.zeros(len(around.names), dtype=np.bool_)
    sensor_places = transform(sensors[:, :2], pose)
    for place, (_, _, bearing, view, reach) in zip(sensor_places, sensors, strict=True):
        offset = around.places - place
        distance = np.hypot(offset[:, 0], offset[:, 1])
        axis = pose[2] + np.nan_to_num(bearing)  # NaN, ahead, becomes 0
        angle = np.arctan2(offset[:, 1], offset[:, 0]) - axis
        angle = np.abs(np.arctan2(np.sin(angle), np.cos(angle)))
        # False for an absent object, whose place is NaN.
        is_in_view = (distance <= reach) & (angle <= 0.5 * view)
        (candidates,) = np.nonzero(is_in_view & ~is_seen)
        if len(candidates):
            ends = _nearest_points(place, offset[candidates], around.extents[candidates])
            starts = np.broadcast_to(place, ends.shape)
            is_seen[candidates] = around.is_clear(starts, ends)
    return _detections(around, np.flatnonzero(is_seen))


def _nearest_points(place: Array, offsets: Array, extents: Array) -> Array:
    """(k, 2) the points of round objects that are nearest to `place` (2,).

    `offsets` (k, 2): from the place to the middle of each object. `extents` (k,): radii in m.
    """
    distances = np.hypot(offsets[:, 0], offsets[:, 1])
    surface_distances = np.maximum(distances - extents, 0.0)
    shares = surface_distances / np.maximum(distances, 1e-9)
    points: Array = place + offsets * shares[:, None]
    return points


def _detections(around: ObjectsAround, seen: Indices) -> tuple[Detection, ...]:
    """The detections of the objects with the indices `seen` (k,), at most MAX_DETECTIONS."""
    offset = around.places[seen] - around.pose[:2]
    bearings = np.arctan2(offset[:, 1], offset[:, 0]) - around.pose[2]
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
