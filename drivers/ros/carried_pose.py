"""A pose in a shared frame that odometry carries on between the poses of a localisation. Pure.

A localisation on a map publishes after motion alone: AMCL after 0.25 m or 0.2 rad (its parameters
`update_min_d` and `update_min_a`), and never while the robot stands. Between two poses the pose
moves as odometry does, and its error grows with way and turn. A jump of the localisation moves the
pose, not the robot: odometry has the motion.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from typing import NamedTuple

from msgspec import structs

from swarmd.core.events import PoseInput
from swarmd.core.values import Odometry, Pose, SharedPose
from swarmd.protection.settings import ODOMETRY_SHARE

HISTORY = 200  # readings of odometry: 4 s at 50 Hz, above the delay of a localisation
SILENCE = 0.25  # s without a pose before odometry carries it; a faster source is never carried
MAX_WAY = 2.0  # m without a pose: the localisation has ended
UNSEEN_WAY, UNSEEN_TURN = 0.25, 0.2  # m and rad without a pose before the driver has started
_NOISE = 0.01, 0.02  # m and rad: less motion is noise of odometry at rest


class _Reading(NamedTuple):
    """A reading of odometry, with the way in m and the turn in rad up to it.

    `mark`: the pose up to which they are summed.
    """

    odometry: Odometry
    mark: Pose
    way: float = 0.0
    turned: float = 0.0


class CarriedPose:
    """The last pose of the localisation, carried by odometry. All times are stamps in s.

    Stamps of poses and of odometry must be of one clock. A pose whose stamp is outside those of the
    kept readings is not carried, since it is of another clock, or too old.
    """

    def __init__(self) -> None:
        self._readings: deque[_Reading] = deque(maxlen=HISTORY)
        self._anchor: tuple[SharedPose, _Reading] | None = None  # a pose, the reading at its time
        self._kept: SharedPose | None = None  # from before the first reading

    def on_pose(self, pose: SharedPose) -> None:
        """Take in a pose."""
        self._anchor = self._kept = None
        stamps = [reading.odometry.stamp for reading in self._readings]
        if stamps and stamps[0] <= pose.stamp <= stamps[-1] + SILENCE:
            nearest = min(self._readings, key=lambda one: abs(one.odometry.stamp - pose.stamp))
            self._anchor = pose, nearest

    def on_kept_pose(self, pose: SharedPose) -> None:
        """Take in a pose of the publisher's cache; the robot may have moved since."""
        if self._anchor is None:
            yaw_error = min(pose.yaw_error + UNSEEN_TURN, math.pi)
            self._kept = structs.replace(pose, error=pose.error + UNSEEN_WAY, yaw_error=yaw_error)

    def on_odometry(self, odometry: Odometry) -> tuple[PoseInput, ...]:
        """Take in a reading; returns the carried pose as input, if there is one."""
        last = self._readings[-1] if self._readings else _Reading(odometry, odometry.pose)
        if odometry.stamp < last.odometry.stamp or odometry.jumps_from(last.odometry):
            self._readings.clear()
            self._anchor, last = None, _Reading(odometry, odometry.pose)
        way = math.dist((odometry.pose.x, odometry.pose.y), (last.mark.x, last.mark.y))
        turn = abs(math.remainder(odometry.pose.yaw - last.mark.yaw, math.tau))
        reading = (
            _Reading(odometry, odometry.pose, last.way + way, last.turned + turn)
            if way > _NOISE[0] or turn > _NOISE[1]
            else last._replace(odometry=odometry)
        )
        self._readings.append(reading)
        if self._kept is not None:
            self._anchor, self._kept = (self._kept, reading), None
        return self._carried(reading)

    def _carried(self, reading: _Reading) -> tuple[PoseInput, ...]:
        if self._anchor is None:
            return ()
        pose, at = self._anchor
        here, there = reading.odometry, at.odometry
        way = reading.way - at.way
        if way > MAX_WAY or here.stamp - there.stamp < SILENCE:
            return ()
        turn = pose.pose.yaw - there.pose.yaw  # from the frame of odometry to the shared frame
        moved = complex(here.pose.x - there.pose.x, here.pose.y - there.pose.y)
        place = complex(pose.pose.x, pose.pose.y) + moved * cmath.rect(1.0, turn)
        carried = SharedPose(
            here.stamp,
            Pose(place.real, place.imag, here.pose.yaw + turn),
            pose.error + (ODOMETRY_SHARE + pose.yaw_error) * way,
            min(pose.yaw_error + ODOMETRY_SHARE * (reading.turned - at.turned), math.pi),
            pose.frame,
        )
        return (PoseInput(carried),)
