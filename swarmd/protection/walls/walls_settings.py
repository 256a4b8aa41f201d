"""The settings of walls that stand, and their lines of a check and a status. No numpy."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta, Struct

from swarmd.core.messages import WallsStandSummary

if TYPE_CHECKING:
    from swarmd.protection.decision import LayerView

MOVING_WALL = "moving_wall"
"""How events and the finding about walls that moved begin."""

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
    def text(self) -> str:
        """The assumption in one line."""
        return f"walls of {self.length:g} m that stood for {self.seconds:g} s stand"

    def misfits(
        self, footprint: Sequence[tuple[float, float]]
    ) -> Iterator[tuple[tuple[str, ...], str]]:
        """The keys and the text of what does not fit a robot with the corners `footprint` in m."""
        widest = max(math.dist(a, b) for a in footprint for b in footprint)
        if self.length <= widest:
            yield (
                ("length",),
                f"is {self.length:g}; expected more than {widest:.2f}, the widest extent of the"
                " footprint: no body of the swarm may count as a wall",
            )

    def summary(
        self, findings: tuple[str, ...], view: LayerView | None, is_bounded: bool, pose_text: str
    ) -> WallsStandSummary:
        """The assumption, and whether it is used; see `LayerSettings`."""
        return WallsStandSummary(
            self.length,
            self.seconds,
            is_used=not any(text.startswith(MOVING_WALL) for text in findings),
        )


def walls_stand_text(walls: WallsStandSummary) -> str:
    """The assumption about walls in one line."""
    text = f"assumed of straight surfaces of {walls.length:g} m that stood for {walls.seconds:g} s"
    return text if walls.is_used else f"{text}; not used, since walls have moved"
