"""Lamps: light by the inverse square law, and the shadows of robots and obstacles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, TypeAlias

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.field_kind import FieldKind, Level, Point
from swarmd.sim.world.geometry import transform
from swarmd.sim.world.line_of_sight import LineOfSight

IsClear: TypeAlias = Callable[[Array, Array], NDArray[np.bool_]]
"""(k,) True where the line from place i of the first array (k, 2) to place i of the second is
clear."""


class LightField(FieldKind, frozen=True, kw_only=True, tag="light"):
    """A lamp at `center`, `height` m above the sensors: the light is `power` / squared distance.

    With `shadows` robots, boxes, poles and walls hide the lamp. A sensor that points at a bearing
    measures the light times the cosine of the angle between its bearing and the lamp, and 0 if the
    lamp is behind the sensor.
    """

    center: Point = (0.0, 0.0)
    power: Level = 1.0
    height: Annotated[float, Meta(ge=0.01, le=1000.0)] = 0.2
    shadows: bool = True

    def at(
        self, places: Array, bearings: Array | None = None, is_clear: IsClear | None = None
    ) -> Array:
        """The light (k,) at `places` (k, 2) in m; without `is_clear` nothing hides the lamp.

        `bearings` (k,) rad in the world, NaN for a sensor that takes light from all directions.
        """
        x = self.center[0] - places[:, 0]
        y = self.center[1] - places[:, 1]
        squared = x * x + y * y + self.height**2
        light: Array = self.power / squared
        if bearings is not None:
            towards = (x * np.cos(bearings) + y * np.sin(bearings)) / np.sqrt(squared)
            light = light * np.where(np.isnan(bearings), 1.0, np.maximum(towards, 0.0))
        if self.shadows and is_clear is not None:
            lamp = np.broadcast_to(np.array(self.center), places.shape)
            light = np.where(is_clear(lamp, places), light, 0.0)
        return light


class Shadows:
    """The obstacles between lamps and a robot: the arena and the outlines of all other bodies."""

    def __init__(self, shapes: Sequence[Array], arena: Arena) -> None:
        """`shapes` (k, 2): the outline of each body in its own frame."""
        most = max(map(len, shapes))
        # A repeated corner makes an edge without length, which hides nothing.
        repeated = (np.minimum(np.arange(most), len(shape) - 1) for shape in shapes)
        self._shapes = np.stack([s[rows] for s, rows in zip(shapes, repeated, strict=True)])
        self._sight = LineOfSight(arena)

    def around(self, body: int, poses: Array) -> IsClear:
        """The test for clear lines of sight past all bodies except `body`.

        `poses` (n, 3) of the bodies; NaN for an absent body.
        """
        outlines = np.delete(transform(self._shapes, poses), body, axis=0)
        return lambda lamp, places: self._sight.is_clear(lamp, places, outlines)
