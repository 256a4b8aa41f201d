"""Arenas: a walled rectangle around the origin, with boxes and poles in it."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from swarmd.errors import ConfigError
from swarmd.sim.world.geometry import transform
from swarmd.values import Array

_WANTED = "wanted is such as 6x6, 6.6x4.8 or 6x6,box:1:0:0.5:0.3:45,pole:-1:2:0.1"
_SIZE = re.compile(r"([0-9.]+)x([0-9.]+)")


@dataclass(frozen=True, slots=True)
class Box:
    """A fixed box: centre and side lengths in m, yaw in rad; as high as the walls."""

    x: float
    y: float
    length: float
    width: float
    yaw: float = 0.0

    @property
    def corners(self) -> Array:
        """(4, 2), counter-clockwise, in m."""
        half = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) / 2.0
        return transform(half * (self.length, self.width), np.array([self.x, self.y, self.yaw]))


@dataclass(frozen=True, slots=True)
class Pole:
    """A fixed round pole: centre and radius in m; as high as the walls."""

    x: float
    y: float
    radius: float


@dataclass(frozen=True, slots=True)
class Arena:
    """The space between four walls, `length` m along x and `width` m along y."""

    length: float
    width: float
    boxes: tuple[Box, ...] = ()
    poles: tuple[Pole, ...] = ()

    @property
    def segments(self) -> Array:
        """Every flat surface as (k, 2, 2) start and end, the solid to the left of it, in m."""
        x, y = self.length / 2.0, self.width / 2.0
        walls = np.array([[-x, -y], [-x, y], [x, y], [x, -y]])
        loops = [walls, *(box.corners for box in self.boxes)]
        return np.concatenate(
            [np.stack((loop, np.roll(loop, -1, axis=0)), axis=1) for loop in loops]
        )

    @property
    def circles(self) -> Array:
        """Every pole as (k, 3) x, y and radius in m."""
        return np.array([[p.x, p.y, p.radius] for p in self.poles]).reshape(-1, 3)


def parse_arena(text: str) -> Arena:
    """The arena that a command line names; ConfigError if it cannot be read.

    `LxW` in m, then any number of `,box:x:y:length:width:yaw_deg` and `,pole:x:y:radius`.
    """
    size, *things = text.split(",")
    match = _SIZE.fullmatch(size)
    if match is None:
        raise ConfigError(f"arena is {text!r}; {_WANTED}")
    boxes, poles = [], []
    for thing in things:
        kind, *words = thing.split(":")
        numbers = [_number(word, text) for word in words]
        if kind == "box" and len(numbers) in (4, 5):
            x, y, length, width, yaw = (*numbers, 0.0)[:5]
            boxes.append(Box(x, y, _size(length, text), _size(width, text), math.radians(yaw)))
        elif kind == "pole" and len(numbers) == 3:
            poles.append(Pole(numbers[0], numbers[1], _size(numbers[2], text)))
        else:
            raise ConfigError(f"arena {text!r}: {thing!r} is neither box nor pole; {_WANTED}")
    length, width = (_size(_number(word, text), text) for word in match.groups())
    return Arena(length, width, tuple(boxes), tuple(poles))


def _number(word: str, text: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"arena {text!r}: {word!r} is no number; {_WANTED}")
    return value


def _size(value: float, text: str) -> float:
    if not 0.01 <= value <= 10_000.0:
        raise ConfigError(f"arena {text!r}: a size is {value:g} m; wanted 0.01 to 10000 m")
    return value
