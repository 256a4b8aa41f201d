"""Dead reckoning of mode `barrier`: poses between readings of odometry, and between two scans.

Part of the library of barrier.py. Units: m, s, rad.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from swarmd.core.values import MAX_SPEED, MAX_STEP, Pose
from swarmd.protection.barrier_assumptions import REACTION, Assumptions
from swarmd.protection.buffers import doubles, maximum
from swarmd.sensing.odometry_history import HISTORY, MAX_EXTRAPOLATION

if TYPE_CHECKING:  # Cython reads this import, CPython the other one
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import INFINITY, copysign, cos, fabs, hypot, remainder, sin
else:
    from swarmd.core.cython_shadow import INFINITY, copysign, cos, fabs, hypot, remainder, sin

LONGEST_EXTRAPOLATION = cython.declare(cython.double, MAX_EXTRAPOLATION)
"""s for which the last measured twist is extrapolated."""

_AGE_TOLERANCE = cython.declare(cython.double, 1e-6)  # s, for the rounding of ages
_max_step = cython.declare(cython.double, MAX_STEP)
_max_speed = cython.declare(cython.double, MAX_SPEED)
_history = cython.declare(cython.Py_ssize_t, HISTORY)
_FIELDS = cython.declare(cython.Py_ssize_t, 7)  # of a reading
_turn = cython.declare(cython.double, 2.0 * math.pi)


@cython.final
@cython.cclass
class PlanarPose:
    """A pose in m and rad."""

    x: cython.double
    y: cython.double
    yaw: cython.double

    @cython.cfunc
    @cython.exceptval(-1)
    def set(self, x: cython.double, y: cython.double, yaw: cython.double) -> cython.int:
        """Take another value."""
        self.x, self.y, self.yaw = x, y, yaw
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def set_relative(self, pose: PlanarPose, base: PlanarPose) -> cython.int:
        """Set this pose to `pose` in the frame of `base`; the yaw is the plain difference."""
        dx: cython.double = pose.x - base.x
        dy: cython.double = pose.y - base.y
        c: cython.double = cos(base.yaw)
        s: cython.double = sin(base.yaw)
        self.x, self.y = c * dx + s * dy, c * dy - s * dx
        self.yaw = pose.yaw - base.yaw
        return 0


@cython.cfunc
@cython.exceptval(check=False)
def _mean_speed(
    now: cython.double, wanted: cython.double, rate: cython.double, seconds: cython.double
) -> cython.double:
    """The mean speed over `seconds` on a ramp of `rate` from `now` to `wanted`."""
    change: cython.double = wanted - now
    ramp: cython.double = fabs(change) / rate
    if ramp >= seconds:
        return now + copysign(0.5 * rate * seconds, change)
    return now + change * (1.0 - 0.5 * ramp / seconds)


@cython.final
@cython.cclass
class DeadReckoning:
    """The poses of a robot from its last readings of odometry."""

    odometry: object  # the last reading that was given
    version: cython.Py_ssize_t  # rises with each reading
    resets: cython.Py_ssize_t  # how often the clock went back or the pose jumped
    _assumptions: Assumptions
    # A ring buffer of readings (stamp, x, y, yaw and three speeds); the newest is at `_last`.
    _readings: cython.double[::1]
    _last: cython.Py_ssize_t
    _known: cython.Py_ssize_t

    def __init__(self, assumptions: Assumptions) -> None:
        self._assumptions, self._readings = assumptions, doubles(_FIELDS * _history)

    @cython.cfunc
    def record(self, odometry):
        """Record a reading of odometry if it is new.

        A new reading whose stamp does not rise, or whose pose jumps, is a reset: poses before it
        are not valid any more.
        """
        self.odometry = odometry
        pose, twist = odometry.pose, odometry.twist
        stamp: cython.double = odometry.stamp
        x: cython.double = pose.x
        y: cython.double = pose.y
        yaw: cython.double = pose.yaw
        linear: cython.double = twist.linear
        angular: cython.double = twist.angular
        lateral: cython.double = twist.lateral
        r: cython.double[::1] = self._readings
        at: cython.Py_ssize_t = _FIELDS * self._last
        if self._known:
            if (
                r[at] == stamp
                and r[at + 1] == x
                and r[at + 2] == y
                and r[at + 3] == yaw
                and r[at + 4] == linear
                and r[at + 5] == angular
                and r[at + 6] == lateral
            ):
                return
            jump: cython.double = maximum(
                hypot(x - r[at + 1], y - r[at + 2]), fabs(remainder(yaw - r[at + 3], _turn))
            )
            if stamp <= r[at] or jump > _max_step + _max_speed * (stamp - r[at]):
                self._known = 0
                self.resets += 1
        self._last = (self._last + 1) % _history
        self._known = min(self._known + 1, _history)
        self.version += 1
        at = _FIELDS * self._last
        r[at], r[at + 1], r[at + 2], r[at + 3] = stamp, x, y, yaw
        r[at + 4], r[at + 5], r[at + 6] = linear, angular, lateral

    @cython.cfunc
    @cython.exceptval(-1)
    def find_pose(
        self, odometry_age: cython.double, ago: cython.double, into: PlanarPose
    ) -> cython.int:
        """Set `into` to the pose `ago` s before a decision.

        The pose is interpolated between two readings, or extrapolated beyond the first or the last.
        `odometry_age` in s is that of the last reading at the decision. Without a reading the pose
        is (0, 0, 0).
        """
        r: cython.double[::1] = self._readings
        if self._known == 0:
            return into.set(0.0, 0.0, 0.0)
        k: cython.Py_ssize_t
        early: cython.Py_ssize_t
        late: cython.Py_ssize_t = _FIELDS * self._last
        at: cython.double = r[late] + odometry_age - ago
        for k in range(self._known):
            early = _FIELDS * ((self._last - k + _history) % _history)
            if r[early] <= at:
                if k == 0:
                    seconds: cython.double = at - r[early]
                    if seconds > LONGEST_EXTRAPOLATION:
                        seconds = LONGEST_EXTRAPOLATION
                    return self._extrapolate(
                        early, r[early + 4], r[early + 5], r[early + 6], seconds, into
                    )
                share: cython.double = (at - r[early]) / (r[late] - r[early])
                turn: cython.double = remainder(r[late + 3] - r[early + 3], _turn)
                return into.set(
                    r[early + 1] + share * (r[late + 1] - r[early + 1]),
                    r[early + 2] + share * (r[late + 2] - r[early + 2]),
                    r[early + 3] + share * turn,
                )
            late = early
        return self._extrapolate(late, r[late + 4], r[late + 5], r[late + 6], at - r[late], into)

    @cython.cfunc
    @cython.exceptval(-1)
    def predict_pose(
        self,
        odometry_age: cython.double,
        linear: cython.double,
        angular: cython.double,
        lateral: cython.double,
        into: PlanarPose,
    ) -> cython.int:
        """Set `into` to the pose at which the next command takes effect.

        From the last reading on, each speed changes towards the command in force, at the assumed
        braking. Without a reading the pose is (0, 0, 0).
        """
        r: cython.double[::1] = self._readings
        if self._known == 0:
            return into.set(0.0, 0.0, 0.0)
        last: cython.Py_ssize_t = _FIELDS * self._last
        slowing: cython.double = self._assumptions.braking_linear
        turning: cython.double = self._assumptions.braking_angular
        seconds: cython.double = odometry_age
        if seconds > LONGEST_EXTRAPOLATION:
            seconds = LONGEST_EXTRAPOLATION
        seconds += REACTION
        return self._extrapolate(
            last,
            _mean_speed(r[last + 4], linear, slowing, seconds),
            _mean_speed(r[last + 5], angular, turning, seconds),
            _mean_speed(r[last + 6], lateral, slowing, seconds),
            seconds,
            into,
        )

    @cython.cfunc
    @cython.exceptval(-1)
    def _extrapolate(
        self,
        at: cython.Py_ssize_t,
        linear: cython.double,
        angular: cython.double,
        lateral: cython.double,
        seconds: cython.double,
        into: PlanarPose,
    ) -> cython.int:
        """Set `into` to the pose `seconds` after the reading at `at`, at a constant twist.

        The robot moves along the chord of the arc; `linear` and `lateral` give its length.
        """
        r: cython.double[::1] = self._readings
        turn: cython.double = angular * seconds
        yaw: cython.double = r[at + 3] + 0.5 * turn
        ahead: cython.double = linear * seconds
        left: cython.double = lateral * seconds
        c: cython.double = cos(yaw)
        s: cython.double = sin(yaw)
        return into.set(
            r[at + 1] + c * ahead - s * left, r[at + 2] + s * ahead + c * left, r[at + 3] + turn
        )


@cython.final
@cython.cclass
class CommandRange:
    """The range of the commands along one direction, in m/s; the range includes 0.

    The base responds late. So the motion between two scans is explained by the commands between
    these scans, and by those between the two scans before.
    """

    _least: cython.double
    _most: cython.double
    _least_before: cython.double
    _most_before: cython.double

    @cython.cfunc
    @cython.exceptval(-1)
    def note(self, speed: cython.double) -> cython.int:
        """Note the command in force since the last decision."""
        self._least = min(self._least, speed)
        self._most = maximum(self._most, speed)
        return 0

    @cython.cfunc
    @cython.exceptval(check=False)
    def explained(self, moved: cython.double, seconds: cython.double) -> cython.double:
        """The part in m of a motion between two scans that the commands explain.

        The call also ends the interval: later commands belong to the next two scans.
        """
        least: cython.double = min(self._least, self._least_before)
        most: cython.double = maximum(self._most, self._most_before)
        self._least_before, self._least = self._least, 0.0
        self._most_before, self._most = self._most, 0.0
        least *= seconds
        most *= seconds
        if not moved >= least:  # NaN too
            return least
        return moved if moved <= most else most


@cython.final
@cython.cclass
class ScanMotion:
    """When and where the last scan was taken, and the motion between the last two scans."""

    pose: PlanarPose  # of the last scan, by odometry
    taken: cython.double  # s, the time of its newest ray; -inf before the first scan
    lag: cython.double  # s from its arrival to its first use
    oldest: cython.double  # s, the age of its oldest ray against the newest
    late: cython.double  # s by which its oldest ray is later than the platform's latency says
    resets: cython.Py_ssize_t  # of odometry before it
    moved: PlanarPose  # since the scan before, in its frame
    ahead: CommandRange
    left: CommandRange
    seconds: cython.double  # between the last two scans
    _now: PlanarPose
    _assumptions: Assumptions
    _reckoning: DeadReckoning

    def __init__(self, assumptions: Assumptions, reckoning: DeadReckoning) -> None:
        self._assumptions, self._reckoning = assumptions, reckoning
        self.pose, self.moved = PlanarPose(), PlanarPose()
        self._now = PlanarPose()
        self.ahead, self.left = CommandRange(), CommandRange()
        self.taken = -INFINITY

    @cython.cfunc
    def begin(
        self,
        now: cython.double,
        age: cython.double,
        newest_age: cython.double,
        delay: cython.double,
        odometry_age: cython.double,
        ages: cython.const[cython.double][::1],
    ):
        """Take time and pose of a scan, and the motion since the scan before.

        False if the scan is not newer than the scan before; then nothing changes. All in s:

        Args:
            now: the time of the call.
            age: since the arrival of the scan.
            newest_age: of the newest ray on arrival, by the platform's latency.
            delay: by which the scan arrives later than the platform's latency says.
            odometry_age: of the newest odometry.
            ages: (n,) of the rays against the newest ray; empty: all are 0.
        """
        i: cython.Py_ssize_t
        oldest: cython.double = 0.0
        for i in range(len(ages)):
            if ages[i] > oldest:
                oldest = ages[i]
        latency: cython.double = newest_age + delay
        taken: cython.double = now - latency - age
        if age > 0.0 and taken < self.taken + _AGE_TOLERANCE:
            return False
        self.oldest, self.late = oldest, delay + oldest
        self.seconds = maximum(taken - self.taken, 0.0)
        reckoning: DeadReckoning = self._reckoning
        if self.resets != reckoning.resets:  # find the pose of the last scan by the speed alone
            stale: cython.double = self._assumptions.stale
            reckoning.find_pose(odometry_age, latency + min(self.seconds, stale), self.pose)
        reckoning.find_pose(odometry_age, latency, self._now)
        self.moved.set_relative(self._now, self.pose)
        self.pose.set(self._now.x, self._now.y, self._now.yaw)
        self.taken, self.lag = taken, age
        self.resets = reckoning.resets
        return True

    @cython.cfunc
    def driven(self):
        """The part of the motion between the last two scans that the robot's commands explain.

        A pose in the frame of the scan before. The turn is the measured turn.
        """
        half: cython.double = 0.5 * self.moved.yaw  # rad, the direction of the chord of the arc
        c: cython.double = cos(half)
        s: cython.double = sin(half)
        x: cython.double = self.moved.x
        y: cython.double = self.moved.y
        seconds: cython.double = min(self.seconds, self._assumptions.stale)  # a hold follows
        ahead: cython.double = self.ahead.explained(c * x + s * y, seconds)
        left: cython.double = self.left.explained(c * y - s * x, seconds)
        return Pose(c * ahead - s * left, s * ahead + c * left, self.moved.yaw)
