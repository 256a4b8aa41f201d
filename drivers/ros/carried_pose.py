"""A pose in a shared frame that odometry carries on between the poses of a localisation. Pure.

A localisation on a map publishes after motion alone: AMCL after 0.25 m or 0.2 rad (its parameters
`update_min_d` and `update_min_a`), and never while the robot stands. Between two poses the pose
moves as odometry does, and its error grows with way and turn. A jump of the localisation moves the
pose, not the robot: odometry has the motion.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from msgspec import structs

from swarmd.core.angles import wrap
from swarmd.core.events import PoseInput
from swarmd.core.values import Odometry, Pose, SharedPose
from swarmd.robot.protection.settings import ODOMETRY_SHARE

HISTORY = 200  # readings of odometry, which reach back for 3 s at any rate: the delay of a pose
SPACING = 0.015  # s between two kept readings: one that comes sooner replaces the newest
SILENCE = 0.25  # s without a pose before odometry carries it; a faster source is never carried
# m and rad without a pose: the localisation has ended
MAX_WAY = 2.0
MAX_TURN = math.tau
MAX_GAP = 0.5  # s of a gap between two readings in which the twist explains motion
SHIFT = 0.1, 0.2  # m and rad between two readings that are motion, beside 1.5 times the twist
# m and rad without a pose before the driver has started
UNSEEN_WAY = 0.25
UNSEEN_TURN = 0.2
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
        self._begins = True  # no pose was known so far

    def forget(self) -> None:
        """The localisation has ended, or tells that it is lost."""
        self._anchor = None
        self._kept = None
        self._begins = False

    def on_pose(self, pose: SharedPose) -> None:
        """Take in a pose."""
        if self._anchor is not None and pose.stamp == self._anchor[0].stamp:
            return  # delivered again, by a new connection
        self.forget()
        stamps = [reading.odometry.stamp for reading in self._readings]
        if stamps and stamps[0] <= pose.stamp <= stamps[-1] + SILENCE:
            nearest = min(self._readings, key=lambda one: abs(one.odometry.stamp - pose.stamp))
            self._anchor = pose, nearest

    def on_kept_pose(self, pose: SharedPose) -> None:
        """Take in a pose of the publisher's cache; the robot may have moved since.

        It counts before any other pose alone.
        """
        if self._begins:
            yaw_error = min(pose.yaw_error + UNSEEN_TURN, math.pi)
            self._kept = structs.replace(pose, error=pose.error + UNSEEN_WAY, yaw_error=yaw_error)

    def on_odometry(self, odometry: Odometry) -> tuple[PoseInput, ...]:
        """Take in a reading; returns the carried pose as input, if there is one."""
        last = self._readings[-1] if self._readings else _Reading(odometry, odometry.pose)
        if _begins_anew(odometry, last.odometry):
            self._readings.clear()
            self._anchor = None
            last = _Reading(odometry, odometry.pose)
        way = math.dist((odometry.pose.x, odometry.pose.y), (last.mark.x, last.mark.y))
        turn = abs(math.remainder(odometry.pose.yaw - last.mark.yaw, math.tau))
        reading = (
            _Reading(odometry, odometry.pose, last.way + way, last.turned + turn)
            if way > _NOISE[0] or turn > _NOISE[1]
            else last._replace(odometry=odometry)
        )
        if len(self._readings) > 1:
            before = self._readings[-2]
            newest = self._readings[-1]
            if newest.odometry.stamp - before.odometry.stamp < SPACING:
                self._readings.pop()
        self._readings.append(reading)
        if self._kept is not None:
            self._anchor = (self._kept, reading)
            self._kept = None
            self._begins = False
        return self._carried(reading)

    def _carried(self, reading: _Reading) -> tuple[PoseInput, ...]:
        if self._anchor is None:
            return ()
        pose, at = self._anchor
        here = reading.odometry
        there = at.odometry
        way = reading.way - at.way
        turned = reading.turned - at.turned
        if way > MAX_WAY or turned > MAX_TURN or here.stamp - there.stamp < SILENCE:
            return ()
        yaw_error = min(pose.yaw_error + ODOMETRY_SHARE * turned, math.pi)
        turn = pose.pose.yaw - there.pose.yaw  # from the frame of odometry to the shared frame
        dx = here.pose.x - there.pose.x
        dy = here.pose.y - there.pose.y
        x = pose.pose.x + math.cos(turn) * dx - math.sin(turn) * dy
        y = pose.pose.y + math.sin(turn) * dx + math.cos(turn) * dy
        carried = SharedPose(
            here.stamp,
            Pose(x, y, wrap(here.pose.yaw + turn)),
            pose.error + (ODOMETRY_SHARE + yaw_error) * way,
            yaw_error,
            pose.frame,
        )
        return (PoseInput(carried),)


def _begins_anew(here: Odometry, last: Odometry) -> bool:
    """True if the pose of odometry may have moved without the robot, as by a reset."""
    seconds = min(here.stamp - last.stamp, MAX_GAP)
    way = math.dist((here.pose.x, here.pose.y), (last.pose.x, last.pose.y))
    turn = abs(math.remainder(here.pose.yaw - last.pose.yaw, math.tau))
    speed = max(math.hypot(one.twist.linear, one.twist.lateral) for one in (here, last))
    rate = max(abs(one.twist.angular) for one in (here, last))
    return (
        seconds < 0.0
        or way > SHIFT[0] + 1.5 * speed * seconds
        or turn > SHIFT[1] + 1.5 * rate * seconds
    )
