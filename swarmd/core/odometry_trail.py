"""The last readings of odometry, and the pose at any time: one rule at the edges for all users.

- A reading begins the trail anew if its stamp goes back, or if its pose jumps: by more than
  MAX_STEP (m or rad) plus MAX_SPEED times the seconds since the newest reading.
- Any other reading with the newest stamp changes nothing: clocks of simulators stand for several
  readings.
- Readings are kept at least HISTORY_SPACING apart, beside the newest: one that comes sooner after
  the last kept one takes the place of the newest. So HISTORY readings reach back for a second at
  least, however often odometry comes.
- Between two readings the pose is interpolated. After the newest it moves on at the measured twist,
  for MAX_EXTRAPOLATION s at most. Before the oldest it moves back at that reading's twist; `covers`
  says whether the readings reach back to a time.

A kernel (see `kernels.py`) that is a part of each unit that uses it. Units: m, s, rad.
"""

from __future__ import annotations

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import TURN
from swarmd.core.bounds import MAX_COORDINATE
from swarmd.core.buffers import doubles
from swarmd.core.cython_shadow import NAN, cos, fabs, hypot, isfinite, remainder, sin
from swarmd.core.values import (
    HISTORY,
    HISTORY_SPACING,
    MAX_EXTRAPOLATION,
    MAX_SPEED,
    MAX_STEP,
    Odometry,
    Pose,
)

LONGEST_EXTRAPOLATION = cython.declare(cython.double, MAX_EXTRAPOLATION)
"""s for which the newest measured twist is extrapolated."""

# What `take` makes of a reading.
REFUSED = cython.declare(cython.int, 0)
SAME = cython.declare(cython.int, 1)
NEXT = cython.declare(cython.int, 2)
ANEW = cython.declare(cython.int, 3)

_READINGS = cython.declare(cython.Py_ssize_t, HISTORY)
_spacing = cython.declare(cython.double, HISTORY_SPACING)
_most = cython.declare(cython.double, MAX_COORDINATE)
_max_step = cython.declare(cython.double, MAX_STEP)
_max_speed = cython.declare(cython.double, MAX_SPEED)

# The fields of a reading at `start`, behind its stamp, which is `readings[start]`.
R_X = cython.declare(cython.Py_ssize_t, 1)
R_Y = cython.declare(cython.Py_ssize_t, 2)
R_YAW = cython.declare(cython.Py_ssize_t, 3)
R_LINEAR = cython.declare(cython.Py_ssize_t, 4)  # the measured speeds
R_ANGULAR = cython.declare(cython.Py_ssize_t, 5)
R_LATERAL = cython.declare(cython.Py_ssize_t, 6)
_FIELDS = cython.declare(cython.Py_ssize_t, 7)


@cython.cfunc
@cython.inline
def is_jump(
    dx: cython.double, dy: cython.double, turn: cython.double, seconds: cython.double
) -> cython.bint:
    """True if no base can move that far in that time: an estimator has shifted the pose."""
    way = max(hypot(dx, dy), fabs(remainder(turn, TURN)))
    return way > _max_step + _max_speed * seconds


@cython.final
@cython.cclass
class OdometryTrail:
    """The last readings of odometry. `set_pose` sets `x`, `y` and `yaw`."""

    count: cython.Py_ssize_t  # readings in use
    latest: cython.double  # the newest stamp; NaN before the first reading
    readings: cython.double[::1]  # a ring buffer
    x: cython.double
    y: cython.double
    yaw: cython.double
    _newest: cython.Py_ssize_t  # the number of the newest reading in the buffer

    def __init__(self) -> None:
        self.latest = NAN
        self.readings = doubles(_FIELDS * _READINGS)

    @cython.ccall
    def take(self, odometry: Odometry, checks: cython.bint = False) -> cython.int:
        """Store a reading: NEXT, or ANEW if it begins the trail anew. Else SAME or REFUSED.

        `checks`: a reading is REFUSED with a number that is not finite or beyond MAX_COORDINATE.
        Without, such a number is in the poses, so that the barrier lets no command pass.
        """
        pose = odometry.pose
        twist = odometry.twist
        stamp: cython.double = odometry.stamp
        x: cython.double = pose.x
        y: cython.double = pose.y
        yaw: cython.double = pose.yaw
        linear: cython.double = twist.linear
        angular: cython.double = twist.angular
        lateral: cython.double = twist.lateral
        taken: cython.int = NEXT
        if checks and not (  # see Odometry.is_valid, which takes longer
            isfinite(stamp)
            and fabs(x) <= _most
            and fabs(y) <= _most
            and fabs(yaw) <= _most
            and fabs(linear) <= _most
            and fabs(angular) <= _most
            and fabs(lateral) <= _most
        ):
            return REFUSED
        r = self.readings
        start: cython.Py_ssize_t = self.place(0)
        if self.count:
            seconds = stamp - r[start]
            if seconds < 0.0 or is_jump(
                x - r[start + R_X], y - r[start + R_Y], yaw - r[start + R_YAW], seconds
            ):
                self.count = 0
                taken = ANEW
            elif seconds == 0.0:
                return SAME
        # Overwrites the oldest reading, or the newest if that came soon after the one before it.
        if self.count < 2 or r[start] - r[self.place(1)] >= _spacing:
            self._newest = (self._newest + 1) % _READINGS
            self.count = min(self.count + 1, _READINGS)
            start = self.place(0)
        r[start] = stamp
        self.latest = stamp
        r[start + R_X] = x
        r[start + R_Y] = y
        r[start + R_YAW] = yaw
        r[start + R_LINEAR] = linear
        r[start + R_ANGULAR] = angular
        r[start + R_LATERAL] = lateral
        return taken

    @cython.ccall
    @cython.exceptval(-1)
    def clear(self) -> cython.int:
        """Forget all readings."""
        self.count = 0
        self.latest = NAN
        return 0

    @cython.cfunc
    @cython.exceptval(check=False)
    def place(self, before: cython.Py_ssize_t) -> cython.Py_ssize_t:
        """The index at which the reading begins that is `before` readings before the newest."""
        return _FIELDS * ((self._newest - before + _READINGS) % _READINGS)

    @cython.ccall
    @cython.exceptval(-1)
    def covers(self, stamp: cython.double) -> cython.bint:
        """True if the readings reach back to a time, to within LONGEST_EXTRAPOLATION."""
        if self.count == 0:
            return False
        return stamp >= self.readings[self.place(self.count - 1)] - LONGEST_EXTRAPOLATION

    def pose_at(self, stamp: cython.double) -> Pose:
        """The pose at a stamp; there must be a reading."""
        self.set_pose(stamp)
        return Pose(self.x, self.y, self.yaw)

    @cython.cfunc
    @cython.exceptval(-1)
    def set_pose(self, stamp: cython.double) -> cython.int:
        """Set `x`, `y` and `yaw` to the pose at a stamp; there must be a reading."""
        r = self.readings
        k: cython.Py_ssize_t
        later: cython.Py_ssize_t = self.place(0)

        # 1. After the newest reading.
        if r[later] <= stamp:
            return self._extrapolate_measured(later, min(stamp - r[later], LONGEST_EXTRAPOLATION))

        # 2. Between the last reading that is not after the stamp, and the next.
        for k in range(1, self.count):
            earlier: cython.Py_ssize_t = self.place(k)
            if r[earlier] <= stamp:
                fraction = (stamp - r[earlier]) / (r[later] - r[earlier])
                turned = remainder(r[later + R_YAW] - r[earlier + R_YAW], TURN)
                self.x = r[earlier + R_X] + fraction * (r[later + R_X] - r[earlier + R_X])
                self.y = r[earlier + R_Y] + fraction * (r[later + R_Y] - r[earlier + R_Y])
                self.yaw = r[earlier + R_YAW] + fraction * turned
                return 0
            later = earlier

        # 3. Before the oldest reading.
        return self._extrapolate_measured(later, stamp - r[later])

    @cython.cfunc
    @cython.inline
    @cython.exceptval(-1)
    def _extrapolate_measured(self, start: cython.Py_ssize_t, seconds: cython.double) -> cython.int:
        r = self.readings
        return self.extrapolate(
            start, r[start + R_LINEAR], r[start + R_ANGULAR], r[start + R_LATERAL], seconds
        )

    @cython.cfunc
    @cython.exceptval(-1)
    def extrapolate(
        self,
        start: cython.Py_ssize_t,
        linear: cython.double,
        angular: cython.double,
        lateral: cython.double,
        seconds: cython.double,
    ) -> cython.int:
        """Set the pose `seconds` after the reading at index `start`, at a constant twist.

        The robot moves along the chord of the arc: the way ahead and to the left, rotated by half
        of the turn.
        """
        r = self.readings
        turn = angular * seconds
        cos_chord = cos(r[start + R_YAW] + 0.5 * turn)
        sin_chord = sin(r[start + R_YAW] + 0.5 * turn)
        ahead = linear * seconds
        left = lateral * seconds
        self.x = r[start + R_X] + cos_chord * ahead - sin_chord * left
        self.y = r[start + R_Y] + sin_chord * ahead + cos_chord * left
        self.yaw = r[start + R_YAW] + turn
        return 0
