"""Scalar fields in the plane, such as light, sampled at the robots' sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from swarmd.core.values import OPTION_INPUTS, Array, Platform, sensor_names
from swarmd.sim.world.field_kind import Degrees, Extent, FieldKind, Level, Point
from swarmd.sim.world.floor import FloorField
from swarmd.sim.world.geometry import transform
from swarmd.sim.world.light import IsClear, LightField

READINGS_RATE = 10.0
"""Hz, in live worlds and in lockstep."""

_MAX_READING = 1e6


class GaussianField(FieldKind, frozen=True, kw_only=True, tag="gaussian"):
    """A bell: `peak` at `center` (m), `floor` far away, `sigma` m its standard deviation."""

    center: Point = (0.0, 0.0)
    sigma: Extent
    peak: Level = 1.0
    floor: Level = 0.0

    def at(self, places: Array) -> Array:
        """The values (k,) at `places` (k, 2) in m."""
        squared = ((places - self.center) ** 2).sum(axis=-1)
        bell: Array = np.exp(squared / (-2.0 * self.sigma**2))
        return self.floor + (self.peak - self.floor) * bell


class LinearField(FieldKind, frozen=True, kw_only=True, tag="linear"):
    """A slope: `base` at `origin` (m), `slope` more with every metre along `direction_deg`."""

    origin: Point = (0.0, 0.0)
    direction_deg: Degrees = 0.0
    slope: Level
    base: Level = 0.0

    def at(self, places: Array) -> Array:
        """The values (k,) at `places` (k, 2) in m."""
        heading = math.radians(self.direction_deg)
        ahead = (places - self.origin) * (math.cos(heading), math.sin(heading))
        distance: Array = ahead.sum(axis=-1)
        return self.base + self.slope * distance


class UniformField(FieldKind, frozen=True, kw_only=True, tag="uniform"):
    """The same `value` everywhere."""

    value: Level

    def at(self, places: Array) -> Array:
        """The values (k,) at `places` (k, 2) in m."""
        return np.full(len(places), self.value)


Field: TypeAlias = GaussianField | LinearField | UniformField | FloorField | LightField
"""Configured as `{kind: gaussian | linear | ..., name: ..., ...}`; fields of one name add up."""


def channels_of(field: Field) -> tuple[str, ...]:
    """The names of the field's readings: its own, and those of the colours of a floor."""
    return field.channels if isinstance(field, FloorField) else (field.name,)


def sample(
    fields: Sequence[Field],
    places: Array,
    bearings: Array | None = None,
    is_clear: IsClear | None = None,
) -> dict[str, Array]:
    """The value (k,) of each reading at `places` (k, 2) in m; fields of one name add up.

    Values are clipped to +-1e6, the bound of a reading on the wire. `bearings` (k,): the directions
    of light sensors in rad in the world, NaN or None: light from all directions counts. `is_clear`:
    where a lamp is in sight; None: nothing hides a lamp.
    """
    values: dict[str, Array] = {}
    for field in fields:
        for name, value in _channels(field, places, bearings, is_clear).items():
            values[name] = values.get(name, 0.0) + value
    return {name: np.clip(value, -_MAX_READING, _MAX_READING) for name, value in values.items()}


def _channels(
    field: Field, places: Array, bearings: Array | None, is_clear: IsClear | None
) -> Mapping[str, Array]:
    if isinstance(field, LightField):
        return {field.name: field.at(places, bearings, is_clear)}
    values = {field.name: field.at(places)}
    if isinstance(field, FloorField) and field.is_coloured:
        values |= dict(zip(field.channels[1:], field.colours(places).T, strict=True))
    return values


def readings_at(
    fields: Sequence[Field],
    sensors: Mapping[str, Array],
    pose: Array,
    is_clear: IsClear | None = None,
) -> dict[str, float]:
    """The readings of a robot at `pose` (3,), by name.

    `sensors`: the sensors of the robot by name of the field, (k, 3) x, y and bearing in the base
    frame. The bearing is NaN for a sensor that senses all directions. A field with sensors has a
    reading for each sensor, `<name>_1`, `<name>_2` ..., and their mean as `<name>`. A field without
    sensors is sampled at the axle. `is_clear`: an argument of `LightField.at`.
    """
    at_axle = [field for field in fields if field.name not in sensors]
    readings = {
        name: float(value[0])
        for name, value in sample(at_axle, pose[None, :2], None, is_clear).items()
    }
    for name, own in sensors.items():
        read = [field for field in fields if field.name == name]
        places = transform(own[:, :2], pose)
        for channel, values in sample(read, places, pose[2] + own[:, 2], is_clear).items():
            # `sensor_names` begins with the name of the mean.
            each = float(values.mean()), *values.tolist()
            readings |= zip(sensor_names(channel, len(values)), each, strict=True)
    return readings


def with_readings(platform: Platform, fields: Sequence[Field]) -> Platform:
    """The platform with the readings of `fields` added to what it provides.

    A field gives `reading:<name>`, and `reading:<name>_<i>` for each sensor i that the platform has
    for the field. A kind of OPTION_INPUTS, such as seen tags, is added if the platform has sensors
    for it.
    """
    words = set(OPTION_INPUTS) & platform.sensors.keys()
    for field in fields:
        count = len(platform.sensors.get(field.name, ()))
        for name in channels_of(field):
            words |= {f"reading:{sensor}" for sensor in sensor_names(name, count)}
    return replace(platform, provides=platform.provides | words)
