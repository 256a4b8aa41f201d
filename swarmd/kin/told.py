"""What a robot tells its peers for kin: its own pose by odometry, and the narrow objects it sees.

Quantized and bounded: at most 9 + 2 * MOST_OBJECTS integers. All values are about the *visible
middle* of a robot, the middle of what other lidars see of it, in place of its axle: a peer at rest
that turns does not seem to move.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from msgspec import Struct

from swarmd.core.values import MAX_COORDINATE

MOST_OBJECTS = 8
"""Objects in a message at most: the nearest."""
_MM = 1000.0  # units of place and distance in a m, of yaw and bearing in a rad, of time in a s
_MOST_UNITS = int(MAX_COORDINATE * _MM)
_MOST_AGE = 2000  # ms: an older message says too little of where the peer is


class Told(Struct, frozen=True, array_like=True):
    """A message of one robot.

    `stamp`: ms on the clock of the sender, at which `x`, `y`, `yaw` (mm, mrad, in the frame of the
    sender's odometry) and `objects` are valid. `age`: ms from the stamp to sending. `resets`: how
    often the frame of the odometry has begun anew. `objects`: distance (mm) and bearing (mrad, from
    the direction in which the sender faces) of each object's middle, seen from the sender's middle.
    """

    id: str
    resets: int
    stamp: int
    age: int
    x: int
    y: int
    yaw: int
    objects: tuple[tuple[int, int], ...] = ()

    @property
    def is_valid(self) -> bool:
        """True if all numbers are within their bounds."""
        numbers = [self.x, self.y, self.yaw, *(n for pair in self.objects for n in pair)]
        return (
            0 <= self.age <= _MOST_AGE
            and len(self.objects) <= MOST_OBJECTS
            and all(-_MOST_UNITS <= number <= _MOST_UNITS for number in numbers)
        )


def tell(
    id: str,
    resets: int,
    stamp: float,
    age: float,
    pose: tuple[float, float, float],
    objects: Iterable[tuple[float, float]],
) -> Told:
    """The message of a robot. `pose`: x, y, yaw. `objects`: distance and bearing; m, rad and s."""
    nearest = sorted(objects)[:MOST_OBJECTS]
    units = [round(number * _MM) for number in (stamp, age, *pose)]
    return Told(id, resets, *units, tuple((round(d * _MM), round(b * _MM)) for d, b in nearest))


def in_units(number: int) -> float:
    """A number of a message in m, rad or s."""
    return number / _MM


def wrapped(angle: float) -> float:
    """The angle in rad within -pi to pi."""
    return math.remainder(angle, math.tau)
