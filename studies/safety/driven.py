"""Whether a robot drove into an obstacle or was pushed, from the motion that its drives allow.

A rammer that meets a robot beside the robot's centre turns the robot, and a corner of the robot may
then move towards the rammer. A robot that backs away may be thrown against the rammer, and a pushed
robot may be pushed into a third robot. Without contact, a robot moves by its own drives. After a
contact begins, the drives can move the robot at most at its speed before the contact, less braking
since, or at the commanded speed. Only the part of this motion towards the other robot counts.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from studies.safety.judge import FAULT, ONCE, Collision, collisions
from studies.safety.meeting import meeting
from swarmd.core.values import Array
from swarmd.sim.metrics.contacts import WALLS
from swarmd.sim.trace import ARENA, Trace
from swarmd.sim.world.geometry import transform
from swarmd.sim.world.realism import REALISTIC, Actuation

_TURNING = 3.0  # rad/s2, the least deceleration of the bases without a cap
_LINEAR = 1.0  # m/s2, the same of linear motion

_THROWN = 0.3  # s after a contact in which the contact may still move the robot
_ROUNDING = 1e-9


def faults(
    trace: Trace,
    unprotected: Collection[str] = (),
    actuation: Actuation = REALISTIC.actuation,
) -> Iterator[Collision]:
    """The judge's faults in which the robot drove, each with the `own_speed` of its drives.

    `actuation`: delay and brakes of the bases. The trace's commands must be dense: 20 or more
    instants a second.
    """
    possible: dict[str, Array] = {}
    for one in collisions(trace, unprotected):
        if not one.is_fault:
            continue
        if one.robot not in possible:
            possible[one.robot] = drives(trace, trace.ids.index(one.robot), actuation)
        if (speed := _own_drive(trace, one, possible[one.robot])) > FAULT:
            yield structs.replace(one, own_speed=speed)


def drives(trace: Trace, robot: int, actuation: Actuation = REALISTIC.actuation) -> Array:
    """(T, 2, 3) the lowest and highest speeds that a robot's drives allow at each instant.

    Ahead in m/s, turning in rad/s, sideways in m/s; in the base frame.
    """
    t, commanded = trace.t, trace.safe[:, robot]
    linear = actuation.linear_acceleration or _LINEAR
    braking = np.array([linear, actuation.angular_acceleration or _TURNING, linear])
    moved, is_thrown = _moved(trace, robot), _is_thrown(trace, robot)
    possible = np.stack((moved, moved), axis=1)
    for row in np.flatnonzero(is_thrown).tolist():
        late = int(np.searchsorted(t, t[row] - actuation.delay - _ROUNDING))
        lost = braking * (t[row] - t[row - 1]) if row else np.inf
        before = possible[row - 1]
        before = np.sign(before) * np.maximum(np.abs(before) - lost, 0.0)
        possible[row, 0] = np.minimum(commanded[late : row + 1].min(axis=0), before[0])
        possible[row, 1] = np.maximum(commanded[late : row + 1].max(axis=0), before[1])
    return possible


def _moved(trace: Trace, robot: int) -> Array:
    """(T, 3) true speeds ahead, of turning and sideways in the step before each instant."""
    pose = trace.pose[:, robot]
    rates = np.diff(pose, axis=0) / np.diff(trace.t)[:, None]
    yaw = (pose[1:, 2] + pose[:-1, 2]) / 2.0
    ahead = np.cos(yaw) * rates[:, 0] + np.sin(yaw) * rates[:, 1]
    aside = np.cos(yaw) * rates[:, 1] - np.sin(yaw) * rates[:, 0]
    moved = np.stack((ahead, rates[:, 2], aside), axis=-1)
    return np.concatenate((np.zeros((1, 3)), moved))


def _is_thrown(trace: Trace, robot: int) -> NDArray[np.bool_]:
    """(T,) whether the robot is in contact, or was within the last `_THROWN` s."""
    touched = np.sort(trace.contact_t[(trace.contact_pair == robot).any(axis=1)])
    touched = np.concatenate(([-np.inf], touched))
    last = touched[np.searchsorted(touched, trace.t + _ROUNDING) - 1]
    return np.asarray(trace.t - last < _THROWN)


def _own_drive(trace: Trace, one: Collision, possible: Array) -> float:
    """The highest closing speed in m/s of the robot at fault by its own drives, (T, 2, 3)."""
    robot = trace.ids.index(one.robot)
    other = _index(trace, one.b if one.robot == one.a else one.a)
    is_own = trace.contact_pair == robot
    of = is_own.any(axis=1) & (trace.contact_pair == other).any(axis=1)
    since = trace.contact_t - one.time
    of &= (since >= -_ROUNDING) & (since < ONCE - _ROUNDING)
    after = np.minimum(np.searchsorted(trace.t, trace.contact_t[of]), len(possible) - 1)
    closing = trace.contact_speed[is_own & of[:, None]]
    speeds = [
        min(speed, max(_closing(trace, robot, other, at, possible[at]) for at in (row - 1, row)))
        for row, speed in zip(after.tolist(), closing.tolist(), strict=True)
        if speed > FAULT
    ]
    return max(speeds, default=0.0)


def _closing(trace: Trace, robot: int, other: int, row: int, possible: Array) -> float:
    """The highest closing speed in m/s of the outline with the possible speeds (2, 3)."""
    outline = trace.footprint(robot)
    if other < 0:  # walls and boxes: in any direction
        angles = np.linspace(-np.pi, np.pi, 73)
        towards = np.stack((np.cos(angles), np.sin(angles)), axis=1)
        at, to = np.tile(outline, (len(angles), 1)), np.repeat(towards, len(outline), axis=0)
    else:
        pose = trace.pose[row, robot]
        there = transform(trace.footprint(other), trace.pose[row, other])
        at, way = meeting(transform(outline, pose), there)
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        to_base = np.array([[cos, sin], [-sin, cos]])
        at, to = (at - pose[:2]) @ to_base.T, np.tile(to_base @ way, (len(at), 1))
    rates = np.stack((to[:, 0], at[:, 0] * to[:, 1] - at[:, 1] * to[:, 0], to[:, 1]), axis=1)
    return float(np.maximum(rates * possible[0], rates * possible[1]).sum(axis=1).max())


def _index(trace: Trace, name: str) -> int:
    if name == WALLS:
        return ARENA
    return (
        trace.ids.index(name) if name in trace.ids else ARENA - 1 - trace.movable_boxes.index(name)
    )
