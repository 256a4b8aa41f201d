"""Dead reckoning of mode `barrier`: poses between readings of odometry, and between two scans.

Part of the unit of barrier.py. Units: m, s, rad.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.core import cython_shadow as cython
from swarmd.core.cython_shadow import INFINITY, Doubles, copysign, cos, fabs, sin
from swarmd.core.odometry_trail import (
    ANEW,
    LONGEST_EXTRAPOLATION,
    NEXT,
    R_ANGULAR,
    R_LATERAL,
    R_LINEAR,
    OdometryTrail,
)
from swarmd.core.values import Pose
from swarmd.robot.protection.barrier_assumptions import REACTION, Assumptions
from swarmd.robot.protection.comparisons import maximum

if TYPE_CHECKING:
    from swarmd.core.values import Odometry

_AGE_TOLERANCE = 1e-6  # s, for the rounding of ages


@cython.cclass
class PlanarPose:
    """A pose in m and rad."""

    x: float
    y: float
    yaw: float

    def set(self, x: float, y: float, yaw: float) -> None:
        """Take another value."""
        self.x = x
        self.y = y
        self.yaw = yaw

    def set_relative(self, pose: PlanarPose, base: PlanarPose) -> None:
        """Set this pose to `pose` in the frame of `base`; the yaw is the plain difference."""
        dx = pose.x - base.x
        dy = pose.y - base.y
        c = cos(base.yaw)
        s = sin(base.yaw)
        self.x = c * dx + s * dy
        self.y = c * dy - s * dx
        self.yaw = pose.yaw - base.yaw


def _mean_speed(now: float, wanted: float, rate: float, seconds: float) -> float:
    """The mean speed over `seconds` on a ramp of `rate` from `now` to `wanted`."""
    change = wanted - now
    ramp = fabs(change) / rate
    if ramp >= seconds:
        return now + copysign(0.5 * rate * seconds, change)
    return now + change * (1.0 - 0.5 * ramp / seconds)


@cython.cclass
class DeadReckoning:
    """The poses of a robot from its last readings of odometry."""

    odometry: Odometry | None  # the last reading that was given
    version: int  # rises with each reading
    resets: int  # how often the clock went back or the pose jumped
    _assumptions: Assumptions
    _trail: OdometryTrail

    def __init__(self, assumptions: Assumptions) -> None:
        self._assumptions = assumptions
        self._trail = OdometryTrail()

    def record(self, odometry: Odometry) -> None:
        """Store a reading of odometry; `resets` rises if it begins the trail anew."""
        self.odometry = odometry
        taken = self._trail.take(odometry)
        if taken >= NEXT:
            self.version += 1
            self.resets += taken == ANEW

    def find_pose(self, odometry_age: float, seconds_before: float, into: PlanarPose) -> None:
        """Set `into` to the pose `seconds_before` s before a decision.

        `odometry_age` in s is the age of the newest reading at the decision. Without a reading the
        pose is (0, 0, 0).
        """
        trail: OdometryTrail = self._trail
        if trail.count == 0:
            into.set(0.0, 0.0, 0.0)
            return
        trail.set_pose(trail.latest + odometry_age - seconds_before)
        into.set(trail.x, trail.y, trail.yaw)

    def predict_pose(
        self, odometry_age: float, linear: float, angular: float, lateral: float, into: PlanarPose
    ) -> None:
        """Set `into` to the pose at which the next command takes effect.

        The prediction begins at the newest reading, `odometry_age` s old at the decision, and ends
        REACTION s after the decision. Meanwhile each speed changes at the assumed braking towards
        the command in force (`linear`, `angular`, `lateral`). The age counts up to
        LONGEST_EXTRAPOLATION. Without a reading the pose is (0, 0, 0).
        """
        trail: OdometryTrail = self._trail
        if trail.count == 0:
            into.set(0.0, 0.0, 0.0)
            return
        newest = trail.place(0)
        readings = trail.readings
        linear_braking = self._assumptions.braking_linear
        angular_braking = self._assumptions.braking_angular
        seconds = odometry_age
        if seconds > LONGEST_EXTRAPOLATION:
            seconds = LONGEST_EXTRAPOLATION
        seconds += REACTION
        trail.extrapolate(
            newest,
            _mean_speed(readings[newest + R_LINEAR], linear, linear_braking, seconds),
            _mean_speed(readings[newest + R_ANGULAR], angular, angular_braking, seconds),
            _mean_speed(readings[newest + R_LATERAL], lateral, linear_braking, seconds),
            seconds,
        )
        into.set(trail.x, trail.y, trail.yaw)


@cython.cclass
class CommandRange:
    """The range of the commands along one direction, in m/s; the range includes 0.

    The base responds late. So two groups of commands explain the motion between two scans: the
    commands between these scans, and the commands between the two scans before.
    """

    _least: float
    _most: float
    _least_before: float
    _most_before: float

    def note(self, speed: float) -> None:
        """Note the command in force since the last decision."""
        self._least = min(self._least, speed)
        self._most = maximum(self._most, speed)

    def explained(self, moved: float, seconds: float) -> float:
        """The part in m of a motion between two scans that the commands explain.

        `moved` in m is the motion by odometry, `seconds` the time between the scans. The motion is
        clamped to what the lowest and the highest command give in this time. The call also ends the
        interval: later commands belong to the next two scans.
        """
        slowest = min(self._least, self._least_before)
        fastest = maximum(self._most, self._most_before)
        self._least_before = self._least
        self._least = 0.0
        self._most_before = self._most
        self._most = 0.0
        least_way = slowest * seconds
        most_way = fastest * seconds
        if not moved >= least_way:  # also for NaN
            return least_way
        return moved if moved <= most_way else most_way


@cython.cclass
class ScanMotion:
    """When and where the last scan was taken, and the motion between the last two scans."""

    pose: PlanarPose  # of the last scan, by odometry
    measured_at: float  # s, time of the newest ray of the scan; -inf before the first scan
    first_use_delay: float  # s from the arrival of the scan to its first use
    oldest: float  # s, the age of the oldest ray against the newest
    extra_age: float  # s by which the oldest ray is older than the platform's latency says
    resets: int  # of odometry before the scan
    moved: PlanarPose  # since the scan before, in the frame of that scan
    ahead: CommandRange
    left: CommandRange
    seconds: float  # between the last two scans
    _now: PlanarPose
    _assumptions: Assumptions
    _reckoning: DeadReckoning

    def __init__(self, assumptions: Assumptions, reckoning: DeadReckoning) -> None:
        self._assumptions = assumptions
        self._reckoning = reckoning
        self.pose = PlanarPose()
        self.moved = PlanarPose()
        self._now = PlanarPose()
        self.ahead = CommandRange()
        self.left = CommandRange()
        self.measured_at = -INFINITY

    def begin(
        self,
        now: float,
        age: float,
        newest_age: float,
        delay: float,
        odometry_age: float,
        ages: Doubles,
    ) -> bool:
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
        oldest_age = 0.0

        # 1. When the scan was measured.
        for i in range(len(ages)):
            if ages[i] > oldest_age:
                oldest_age = ages[i]
        latency = newest_age + delay  # s from the newest ray to its arrival
        measured_at = now - latency - age
        if age > 0.0 and measured_at < self.measured_at + _AGE_TOLERANCE:
            return False

        self.oldest = oldest_age
        self.extra_age = delay + oldest_age
        # inf at the first scan; 0 if a scan of age 0 is not newer than the scan before.
        self.seconds = maximum(measured_at - self.measured_at, 0.0)

        # 2. `pose` is still that of the scan before. After a reset of odometry it is in the frame
        # before. Finds it in the new frame: new readings are extrapolated back by their speed.
        reckoning: DeadReckoning = self._reckoning
        if self.resets != reckoning.resets:
            longest_age = self._assumptions.longest_scan_age
            reckoning.find_pose(odometry_age, latency + min(self.seconds, longest_age), self.pose)

        # 3. Where the scan was measured, and the motion since the scan before. `age` is left out:
        # the pose is that of the rays that just arrived, not that of remembered rays.
        reckoning.find_pose(odometry_age, latency, self._now)
        self.moved.set_relative(self._now, self.pose)
        self.pose.set(self._now.x, self._now.y, self._now.yaw)
        self.measured_at = measured_at
        self.first_use_delay = age
        self.resets = reckoning.resets
        return True

    def driven(self) -> Pose:
        """The part of the motion between the last two scans that the robot's commands explain.

        A Pose in the frame of the scan before. The motion is split along and across the chord of
        the arc (the direction of the mean yaw), and each part is clamped to what the commands ahead
        and sideways explain. The turn is the measured turn.
        """
        chord_angle = 0.5 * self.moved.yaw  # rad, of the chord of the arc
        cos_chord = cos(chord_angle)
        sin_chord = sin(chord_angle)
        x = self.moved.x
        y = self.moved.y
        # A longer time between two scans holds the robot, so no command explains more.
        seconds = min(self.seconds, self._assumptions.longest_scan_age)
        ahead = self.ahead.explained(cos_chord * x + sin_chord * y, seconds)
        left = self.left.explained(cos_chord * y - sin_chord * x, seconds)
        return Pose(
            cos_chord * ahead - sin_chord * left,
            sin_chord * ahead + cos_chord * left,
            self.moved.yaw,
        )
