"""The room that a robot of mode `barrier` needs: clearances, and the narrowest passage.

Part of the unit of barrier.py. Units: m, s, rad.
"""

from __future__ import annotations

import math

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.messages import NarrowestPassage
from swarmd.core.values import ScanSpec
from swarmd.robot.protection.barrier_assumptions import REACTION, Assumptions
from swarmd.robot.protection.closing_speed import (
    CREEP_SPEED,
    DECISION_PERIOD,
    closing_cap,
    reciprocal_cap,
)
from swarmd.robot.protection.comparisons import maximum
from swarmd.robot.protection.constraints import SIDE_ANGLE
from swarmd.robot.protection.decision import Clearance
from swarmd.robot.protection.outline import Chunk, Outline

_PASSAGE_SLACK = 0.03  # m per side by which a passage must be wider: noise, a turning lidar
_CORRIDOR_SPEED = 0.08  # m/s: what counts as passing a corridor
_PLACES_BESIDE = 33  # along each wall of a corridor, odd: one lies beside a lidar in the middle
_FARTHEST_AHEAD = 5.0  # m
_STEP_AHEAD = 0.05  # m
_BESIDE_SLACK = 0.06  # m


@cython.cclass
class Room:
    """The room that one robot needs to drive and to pass."""

    _assumptions: Assumptions
    _outline: Outline
    _scan: ScanSpec

    def __init__(self, assumptions: Assumptions, outline: Outline, scan: ScanSpec) -> None:
        self._assumptions = assumptions
        self._outline = outline
        self._scan = scan

    def clearance(self, speed: float) -> Clearance:
        """The room in m that the robot needs to drive at `speed` m/s, ahead and to each side.

        Lengths ahead are from the axle. The length ahead is at most _FARTHEST_AHEAD, even if an
        obstacle at that distance does not allow the speed.
        """
        assumptions: Assumptions = self._assumptions
        corners = self._outline.corners
        age = 0.5 / self._scan.rate + self._scan.latency + REACTION
        front = float(corners[:, 0].max())
        ahead = _FARTHEST_AHEAD
        # The nearest obstacle ahead for which the robot may still drive at `speed`.
        for i in range(round(_FARTHEST_AHEAD / _STEP_AHEAD)):
            if self._fastest_at(_STEP_AHEAD * i, front, age) >= speed:
                ahead = _STEP_AHEAD * i
                break
        half_width = float(np.abs(corners[:, 1]).max())
        beside = half_width + assumptions.margin + assumptions.unseen_extent + _BESIDE_SLACK
        keep_out = assumptions.keep_out if assumptions.has_keep_out() else 0.0
        return Clearance(ahead, max(beside, keep_out), half_width)

    def _fastest_at(self, distance: float, front: float, age: float) -> float:
        """The highest speed ahead in m/s for an obstacle `distance` m ahead of the axle.

        `front` in m is the front of the outline; `age` in s is that of the scan.
        """
        assumptions: Assumptions = self._assumptions
        room = distance - front - assumptions.margin - assumptions.unseen_extent
        braking = assumptions.braking_linear
        cap = closing_cap(room, braking, age, assumptions.others_speed)
        if assumptions.has_keep_out():
            room = distance - self._outline.lidar_x - assumptions.keep_out
            cap = min(cap, reciprocal_cap(room, braking, age))
        return cap

    def narrowest_passage(self) -> NarrowestPassage:
        """The narrowest door, corridor and meeting that protection lets this robot through.

        Each width is that of the robot, plus gaps to the sides:

        - Door: the posts of a door may approach while no scan shows them, so the gap covers this
          motion. A robot that may creep needs less.
        - Corridor: the gap is so wide that the side constraints allow `_CORRIDOR_SPEED`.
        - Meeting: a corridor in which another robot of the same width passes.

        Each gap is `_PASSAGE_SLACK` wider, since the nearest of noisy returns is nearer than the
        surface. While creeping past obstacles without unseen parts, this slack is not needed.
        """
        assumptions: Assumptions = self._assumptions
        width = 2.0 * float(np.abs(self._outline.corners[:, 1]).max())
        age = self._scan.latency + REACTION
        others_speed = assumptions.others_speed

        # 1. The gap to a post of a door.
        free_distance = assumptions.margin + assumptions.unseen_extent
        post_gap = free_distance + others_speed * (age + DECISION_PERIOD) + _PASSAGE_SLACK

        # 2. The gap to a wall. Until the next decision, the side constraints let a corner use half
        # of the gap beyond contact (`Constraints._add_side`). So the gap is twice the way of the
        # corner. A robot that drives along the wall moves in the side direction at sin(SIDE_ANGLE)
        # of its speed. The reserve of the side constraints is added. A scan is half a period old on
        # average.
        until_next_decision = age + 0.5 / self._scan.rate + DECISION_PERIOD
        contact_gap = self._contact_gap_beside()
        corner_speed = _CORRIDOR_SPEED * math.sin(SIDE_ANGLE) + assumptions.side_reserve
        side_gap = contact_gap + 2.0 * until_next_decision * corner_speed + _PASSAGE_SLACK

        # 3. The gap to a post past which the robot creeps.
        creeping_gap = post_gap
        if assumptions.may_creep:
            slack = _PASSAGE_SLACK if assumptions.unseen_extent > 0.0 else 0.0
            creeping_gap = contact_gap + 2.0 * until_next_decision * CREEP_SPEED + slack

        # 4. The gaps to posts and walls, and between two robots that meet, also keep obstacles out
        # of the circle around the lidar.
        if assumptions.has_keep_out():
            circle_gap = assumptions.keep_out + _PASSAGE_SLACK - 0.5 * width
            creeping_gap = max(creeping_gap, circle_gap)
            side_gap = max(side_gap, post_gap, circle_gap)
            post_gap = side_gap

        # 5. The widths. Two robots that meet have a corridor's gap to the walls, and the gap to a
        # post between them.
        door = width + 2.0 * min(creeping_gap, post_gap)
        corridor = max(door, width + 2.0 * side_gap)
        return NarrowestPassage(door, corridor, corridor + width + post_gap)

    def _contact_gap_beside(self) -> float:
        """m from the outline within which a wall along the way may touch the robot unseen.

        The sum of the margin, the unseen extent, and the greatest hidden gap towards a wall (see
        `Outline.separate`). The hidden gap is computed for `_PLACES_BESIDE` places along each side.
        """
        chunk: Chunk = Chunk()
        outline: Outline = self._outline
        corners = outline.corners[:, 0]
        hidden = 0.0
        chunk.count = 1
        for x in np.linspace(corners.min(), corners.max(), _PLACES_BESIDE).tolist():
            for y in (-2.0 * outline.outer, 2.0 * outline.outer):
                chunk.x[0] = x
                chunk.y[0] = y
                outline.separate(chunk, self._assumptions.blind_radius)
                hidden = maximum(hidden, chunk.hidden[0])
        return self._assumptions.margin + self._assumptions.unseen_extent + hidden
