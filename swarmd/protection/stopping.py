"""Checks that the outline stays clear while the robot brakes, which linear constraints do not.

A constraint bounds how fast the nearest place of the outline closes on an obstacle now. But a
corner swings outwards while a turn ends, and of two speeds, one of which opens what the other
closes, one may reach zero first. So the stop from a command is simulated, as in the dynamic window
approach (Fox, Burgard and Thrun, IEEE RAM 1997): with both brakes as weak as assumed, and with
either of them ideal.

An obstacle may also move along the outline, to where a turn moves the outline outwards. So at each
pose no place that an obstacle can have reached by then may move outwards by the turn.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.protection.footprint import Footprint

NEGLIGIBLE_SPEED = 0.015
"""m/s: closing at a speed up to this is no approach."""

FAULT_SPEED = 0.02
"""m/s: a contact at a closing speed up to this is not a fault of the robot."""

_STEPS = 4  # poses of a simulated stop; the kernel has four, too
_GRID = (1.0, 0.75, 0.5, 0.25, 0.0)
SPEED_SHARES = np.array(
    sorted(
        ((a, b) for a in _GRID for b in _GRID if (a, b) != (1.0, 1.0)),
        key=lambda share: (1.0 - share[0]) ** 2 + (1.0 - share[1]) ** 2,
    )
)
"""Shares of the two speeds, those nearest to the whole first; the last is zero."""
_BATCH_SIZE = 4  # shares checked together
ROUNDING = 1e-9  # m, of the way of an outline: it prunes nothing that binds


class StopCheck:
    """Checks stops of a base that brakes at least at `linear` m/s2 and `angular` rad/s2."""

    def __init__(self, outline: Footprint, linear: float, angular: float, tick: float) -> None:
        """A command holds for `tick` s."""
        self._outline = outline
        self._radius = float(np.hypot(*outline.corners.T).max())
        self._brakes = np.array(((linear, angular), (np.inf, angular), (linear, np.inf)))
        self._tick = tick

    def limited(
        self,
        speeds: Array,
        along: Array,
        points: Array,
        gaps: Array,
        need: Array,
        reach: Array,
        others: float,
        shares: Array = SPEED_SHARES,
    ) -> Array:
        """(2,) `speeds`, or the first of `shares` (c, 2) of them whose stops stay clear.

        `speeds` (2,) in m/s along the unit vector `along` (2,) and in rad/s. `points` (k, 2) in the
        base frame, at `gaps` (k,) m from the outline. `need` (k,) m: the gap within which the
        outline must not close on a point; it grows at `others` m/s. An obstacle seen at a point
        may be `reach` (k,) m from it, which grows likewise. The zero command
        is always clear.
        """
        if self._is_clear(speeds[None], along, points, gaps, need, reach, others)[0]:
            return speeds
        for first in range(0, len(shares), _BATCH_SIZE):  # mostly one of the first is clear
            candidates: Array = shares[first : first + _BATCH_SIZE] * speeds
            found = np.flatnonzero(
                self._is_clear(candidates, along, points, gaps, need, reach, others)
            )
            if len(found):
                chosen: Array = candidates[found[0]]
                return chosen
        return np.zeros(2)

    def _is_clear(
        self,
        speeds: Array,
        along: Array,
        points: Array,
        gaps: Array,
        need: Array,
        reach: Array,
        others: float,
    ) -> NDArray[np.bool_]:
        """(c,) true for those of `speeds` (c, 2) from which every stop stays clear."""
        poses, times, speeds_then, step, way = self._stops(speeds, along)
        # The outline comes no nearer to a point than by its own way.
        is_beyond = gaps >= need + others * times.max() + way + ROUNDING
        if is_beyond.all():
            return np.ones(len(speeds), np.bool_)
        if is_beyond.any():
            points, gaps, need, reach = (part[~is_beyond] for part in (points, gaps, need, reach))
        cos, sin = np.cos(poses[..., 2:]), np.sin(poses[..., 2:])
        dx, dy = points[:, 0] - poses[..., :1], points[:, 1] - poses[..., 1:2]
        seen = np.stack((cos * dx + sin * dy, cos * dy - sin * dx), axis=-1)
        shape = len(speeds), len(self._brakes), _STEPS, len(points)
        left = self._outline.gaps(seen.reshape(-1, 2)).reshape(shape)
        before = np.concatenate(
            (np.broadcast_to(gaps, left[:, :, :1].shape), left[:, :, :-1]), axis=2
        )
        is_free = left >= need + others * times.reshape(shape[:3])[..., None]
        is_free |= before - left <= NEGLIGIBLE_SPEED * step[..., None]
        middle = times.reshape(shape[:3]) - 0.5 * step
        within = reach + others * middle[..., None]
        is_free &= ~self._swings(seen.reshape(*shape, 2), within, speeds_then, along)
        clear: NDArray[np.bool_] = np.asarray(is_free.all(axis=(1, 2, 3)))
        return clear

    def _swings(
        self, points: Array, within: Array, speeds: Array, along: Array
    ) -> NDArray[np.bool_]:
        """(c, b, s, k) true where a turn moves a place of the outline near a point outwards.

        `points` (c, b, s, k, 2) in the base frame of each pose, `within` (c, b, s, k) m from them,
        at `speeds` (c, b, s, 2). Along an edge the outward speed is linear, so it is greatest where
        the circle around the point, or the edge, begins or ends.
        """
        found = np.zeros(within.shape, np.bool_)
        v, w = speeds[..., None, 0], speeds[..., None, 1]
        outline, count = self._outline, len(self._outline.lengths)
        for k, (x, y) in enumerate(outline.corners):
            (ax, ay), (nx, ny) = outline.axes[k], outline.axes[count + k]
            above = points[..., 0] * nx + points[..., 1] * ny - outline.origins[count + k]
            place = points[..., 0] * ax + points[..., 1] * ay - outline.origins[k]
            half = np.sqrt(np.maximum(within * within - above * above, 0.0))
            length = outline.lengths[k]
            # From behind the edge's line the way leads around the nearer corner.
            past = np.maximum(-place, place - length)
            left = within - np.hypot(past, above)
            is_behind, is_first = above <= 0.0, place < 0.0
            first = np.where(is_behind, np.where(is_first, 0.0, length - left), place - half)
            last = np.where(is_behind, np.where(is_first, left, length), place + half)
            first, last = np.maximum(first, 0.0), np.minimum(last, length)
            turned = w * (x * ny - y * nx - np.where(w > 0.0, first, last))
            outwards = np.minimum(turned, turned + v * (along[0] * nx + along[1] * ny))
            reaches = np.where(is_behind, (past > 0.0) & (left > 0.0), above < within)
            found |= reaches & (first <= last) & (outwards > FAULT_SPEED)
        return found

    def _stops(self, speeds: Array, along: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Poses (c, s, 3) and times (c, s) of the stops from `speeds` (c, 2).

        Also the speeds (c, b, s, 2) and the time steps, and the m by which a place of the outline
        moves at most in each stop.
        """
        v, w = np.abs(speeds[:, None, None, 0]), np.abs(speeds[:, None, None, 1])
        b_v, b_w = self._brakes[:, 0, None], self._brakes[:, 1, None]
        last = self._tick + np.maximum(v / b_v, w / b_w)
        step = last / _STEPS
        braked = np.maximum(step * (np.arange(_STEPS) + 0.5) - self._tick, 0.0)
        until = np.maximum(step * np.arange(_STEPS) - self._tick, 0.0)
        moves = np.maximum(v - _shed(b_v, braked), 0.0) * step * np.sign(speeds[:, None, None, 0])
        turns = np.maximum(w - _shed(b_w, braked), 0.0) * step * np.sign(speeds[:, None, None, 1])
        yaw = turns.cumsum(axis=2)
        middle = yaw - 0.5 * turns
        cos, sin = np.cos(middle), np.sin(middle)
        x = (moves * (cos * along[0] - sin * along[1])).cumsum(axis=2)
        y = (moves * (sin * along[0] + cos * along[1])).cumsum(axis=2)
        times = step * (np.arange(_STEPS) + 1.0)
        flat = len(speeds), -1
        poses = np.stack((x.reshape(flat), y.reshape(flat), yaw.reshape(flat)), axis=2)
        way = (np.abs(moves) + self._radius * np.abs(turns)).sum(axis=2).max()
        v_then = np.maximum(v - _shed(b_v, until), 0.0) * np.sign(speeds[:, None, None, 0])
        w_then = np.maximum(w - _shed(b_w, until), 0.0) * np.sign(speeds[:, None, None, 1])
        then = np.stack(np.broadcast_arrays(v_then, w_then), axis=-1)
        return poses, np.broadcast_to(times, x.shape).reshape(flat), then, step, way


def _shed(brake: Array, seconds: Array) -> Array:
    """The speed lost after braking for `seconds`; an ideal (infinite) brake stops at once."""
    product = np.broadcast_to(brake, np.broadcast_shapes(brake.shape, seconds.shape))
    shed: Array = np.where(seconds > 0.0, np.where(np.isinf(product), 1e9, product) * seconds, 0.0)
    return shed
