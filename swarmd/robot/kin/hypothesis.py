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

A kernel (see `core/kernels.py`), compiled into one unit with kin.py. Units: m, s, rad.
"""

from __future__ import annotations

import math

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import angle_between
from swarmd.core.cython_shadow import INFINITY, Doubles, cos, fabs, log, sin, sqrt

POINT = 3
"""Numbers of a point in a buffer: its x, y, and distance from the origin of its frame."""
MOST_SCORE = 16.0
"""A hypothesis that is wrong after all, or whose odometry has slipped, must fall within seconds."""
_NEWS = 0.15  # m of motion after which a sight says something new
# m, of the middle of a body by one scan: its visible side is not known
_SIGHT_NOISE = 0.05
# of a distance: the bias of a lidar, alike from scan to scan
_RANGE_NOISE = 0.02
_GATE = 9.2  # squared standard deviations: 99 % of two dimensions
_MOST_GATE = 0.35  # m: no two middles of robots are nearer
_DENSITY = 0.5  # objects in a m2 that are there by chance
_TRUST = 0.5  # share of a ratio that counts: errors are alike
_MOST_GAIN = 2.5
# Drift of odometry, as a random walk: m2 per m, rad2 per m, rad2 per rad
_PLACE_DRIFT = 0.02**2
_TURN_DRIFT = 0.02**2
_YAW_DRIFT = 0.04**2
# m2, rad2: errors that are alike from sight to sight do not average out
_LEAST = 0.02**2


@cython.cclass
class Evidence:
    """How often what a moving robot shows has fitted, and over what a distance."""

    count: int
    extent: float  # m, the greatest distance from the first place at which it counted
    _first_x: float
    _first_y: float
    _last_x: float
    _last_y: float

    def begin(self, x: float, y: float) -> None:
        """Begin anew. `x`, `y`: the place of the robot that moves, by its own odometry."""
        self.count = 0
        self.extent = 0.0
        self._first_x = x
        self._last_x = x
        self._first_y = y
        self._last_y = y

    def is_news(self, x: float, y: float) -> bool:
        """True if the robot has moved far enough since it last counted."""
        return length(x - self._last_x, y - self._last_y) >= _NEWS

    def add(self, x: float, y: float) -> None:
        """Count a place."""
        self.count += 1
        self._last_x = x
        self._last_y = y
        self.extent = max(self.extent, length(x - self._first_x, y - self._first_y))


@cython.cclass
class Hypothesis:
    """A pose (x, y, yaw) of the peer's middle, m and rad, with its covariance and score."""

    x: float
    y: float
    yaw: float
    xx: float
    xy: float
    xt: float
    yy: float
    yt: float
    tt: float
    score: float
    seen_at: float  # s, the last sight
    sights: Evidence
    mutual: Evidence

    def prove(self, peer_x: float, peer_y: float, own_x: float, own_y: float) -> None:
        """Begin the evidence anew, at these places of both robots by their odometry."""
        self.sights.begin(peer_x, peer_y)
        self.mutual.begin(own_x, own_y)
        self.score = 0.0

    def sd(self) -> float:
        """m, the standard deviation of the place in one direction, on average."""
        return sqrt(0.5 * (self.xx + self.yy))

    def move(self, ahead: float, left: float, turn: float) -> None:
        """Move by what the peer tells, in the frame of its body before the motion."""
        c = cos(self.yaw)
        s = sin(self.yaw)
        dx = c * ahead - s * left
        dy = s * ahead + c * left
        self.x = self.x + dx
        self.y = self.y + dy
        self.yaw = self.yaw + turn
        # The yaw's error moves the place aside.
        self.xx += -2.0 * dy * self.xt + dy * dy * self.tt
        self.yy += 2.0 * dx * self.yt + dx * dx * self.tt
        self.xy += dx * self.xt - dy * self.yt - dx * dy * self.tt
        self.xt -= dy * self.tt
        self.yt += dx * self.tt
        self.drift(length(ahead, left), fabs(turn), 0.0)

    def drift(self, way: float, turn: float, lever: float) -> None:
        """Widen by the error of a motion; `lever`: m from the robot that moved to the peer."""
        yaw = _TURN_DRIFT * way + _YAW_DRIFT * turn
        place = _PLACE_DRIFT * way + 0.5 * lever * lever * yaw
        self.xx = self.xx + place
        self.yy = self.yy + place
        self.tt = self.tt + yaw

    def see(self, places: Doubles, count: int, distance: float, is_news: bool) -> bool:
        """Correct by the place that fits a sight best; False if none does.

        `places`: the first `count` are used, in the frame of the own odometry. `distance`: m to the
        peer.
        """
        return self._take(
            places, count, self.x, self.y, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, distance, is_news
        )

    def be_seen(self, objects: Doubles, count: int, x: float, y: float, is_news: bool) -> bool:
        """Correct by the told object that fits a mutual sight best; False if none does.

        `objects`: ahead and left of the peer. `x`, `y`: the own middle.
        """
        c = cos(self.yaw)
        s = sin(self.yaw)
        ahead = c * (x - self.x) + s * (y - self.y)
        left = c * (y - self.y) - s * (x - self.x)
        return self._take(
            objects, count, ahead, left, -c, -s, left, s, -c, -ahead, length(ahead, left), is_news
        )

    def fits(self, dx: float, dy: float) -> float:
        """Squared standard deviations of a difference in m to the pose; inf beyond the gate."""
        sd = _SIGHT_NOISE * _SIGHT_NOISE
        return _deviation(dx, dy, self.xx + sd, self.xy, self.yy + sd)

    def is_like(self, x: float, y: float, yaw: float, share: float) -> bool:
        """True if a pose is one with this: within `share` of 0.3 m and 0.4 rad."""
        if length(x - self.x, y - self.y) >= 0.3 * share:
            return False
        return angle_between(yaw, self.yaw) < 0.4 * share

    def _take(
        self,
        points: Doubles,
        count: int,
        x: float,
        y: float,
        # The derivatives of the expected x by the pose, and those of y.
        ux: float,
        uy: float,
        ut: float,
        vx: float,
        vy: float,
        vt: float,
        distance: float,
        is_news: bool,
    ) -> bool:
        """Correct by the point nearest to the expected `x`, `y`; False without one in the gate."""
        # The covariance times the derivatives.
        ax = self.xx * ux + self.xy * uy + self.xt * ut
        ay = self.xy * ux + self.yy * uy + self.yt * ut
        at = self.xt * ux + self.yt * uy + self.tt * ut
        bx = self.xx * vx + self.xy * vy + self.xt * vt
        by = self.xy * vx + self.yy * vy + self.yt * vt
        bt = self.xt * vx + self.yt * vy + self.tt * vt
        noise = (_SIGHT_NOISE + _RANGE_NOISE * distance) ** 2
        s11 = ux * ax + uy * ay + ut * at + noise
        s12 = ux * bx + uy * by + ut * bt
        s22 = vx * bx + vy * by + vt * bt + noise
        nearest = INFINITY
        dx = 0.0
        dy = 0.0
        for k in range(count):
            i = POINT * k
            far = _deviation(points[i] - x, points[i + 1] - y, s11, s12, s22)
            if far < nearest:
                nearest = far
                dx = points[i] - x
                dy = points[i + 1] - y
        if nearest == INFINITY:
            return False
        if is_news:
            area = 2.0 * math.pi * sqrt(s11 * s22 - s12 * s12)
            ratio = -0.5 * nearest - log(area * _DENSITY)
            gain = min(max(_TRUST * ratio, -_MOST_GAIN), _MOST_GAIN)
            self.score = min(self.score + gain, MOST_SCORE)
        det = s11 * s22 - s12 * s12
        i11 = s22 / det
        i12 = -s12 / det
        i22 = s11 / det
        u = i11 * dx + i12 * dy
        v = i12 * dx + i22 * dy
        self.x += ax * u + bx * v
        self.y += ay * u + by * v
        self.yaw += at * u + bt * v
        self.xx = max(self.xx - (ax * ax * i11 + 2 * ax * bx * i12 + bx * bx * i22), _LEAST)
        self.yy = max(self.yy - (ay * ay * i11 + 2 * ay * by * i12 + by * by * i22), _LEAST)
        self.tt = max(self.tt - (at * at * i11 + 2 * at * bt * i12 + bt * bt * i22), _LEAST)
        self.xy -= ax * ay * i11 + (ax * by + bx * ay) * i12 + bx * by * i22
        self.xt -= ax * at * i11 + (ax * bt + bx * at) * i12 + bx * bt * i22
        self.yt -= ay * at * i11 + (ay * bt + by * at) * i12 + by * bt * i22
        return True


def _deviation(dx: float, dy: float, xx: float, xy: float, yy: float) -> float:
    """Squared standard deviations of a difference in m; inf beyond the gate."""
    if dx * dx + dy * dy > _MOST_GATE * _MOST_GATE:
        return INFINITY
    det = xx * yy - xy * xy
    if not det > 0.0:  # rounding has made it no covariance
        return INFINITY
    far = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / det
    return far if far <= _GATE else INFINITY


def begun(x: float, y: float, yaw: float, sd: float, yaw_sd: float) -> Hypothesis:
    """A new pose with these standard deviations; `prove` must follow."""
    one: Hypothesis = Hypothesis.__new__(Hypothesis)  # without objects of Python for its numbers
    one.x = x
    one.y = y
    one.yaw = yaw
    one.xx = one.yy = sd * sd
    one.tt = yaw_sd * yaw_sd
    one.seen_at = -INFINITY
    one.sights = Evidence.__new__(Evidence)
    one.mutual = Evidence.__new__(Evidence)
    return one


def length(x: float, y: float) -> float:
    """The length of a vector; C's hypot takes five times as long."""
    return sqrt(x * x + y * y)
