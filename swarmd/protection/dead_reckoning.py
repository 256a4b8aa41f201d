"""Dead reckoning of mode `barrier`: poses between readings of odometry, and between two scans.

Part of the library of barrier.py. Units: m, s, rad.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.core.angles import TURN
from swarmd.core.buffers import doubles
from swarmd.core.values import HISTORY, MAX_EXTRAPOLATION, MAX_SPEED, MAX_STEP, Pose
from swarmd.protection.barrier_assumptions import REACTION, Assumptions
from swarmd.protection.comparisons import maximum

if TYPE_CHECKING:  # Cython reads this import, CPython the other one
    import cython

    from swarmd.core.values import Odometry
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

# The fields of a reading of odometry.
_R_STAMP = cython.declare(cython.Py_ssize_t, 0)  # s
_R_X = cython.declare(cython.Py_ssize_t, 1)
_R_Y = cython.declare(cython.Py_ssize_t, 2)
_R_YAW = cython.declare(cython.Py_ssize_t, 3)
_R_LINEAR = cython.declare(cython.Py_ssize_t, 4)  # the measured speeds
_R_ANGULAR = cython.declare(cython.Py_ssize_t, 5)
_R_LATERAL = cython.declare(cython.Py_ssize_t, 6)
_R_FIELDS = cython.declare(cython.Py_ssize_t, 7)


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

    odometry: Odometry | None  # the last reading that was given
    version: cython.Py_ssize_t  # rises with each reading
    resets: cython.Py_ssize_t  # how often the clock went back or the pose jumped
    _assumptions: Assumptions
    # A ring buffer: _R_FIELDS of each reading. `_count` readings are in use, and `_newest` is the
    # number of the newest reading.
    _readings: cython.double[::1]
    _newest: cython.Py_ssize_t
    _count: cython.Py_ssize_t

    def __init__(self, assumptions: Assumptions) -> None:
        self._assumptions, self._readings = assumptions, doubles(_R_FIELDS * _history)

    @cython.cfunc
    def record(self, odometry: Odometry) -> None:
        """Store a reading of odometry if it differs from the newest stored reading.

        If the stamp does not rise, or the pose jumps, odometry had a reset: the function drops the
        readings before, and `resets` rises.
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
        readings: cython.double[::1] = self._readings
        start: cython.Py_ssize_t = _R_FIELDS * self._newest  # of the newest reading in the buffer
        if self._count:
            is_same_pose: cython.bint = (
                readings[start + _R_STAMP] == stamp
                and readings[start + _R_X] == x
                and readings[start + _R_Y] == y
                and readings[start + _R_YAW] == yaw
            )
            is_same_twist: cython.bint = (
                readings[start + _R_LINEAR] == linear
                and readings[start + _R_ANGULAR] == angular
                and readings[start + _R_LATERAL] == lateral
            )
            if is_same_pose and is_same_twist:
                return
            if self._is_reset(stamp, x, y, yaw):
                self._count = 0
                self.resets += 1
        # Overwrites the oldest reading.
        self._newest = (self._newest + 1) % _history
        self._count = min(self._count + 1, _history)
        self.version += 1
        start = _R_FIELDS * self._newest
        readings[start + _R_STAMP] = stamp
        readings[start + _R_X], readings[start + _R_Y] = x, y
        readings[start + _R_YAW] = yaw
        readings[start + _R_LINEAR], readings[start + _R_LATERAL] = linear, lateral
        readings[start + _R_ANGULAR] = angular

    @cython.cfunc
    @cython.exceptval(-1)
    def _is_reset(
        self, stamp: cython.double, x: cython.double, y: cython.double, yaw: cython.double
    ) -> cython.int:
        """1 if the stamp of a new reading does not rise, or if its pose jumps.

        A jump is a step of more than MAX_STEP (m or rad) plus MAX_SPEED times the seconds since the
        newest reading.
        """
        readings: cython.double[::1] = self._readings
        start: cython.Py_ssize_t = _R_FIELDS * self._newest
        distance: cython.double = hypot(x - readings[start + _R_X], y - readings[start + _R_Y])
        turned: cython.double = fabs(remainder(yaw - readings[start + _R_YAW], TURN))
        jump: cython.double = maximum(distance, turned)
        longest_jump: cython.double = _max_step + _max_speed * (stamp - readings[start + _R_STAMP])
        is_reset: cython.bint = stamp <= readings[start + _R_STAMP] or jump > longest_jump
        return is_reset

    @cython.cfunc
    @cython.exceptval(-1)
    def find_pose(
        self, odometry_age: cython.double, seconds_before: cython.double, into: PlanarPose
    ) -> cython.int:
        """Set `into` to the pose `seconds_before` s before a decision.

        `odometry_age` in s is the age of the newest reading at the decision. Without a reading the
        pose is (0, 0, 0).
        """
        readings: cython.double[::1] = self._readings
        if self._count == 0:
            return into.set(0.0, 0.0, 0.0)
        later: cython.Py_ssize_t = _R_FIELDS * self._newest
        stamp: cython.double = readings[later + _R_STAMP] + odometry_age - seconds_before

        # 1. After the newest reading: extrapolates at its twist, for a limited time.
        seconds: cython.double = stamp - readings[later + _R_STAMP]
        if readings[later + _R_STAMP] <= stamp:
            if seconds > LONGEST_EXTRAPOLATION:
                seconds = LONGEST_EXTRAPOLATION
            return self._extrapolate_measured(later, seconds, into)

        # 2. Between two readings: goes back to the first reading that is not after `stamp`, and
        # interpolates.
        k: cython.Py_ssize_t
        for k in range(1, self._count):
            earlier: cython.Py_ssize_t = _R_FIELDS * ((self._newest - k + _history) % _history)
            if readings[earlier + _R_STAMP] <= stamp:
                earlier_stamp: cython.double = readings[earlier + _R_STAMP]
                later_stamp: cython.double = readings[later + _R_STAMP]
                fraction: cython.double = (stamp - earlier_stamp) / (later_stamp - earlier_stamp)
                x: cython.double = readings[earlier + _R_X]
                y: cython.double = readings[earlier + _R_Y]
                yaw: cython.double = readings[earlier + _R_YAW]
                return into.set(
                    x + fraction * (readings[later + _R_X] - x),
                    y + fraction * (readings[later + _R_Y] - y),
                    yaw + fraction * remainder(readings[later + _R_YAW] - yaw, TURN),
                )
            later = earlier

        # 3. Before the oldest reading: extrapolates back at its twist.
        return self._extrapolate_measured(later, stamp - readings[later + _R_STAMP], into)

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

        The prediction begins at the newest reading, `odometry_age` s old at the decision, and ends
        REACTION s after the decision. Meanwhile each speed changes at the assumed braking towards
        the command in force (`linear`, `angular`, `lateral`). The age counts up to
        LONGEST_EXTRAPOLATION. Without a reading the pose is (0, 0, 0).
        """
        readings: cython.double[::1] = self._readings
        if self._count == 0:
            return into.set(0.0, 0.0, 0.0)
        newest: cython.Py_ssize_t = _R_FIELDS * self._newest
        linear_braking: cython.double = self._assumptions.braking_linear
        angular_braking: cython.double = self._assumptions.braking_angular
        seconds: cython.double = odometry_age
        if seconds > LONGEST_EXTRAPOLATION:
            seconds = LONGEST_EXTRAPOLATION
        seconds += REACTION
        return self._extrapolate(
            newest,
            _mean_speed(readings[newest + _R_LINEAR], linear, linear_braking, seconds),
            _mean_speed(readings[newest + _R_ANGULAR], angular, angular_braking, seconds),
            _mean_speed(readings[newest + _R_LATERAL], lateral, linear_braking, seconds),
            seconds,
            into,
        )

    @cython.cfunc
    @cython.inline
    @cython.exceptval(-1)
    def _extrapolate_measured(
        self, start: cython.Py_ssize_t, seconds: cython.double, into: PlanarPose
    ) -> cython.int:
        """Set `into` to the pose `seconds` after the reading at index `start`, at its twist."""
        readings: cython.double[::1] = self._readings
        linear: cython.double = readings[start + _R_LINEAR]
        angular: cython.double = readings[start + _R_ANGULAR]
        lateral: cython.double = readings[start + _R_LATERAL]
        return self._extrapolate(start, linear, angular, lateral, seconds, into)

    @cython.cfunc
    @cython.exceptval(-1)
    def _extrapolate(
        self,
        start: cython.Py_ssize_t,
        linear: cython.double,
        angular: cython.double,
        lateral: cython.double,
        seconds: cython.double,
        into: PlanarPose,
    ) -> cython.int:
        """Set `into` to the pose `seconds` after the reading at index `start`, at a constant twist.

        The robot moves along the chord of the arc: the way ahead and to the left, rotated by half
        of the turn.
        """
        readings: cython.double[::1] = self._readings
        turn: cython.double = angular * seconds
        yaw: cython.double = readings[start + _R_YAW] + 0.5 * turn
        ahead: cython.double = linear * seconds
        left: cython.double = lateral * seconds
        cos_yaw: cython.double = cos(yaw)
        sin_yaw: cython.double = sin(yaw)
        return into.set(
            readings[start + _R_X] + cos_yaw * ahead - sin_yaw * left,
            readings[start + _R_Y] + sin_yaw * ahead + cos_yaw * left,
            readings[start + _R_YAW] + turn,
        )


@cython.final
@cython.cclass
class CommandRange:
    """The range of the commands along one direction, in m/s; the range includes 0.

    The base responds late. So two groups of commands explain the motion between two scans: the
    commands between these scans, and the commands between the two scans before.
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

    @cython.cfunc
    @cython.exceptval(check=False)
    def explained(self, moved: cython.double, seconds: cython.double) -> cython.double:
        """The part in m of a motion between two scans that the commands explain.

        `moved` in m is the motion by odometry, `seconds` the time between the scans. The motion is
        clamped to what the lowest and the highest command give in this time. The call also ends the
        interval: later commands belong to the next two scans.
        """
        slowest: cython.double = min(self._least, self._least_before)
        fastest: cython.double = maximum(self._most, self._most_before)
        self._least_before, self._least = self._least, 0.0
        self._most_before, self._most = self._most, 0.0
        least_way: cython.double = slowest * seconds
        most_way: cython.double = fastest * seconds
        if not moved >= least_way:  # also for NaN
            return least_way
        return moved if moved <= most_way else most_way


@cython.final
@cython.cclass
class ScanMotion:
    """When and where the last scan was taken, and the motion between the last two scans."""

    pose: PlanarPose  # of the last scan, by odometry
    measured_at: cython.double  # s, time of the newest ray of the scan; -inf before the first scan
    first_use_delay: cython.double  # s from the arrival of the scan to its first use
    oldest: cython.double  # s, the age of the oldest ray against the newest
    extra_age: cython.double  # s by which the oldest ray is older than the platform's latency says
    resets: cython.Py_ssize_t  # of odometry before the scan
    moved: PlanarPose  # since the scan before, in the frame of that scan
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
        self.measured_at = -INFINITY

    @cython.cfunc
    def begin(
        self,
        now: cython.double,
        age: cython.double,
        newest_age: cython.double,
        delay: cython.double,
        odometry_age: cython.double,
        ages: cython.const_double[::1],
    ) -> cython.bint:
        """Store time and pose of a scan, and the motion since the scan before.

        False, and nothing changes, if the newest ray of the scan is not newer than the newest ray
        of the scan before. A scan of age 0 always counts, since all its rays arrived just now.

        Args:
            now: s, the time of the call.
            age: s from the arrival of the scan until `now`. For a scan with rays that conditioning
                has remembered: from the arrival of the oldest of these rays.
            newest_age: s, how old the newest ray is on arrival by the platform's latency.
            delay: s by which the scan arrives later than the platform's latency says.
            odometry_age: s, how old the newest odometry is at `now`.
            ages: (n,) s, by how much each ray is older than the newest ray; empty: all are 0.
        """
        i: cython.Py_ssize_t
        oldest_age: cython.double = 0.0

        # 1. When the scan was measured.
        for i in range(len(ages)):
            if ages[i] > oldest_age:
                oldest_age = ages[i]
        latency: cython.double = newest_age + delay  # s from the newest ray to its arrival
        measured_at: cython.double = now - latency - age
        if age > 0.0 and measured_at < self.measured_at + _AGE_TOLERANCE:
            return False

        self.oldest, self.extra_age = oldest_age, delay + oldest_age
        # inf at the first scan; 0 if a scan of age 0 is not newer than the scan before.
        self.seconds = maximum(measured_at - self.measured_at, 0.0)

        # 2. `pose` is still that of the scan before. After a reset of odometry it is in the frame
        # before. Finds it in the new frame: new readings are extrapolated back by their speed.
        reckoning: DeadReckoning = self._reckoning
        if self.resets != reckoning.resets:
            longest_age: cython.double = self._assumptions.longest_scan_age
            reckoning.find_pose(odometry_age, latency + min(self.seconds, longest_age), self.pose)

        # 3. Where the scan was measured, and the motion since the scan before. `age` is left out:
        # the pose is that of the rays that just arrived, not that of remembered rays.
        reckoning.find_pose(odometry_age, latency, self._now)
        self.moved.set_relative(self._now, self.pose)
        self.pose.set(self._now.x, self._now.y, self._now.yaw)
        self.measured_at, self.first_use_delay = measured_at, age
        self.resets = reckoning.resets
        return True

    @cython.cfunc
    def driven(self) -> Pose:
        """The part of the motion between the last two scans that the robot's commands explain.

        A Pose in the frame of the scan before. The motion is split along and across the chord of
        the arc (the direction of the mean yaw), and each part is clamped to what the commands ahead
        and sideways explain. The turn is the measured turn.
        """
        chord_angle: cython.double = 0.5 * self.moved.yaw  # rad, of the chord of the arc
        cos_chord: cython.double = cos(chord_angle)
        sin_chord: cython.double = sin(chord_angle)
        x: cython.double = self.moved.x
        y: cython.double = self.moved.y
        # A longer time between two scans holds the robot, so no command explains more.
        seconds: cython.double = min(self.seconds, self._assumptions.longest_scan_age)
        ahead: cython.double = self.ahead.explained(cos_chord * x + sin_chord * y, seconds)
        left: cython.double = self.left.explained(cos_chord * y - sin_chord * x, seconds)
        return Pose(
            cos_chord * ahead - sin_chord * left,
            sin_chord * ahead + cos_chord * left,
            self.moved.yaw,
        )
