"""The fence: limits a command so that the whole outline stops inside an area in a shared frame.

The pose of the robot in the shared frame comes as an `Anchor`: a measured pose, and the odometry at
that time. The fence dead-reckons the pose at which the next command takes effect, and simulates
stops from the command. A command is permitted if the outline keeps, at each step of each stop, the
clearance that errors and margin need. A robot that is nearer to the fence than this clearance, or
outside, may only drive inwards: the clearance falls at no step of a stop. An error of the direction
can make a stop along the fence look like a stop inwards. So the clearance must also rise by more
than this error. Zero is always permitted.

A stop that comes nearer to the nearest edge of one place may lead away from the nearest edge of a
place beside it. So a robot that may be outside, for its clearance is below the error, may only
drive inwards from each place at which it may be: the predicted place, and _AROUND places at the
distance of the error from it.

The fence uses a circle in place of the outline: the smallest circle around the axle that contains
the outline. So the clearance does not depend on the yaw: a robot at the fence can turn and leave.

The model is that of mode `barrier`: the base responds REACTION_TIME after a decision, a command
stands for a tick, and the base brakes at least at `braking_linear` and `braking_angular`.

Units: m, s, rad.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from swarmd.core.clock import TICK
from swarmd.core.values import MAX_EXTRAPOLATION, Array, Platform, Pose, Twist
from swarmd.robot.protection.binding_range import REACTION_TIME
from swarmd.robot.protection.decision import Anchor, DecisionContext, LayerView
from swarmd.robot.protection.fence import fence_stops
from swarmd.robot.protection.fence.fence_settings import FenceSettings
from swarmd.robot.protection.footprint import radius_of
from swarmd.robot.protection.settings import ODOMETRY_SHARE, BarrierSettings

_SHARES = 8  # a limited command has shares of the request in steps of 1 / _SHARES
_SPACING = 0.1  # m between the points that stand for the fence
_GRID = 40  # cells along each side, in the search for the widest place
_AROUND = 8  # places around the predicted place of a robot that may be outside
_HALF_STEP = 0.1  # share of the longest stop: more than the half of a step that a stop adds


class Fence:
    """The fence of one robot. Its only state is stored results, which save computations."""

    def __init__(self, settings: FenceSettings, platform: Platform) -> None:
        self._margin = settings.margin
        self._polygons = [np.array(corners, np.float64) for corners in settings.polygons]
        numbers = np.repeat(np.arange(len(self._polygons)), [len(one) for one in self._polygons])
        starts = np.concatenate(self._polygons)
        ends = np.concatenate([np.roll(one, -1, axis=0) for one in self._polygons])
        self._edges = np.column_stack((starts, ends, numbers))
        self.radius = radius_of(platform)
        given = platform.protection.get("barrier") or {"others_speed": 0.3, "unseen_extent": 0.0}
        barrier = msgspec.convert(given, BarrierSettings)
        self._braking = barrier.braking_linear, barrier.braking_angular
        self._limits = platform.limits
        self._top = math.hypot(platform.limits.linear, platform.limits.lateral)
        stop_s = max(self._top / self._braking[0], platform.limits.angular / self._braking[1])
        self._longest_stop = self._top * (TICK + stop_s)  # m that the axle moves at most
        self._known = (0.0, 0.0, -math.inf)  # a place of the axle, and its clearance
        part = np.arange(_SHARES + 1) / _SHARES
        ones = np.ones_like(part)
        zeros = np.zeros_like(part)
        columns = ((part, ones), (ones, part), (part, part), (part, zeros), (zeros, part))
        shares = np.unique(np.concatenate([np.stack(one, axis=1) for one in columns]), axis=0)
        self._shares = shares[(shares > 0.0).any(axis=1)]
        angles = 2.0 * math.pi * np.arange(_AROUND) / _AROUND
        around = np.stack((np.cos(angles), np.sin(angles)), axis=1)
        self._offsets = np.concatenate((np.zeros((1, 2)), around))  # over the error of the place
        self._even = part[::-1][:-1, None] * np.ones(2)  # shares of both speeds alike, from 1 down

    # Geometry

    def clearances(self, places: Array) -> Array:
        """(n,) m from the circle around the axle at places (n, 2) to the fence; negative outside.

        The circle holds the outline at each yaw. For a place outside, the clearance is minus the
        distance from the fence to the farthest place of the circle.
        """
        clearances: Array = fence_stops.clearances(self._edges, places, self.radius)
        return clearances

    def widest(self) -> float:
        """About the radius in m of the largest circle that the fence permits; 0 without any."""
        outer = self._polygons[0]
        low = outer.min(axis=0)
        high = outer.max(axis=0)
        best = 0.0
        center = (low + high) / 2.0
        for _ in range(6):
            axes = [np.linspace(low[i], high[i], _GRID + 1) for i in (0, 1)]
            points = np.stack(np.meshgrid(*axes), axis=2).reshape(-1, 2)
            away = fence_stops.clearances(self._edges, points, 0.0)
            index = int(away.argmax())
            if away[index] > best:
                best = float(away[index])
                center = points[index]
            half = 2.0 * (high - low) / _GRID
            low = center - half
            high = center + half
        return best

    # Decisions

    def limit(
        self,
        requested: Twist,
        context: DecisionContext,
        command: Twist,
        *,
        is_even: bool = False,
    ) -> Twist:
        """The permitted command near the request; the request itself if it is permitted.

        Each speed of the result is a share of the request, so that zero stays zero. Without an
        anchor the request passes: the caller holds the robot, or drives without the fence.

        Args:
            requested: within the limits of the platform.
            context: the time, odometry and the anchor with their ages.
            command: the command in force, by which the base moves until the next command.
            is_even: reduce all speeds by one share. Then the result satisfies all constraints that
                the request satisfies, if they are convex and permit zero, as those of a mode do.
        """
        if requested.is_zero or context.anchor is None or context.odometry is None:
            return requested

        # 1. The place at which the command takes effect. Far from the fence each command is
        # permitted: even the longest stop keeps the clearance `need`.
        pose, speeds, error = self._predicted(context, context.anchor, command)
        need = error + self._margin
        turn_error = context.anchor.yaw_error + ODOMETRY_SHARE
        if self._room(pose) > need + self._longest_stop * (1.0 + _HALF_STEP + turn_error):
            return requested

        # 2. The share of the request that is permitted and nearest to the request, in the plane of
        # linear and angular speed, each over its limit.
        limits = self._limits
        shares = self._even if is_even else self._shares
        linear_size = math.hypot(requested.linear, requested.lateral) / limits.linear
        turn_size = abs(requested.angular) / limits.angular
        places = self._places(pose, error)
        index = fence_stops.nearest_permitted(
            self._edges,
            shares,
            (requested.linear, requested.lateral, requested.angular),
            (linear_size, turn_size),
            places,
            pose.yaw,
            speeds,
            self._braking,
            (self.radius, need, turn_error, error if len(places) > 1 else 0.0),
        )
        if index < 0:  # no share is permitted
            return Twist()
        if index == len(shares):  # the request is permitted
            return requested
        part, turn_part = shares[index].tolist()
        return Twist(
            requested.linear * part, requested.angular * turn_part, requested.lateral * part
        )

    def view(self, context: DecisionContext) -> LayerView | None:
        """The present clearance; None without an anchor."""
        if context.anchor is None or context.odometry is None:
            return None
        pose, _, error = self._predicted(context, context.anchor, Twist())
        return LayerView(self._clearance(pose), error)

    def points(self, context: DecisionContext, within: float) -> Array:
        """(k, 2) points of the fence within `within` m of the axle, in m in the base frame."""
        if context.anchor is None or context.odometry is None:
            return np.empty((0, 2))
        pose, _, _ = self._predicted(context, context.anchor, Twist())
        if self._room(pose) > within:
            return np.empty((0, 2))
        here = np.array([pose.x, pose.y])
        parts = [np.empty((0, 2))]
        for start, end in zip(self._edges[:, :2] - here, self._edges[:, 2:4] - here, strict=True):
            length = math.dist(start, end)
            middle = -start.dot(end - start) / length  # of the nearest place along the edge
            first = max(middle - within, 0.0)
            last = min(middle + within, length)
            if first < last:
                along = np.arange(first, last, _SPACING) / length
                parts.append(start + along[:, None] * (end - start))
        points = np.concatenate(parts)
        points = points[np.hypot(points[:, 0], points[:, 1]) <= within]
        cos = math.cos(pose.yaw)
        sin = math.sin(pose.yaw)
        x, y = points.T
        return np.stack((cos * x + sin * y, cos * y - sin * x), axis=1)

    def _room(self, pose: Pose) -> float:
        """A lower bound of the clearance in m at a pose, which repeats the last distance."""
        x, y, room = self._known
        left = room - math.hypot(pose.x - x, pose.y - y)
        if left > 2.0 * self._longest_stop:
            return left
        room = self._clearance(pose)
        self._known = (pose.x, pose.y, room)
        return room

    def _places(self, pose: Pose, error: float) -> Array:
        """(n, 3) x, y and clearance in m of the places at which a command must be permitted.

        The first place is that of the pose. A robot that is inside has no further place: `need`
        contains its error.
        """
        present = self._clearance(pose)
        if present >= error:
            return np.array([[pose.x, pose.y, present]])
        places = (pose.x, pose.y) + error * self._offsets
        return np.column_stack((places, self.clearances(places)))

    def _clearance(self, pose: Pose) -> float:
        return float(fence_stops.clearance(self._edges, pose.x, pose.y, self.radius))

    def _predicted(
        self, context: DecisionContext, anchor: Anchor, command: Twist
    ) -> tuple[Pose, tuple[float, float, float], float]:
        """Pose, speeds, and the error of the place in m, when the next command takes effect.

        The pose is in the frame of the fence. The speeds are in m/s ahead, m/s to the left, and
        rad/s. The error is a bound for each place of the outline.
        """
        odometry = context.odometry
        age = context.odometry_age or 0.0
        assert odometry is not None
        # 1. The pose by the newest odometry, in the shared frame.
        frame_turn = anchor.pose.yaw - anchor.odometry.yaw
        cos = math.cos(frame_turn)
        sin = math.sin(frame_turn)
        dx = odometry.pose.x - anchor.odometry.x
        dy = odometry.pose.y - anchor.odometry.y
        x = anchor.pose.x + cos * dx - sin * dy
        y = anchor.pose.y + sin * dx + cos * dy
        yaw = odometry.pose.yaw + frame_turn

        # 2. The motion until the command takes effect: each speed goes to the command in force.
        twist = odometry.twist
        seconds = min(age, MAX_EXTRAPOLATION) + REACTION_TIME
        braking, turning = self._braking
        ahead, ahead_speed = _ramp(twist.linear, command.linear, braking, seconds)
        left, left_speed = _ramp(twist.lateral, command.lateral, braking, seconds)
        turn, turn_speed = _ramp(twist.angular, command.angular, turning, seconds)
        cos = math.cos(yaw + 0.5 * turn)
        sin = math.sin(yaw + 0.5 * turn)
        pose = Pose(x + cos * ahead - sin * left, y + sin * ahead + cos * left, yaw + turn)

        # 3. The bound of the error. The error of the anchor's yaw counts over the distance from the
        # anchor.
        of_anchor = anchor.error + anchor.yaw_error * math.hypot(dx, dy)
        # Odometry is wrong by a share of the way, and its heading by the same share of the turn. A
        # wrong heading moves the robot across the way.
        of_odometry = ODOMETRY_SHARE * (1.0 + anchor.turned) * anchor.way
        # The base may have changed its speed at once, or not at all. After MAX_EXTRAPOLATION the
        # motion is not predicted.
        change = math.hypot(twist.linear - command.linear, twist.lateral - command.lateral)
        of_prediction = change * seconds + self._top * max(age - MAX_EXTRAPOLATION, 0.0)
        error = of_anchor + of_odometry + of_prediction
        return pose, (ahead_speed, left_speed, turn_speed), error


def fence_fault(settings: FenceSettings, platform: Platform) -> str:
    """Why the platform cannot drive within the fence; empty if it can."""
    if "odometry" not in platform.provides:
        return f"needs odometry, which platform {platform.name} does not provide"
    widest = Fence(settings, platform).widest()
    needed = radius_of(platform) + settings.margin
    if widest < needed:
        return (
            f"is too small for platform {platform.name}: its widest place has a radius of"
            f" {widest:.2f} m; expected more than {needed:.2f} m, for the outline around its axle"
            f" and the margin of {settings.margin:g} m"
        )
    return ""


def _ramp(speed: float, command: float, rate: float, seconds: float) -> tuple[float, float]:
    """The way over `seconds` on a ramp of `rate` from `speed` to `command`, and the last speed."""
    change = command - speed
    ramp_s = abs(change) / rate
    if ramp_s >= seconds:
        last = speed + math.copysign(rate * seconds, change)
        return 0.5 * (speed + last) * seconds, last
    return command * seconds - 0.5 * change * ramp_s, command
