"""Rows for who slides along something that is near: what moves is met elsewhere than it was seen.

Along a face nothing of a robot closes on what it passes, if that stands. Two that slide towards the
same place each pass what stood there when they last looked, until their corners meet. So where the
room of a row is used up, how fast the outline comes nearer is bounded in other directions as well,
by what is left until the two touch.
"""

from __future__ import annotations

import math

import numpy as np

from swarmd.protection.feasible import Point
from swarmd.protection.footprint import Facing
from swarmd.protection.rows import Rows
from swarmd.values import Array

_ASIDE = math.radians(60.0)
"""By how much it may be in another direction than it was seen: moving away stays free."""


def sliding(
    rows: Rows, facing: Facing, corners: Array, along: Point, rest: Array, creep: float
) -> Rows:
    """Two more for each of `rows` whose cap is 0; `facing` is how the outline faces them.

    They bound its corners (c, 2) that are foremost in these directions. `rest` (k,) m/s is how fast
    it may come nearer without a touch before it has looked again, where the other does the same;
    `creep` m/s is always allowed.
    """
    near = np.flatnonzero(rows.caps <= 0.0)
    x, y, gaps, nx, ny = (
        np.concatenate((part[near], part[near]))
        for part in (rows.x, rows.y, rows.gaps, facing.nx, facing.ny)
    )
    sin = np.repeat((math.sin(_ASIDE), -math.sin(_ASIDE)), len(near))
    ax, ay = math.cos(_ASIDE) * nx - sin * ny, sin * nx + math.cos(_ASIDE) * ny
    foremost = corners[(corners[:, :1] * ax + corners[:, 1:] * ay).argmax(axis=0)]
    lever = foremost[:, 0] * ay - foremost[:, 1] * ax
    caps = np.maximum(rest[near], creep)
    caps = np.concatenate((caps, caps))
    return Rows(ax * along[0] + ay * along[1], lever, caps, x, y, gaps)
