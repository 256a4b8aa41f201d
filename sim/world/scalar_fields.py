"""Scalar fields in the plane, such as light, sampled at the robots' positions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, TypeAlias

import numpy as np
from msgspec import Meta, Struct

from swarmd.core.values import Array, Platform

Name = Annotated[
    str,
    Meta(
        pattern="^[A-Za-z_][A-Za-z0-9_]*$",
        max_length=63,
        extra_json_schema={"description": "up to 63 letters, digits and _"},
    ),
]
Level = Annotated[float, Meta(ge=-1e6, le=1e6)]
Coordinate = Annotated[float, Meta(ge=-10_000.0, le=10_000.0)]
Point = tuple[Coordinate, Coordinate]

READINGS_RATE = 10.0
"""Hz, in live worlds and in lockstep."""

_MAX_READING = 1e6


class _Field(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind"):
    name: Name


class GaussianField(_Field, frozen=True, kw_only=True, tag="gaussian"):
    """A bell: `peak` at `center` (m), `floor` far away, `sigma` m its standard deviation."""

    center: Point = (0.0, 0.0)
    sigma: Annotated[float, Meta(ge=0.001, le=10_000.0)]
    peak: Level = 1.0
    floor: Level = 0.0

    def at(self, places: Array) -> Array:
        """The values (k,) at `places` (k, 2) in m."""
        squared = ((places - self.center) ** 2).sum(axis=-1)
        bell: Array = np.exp(squared / (-2.0 * self.sigma**2))
        return self.floor + (self.peak - self.floor) * bell


class LinearField(_Field, frozen=True, kw_only=True, tag="linear"):
    """A slope: `base` at `origin` (m), `slope` more with every metre along `direction_deg`."""

    origin: Point = (0.0, 0.0)
    direction_deg: Annotated[float, Meta(ge=-360.0, le=360.0)] = 0.0
    slope: Level
    base: Level = 0.0

    def at(self, places: Array) -> Array:
        """The values (k,) at `places` (k, 2) in m."""
        heading = math.radians(self.direction_deg)
        ahead = (places - self.origin) * (math.cos(heading), math.sin(heading))
        distance: Array = ahead.sum(axis=-1)
        return self.base + self.slope * distance


class UniformField(_Field, frozen=True, kw_only=True, tag="uniform"):
    """The same `value` everywhere."""

    value: Level

    def at(self, places: Array) -> Array:
        """The values (k,) at `places` (k, 2) in m."""
        return np.full(len(places), self.value)


Field: TypeAlias = GaussianField | LinearField | UniformField
"""Configured as `{kind: gaussian | linear | uniform, name: ..., ...}`; one name adds up."""


def sample(fields: Sequence[Field], places: Array) -> dict[str, Array]:
    """The value (k,) of each name at `places` (k, 2) in m; fields of one name add up.

    Clipped to +-1e6, the bound of a reading on the wire.
    """
    values: dict[str, Array] = {}
    for field in fields:
        values[field.name] = values.get(field.name, 0.0) + field.at(places)
    return {name: np.clip(value, -_MAX_READING, _MAX_READING) for name, value in values.items()}


def with_readings(platform: Platform, fields: Sequence[Field]) -> Platform:
    """The platform with a sensor `reading:<name>` for each field."""
    words = {f"reading:{field.name}" for field in fields}
    return replace(platform, provides=platform.provides | words)
