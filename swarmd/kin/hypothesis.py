"""One hypothesis of where a peer is: its pose in the frame of the own odometry, with a score.

The pose and the told pose of the same time are the transform between both frames of odometry. An
extended Kalman filter (Kalman 1960) moves the pose by the told motion, and corrects it by two kinds
of sight, each of which measures a place:

- *sight*: the own robot sees an object where the peer should be;
- *mutual sight*: the peer tells an object where the own robot should be for it.

The score is a log-likelihood ratio against an object that is there by chance: the track score of
Blackman and Popoli, "Design and Analysis of Modern Tracking Systems", 1999, 6.2. Only sights after
motion count, since things that stand fit for ever: a sight counts after the peer has moved by
_NEWS from where it last counted, a mutual sight after the own robot has.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

MOST_SCORE = 16.0
"""A hypothesis that is wrong after all, or whose odometry has slipped, must fall within seconds."""
_NEWS = 0.15  # m of motion after which a sight says something new
_SIGHT_NOISE = 0.05  # m, of the middle of a body by one scan: its visible side is not known
_RANGE_NOISE = 0.02  # of a distance: the bias of a lidar, alike from scan to scan
_GATE = 9.2  # squared standard deviations: 99 % of two dimensions
_MOST_GATE = 0.35  # m: no two middles of robots are nearer
_DENSITY = 0.5  # objects in a m2 that are there by chance
_TRUST = 0.5  # share of a ratio that counts: successive errors are alike
_MOST_GAIN = 2.5
_SAME = 2.0  # factor of the noise of a sight without news
# Drift of odometry, as a random walk: m2 per m, rad2 per m, rad2 per rad
_PLACE_DRIFT = 0.02**2
_TURN_DRIFT = 0.02**2
_YAW_DRIFT = 0.04**2
_LEAST = 0.02**2  # m2, rad2: errors that are alike from sight to sight do not average out


class Evidence:
    """How often what a moving robot shows has fitted, and over what a distance."""

    __slots__ = ("_first", "_last", "count", "extent")

    def __init__(self, x: float, y: float) -> None:
        """`x`, `y`: the place of the robot that moves, in the frame of its own odometry."""
        self._first = self._last = (x, y)
        self.count = 0
        self.extent = 0.0  # m, the greatest distance from the first place at which it counted

    def is_news(self, x: float, y: float) -> bool:
        """True if the robot has moved far enough since it last counted."""
        return math.hypot(x - self._last[0], y - self._last[1]) >= _NEWS

    def add(self, x: float, y: float) -> None:
        """Count a place."""
        self.count += 1
        self._last = (x, y)
        self.extent = max(self.extent, math.hypot(x - self._first[0], y - self._first[1]))


class Hypothesis:
    """A pose (x, y, yaw) of the peer's middle, m and rad, with its covariance and score."""

    __slots__ = (
        *("confirmed_at", "mutual", "score", "seen_at", "sights"),
        *("tt", "x", "xt", "xx", "xy", "y", "yaw", "yt", "yy"),
    )

    def __init__(
        self,
        pose: tuple[float, float, float],
        sd: float,
        yaw_sd: float,
        peer: tuple[float, float],
        own: tuple[float, float],
    ) -> None:
        """`peer`, `own`: the places of both robots in the frames of their odometry."""
        self.x, self.y, self.yaw = pose
        self.xx = self.yy = sd * sd
        self.tt = yaw_sd * yaw_sd
        self.xy = self.xt = self.yt = 0.0
        self.score = 0.0
        self.sights, self.mutual = Evidence(*peer), Evidence(*own)
        self.seen_at = -math.inf  # s, the last sight
        self.confirmed_at = math.inf  # s, when it became the pose of the peer

    @property
    def sd(self) -> float:
        """m, the standard deviation of the place in one direction, on average."""
        return math.sqrt(0.5 * (self.xx + self.yy))

    def prove_again(self, peer: tuple[float, float], own: tuple[float, float]) -> None:
        """Begin the evidence anew, at these places of both robots (see `__init__`)."""
        self.sights, self.mutual = Evidence(*peer), Evidence(*own)
        self.score = 0.0
        self.confirmed_at = math.inf

    def move(self, ahead: float, left: float, turn: float) -> None:
        """Move by what the peer tells, in the frame of its body before the motion."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        dx, dy = c * ahead - s * left, s * ahead + c * left
        self.x, self.y, self.yaw = self.x + dx, self.y + dy, self.yaw + turn
        # The yaw's error moves the place aside.
        self.xx += -2.0 * dy * self.xt + dy * dy * self.tt
        self.yy += 2.0 * dx * self.yt + dx * dx * self.tt
        self.xy += dx * self.xt - dy * self.yt - dx * dy * self.tt
        self.xt -= dy * self.tt
        self.yt += dx * self.tt
        self.drift(math.hypot(ahead, left), abs(turn), 0.0)

    def drift(self, way: float, turn: float, lever: float) -> None:
        """Widen by the error of a motion; `lever`: m from the robot that moved to the peer."""
        yaw = _TURN_DRIFT * way + _YAW_DRIFT * turn
        place = _PLACE_DRIFT * way + 0.5 * lever * lever * yaw
        self.xx, self.yy, self.tt = self.xx + place, self.yy + place, self.tt + yaw

    def see(self, places: Iterable[tuple[float, float]], distance: float, is_news: bool) -> int:
        """Correct by the object that fits a sight best; its index, or -1.

        `places`: of objects, in the frame of the own odometry. `distance`: m to the peer.
        """
        return self._take(
            places, self.x, self.y, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), distance, is_news
        )

    def be_seen(
        self, objects: Iterable[tuple[float, float]], x: float, y: float, is_news: bool
    ) -> int:
        """Correct by the told object that fits a mutual sight best; its index, or -1.

        `objects`: ahead and left of the peer. `x`, `y`: the own middle.
        """
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        ahead, left = self.ahead_and_left(x, y)
        return self._take(
            objects, ahead, left, (-c, -s, left), (s, -c, -ahead), math.hypot(ahead, left), is_news
        )

    def ahead_and_left(self, x: float, y: float) -> tuple[float, float]:
        """A place of the own odometry's frame, seen from the peer."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        dx, dy = x - self.x, y - self.y
        return c * dx + s * dy, c * dy - s * dx

    def fits(self, x: float, y: float) -> float:
        """Squared standard deviations between the pose and a place; inf beyond the gate."""
        sd = _SIGHT_NOISE * _SIGHT_NOISE
        return _distance(x - self.x, y - self.y, self.xx + sd, self.xy, self.yy + sd)

    def is_like(self, pose: tuple[float, float, float], near: float, turned: float) -> bool:
        """True if a pose differs by less than `near` m and `turned` rad."""
        x, y, yaw = pose
        is_near = math.hypot(x - self.x, y - self.y) < near
        return is_near and abs(wrapped(yaw - self.yaw)) < turned

    def _take(
        self,
        places: Iterable[tuple[float, float]],
        x: float,
        y: float,
        row_x: tuple[float, float, float],
        row_y: tuple[float, float, float],
        distance: float,
        is_news: bool,
    ) -> int:
        """Correct by the place nearest to the expected `x`, `y`, whose derivatives are the rows."""
        ax, ay, at = self._times(row_x)
        bx, by, bt = self._times(row_y)
        noise = (_SIGHT_NOISE + _RANGE_NOISE * distance) ** 2
        s11 = row_x[0] * ax + row_x[1] * ay + row_x[2] * at + noise
        s12 = row_x[0] * bx + row_x[1] * by + row_x[2] * bt
        s22 = row_y[0] * bx + row_y[1] * by + row_y[2] * bt + noise
        best, nearest, off_x, off_y = -1, math.inf, 0.0, 0.0
        for index, (px, py) in enumerate(places):
            far = _distance(px - x, py - y, s11, s12, s22)
            if far < nearest:
                best, nearest, off_x, off_y = index, far, px - x, py - y
        if best < 0:
            return best
        if is_news:
            area = 2.0 * math.pi * math.sqrt(s11 * s22 - s12 * s12)
            ratio = -0.5 * nearest - math.log(area * _DENSITY)
            gain = min(max(_TRUST * ratio, -_MOST_GAIN), _MOST_GAIN)
            self.score = min(self.score + gain, MOST_SCORE)
        else:
            more = (_SAME * _SAME - 1.0) * noise
            s11, s22 = s11 + more, s22 + more
        det = s11 * s22 - s12 * s12
        i11, i12, i22 = s22 / det, -s12 / det, s11 / det
        u, v = i11 * off_x + i12 * off_y, i12 * off_x + i22 * off_y
        self.x += ax * u + bx * v
        self.y += ay * u + by * v
        self.yaw += at * u + bt * v
        self.xx = max(self.xx - (ax * ax * i11 + 2 * ax * bx * i12 + bx * bx * i22), _LEAST)
        self.yy = max(self.yy - (ay * ay * i11 + 2 * ay * by * i12 + by * by * i22), _LEAST)
        self.tt = max(self.tt - (at * at * i11 + 2 * at * bt * i12 + bt * bt * i22), _LEAST)
        self.xy -= ax * ay * i11 + (ax * by + bx * ay) * i12 + bx * by * i22
        self.xt -= ax * at * i11 + (ax * bt + bx * at) * i12 + bx * bt * i22
        self.yt -= ay * at * i11 + (ay * bt + by * at) * i12 + by * bt * i22
        return best

    def _times(self, row: tuple[float, float, float]) -> tuple[float, float, float]:
        """The covariance times a row of derivatives."""
        a, b, c = row
        return (
            self.xx * a + self.xy * b + self.xt * c,
            self.xy * a + self.yy * b + self.yt * c,
            self.xt * a + self.yt * b + self.tt * c,
        )


def _distance(dx: float, dy: float, xx: float, xy: float, yy: float) -> float:
    """Squared standard deviations of a difference in m; inf beyond the gate."""
    if dx * dx + dy * dy > _MOST_GATE * _MOST_GATE:
        return math.inf
    far = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
    return far if far <= _GATE else math.inf


def wrapped(angle: float) -> float:
    """The angle in rad within -pi to pi."""
    return math.remainder(angle, math.tau)
