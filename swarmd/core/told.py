"""What a robot tells its peers for kin (`swarmd/kin/`): its pose by odometry, and what it sees.

All values are about the *visible middle* of a robot, the middle of what other lidars see of it, in
place of its axle: a peer at rest that turns does not seem to move.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

from msgspec import Meta, Struct

from swarmd.core.bounds import MAX_SECONDS
from swarmd.core.values import MAX_COORDINATE

MOST_OBJECTS = 8
"""Objects in a message at most: the nearest."""
UNIT = 1e-3  # m, rad or s, of all numbers
_MOST = round(MAX_COORDINATE / UNIT)

Coordinate = Annotated[int, Meta(ge=-_MOST, le=_MOST)]
Angle = Annotated[int, Meta(ge=-3142, le=3142)]
Distance = Annotated[int, Meta(ge=0, le=100_000)]


class Told(Struct, frozen=True, array_like=True):
    """A message of one robot, some 40 bytes and 6 for each object.

    - `resets`: marks the frame of the odometry; another number is another frame.
    - `stamp`: ms on the clock of the sender, at which all other values are valid.
    - `x`, `y`, `yaw`: mm and mrad in the frame of the sender's odometry.
    - `objects`: distance in mm and bearing in mrad of the middle of each narrow object, from the
      sender's middle and the direction in which the sender faces.
    - `asks`: the sender runs a pattern that needs the places of its peers.
    """

    resets: Annotated[int, Meta(ge=0, le=2**53)]
    stamp: Annotated[int, Meta(ge=0, le=round(MAX_SECONDS / UNIT))]
    x: Coordinate
    y: Coordinate
    yaw: Angle
    objects: Annotated[tuple[tuple[Distance, Angle], ...], Meta(max_length=MOST_OBJECTS)] = ()
    asks: bool = False


def tell(
    resets: int,
    stamp: float,
    pose: tuple[float, float, float],
    objects: Iterable[tuple[float, float]],
    *,
    asks: bool,
) -> Told:
    """The message of a robot. `pose`: x, y, yaw. `objects`: distance and bearing; m, rad and s."""
    nearest = tuple(
        (round(distance / UNIT), round(bearing / UNIT))
        for distance, bearing in sorted(objects)[:MOST_OBJECTS]
    )
    stamp_ms, x, y, yaw = (round(number / UNIT) for number in (stamp, *pose))
    return Told(resets, stamp_ms, x, y, yaw, nearest, asks)
