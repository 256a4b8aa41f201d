"""The pose of this robot in a shared frame, which its driver reports: the only place of this fact.

`Peers` (the places of peers as obstacles, and what is sent to peers), `NeighborPlaces` (the places
of neighbours for patterns) and the inputs of patterns read it here. The fence keeps poses of its
own (`protection/fence/fence_pose.py`): only those that odometry confirms, each with the odometry at
its time. Pure. Times are in s on the robot's monotonic clock.
"""

from __future__ import annotations

import math

from swarmd.core.arrival_delay import ArrivalDelay
from swarmd.core.neighbor_places import TimedPose
from swarmd.core.values import Limits, Pose, SharedPose, Twist

POSE_TIMEOUT = 0.5  # s of age beyond which a pose in a shared frame is neither sent nor used
FASTEST_POSE = 0.1  # s: upper bound of the least delay of own poses, which no clock can measure


class OwnPose:
    """The last valid pose of this robot in a shared frame, and the bounds of its errors.

    - `last`: the pose, and its assumed time; the true time differs by at most FASTEST_POSE / 2.
      None before the first pose.
    - `shift`, `turn`: m and rad by which the robot moves in FASTEST_POSE / 2.
    """

    def __init__(self, limits: Limits) -> None:
        """No pose yet. `limits`: of the platform; the speed of a robot without fresh odometry."""
        self._limits = limits
        self._delay = ArrivalDelay()
        self.last: TimedPose | None = None
        self.shift = 0.0
        self.turn = 0.0

    def take(self, pose: SharedPose, twist: Twist | None, now: float) -> TimedPose | None:
        """Take in a pose of the driver; returns the pose with its time, None if it is ignored.

        `twist`: the measured twist, None without fresh odometry. A pose that is invalid, or whose
        stamp is not newer than the last stamp, is ignored.
        """
        if not pose.is_valid:
            return None
        # `late`: s beyond the least delay of own poses, which is at most FASTEST_POSE.
        late = self._delay.take(pose.stamp, now)
        if late is None:
            return None
        limits = self._limits
        half = 0.5 * FASTEST_POSE
        if twist is None:
            twist = Twist(limits.linear, limits.angular, limits.lateral)
        self.shift = half * math.hypot(twist.linear, twist.lateral)
        self.turn = half * abs(twist.angular)
        self.last = TimedPose(pose, now - late - half)
        return self.last

    @property
    def errors(self) -> tuple[float, float]:
        """Bounds in m and rad of the errors of the last pose; its time error is included."""
        assert self.last is not None
        shared = self.last.pose
        return shared.error + self.shift, shared.yaw_error + self.turn

    def usable(self, now: float) -> Pose | None:
        """The pose for patterns; None without a fresh one."""
        last = self.last
        return last.pose.pose if last is not None and now <= last.at + POSE_TIMEOUT else None

    def shown(self, now: float) -> tuple[SharedPose, float] | None:
        """The pose and its age in s, for viewers; None without a fresh pose."""
        last = self.last
        age = 0.0 if last is None else max(now - last.at, 0.0)
        return None if last is None or age > POSE_TIMEOUT else (last.pose, age)

    def to_tell(self, now: float) -> tuple[SharedPose, float] | None:
        """The pose for peers, and its highest possible age in s; None without a fresh pose."""
        last = self.last
        if last is None:
            return None
        age = now - last.at + 0.5 * FASTEST_POSE
        return (last.pose, age) if age <= POSE_TIMEOUT else None
