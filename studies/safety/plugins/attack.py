"""Attacks the nearest robot that it detects, backs off, and attacks again.

The attacker moves in any direction without turning. So every point of its outline has exactly
`speed`, the speed that protection assumes of others. The attacker backs off, since minutes of
leaning against one robot prove little.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np

from swarmd.api import ZERO, Context, Inputs, MovementPattern, Params, Twist, about, clusters

_WIDEST = 0.8  # m: wider objects are walls
_TOUCH = 0.03  # m between outlines below which the target counts as met
_LEANS, _BACKS = 0.7, 4.0  # s for which it drives on in contact, and then backs off
_LONGEST = 20.0  # s of one attack
_NEW = 0.3  # weight of a new measurement of the target's velocity
_SAME = 0.4  # m: a return farther from where the target is expected is of another body
_STAGE = 0.5  # m behind its target where an attack from behind begins


class AttackParams(Params, frozen=True):
    """How fast, and in which way."""

    speed: Annotated[float, about("of every point of its outline", ge=0.01, le=5.0, unit="m/s")] = (
        0.3
    )
    way: Annotated[
        Literal["ram", "lead", "behind", "corner", "flank", "spin"],
        about(
            "ram: straight at where the target is; lead: where it will be; behind: from where it"
            " comes, along its motion; corner: at its left or right edge; flank: past its edge, in"
            " touch; spin: half of the speed for turning"
        ),
    ] = "lead"


class Attack(MovementPattern[AttackParams]):
    """Homes in on the nearest thing that is no wall; where it sees none it wanders."""

    params_type = AttackParams
    needs = frozenset({"odometry"})

    def __init__(self, params: AttackParams, context: Context) -> None:
        super().__init__(params, context)
        self._half = float(np.hypot(*context.platform.footprint.T).max())
        self._place: np.ndarray | None = None  # of the target, and its velocity, by odometry
        self._velocity = np.zeros(2)
        self._width = 0.0
        self._seen_at = self._begun = -math.inf
        self._touched_until = self._back_until = -math.inf
        self._way = np.array([1.0, 0.0])
        self._side = 1.0

    def drive(self, inputs: Inputs) -> Twist:
        """Towards the place at which it meets the target."""
        if inputs.odometry is None:
            return ZERO
        pose, now, speed = inputs.odometry.pose, inputs.now, self.params.speed
        own = np.array([pose.x, pose.y])
        if inputs.is_new_scan:
            self._look(inputs, own, pose.yaw)
        if now >= self._touched_until and now < self._back_until:
            way = -self._way
        else:
            self._way = way = self._towards(own, now)
        linear = float(math.cos(pose.yaw) * way[0] + math.sin(pose.yaw) * way[1])
        lateral = float(math.cos(pose.yaw) * way[1] - math.sin(pose.yaw) * way[0])
        if self.params.way == "spin":
            half = 0.5 * speed
            return Twist(half * linear, self._side * half / self._half, half * lateral)
        return Twist(speed * linear, 0.0, speed * lateral)

    def _look(self, inputs: Inputs, own: np.ndarray, yaw: float) -> None:
        """Find the target in the scan, and its velocity; end an attack that has met it."""
        seen = clusters(inputs.scan, within=self.context.platform.scan.range_max)
        is_body = seen.is_free & (seen.widths < _WIDEST)
        if not is_body.any():
            self._place = None
            return
        angles = yaw + seen.bearings[is_body]
        ways = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
        places = own + seen.ranges[is_body, None] * ways
        widths, ranges = seen.widths[is_body], seen.ranges[is_body]
        lasted = inputs.now - self._seen_at
        chosen = int(ranges.argmin())
        if self._place is not None:
            expected = self._place + self._velocity * lasted
            nearest = np.hypot(*(places - expected).T)
            if nearest.min() < _SAME:
                chosen = int(nearest.argmin())
                moved = (places[chosen] - self._place) / max(lasted, 1e-3)
                self._velocity += _NEW * (moved - self._velocity)
            else:
                self._velocity = np.zeros(2)
        self._place, self._width = places[chosen], float(widths[chosen])
        self._seen_at = inputs.now
        is_over = inputs.now - self._begun > _LONGEST
        if inputs.now >= self._back_until and (is_over or ranges.min() < self._half + _TOUCH):
            self._touched_until = inputs.now + (0.0 if is_over else _LEANS)
            self._back_until = self._touched_until + _BACKS
            self._begun = self._back_until
            self._side = float(self.context.rng.choice((-1.0, 1.0)))

    def _towards(self, own: np.ndarray, now: float) -> np.ndarray:
        """The unit direction in which to drive, by odometry."""
        if self._place is None:
            angle = self.context.rng.normal(math.atan2(self._way[1], self._way[0]), 0.05)
            return np.array([math.cos(angle), math.sin(angle)])
        way = self.params.way
        place = self._place + self._velocity * (now - self._seen_at)
        across = np.array([own[1] - place[1], place[0] - own[0]])
        across *= self._side / max(float(np.hypot(*across)), 1e-6)
        if way == "corner":
            place = place + 0.5 * self._width * across
        elif way == "flank":
            place = place + (0.5 * self._width + 0.7 * self._half) * across
        elif way == "behind":
            place = self._from_behind(own, place, across)
        if way != "ram":
            apart = float(np.hypot(*(place - own)))
            place = place + self._velocity * min(apart / self.params.speed, 2.0)
        aim = place - own
        return np.asarray(aim / max(float(np.hypot(*aim)), 1e-6))

    def _from_behind(self, own: np.ndarray, place: np.ndarray, across: np.ndarray) -> np.ndarray:
        """The target if this robot is behind it, else a place on the way to there."""
        moves = float(np.hypot(*self._velocity))
        if moves < 0.03:
            return place
        ahead = self._velocity / moves
        if float((place - own) @ ahead) > 0.7 * float(np.hypot(*(place - own))):
            return place
        return np.asarray(place + _STAGE * (across - ahead))
