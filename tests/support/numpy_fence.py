"""The fence by arrays of numpy, a second form of `robot/protection/fence/fence_stops.py` for tests.

It simulates the stops of all shares of a request at once.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from swarmd.core.clock import TICK
from swarmd.core.values import Array, Platform, Pose, Twist
from swarmd.robot.protection.decision import DecisionContext
from swarmd.robot.protection.fence.fence import Fence
from swarmd.robot.protection.fence.fence_settings import FenceSettings
from swarmd.robot.protection.settings import ODOMETRY_SHARE

_STEPS = 8
_IDEAL_BRAKING = 1e9
_ROUNDING = 1e-9


class NumpyFence(Fence):
    """A fence whose `limit` and `clearances` are computed by arrays."""

    def __init__(self, settings: FenceSettings, platform: Platform) -> None:
        super().__init__(settings, platform)
        self._starts = np.concatenate(self._polygons)
        self._ends = np.concatenate([np.roll(one, -1, axis=0) for one in self._polygons])

    def clearances(self, places: Array) -> Array:
        away = _distances(places, self._starts, self._ends).min(axis=1)
        clearances: Array = np.where(self._permits(places), away, -away) - self.radius
        return clearances

    def _permits(self, points: Array) -> NDArray[np.bool_]:
        outer, *others = (_contains(polygon, points) for polygon in self._polygons)
        for one in others:
            outer &= ~one
        return outer

    def limit(
        self,
        requested: Twist,
        context: DecisionContext,
        command: Twist,
        *,
        is_even: bool = False,
    ) -> Twist:
        if requested.is_zero or context.anchor is None or context.odometry is None:
            return requested
        pose, base_speeds, error = self._predicted(context, context.anchor, command)
        speeds = np.array(base_speeds)
        need = error + self._margin
        turn_error = context.anchor.yaw_error + ODOMETRY_SHARE
        present = float(self.clearances(np.array([[pose.x, pose.y]]))[0])
        poses = [pose]
        if present < error:  # the robot may be outside
            for way in np.arange(8) * math.pi / 4.0:
                x = pose.x + error * math.cos(way)
                y = pose.y + error * math.sin(way)
                poses.append(Pose(x, y, pose.yaw))

        def are_permitted(twists: Array) -> NDArray[np.bool_]:
            each = [self._are_permitted(twists, one, speeds, need, turn_error) for one in poses]
            return np.asarray(np.all(each, axis=0))

        wanted = np.array([[requested.linear, requested.lateral, requested.angular]])
        if are_permitted(wanted)[0]:
            return requested
        shares = self._even if is_even else self._shares
        tried = wanted * shares[:, [0, 0, 1]]
        is_permitted = are_permitted(tried)
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

    def _are_permitted(
        self,
        twists: Array,
        pose: Pose,
        speeds: Array,
        need: float,
        turn_error: float,
    ) -> NDArray[np.bool_]:
        """(n,) whether the outline stays clear, or comes inwards, in each stop from `twists`.

        Args:
            twists: (n, 3) speeds ahead, left, and turn of the commands.
            pose: at which the command takes effect.
            speeds: (3,) of the base then.
            need: m, the clearance that the errors and the margin need.
            turn_error: rad by which the direction of the simulated motion may be wrong.
        """
        n = len(twists)
        present = float(self.clearances(np.array([[pose.x, pose.y]]))[0])
        # 1. Four stops: from the command with both brakes, with one ideal brake each, and from the
        # speeds of the base.
        begins = np.concatenate((twists, twists, twists, np.broadcast_to(speeds, (n, 3))))
        braking = np.empty((4 * n, 2))
        braking[:] = self._braking
        braking[n : 2 * n, 0] = braking[2 * n : 3 * n, 1] = _IDEAL_BRAKING
        poses, travel = self._stops(begins, np.concatenate((twists,) * 4), braking, pose)
        places = poses[..., :2].reshape(-1, 2)
        clearance = self.clearances(places).reshape(4 * n, _STEPS)

        # 2. Between two steps the axle moves by half of a step away from the nearer one. Inwards:
        # the clearance never falls, and rises as far as errors of the direction need.
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
        linear = np.hypot(begins[:, 0], begins[:, 1])
        linear = np.maximum(linear, np.hypot(commands[:, 0], commands[:, 1]))
        turn = np.maximum(np.abs(begins[:, 2]), np.abs(commands[:, 2]))
        seconds = TICK + np.maximum(linear / braking[:, 0], turn / braking[:, 1])
        step = (seconds / _STEPS)[:, None]
        until = step * (np.arange(_STEPS) + 0.5)  # the middle of each step
        rates = braking[:, [0, 0, 1]][:, None, :]
        # The speed at the middle of a step: towards the command for TICK, then towards zero.
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
