"""The rigid registration of two paths, from sums that forget.

The rotation and translation that lay the points q on the points p with the least squared distance:
Arun, Huang, Blostein, "Least-squares fitting of two 3-D point sets", PAMI 9(5), 1987; Umeyama,
"Least-squares estimation of transformation parameters between two point patterns", PAMI 13(4),
1991. In the plane both need five sums and no singular values: with a = sum p . q and b = sum q x p
of the points less their means, the rotation is atan2(b, a), and the sum of squared residuals is
sum p.p + sum q.q - 2 hypot(a, b). Each pair loses weight with time, so no points are stored.
"""

from __future__ import annotations

import math

_MEMORY = 4.0  # s, in which the weight of a pair falls to 1/e


class PathFit:
    """The fit of the path q of a peer (its odometry) to the path p of a track. Units: m, s, rad."""

    __slots__ = ("_cross", "_dot", "_pp", "_px", "_py", "_qq", "_qx", "_qy", "_time", "weight")

    def __init__(self) -> None:
        self.weight = self._time = 0.0
        self._px = self._py = self._qx = self._qy = 0.0  # means
        self._pp = self._qq = self._dot = self._cross = 0.0  # sums of points less their means

    def add(self, time: float, px: float, py: float, qx: float, qy: float) -> None:
        """Add a pair of points at a time that rises (the weighted update of Welford and West)."""
        keep = math.exp((self._time - time) / _MEMORY) if self.weight else 0.0
        self._time = time
        self.weight = self.weight * keep + 1.0
        share = 1.0 / self.weight
        ax, ay, bx, by = px - self._px, py - self._py, qx - self._qx, qy - self._qy
        self._px, self._py = self._px + share * ax, self._py + share * ay
        self._qx, self._qy = self._qx + share * bx, self._qy + share * by
        gain = 1.0 - share
        self._pp = keep * self._pp + gain * (ax * ax + ay * ay)
        self._qq = keep * self._qq + gain * (bx * bx + by * by)
        self._dot = keep * self._dot + gain * (ax * bx + ay * by)
        self._cross = keep * self._cross + gain * (bx * ay - by * ax)

    @property
    def spread(self) -> float:
        """m, root mean square distance of the peer's points from their mean."""
        return math.sqrt(self._qq / self.weight) if self.weight else 0.0

    @property
    def residual(self) -> float:
        """m, root mean square distance between the points after the fit."""
        if not self.weight:
            return 0.0
        left = self._pp + self._qq - 2.0 * math.hypot(self._dot, self._cross)
        return math.sqrt(max(left, 0.0) / self.weight)

    @property
    def turn(self) -> float:
        """rad, the yaw of the frame of q in the frame of p."""
        return math.atan2(self._cross, self._dot)

    def place(self, qx: float, qy: float) -> tuple[float, float]:
        """A point of the frame of q in the frame of p."""
        c, s = math.cos(self.turn), math.sin(self.turn)
        dx, dy = qx - self._qx, qy - self._qy
        return self._px + c * dx - s * dy, self._py + s * dx + c * dy
