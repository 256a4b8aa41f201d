"""The settings of the fence, the faults of its polygons, and its lines of a check and a status.

The schema of files imports this module, so the module does not import numpy. Units: m in the shared
frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Literal

from msgspec import Meta, Struct

from swarmd.core.messages import FenceSummary

if TYPE_CHECKING:
    from swarmd.robot.protection.decision import LayerView

_Coordinate = Annotated[float, Meta(ge=-1e6, le=1e6)]
Corner = tuple[_Coordinate, _Coordinate]
Corners = Annotated[list[Corner], Meta(max_length=64)]
MIN_EDGE = 0.01
"""m: a shorter edge is taken for two equal corners."""


class FenceSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An area in a shared frame that robots do not leave.

    - `frame`: the name of the shared frame of the corners.
    - `polygon`: the corners of the outer polygon, each x, y in m, in order around it.
    - `keep_out`: polygons that robots do not enter.
    - `margin`: m kept free on the inner side, beside the errors of the pose.
    - `without_pose`: `hold`: without a fresh pose the robot stands. `drive`: the robot drives on
      without the fence.
    """

    frame: Annotated[str, Meta(min_length=1, max_length=63)]
    polygon: Corners
    keep_out: Annotated[list[Corners], Meta(max_length=16)] = []
    margin: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.05
    without_pose: Literal["hold", "drive"] = "hold"

    @property
    def polygons(self) -> tuple[Sequence[Corner], ...]:
        """The outer polygon, then those of `keep_out`."""
        return (self.polygon, *self.keep_out)

    @property
    def text(self) -> str:
        """The fence in one line."""
        areas = f", {len(self.keep_out)} areas to keep out of" if self.keep_out else ""
        without = "stands" if self.without_pose == "hold" else "drives on without the fence"
        return (
            f"{len(self.polygon)} corners in frame {self.frame!r}{areas}; keeps {self.margin:g} m"
            f" of margin; without a fresh pose the robot {without}"
        )

    def summary(
        self, findings: tuple[str, ...], view: LayerView | None, is_bounded: bool, pose_text: str
    ) -> FenceSummary:
        """The fence and the place of the robot against it; see `LayerSettings`."""
        return FenceSummary(
            frame=self.frame,
            polygons=tuple(tuple(corners) for corners in self.polygons),
            clearance=None if view is None else view.clearance,
            error=0.0 if view is None else view.error,
            limits=is_bounded,
            holds=self.without_pose == "hold",
            text=pose_text,
        )

    def faults(self) -> Iterator[tuple[tuple[str | int, ...], str]]:
        """The keys of each faulty polygon, with the text of its first fault."""
        if not self.frame.isprintable():
            yield ("frame",), f"is {self.frame!r}; expected printable characters"
        keyed: list[tuple[tuple[str | int, ...], Sequence[Corner]]] = [(("polygon",), self.polygon)]
        keyed += [(("keep_out", index), one) for index, one in enumerate(self.keep_out)]
        for keys, corners in keyed:
            if text := polygon_fault(corners):
                yield keys, text


def fence_text(fence: FenceSummary) -> str:
    """The place of the robot against its fence in one line."""
    frame = f"in frame {fence.frame}"
    if fence.clearance is None:
        effect = "the robot stands" if fence.holds else "it does not limit"
        return f"{frame}; {effect}: {fence.text}"
    side = "inside" if fence.clearance >= 0.0 else "outside"
    limits = "; limits the command" if fence.limits else ""
    return f"{abs(fence.clearance):.2f} m {side} (+- {fence.error:.2f} m), {frame}{limits}"


def polygon_fault(corners: Sequence[Corner]) -> str:
    """Why the corners are no simple polygon: a short edge, or two edges that meet; "" if simple."""
    n = len(corners)
    if n < 3:
        return f"has {n} corners; expected at least 3"
    edges = [(corners[i], corners[(i + 1) % n]) for i in range(n)]
    for a, b in edges:
        if not math.dist(a, b) >= MIN_EDGE:
            return f"has two equal corners: {_shown(a)} and the next one"
    for i, (a, b) in enumerate(edges):
        for j in range(i + 1, n):
            c, d = edges[j]
            if j == i + 1 or (i == 0 and j == n - 1):  # neighbors share a corner
                first, shared, last = (a, b, d) if j == i + 1 else (c, a, b)
                if _turns_back(first, shared, last):
                    return f"turns back on itself at {_shown(shared)}"
            elif _meet(a, b, c, d):
                return (
                    f"crosses itself: the edge from {_shown(a)} to {_shown(b)} meets the edge from"
                    f" {_shown(c)} to {_shown(d)}"
                )
    return ""


def _shown(corner: Corner) -> str:
    return f"[{corner[0]:g}, {corner[1]:g}]"


def _side(a: Corner, b: Corner, p: Corner) -> float:
    """Twice the signed area of a, b, p in m2: positive if p is left of the line from a to b."""
    return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])


def _turns_back(first: Corner, shared: Corner, last: Corner) -> bool:
    ahead = (shared[0] - first[0]) * (last[0] - shared[0])
    ahead += (shared[1] - first[1]) * (last[1] - shared[1])
    scale = math.dist(first, shared) * math.dist(shared, last)
    return ahead < 0.0 and abs(_side(first, shared, last)) <= 1e-9 * scale


def _meet(a: Corner, b: Corner, c: Corner, d: Corner) -> bool:
    """True if the edges a b and c d have a point in common."""
    sides = _side(a, b, c), _side(a, b, d), _side(c, d, a), _side(c, d, b)
    if sides[0] * sides[1] < 0.0 and sides[2] * sides[3] < 0.0:
        return True
    ends = ((a, b, c, sides[0]), (a, b, d, sides[1]), (c, d, a, sides[2]), (c, d, b, sides[3]))
    return any(side == 0.0 and _is_between(*edge) for *edge, side in ends)


def _is_between(a: Corner, b: Corner, p: Corner) -> bool:
    """True if p, on the line through a and b, lies between a and b."""
    return all(min(a[i], b[i]) <= p[i] <= max(a[i], b[i]) for i in (0, 1))
