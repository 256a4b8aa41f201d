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
    from the axle to the middle of the object. At most MAX_DETECTIONS.
    """
    pose, is_seen = around.pose, np.zeros(len(around.names), dtype=np.bool_)
    for eye, (_, _, bearing, view, reach) in zip(
        transform(sensors[:, :2], pose), sensors, strict=True
    ):
        to = around.places - eye
        away = np.hypot(to[:, 0], to[:, 1])
        looks = pose[2] + np.nan_to_num(bearing)
        off = np.arctan2(to[:, 1], to[:, 0]) - looks
        off = np.abs(np.arctan2(np.sin(off), np.cos(off)))
        (near,) = np.nonzero((away <= reach) & (off <= 0.5 * view) & ~is_seen)  # false for NaN
        if len(near):
            share = np.maximum(away[near] - around.extents[near], 0.0) / np.maximum(
                away[near], 1e-9
            )
            ends = eye + to[near] * share[:, None]
            is_seen[near] = around.is_clear(np.broadcast_to(eye, ends.shape), ends)
    seen = np.flatnonzero(is_seen)
    to = around.places[seen] - pose[:2]
    bearings = np.arctan2(to[:, 1], to[:, 0]) - pose[2]
    bearings = np.arctan2(np.sin(bearings), np.cos(bearings))
    places = zip(bearings.tolist(), np.hypot(to[:, 0], to[:, 1]).tolist(), strict=True)
    return tuple(
        Detection(around.names[row][0], bearing, distance, around.names[row][1])
        for row, (bearing, distance) in zip(seen.tolist(), places, strict=True)
    )[:MAX_DETECTIONS]
