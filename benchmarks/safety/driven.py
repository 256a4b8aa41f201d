"""Whether a robot drove into what it touched, or was pushed: by what its own drives can have done.

Who is rammed beside its middle is turned, and its corner then comes towards the rammer; who is
pushed may be pushed into a third. While nothing touches a robot, it moves by its own drives. From a
touch on, they move its surface no faster than they did, less what it has braked since, or than it
is told to.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from benchmarks.safety.judge import FAULT, ONCE, Collision, collisions
from swarmd.sim.metrics.touches import WALLS
from swarmd.sim.trace import ARENA, Trace
from swarmd.sim.world.geometry import radius
from swarmd.sim.world.realism import REALISTIC
from swarmd.values import Array

BRAKING = np.array([1.0, 3.0, 1.0])
"""m/s2, rad/s2, m/s2: the least that the bases do."""

_THROWN = 0.3  # s after a touch in which a robot may still move by it
_ROUNDING = 1e-9


def faults(trace: Trace, unprotected: Collection[str] = ()) -> Iterator[Collision]:
    """The judge's faults in which the robot drove, each with the `own_speed` of its drives.

    The trace's commands must be dense: 20 or more instants a second.
    """
    able: dict[str, Array] = {}
    for one in collisions(trace, unprotected):
        if not one.is_fault:
            continue
        if one.who not in able:
            able[one.who] = drive_speeds(trace, trace.ids.index(one.who))
        if (speed := _own_drive(trace, one, able[one.who])) > FAULT:
            yield structs.replace(one, own_speed=speed)


def drive_speeds(trace: Trace, robot: int) -> Array:
    """(T,) m/s: the most that the drives of a robot can move any of its points at each instant."""
    t, told = trace.t, np.abs(trace.safe[:, robot])
    driven, is_thrown = _moved(trace, robot), _is_thrown(trace, robot)
    for row in np.flatnonzero(is_thrown).tolist():
        late = int(np.searchsorted(t, t[row] - REALISTIC.actuation.delay - _ROUNDING))
        before = driven[row - 1] - BRAKING * (t[row] - t[row - 1]) if row else 0.0
        driven[row] = np.maximum(told[late : row + 1].max(axis=0), before)
    reach = radius(trace.footprint(robot))
    speeds: Array = np.hypot(driven[:, 0], driven[:, 2]) + driven[:, 1] * reach
    return speeds


def _moved(trace: Trace, robot: int) -> Array:
    """(T, 3) how fast it moved ahead, turned and moved aside up to each instant: truth, >= 0."""
    pose = trace.pose[:, robot]
    rates = np.diff(pose, axis=0) / np.diff(trace.t)[:, None]
    yaw = (pose[1:, 2] + pose[:-1, 2]) / 2.0
    ahead = np.cos(yaw) * rates[:, 0] + np.sin(yaw) * rates[:, 1]
    aside = np.cos(yaw) * rates[:, 1] - np.sin(yaw) * rates[:, 0]
    moved = np.abs(np.stack((ahead, rates[:, 2], aside), axis=-1))
    return np.concatenate((np.zeros((1, 3)), moved))


def _is_thrown(trace: Trace, robot: int) -> NDArray[np.bool_]:
    """(T,) whether something touches it, or has so recently that it may still move by it."""
    touched = np.sort(trace.contact_t[(trace.contact_pair == robot).any(axis=1)])
    touched = np.concatenate(([-np.inf], touched))
    last = touched[np.searchsorted(touched, trace.t + _ROUNDING) - 1]
    return np.asarray(trace.t - last < _THROWN)


def _own_drive(trace: Trace, one: Collision, able: Array) -> float:
    """The fastest that who is at fault in a count closed by its own drives, `able` (T,), in m/s."""
    robot = trace.ids.index(one.who)
    other = _index(trace, one.b if one.who == one.a else one.a)
    is_own = trace.contact_pair == robot
    of = is_own.any(axis=1) & (trace.contact_pair == other).any(axis=1)
    since = trace.contact_t - one.time
    of &= (since >= -_ROUNDING) & (since < ONCE - _ROUNDING)
    after = np.searchsorted(trace.t, trace.contact_t[of])
    last = len(able) - 1
    most = np.maximum(able[np.minimum(after, last)], able[np.clip(after - 1, 0, last)])
    closing = trace.contact_speed[is_own & of[:, None]]
    return float(np.minimum(closing, most).max(initial=0.0))


def _index(trace: Trace, name: str) -> int:
    if name == WALLS:
        return ARENA
    return trace.ids.index(name) if name in trace.ids else ARENA - 1 - trace.things.index(name)
