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
from swarmd.core.cython_shadow import NAN, Doubles, cos, fabs, hypot, isfinite, remainder, sin
from swarmd.core.values import (
    HISTORY,
    HISTORY_SPACING,
    MAX_EXTRAPOLATION,
    MAX_SPEED,
    MAX_STEP,
    Odometry,
    Pose,
)

LONGEST_EXTRAPOLATION = MAX_EXTRAPOLATION
"""s for which the newest measured twist is extrapolated."""

# What `take` makes of a reading.
REFUSED = 0
SAME = 1
NEXT = 2
ANEW = 3

_READINGS = HISTORY
_spacing = HISTORY_SPACING
_most = MAX_COORDINATE
_max_step = MAX_STEP
_max_speed = MAX_SPEED

# The fields of a reading at `start`, behind its stamp, which is `readings[start]`.
R_X = 1
R_Y = 2
R_YAW = 3
R_LINEAR = 4  # the measured speeds
R_ANGULAR = 5
R_LATERAL = 6
_FIELDS = 7


def is_jump(dx: float, dy: float, turn: float, seconds: float) -> bool:
    """True if no base can move that far in that time: an estimator has shifted the pose."""
    way = max(hypot(dx, dy), fabs(remainder(turn, TURN)))
    return way > _max_step + _max_speed * seconds


@cython.cclass
class OdometryTrail:
    """The last readings of odometry. `set_pose` sets `x`, `y` and `yaw`."""

    count: int  # readings in use
    latest: float  # the newest stamp; NaN before the first reading
    readings: Doubles  # a ring buffer
    x: float
    y: float
    yaw: float
    _newest: int  # the number of the newest reading in the buffer

    def __init__(self) -> None:
        self.latest = NAN
        self.readings = doubles(_FIELDS * _READINGS)

    def take(self, odometry: Odometry, checks: bool = False) -> int:
        """Store a reading: NEXT, or ANEW if it begins the trail anew. Else SAME or REFUSED.

        `checks`: a reading is REFUSED with a number that is not finite or beyond MAX_COORDINATE.
        Without, such a number is in the poses, so that the barrier lets no command pass.
        """
        pose = odometry.pose
        twist = odometry.twist
        stamp = odometry.stamp
        x = pose.x
        y = pose.y
        yaw = pose.yaw
        linear = twist.linear
        angular = twist.angular
        lateral = twist.lateral
        taken = NEXT
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
        start = self.place(0)
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

    def clear(self) -> None:
        """Forget all readings."""
        self.count = 0
        self.latest = NAN

    def place(self, before: int) -> int:
        """The index at which the reading begins that is `before` readings before the newest."""
        return _FIELDS * ((self._newest - before + _READINGS) % _READINGS)

    def covers(self, stamp: float) -> bool:
        """True if the readings reach back to a time, to within LONGEST_EXTRAPOLATION."""
        if self.count == 0:
            return False
        return stamp >= self.readings[self.place(self.count - 1)] - LONGEST_EXTRAPOLATION

    def pose_at(self, stamp: float) -> Pose:
        """The pose at a stamp; there must be a reading."""
        self.set_pose(stamp)
        return Pose(self.x, self.y, self.yaw)

    def set_pose(self, stamp: float) -> None:
        """Set `x`, `y` and `yaw` to the pose at a stamp; there must be a reading."""
        r = self.readings
        later = self.place(0)

        # 1. After the newest reading.
        if r[later] <= stamp:
            self._extrapolate_measured(later, min(stamp - r[later], LONGEST_EXTRAPOLATION))
            return

        # 2. Between the last reading that is not after the stamp, and the next.
        for k in range(1, self.count):
            earlier = self.place(k)
            if r[earlier] <= stamp:
                fraction = (stamp - r[earlier]) / (r[later] - r[earlier])
                turned = remainder(r[later + R_YAW] - r[earlier + R_YAW], TURN)
                self.x = r[earlier + R_X] + fraction * (r[later + R_X] - r[earlier + R_X])
                self.y = r[earlier + R_Y] + fraction * (r[later + R_Y] - r[earlier + R_Y])
                self.yaw = r[earlier + R_YAW] + fraction * turned
                return
            later = earlier

        # 3. Before the oldest reading.
        self._extrapolate_measured(later, stamp - r[later])

    def _extrapolate_measured(self, start: int, seconds: float) -> None:
        r = self.readings
        self.extrapolate(
            start, r[start + R_LINEAR], r[start + R_ANGULAR], r[start + R_LATERAL], seconds
        )

    def extrapolate(
        self, start: int, linear: float, angular: float, lateral: float, seconds: float
    ) -> None:
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
