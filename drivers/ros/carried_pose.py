"""A pose in a shared frame that odometry carries on between the poses of a localisation. Pure.

A localisation on a map publishes after motion alone: AMCL after 0.25 m or 0.2 rad (its parameters
`update_min_d` and `update_min_a`), and never while the robot stands. Between two poses the pose
moves as odometry does, and its error grows with way and turn. A jump of the localisation moves the
pose, not the robot: odometry has the motion.
"""

from __future__ import annotations

import math
from collections import deque

from msgspec import structs

from swarmd.core.values import Odometry, Pose, SharedPose

HISTORY = 200  # readings of odometry: 4 s at 50 Hz, above the delay of a localisation
SILENCE = 0.25  # s without a pose before odometry carries it; a faster source is never carried
PERIOD = 0.04  # s between two carried poses, at least
ODOMETRY_SHARE = 0.05  # of way and turn, the bound of the error of odometry, as of the fence
MAX_WAY, MAX_TURN = 2.0, 2.0 * math.pi  # m and rad without a pose: the localisation has ended
UNSEEN_WAY, UNSEEN_TURN = 0.25, 0.2  # m and rad without a pose before the driver has started
_STEP, _TURN = 0.01, 0.02  # m and rad: less is noise of odometry at rest


class CarriedPose:
    """The last pose of the localisation, carried by odometry. All times are stamps in s.

    Stamps of poses and of odometry must be of one clock. A pose whose stamp is outside those of the
    kept readings is not carried, since it is of another clock, or too old.
    """

    def __init__(self) -> None:
        self._readings: deque[Odometry] = deque(maxlen=HISTORY)
        self._anchor: tuple[SharedPose, Odometry] | None = None  # a pose, the odometry at its time
        self._kept: SharedPose | None = None  # from before the first reading
        self._way = self._turned = 0.0  # m and rad since the anchor
        self._mark: Odometry | None = None  # the reading up to which way and turn are summed
        self._sent = -math.inf

    def on_pose(self, pose: SharedPose, *, is_kept: bool = False) -> None:
        """Take in a pose; `is_kept`: from the publisher's cache, so the robot may have moved."""
        if is_kept and self._anchor is None:
            error, yaw_error = pose.error + UNSEEN_WAY, min(pose.yaw_error + UNSEEN_TURN, math.pi)
            self._kept = structs.replace(pose, error=error, yaw_error=yaw_error)
        if is_kept:
            return
        self._anchor = self._kept = None
        readings = self._readings
        if not readings or not readings[0].stamp <= pose.stamp <= readings[-1].stamp + SILENCE:
            return
        nearest = min(readings, key=lambda reading: abs(reading.stamp - pose.stamp))
        self._begin(pose, nearest)
        for reading in readings:
            if reading.stamp > nearest.stamp:
                self._measure(reading)

    def on_odometry(self, odometry: Odometry) -> SharedPose | None:
        """Take in a reading; returns the carried pose if one is due."""
        last = self._readings[-1] if self._readings else None
        if last is not None and (odometry.stamp < last.stamp or odometry.jumps_from(last)):
            self._readings.clear()
            self._anchor = None
        self._readings.append(odometry)
        if self._kept is not None:
            self._begin(self._kept, odometry)
            self._kept = None
        self._measure(odometry)
        return self._carried(odometry)

    def _begin(self, pose: SharedPose, at: Odometry) -> None:
        self._anchor, self._mark = (pose, at), at
        self._way = self._turned = 0.0
        self._sent = -math.inf

    def _measure(self, odometry: Odometry) -> None:
        """Add the motion since `_mark`, unless it is too small to tell from noise."""
        if self._mark is None:
            return
        here, there = odometry.pose, self._mark.pose
        way = math.hypot(here.x - there.x, here.y - there.y)
        turn = abs(math.remainder(here.yaw - there.yaw, 2.0 * math.pi))
        if way > _STEP or turn > _TURN:
            self._mark = odometry
            self._way += way
            self._turned += turn

    def _carried(self, odometry: Odometry) -> SharedPose | None:
        if self._anchor is None or self._way > MAX_WAY or self._turned > MAX_TURN:
            return None
        pose, at = self._anchor
        if odometry.stamp - max(at.stamp + SILENCE - PERIOD, self._sent) < PERIOD:
            return None
        self._sent = odometry.stamp
        dx, dy = odometry.pose.x - at.pose.x, odometry.pose.y - at.pose.y
        turn = pose.pose.yaw - at.pose.yaw  # from the frame of odometry to the shared frame
        cos, sin = math.cos(turn), math.sin(turn)
        x, y = pose.pose.x + cos * dx - sin * dy, pose.pose.y + sin * dx + cos * dy
        error = pose.error + (ODOMETRY_SHARE + pose.yaw_error) * self._way
        yaw_error = min(pose.yaw_error + ODOMETRY_SHARE * self._turned, math.pi)
        carried = Pose(x, y, odometry.pose.yaw + turn)
        return SharedPose(odometry.stamp, carried, error, yaw_error, pose.frame)
