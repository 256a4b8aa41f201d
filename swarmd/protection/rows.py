"""Half-planes of commands: what the rows of mode `barrier` are made of."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from swarmd.protection.feasible import Point
from swarmd.protection.footprint import Footprint
from swarmd.protection.verdict import Row
from swarmd.values import Array, Limits, Pose, Twist

MOST = 4
"""Rows that a verdict names."""


class Rows(NamedTuple):
    """Half-planes: closing speed = linear * v + lever * w <= cap, for points at x, y."""

    linear: Array
    lever: Array
    caps: Array
    x: Array
    y: Array
    gaps: Array


def joined(one: Rows, other: Rows) -> Rows:
    """The rows of both."""
    return Rows(*(np.concatenate(pair) for pair in zip(one, other, strict=True)))


def bounding(rows: Rows, tight: list[int], outline: Footprint) -> tuple[Row, ...]:
    """The rows that bound the command, those with the lowest caps first.

    A row may be that of a corner, which is further off than `outline` is: what it tells is the gap.
    """
    among = [i for i in tight if i < len(rows.caps)]  # the others are the envelope's
    seen = [i for i in among if rows.gaps[i] < math.inf]  # the others are of a touch zone
    order = sorted(seen, key=lambda i: (float(rows.caps[i]), float(rows.gaps[i])))
    shown = order[:MOST]
    gaps = outline.gaps(np.stack((rows.x[shown], rows.y[shown]), axis=1)) if shown else ()
    return tuple(
        Row(math.atan2(float(rows.y[i]), float(rows.x[i])), float(gap), float(rows.caps[i]))
        for i, gap in zip(shown, gaps, strict=True)
    )


def split(wish: Twist) -> tuple[Point, float]:
    """The direction of the linear motion and the speed along it; ahead if there is none."""
    if wish.lateral == 0.0:
        return (1.0, 0.0), wish.linear
    speed = math.hypot(wish.linear, wish.lateral)
    return (wish.linear / speed, wish.lateral / speed), speed


def most(limits: Limits, along: Point) -> float:
    """The limit of the linear speed in a direction, in m/s."""
    linear, lateral = abs(along[0]), abs(along[1])
    return min(
        limits.linear / linear if linear else math.inf,
        limits.lateral / lateral if lateral else math.inf,
    )


def placed(x: Array, y: Array, frame: Pose) -> tuple[Array, Array]:
    """The x and y of points of a frame."""
    cos, sin = math.cos(frame.yaw), math.sin(frame.yaw)
    return frame.x + cos * x - sin * y, frame.y + sin * x + cos * y
