"""The fence: limits a command so that the whole outline stops inside an area in a shared frame.

The pose of the robot in the shared frame comes as an `Anchor`: a measured pose, and the odometry at
that time. The fence dead-reckons the pose at which the next command takes effect, and simulates
stops from the command. A command is permitted if the outline keeps, at each step of each stop, the
clearance that errors and margin need. A robot that is nearer to the fence than that, or outside,
may only drive inwards: the clearance must rise at each step. Zero is always permitted.

A circle around the axle that holds the outline stands for the outline. So a robot can turn at the
fence, and does not stay there.

The model is that of mode `barrier`: the base responds REACTION_TIME after a decision, a command
stands for a tick, and the base brakes at least at `braking_linear` and `braking_angular`.

Units: m, s, rad.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from swarmd.core.clock import TICK
from swarmd.core.values import Array, Platform, Pose, Twist
from swarmd.protection.binding_range import REACTION_TIME
from swarmd.protection.compatibility import radius_of
from swarmd.protection.decision import Anchor, DecisionContext
from swarmd.protection.fence_settings import FenceSettings
from swarmd.protection.settings import BarrierSettings
from swarmd.sensing.odometry_history import MAX_EXTRAPOLATION

ODOMETRY_SHARE = 0.05
"""Error of odometry between two poses, as a share of the way and of the turn."""
_STEPS = 8  # of a simulated stop
_SHARES = 8  # a limited command has shares of the request in steps of 1 / _SHARES
_IDEAL_BRAKING = 1e9  # m/s2 or rad/s2: stops at once
_SPACING = 0.1  # m between the points that stand for the fence
_GRID = 40  # cells along each side, in the search for the widest place
_ROUNDING = 1e-9  # m


class FenceView(Struct, frozen=True):
    """The place of a robot against its fence.

    `clearance`: m from the circle around the outline to the fence; negative if the circle is not
    inside. `error`: m, bound of the error of the clearance.
    """

    clearance: float
    error: float


class Fence:
    """The fence of one robot. Without state beside what repeats a computation."""

    def __init__(self, settings: FenceSettings, platform: Platform) -> None:
        self.frame, self._margin = settings.frame, settings.margin
        self._polygons = [np.array(corners, np.float64) for corners in settings.polygons]
        self._starts = np.concatenate(self._polygons)
        self._ends = np.concatenate([np.roll(one, -1, axis=0) for one in self._polygons])
        self.radius = radius_of(platform)
        given = platform.protection.get("barrier") or {"others_speed": 0.3, "unseen_extent": 0.0}
        barrier = msgspec.convert(given, BarrierSettings)
        self._braking = barrier.braking_linear, barrier.braking_angular
        limits = platform.limits
        self._limits = limits
        self._top = math.hypot(limits.linear, limits.lateral)
        stop_s = max(self._top / self._braking[0], limits.angular / self._braking[1])
        self._longest_stop = self._top * (TICK + stop_s)  # m that the axle moves at most
        self._known = (0.0, 0.0, -math.inf)  # a place of the axle, and its clearance
        part = np.arange(_SHARES + 1) / _SHARES
        ones, zeros = np.ones_like(part), np.zeros_like(part)
        columns = ((part, ones), (ones, part), (part, part), (part, zeros), (zeros, part))
        shares = np.unique(np.concatenate([np.stack(one, axis=1) for one in columns]), axis=0)
        self._shares = shares[(shares > 0.0).any(axis=1)]
        self._even = part[::-1][:-1, None] * np.ones(2)  # shares of both speeds alike, from 1 down

    # Geometry

    def clearances(self, places: Array) -> Array:
        """(n,) m from the circle around the axle at places (n, 2) to the fence; negative outside.

        The circle holds the outline at each yaw. For a place outside, the clearance is minus the
        distance from the fence to the farthest place of the circle.
        """
        middle = places.mean(axis=0)
        spread = float(np.hypot(*(places - middle).T).max())
        to_edges = _distances(middle[None], self._starts, self._ends)[0]
        near = to_edges <= to_edges.min() + 2.0 * spread + _ROUNDING
        away = _distances(places, self._starts[near], self._ends[near]).min(axis=1)
        clearances: Array = np.where(self._permits(places), away, -away) - self.radius
        return clearances

    def _permits(self, points: Array) -> NDArray[np.bool_]:
        """(n,) whether points (n, 2) are within the outer polygon and outside all others."""
        outer, *others = (_contains(polygon, points) for polygon in self._polygons)
        for one in others:
            outer &= ~one
        return outer

    def widest(self) -> float:
        """About the radius in m of the largest circle that the fence permits; 0 without any."""
        outer = self._polygons[0]
        low, high = outer.min(axis=0), outer.max(axis=0)
        best, center = 0.0, (low + high) / 2.0
        for _ in range(6):
            axes = [np.linspace(low[i], high[i], _GRID + 1) for i in (0, 1)]
            points = np.stack(np.meshgrid(*axes), axis=2).reshape(-1, 2)
            away = _distances(points, self._starts, self._ends).min(axis=1)
            away[~self._permits(points)] = 0.0
            index = int(away.argmax())
            if away[index] > best:
                best, center = float(away[index]), points[index]
            half = 2.0 * (high - low) / _GRID
            low, high = center - half, center + half
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
            is_even: reduce all speeds by one share. If the request satisfies constraints that are
                convex and permit zero, such as those of a mode, then so does the result.
        """
        if requested.is_zero or context.anchor is None or context.odometry is None:
            return requested

        # 1. The place at which the command takes effect; far from the fence nothing is limited.
        pose, speeds, error = self._predicted(context, context.anchor, command)
        need = error + self._margin
        turn_error = context.anchor.yaw_error + ODOMETRY_SHARE
        # 1.1: `_are_permitted` adds half a step, which is less than 0.1 of a stop.
        most = need + self._longest_stop * (1.1 + turn_error)
        if self._room(pose) > most:
            return requested

        # 2. The request, and then its shares, the nearest first.
        present = self._clearance(pose)
        wanted = np.array([[requested.linear, requested.lateral, requested.angular]])
        if self._are_permitted(wanted, pose, speeds, present, need, turn_error)[0]:
            return requested
        shares = self._even if is_even else self._shares
        tried = wanted * shares[:, [0, 0, 1]]
        is_permitted = self._are_permitted(tried, pose, speeds, present, need, turn_error)
        if not is_permitted.any():
            return Twist()
        limits = self._limits
        off = (1.0 - shares) * [
            math.hypot(requested.linear, requested.lateral) / limits.linear,
            abs(requested.angular) / limits.angular,
        ]
        distances = np.where(is_permitted, np.hypot(off[:, 0], off[:, 1]), np.inf)
        linear, lateral, angular = tried[int(distances.argmin())].tolist()
        return Twist(linear, angular, lateral)

    def view(self, context: DecisionContext) -> FenceView | None:
        """The present clearance; None without an anchor."""
        if context.anchor is None or context.odometry is None:
            return None
        pose, _, error = self._predicted(context, context.anchor, Twist())
        return FenceView(self._clearance(pose), error)

    def points(self, context: DecisionContext, within: float) -> Array:
        """(k, 2) points of the fence within `within` m of the axle, in m in the base frame."""
        if context.anchor is None or context.odometry is None:
            return np.empty((0, 2))
        pose, _, _ = self._predicted(context, context.anchor, Twist())
        if self._room(pose) > within:
            return np.empty((0, 2))
        here = np.array([pose.x, pose.y])
        parts = [np.empty((0, 2))]
        for start, end in zip(self._starts - here, self._ends - here, strict=True):
            length = math.dist(start, end)
            middle = -start.dot(end - start) / length  # of the nearest place along the edge
            first, last = max(middle - within, 0.0), min(middle + within, length)
            if first < last:
                along = np.arange(first, last, _SPACING) / length
                parts.append(start + along[:, None] * (end - start))
        points = np.concatenate(parts)
        points = points[np.hypot(points[:, 0], points[:, 1]) <= within]
        cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
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

    def _clearance(self, pose: Pose) -> float:
        return float(self.clearances(np.array([[pose.x, pose.y]]))[0])

    def _predicted(
        self, context: DecisionContext, anchor: Anchor, command: Twist
    ) -> tuple[Pose, Array, float]:
        """Pose and speeds as the next command takes effect, and the bound of the place's error.

        The speeds: ahead, left, turn. The error in m holds for each place of the outline.
        """
        odometry, age = context.odometry, context.odometry_age or 0.0
        assert odometry is not None
        # 1. The pose by the newest odometry, in the shared frame.
        turned = anchor.pose.yaw - anchor.odometry.yaw
        cos, sin = math.cos(turned), math.sin(turned)
        dx, dy = odometry.pose.x - anchor.odometry.x, odometry.pose.y - anchor.odometry.y
        x, y = anchor.pose.x + cos * dx - sin * dy, anchor.pose.y + sin * dx + cos * dy
        yaw = odometry.pose.yaw + turned

        # 2. The motion until the command takes effect: each speed goes to the command in force.
        twist = odometry.twist
        seconds = min(age, MAX_EXTRAPOLATION) + REACTION_TIME
        braking, turning = self._braking
        ahead, ahead_speed = _ramp(twist.linear, command.linear, braking, seconds)
        left, left_speed = _ramp(twist.lateral, command.lateral, braking, seconds)
        turn, turn_speed = _ramp(twist.angular, command.angular, turning, seconds)
        cos, sin = math.cos(yaw + 0.5 * turn), math.sin(yaw + 0.5 * turn)
        pose = Pose(x + cos * ahead - sin * left, y + sin * ahead + cos * left, yaw + turn)

        # 3. The bound of the error. Odometry is off by a share of the way, and across the way by
        # the error of its heading, a share of the rad turned. The base may change its speed at any
        # rate.
        change = math.hypot(twist.linear - command.linear, twist.lateral - command.lateral)
        error = anchor.error + anchor.yaw_error * math.hypot(dx, dy)
        error += ODOMETRY_SHARE * (1.0 + anchor.turned) * anchor.way
        error += change * seconds + self._top * max(age - MAX_EXTRAPOLATION, 0.0)
        return pose, np.array([ahead_speed, left_speed, turn_speed]), error

    def _are_permitted(
        self,
        twists: Array,
        pose: Pose,
        speeds: Array,
        present: float,
        need: float,
        turn_error: float,
    ) -> NDArray[np.bool_]:
        """(n,) whether the outline stays clear, or comes inwards, in each stop from `twists`.

        Args:
            twists: (n, 3) speeds ahead, left, and turn of the commands.
            pose: at which the command takes effect.
            speeds: (3,) of the base then.
            present: m, the clearance at the pose.
            need: m, the clearance that the errors and the margin need.
            turn_error: rad by which the direction of the simulated motion may be wrong.
        """
        n = len(twists)
        # 1. Four stops: from the command with both brakes as weak as assumed, and with either brake
        # ideal, since the path bends otherwise if a brake is stronger; and from the speeds of the
        # base, which need not have reached the command.
        begins = np.concatenate((twists, twists, twists, np.broadcast_to(speeds, (n, 3))))
        braking = np.empty((4 * n, 2))
        braking[:] = self._braking
        braking[n : 2 * n, 0] = braking[2 * n : 3 * n, 1] = _IDEAL_BRAKING
        poses, travel = self._stops(begins, np.concatenate((twists,) * 4), braking, pose)
        places = poses[..., :2].reshape(-1, 2)
        clearance = self.clearances(places).reshape(4 * n, _STEPS)

        # 2. Between two steps the axle moves by half of a step away from the nearer one. Inwards:
        # the clearance never falls, and rises by at least what an error of the direction can feign.
        steps = np.diff(travel, axis=1, prepend=0.0)
        is_clear = clearance >= need + turn_error * travel + 0.5 * steps
        before = np.concatenate((np.full((4 * n, 1), present), clearance[:, :-1]), axis=1)
        rises = clearance >= present + turn_error * travel - _ROUNDING
        rises &= clearance >= before - _ROUNDING
        is_permitted = (is_clear | rises).reshape(4, n, _STEPS)
        return np.asarray(is_permitted.all(axis=(0, 2)))

    def _stops(
        self, begins: Array, commands: Array, braking: Array, pose: Pose
    ) -> tuple[Array, Array]:
        """Poses (n, steps, 3) of stops, and the m (n, steps) that the axle has moved.

        `begins`: (n, 3) speeds at which the base begins. `commands`: (n, 3) towards which the base
        changes its speed for TICK. `braking`: (n, 2) m/s2 and rad/s2.
        """
        # Each stop ends TICK and the longer of its two braking times after its begin.
        linear = np.hypot(begins[:, 0], begins[:, 1])
        linear = np.maximum(linear, np.hypot(commands[:, 0], commands[:, 1]))
        turn = np.maximum(np.abs(begins[:, 2]), np.abs(commands[:, 2]))
        seconds = TICK + np.maximum(linear / braking[:, 0], turn / braking[:, 1])
        step = (seconds / _STEPS)[:, None]
        until = step * (np.arange(_STEPS) + 0.5)  # (n, steps) s, the middle of each step
        rates = braking[:, [0, 0, 1]][:, None, :]
        # The speeds (n, steps, 3) at the middle of a step: each changes towards the command for
        # TICK, at its braking and not beyond the command; then towards zero.
        driven = np.minimum(until, TICK)[..., None] * rates
        start, wanted = begins[:, None, :], commands[:, None, :]
        speed = start + np.clip(wanted - start, -driven, driven)
        braked = np.maximum(until - TICK, 0.0)[..., None] * rates
        speed = np.sign(speed) * np.maximum(np.abs(speed) - braked, 0.0)
        moved = speed * step[..., None]
        yaw = pose.yaw + np.cumsum(moved[..., 2], axis=1)
        middle = yaw - 0.5 * moved[..., 2]
        cos, sin = np.cos(middle), np.sin(middle)
        x = pose.x + np.cumsum(cos * moved[..., 0] - sin * moved[..., 1], axis=1)
        y = pose.y + np.cumsum(sin * moved[..., 0] + cos * moved[..., 1], axis=1)
        way = np.hypot(moved[..., 0], moved[..., 1])
        return np.stack((x, y, yaw), axis=2), np.cumsum(way, axis=1)


def fence_fault(settings: FenceSettings, platform: Platform) -> str:
    """Why the platform cannot drive within the fence; empty if it can."""
    if "odometry" not in platform.provides:
        return f"needs odometry, which platform {platform.name} does not provide"
    widest, needed = Fence(settings, platform).widest(), radius_of(platform) + settings.margin
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


def _distances(points: Array, starts: Array, ends: Array) -> Array:
    """(n, k) distances in m of points (n, 2) to edges from `starts` to `ends` (k, 2)."""
    along = ends - starts
    squares = (along * along).sum(axis=1)
    dx, dy = points[:, :1] - starts[:, 0], points[:, 1:] - starts[:, 1]
    part = np.clip((dx * along[:, 0] + dy * along[:, 1]) / squares, 0.0, 1.0)
    distances: Array = np.hypot(dx - part * along[:, 0], dy - part * along[:, 1])
    return distances


def _contains(polygon: Array, points: Array) -> NDArray[np.bool_]:
    """(n,) whether points (n, 2) are within a polygon (k, 2): even-odd rule."""
    ends = np.roll(polygon, -1, axis=0)
    x, y = points[:, :1], points[:, 1:]
    is_across = (polygon[:, 1] > y) != (ends[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = polygon[:, 0] + (y - polygon[:, 1]) * (ends[:, 0] - polygon[:, 0]) / (
            ends[:, 1] - polygon[:, 1]
        )
    inside: NDArray[np.bool_] = (np.where(is_across, x < at, False).sum(axis=1) % 2).astype(bool)
    return inside
