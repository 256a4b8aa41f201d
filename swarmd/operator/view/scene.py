"""The content of a terminal view: robots, poses, and texts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from swarmd.core.messages import Status

Place = tuple[float, float, float]
"""x, y in m and yaw in rad."""

MIN_SIDE = 2.0
"""The smallest side of the area around known places, in m."""


@dataclass(frozen=True, slots=True)
class Area:
    """A rectangle on the floor: `center` x, y and `size` along x and y, in m."""

    size: tuple[float, float]
    center: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Scene:
    """The content of a terminal view."""

    title: str
    area: Area
    poses: Mapping[str, Place]  # of robots whose pose is known
    statuses: Mapping[str, Status]  # of robots that answered
    footer: str = ""
    footer_style: str = "dim"
    robots: Sequence[str] = ()  # all robots in the order of the table; empty: that of `poses`
    notes: Mapping[str, str] = field(default_factory=dict)  # a few words on robots without status
    below: Sequence[tuple[str, str]] = ()  # lines under table and map, with their styles
    map_note: str = ""

    @property
    def order(self) -> Sequence[str]:
        """The robots in the order of the table."""
        return self.robots or tuple(self.poses)


def area_around(poses: Mapping[str, Place]) -> Area:
    """An area in whole metres that contains all places, with a margin of at least 0.5 m."""
    if not poses:
        return Area((2.0 * MIN_SIDE, 2.0 * MIN_SIDE))
    spans = []
    for axis in (0, 1):
        values = [pose[axis] for pose in poses.values()]
        low = math.floor(min(values) - 0.5)
        high = math.ceil(max(values) + 0.5)
        spans.append((low, max(high, low + MIN_SIDE)))
    (left, right), (bottom, top) = spans
    return Area((right - left, top - bottom), ((left + right) / 2.0, (bottom + top) / 2.0))
