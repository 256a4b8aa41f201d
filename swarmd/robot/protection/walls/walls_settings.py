"""The settings of walls that stand, and their lines of a check and a status. No numpy."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta, Struct

from swarmd.core.messages import WallsStandSummary

if TYPE_CHECKING:
    from swarmd.robot.protection.decision import LayerView

MOVING_WALL = "moving_wall"
"""How events and the finding about walls that moved begin."""

LEAST_LENGTH_WITH_FOOT = 1.0
"""m, the least `length` with a `foot`: the longest diagonal of a platform of swarmd is 0.67 m."""

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
    # m by which such a surface sticks out at most, below or above the scan plane: in place of
    # `unseen_extent`. None: nothing is known, and `unseen_extent` holds. Higher: keeps larger gaps.
    # Lower than the truth: the robot hits what sticks out, such as a skirting board or a radiator.
    foot: Annotated[float, Meta(ge=0.0, le=1.0)] | None = None

    @property
    def text(self) -> str:
        """The assumption in one line."""
        text = f"walls of {self.length:g} m that stood for {self.seconds:g} s stand"
        return text if self.foot is None else f"{text}, and stick out by {self.foot:g} m at most"

    def misfits(
        self, footprint: Sequence[tuple[float, float]], extent: float, cone: float
    ) -> Iterator[tuple[tuple[str, ...], str]]:
        """The keys and the text of what does not fit a robot.

        Args:
            footprint: its corners in m.
            extent: m, its `unseen_extent`.
            cone: rad, the width of a beam of its lidar; 0: a ray.
        """
        widest = max(math.dist(a, b) for a in footprint for b in footprint)
        if self.length <= widest:
            yield (
                ("length",),
                f"is {self.length:g}; expected more than {widest:.2f}, the widest extent of the"
                " footprint: no body of the swarm may count as a wall",
            )
        if self.foot is None:
            return
        if self.length < LEAST_LENGTH_WITH_FOOT:
            yield (
                ("length",),
                f"is {self.length:g}; expected at least {LEAST_LENGTH_WITH_FOOT:g} with `foot`: a"
                " shorter surface may be a body with parts that stick out",
            )
        if self.foot > extent:
            yield (
                ("foot",),
                f"is {self.foot:g}; expected at most {extent:g}, the `unseen_extent` of this"
                " platform: raise that instead, which holds for all obstacles",
            )
        if cone > 0.0:
            yield (
                ("foot",),
                "needs a lidar of narrow rays: `unseen_extent` also covers the width of the beams"
                " of scan.cone_deg; remove it",
            )

    def summary(
        self, findings: tuple[str, ...], view: LayerView | None, is_bounded: bool, pose_text: str
    ) -> WallsStandSummary:
        """The assumption, and whether it is used; see `LayerSettings`."""
        return WallsStandSummary(
            self.length,
            self.seconds,
            is_used=not any(text.startswith(MOVING_WALL) for text in findings),
            foot=self.foot,
        )


def walls_stand_text(walls: WallsStandSummary) -> str:
    """The assumption about walls in one line."""
    text = f"assumed of straight surfaces of {walls.length:g} m that stood for {walls.seconds:g} s"
    if walls.foot is not None:
        text = f"{text} and stick out by {walls.foot:g} m at most"
    return text if walls.is_used else f"{text}; not used, since walls have moved"
