"""What a robot tells its peers for kin (`swarmd/robot/kin/`): its pose by odometry, and what it
sees.

All values are about the *visible middle* of a robot, the middle of what other lidars see of it, in
place of its axle: a peer at rest that turns does not seem to move.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Set
from typing import Annotated, NamedTuple

from msgspec import Meta, Struct

from swarmd.core.bounds import MAX_COORDINATE, MAX_SECONDS, Name

MOST_OBJECTS = 8
"""Objects in a message at most: the nearest."""
MOST_NAMES = 8
"""Names of robots in each list of a message at most."""
OBJECT = struct.Struct(">Hh")
"""An object in a message: its distance in mm and its bearing in mrad, big-endian."""
UNIT = 1e-3  # m, rad or s, of all numbers
_MOST = round(MAX_COORDINATE / UNIT)

Coordinate = Annotated[int, Meta(ge=-_MOST, le=_MOST)]
Angle = Annotated[int, Meta(ge=-3142, le=3142)]
Names = Annotated[tuple[Name, ...], Meta(max_length=MOST_NAMES)]


class KinMessage(Struct, frozen=True, array_like=True):
    """A message of one robot, some 25 bytes and 4 for each object.

    - `resets`: marks the frame of the odometry; another number is another frame.
    - `stamp`: ms on the clock of the sender, at which all other values are valid.
    - `x`, `y`, `yaw`: mm and mrad in the frame of the sender's odometry.
    - `objects`: for each narrow object two big-endian numbers: the distance in mm (uint16) and the
      bearing in mrad (int16) of its middle, from the sender's middle and its direction ahead.
    - `asks`: the sender runs a pattern that needs the places of its peers.
    - `stood`: ms for which the base of the sender has had the command zero; 0: it has another. A
      time, since a listener that misses messages would take two stands for one.
    - `doubted`: the robots that do not tell to see the sender where it is.
    - `straying`: the robots that move while they tell that they stand.
    - `fitting`: so many robots tell to see the sender where it is.
    - `is_partial`: the lidar of the sender leaves out directions or is short, so that it need not
      see a robot within 1.8 m.
    """

    resets: Annotated[int, Meta(ge=0, le=2**53)]
    stamp: Annotated[int, Meta(ge=0, le=round(MAX_SECONDS / UNIT))]
    x: Coordinate
    y: Coordinate
    yaw: Angle
    objects: Annotated[bytes, Meta(max_length=OBJECT.size * MOST_OBJECTS)] = b""
    asks: bool = False
    stood: Annotated[int, Meta(ge=0, le=round(MAX_SECONDS / UNIT))] = 0
    doubted: Names = ()
    straying: Names = ()
    fitting: Annotated[int, Meta(ge=0, le=2**31)] = 0
    is_partial: bool = False


class KinOpinions(NamedTuple):
    """What kin tells of faults of peers: the own findings, and the messages of peers that have any.

    `doubted`, `straying`: the figure of each robot, in words.
    """

    doubted: Mapping[str, str]
    straying: Mapping[str, str]
    fitting: Set[str]
    told: Mapping[str, KinMessage]
