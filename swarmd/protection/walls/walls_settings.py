"""The settings of walls that stand. The schema of files imports this module: no numpy."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

STILL = 0.02
"""m by which the noise of ranges may move the line of a wall between two scans."""


class WallsStand(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The assumption that long, straight surfaces which have stood still do not begin to move."""

    # m, the least length of such a surface. Higher: fewer walls count. Lower than the longest body,
    # or row of bodies, around the robot: this body counts as a wall once it has stood.
    length: Annotated[float, Meta(ge=0.2, le=2.0)] = 0.5
    # s for which the surface must have stood still, seen in each scan. Higher: walls that come into
    # view count later. Lower: a body that stops for a short time counts sooner.
    seconds: Annotated[float, Meta(ge=1.0, le=60.0)] = 2.0

    @property
    def unnoticed_speed(self) -> float:
        """The m/s of a wall that moves by less than STILL in `seconds`, which is not noticed."""
        return STILL / self.seconds
