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
from swarmd.core.cython_shadow import INFINITY, cos, fabs, log, sin, sqrt

POINT = cython.declare(cython.Py_ssize_t, 3)
"""Numbers of a point in a buffer: its x, y, and distance from the origin of its frame."""
MOST_SCORE = cython.declare(cython.double, 16.0)
"""A hypothesis that is wrong after all, or whose odometry has slipped, must fall within seconds."""
_NEWS = cython.declare(cython.double, 0.15)  # m of motion after which a sight says something new
# m, of the middle of a body by one scan: its visible side is not known
_SIGHT_NOISE = cython.declare(cython.double, 0.05)
# of a distance: the bias of a lidar, alike from scan to scan
_RANGE_NOISE = cython.declare(cython.double, 0.02)
_GATE = cython.declare(cython.double, 9.2)  # squared standard deviations: 99 % of two dimensions
_MOST_GATE = cython.declare(cython.double, 0.35)  # m: no two middles of robots are nearer
_DENSITY = cython.declare(cython.double, 0.5)  # objects in a m2 that are there by chance
_TRUST = cython.declare(cython.double, 0.5)  # share of a ratio that counts: errors are alike
_MOST_GAIN = cython.declare(cython.double, 2.5)
# Drift of odometry, as a random walk: m2 per m, rad2 per m, rad2 per rad
_PLACE_DRIFT = cython.declare(cython.double, 0.02**2)
_TURN_DRIFT = cython.declare(cython.double, 0.02**2)
_YAW_DRIFT = cython.declare(cython.double, 0.04**2)
# m2, rad2: errors that are alike from sight to sight do not average out
_LEAST = cython.declare(cython.double, 0.02**2)


@cython.final
@cython.cclass
class Evidence:
    """How often what a moving robot shows has fitted, and over what a distance."""

    count: cython.Py_ssize_t
    extent: cython.double  # m, the greatest distance from the first place at which it counted
    _first_x: cython.double
    _first_y: cython.double
    _last_x: cython.double
    _last_y: cython.double

    @cython.cfunc
    def begin(self, x: cython.double, y: cython.double) -> cython.int:
        """Begin anew. `x`, `y`: the place of the robot that moves, by its own odometry."""
        self.count = 0
        self.extent = 0.0
        self._first_x = x
        self._last_x = x
        self._first_y = y
        self._last_y = y

    @cython.cfunc
    def is_news(self, x: cython.double, y: cython.double) -> cython.bint:
        """True if the robot has moved far enough since it last counted."""
        return length(x - self._last_x, y - self._last_y) >= _NEWS

    @cython.cfunc
    def add(self, x: cython.double, y: cython.double) -> cython.int:
        """Count a place."""
        self.count += 1
        self._last_x = x
        self._last_y = y
        self.extent = max(self.extent, length(x - self._first_x, y - self._first_y))


@cython.final
@cython.cclass
class Hypothesis:
    """A pose (x, y, yaw) of the peer's middle, m and rad, with its covariance and score."""

    x: cython.double
    y: cython.double
    yaw: cython.double
    xx: cython.double
    xy: cython.double
    xt: cython.double
    yy: cython.double
    yt: cython.double
    tt: cython.double
    score: cython.double
    seen_at: cython.double  # s, the last sight
    sights: Evidence
    mutual: Evidence

    @cython.cfunc
    def prove(
        self,
        peer_x: cython.double,
        peer_y: cython.double,
        own_x: cython.double,
        own_y: cython.double,
    ) -> cython.int:
        """Begin the evidence anew, at these places of both robots by their odometry."""
        self.sights.begin(peer_x, peer_y)
        self.mutual.begin(own_x, own_y)
        self.score = 0.0

    @cython.cfunc
    def sd(self) -> cython.double:
        """m, the standard deviation of the place in one direction, on average."""
        return sqrt(0.5 * (self.xx + self.yy))

    @cython.cfunc
    def move(self, ahead: cython.double, left: cython.double, turn: cython.double) -> cython.int:
        """Move by what the peer tells, in the frame of its body before the motion."""
        c: cython.double = cos(self.yaw)
        s: cython.double = sin(self.yaw)
        dx: cython.double = c * ahead - s * left
        dy: cython.double = s * ahead + c * left
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

    @cython.cfunc
    def drift(self, way: cython.double, turn: cython.double, lever: cython.double) -> cython.int:
        """Widen by the error of a motion; `lever`: m from the robot that moved to the peer."""
        yaw: cython.double = _TURN_DRIFT * way + _YAW_DRIFT * turn
        place: cython.double = _PLACE_DRIFT * way + 0.5 * lever * lever * yaw
        self.xx = self.xx + place
        self.yy = self.yy + place
        self.tt = self.tt + yaw

    @cython.cfunc
    def see(
        self,
        places: cython.double[::1],
        count: cython.Py_ssize_t,
        distance: cython.double,
        is_news: cython.bint,
    ) -> cython.bint:
        """Correct by the place that fits a sight best; False if none does.

        `places`: the first `count` are used, in the frame of the own odometry. `distance`: m to the
        peer.
        """
        return self._take(
            places, count, self.x, self.y, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, distance, is_news
        )

    @cython.cfunc
    def be_seen(
        self,
        objects: cython.double[::1],
        count: cython.Py_ssize_t,
        x: cython.double,
        y: cython.double,
        is_news: cython.bint,
    ) -> cython.bint:
        """Correct by the told object that fits a mutual sight best; False if none does.

        `objects`: ahead and left of the peer. `x`, `y`: the own middle.
        """
        c: cython.double = cos(self.yaw)
        s: cython.double = sin(self.yaw)
        ahead: cython.double = c * (x - self.x) + s * (y - self.y)
        left: cython.double = c * (y - self.y) - s * (x - self.x)
        return self._take(
            objects, count, ahead, left, -c, -s, left, s, -c, -ahead, length(ahead, left), is_news
        )

    @cython.cfunc
    def fits(self, dx: cython.double, dy: cython.double) -> cython.double:
        """Squared standard deviations of a difference in m to the pose; inf beyond the gate."""
        sd: cython.double = _SIGHT_NOISE * _SIGHT_NOISE
        return _deviation(dx, dy, self.xx + sd, self.xy, self.yy + sd)

    @cython.cfunc
    def is_like(
        self, x: cython.double, y: cython.double, yaw: cython.double, share: cython.double
    ) -> cython.bint:
        """True if a pose is one with this: within `share` of 0.3 m and 0.4 rad."""
        if length(x - self.x, y - self.y) >= 0.3 * share:
            return False
        return angle_between(yaw, self.yaw) < 0.4 * share

    @cython.cfunc
    def _take(
        self,
        points: cython.double[::1],
        count: cython.Py_ssize_t,
        x: cython.double,
        y: cython.double,
        # The derivatives of the expected x by the pose, and those of y.
        ux: cython.double,
        uy: cython.double,
        ut: cython.double,
        vx: cython.double,
        vy: cython.double,
        vt: cython.double,
        distance: cython.double,
        is_news: cython.bint,
    ) -> cython.bint:
        """Correct by the point nearest to the expected `x`, `y`; False without one in the gate."""
        # The covariance times the derivatives.
        ax: cython.double = self.xx * ux + self.xy * uy + self.xt * ut
        ay: cython.double = self.xy * ux + self.yy * uy + self.yt * ut
        at: cython.double = self.xt * ux + self.yt * uy + self.tt * ut
        bx: cython.double = self.xx * vx + self.xy * vy + self.xt * vt
        by: cython.double = self.xy * vx + self.yy * vy + self.yt * vt
        bt: cython.double = self.xt * vx + self.yt * vy + self.tt * vt
        noise: cython.double = (_SIGHT_NOISE + _RANGE_NOISE * distance) ** 2
        s11: cython.double = ux * ax + uy * ay + ut * at + noise
        s12: cython.double = ux * bx + uy * by + ut * bt
        s22: cython.double = vx * bx + vy * by + vt * bt + noise
        nearest: cython.double = INFINITY
        dx: cython.double = 0.0
        dy: cython.double = 0.0
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        for k in range(count):
            i = POINT * k
            far: cython.double = _deviation(points[i] - x, points[i + 1] - y, s11, s12, s22)
            if far < nearest:
                nearest = far
                dx = points[i] - x
                dy = points[i + 1] - y
        if nearest == INFINITY:
            return False
        if is_news:
            area: cython.double = 2.0 * math.pi * sqrt(s11 * s22 - s12 * s12)
            ratio: cython.double = -0.5 * nearest - log(area * _DENSITY)
            gain: cython.double = min(max(_TRUST * ratio, -_MOST_GAIN), _MOST_GAIN)
            self.score = min(self.score + gain, MOST_SCORE)
        det: cython.double = s11 * s22 - s12 * s12
        i11: cython.double = s22 / det
        i12: cython.double = -s12 / det
        i22: cython.double = s11 / det
        u: cython.double = i11 * dx + i12 * dy
        v: cython.double = i12 * dx + i22 * dy
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


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _deviation(
    dx: cython.double, dy: cython.double, xx: cython.double, xy: cython.double, yy: cython.double
) -> cython.double:
    """Squared standard deviations of a difference in m; inf beyond the gate."""
    if dx * dx + dy * dy > _MOST_GATE * _MOST_GATE:
        return INFINITY
    det: cython.double = xx * yy - xy * xy
    if not det > 0.0:  # rounding has made it no covariance
        return INFINITY
    far: cython.double = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / det
    return far if far <= _GATE else INFINITY


@cython.cfunc
def begun(
    x: cython.double,
    y: cython.double,
    yaw: cython.double,
    sd: cython.double,
    yaw_sd: cython.double,
) -> Hypothesis:
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


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def length(x: cython.double, y: cython.double) -> cython.double:
    """The length of a vector; C's hypot takes five times as long."""
    return sqrt(x * x + y * y)
