"""The speed at which the outline may close on an obstacle: caps of mode `barrier`.

Part of the library of barrier.py. Units: m, s, rad.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.core.clock import TICK
from swarmd.protection.buffers import maximum

if TYPE_CHECKING:  # Cython reads this import, CPython the other one
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import fabs, sqrt
else:
    from swarmd.core.cython_shadow import fabs, sqrt

DECISION_PERIOD = cython.declare(cython.double, TICK)
"""s between two decisions, for which a command stands."""
CREEP_SPEED = cython.declare(cython.double, 0.015)
"""m/s: the fastest corner in contact, where part of the obstacle may be unseen.

Also that of a robot that creeps towards an obstacle which stops any faster robot.
"""
MIN_BRAKING = cython.declare(cython.double, 0.02)
"""m/s2, for constraints that hardly any motion closes."""


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def closing_cap(
    room: cython.double,
    braking: cython.double,
    unseen: cython.double,
    others: cython.double,
    is_passive: cython.bint,
) -> cython.double:
    """The cap in m/s on the closing speed, for an obstacle that approaches at `others` m/s.

    From the cap the robot can still stop before robot and obstacle use up `room` m, the gap less
    what stays free. `braking` m/s2 is the rate at which the closing speed can fall, `unseen` s the
    time since the obstacle was seen. Solves
    s tick + s^2 / 2b + V (unseen + tick + s / b) = room. After the dynamic window with moving
    obstacles and "passive safety" (Mitsch, Ghorbal, Vogelbacher and Platzer, IJRR 2017).
    """
    if not is_passive:
        return reciprocal_cap(room, braking, unseen)
    left: cython.double = room - others * (unseen + DECISION_PERIOD)
    first: cython.double = braking * DECISION_PERIOD + others
    root: cython.double = sqrt(first * first + 2.0 * braking * maximum(left, 0.0))
    return maximum(root - first, 0.0)


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def reciprocal_cap(
    room: cython.double, braking: cython.double, unseen: cython.double
) -> cython.double:
    """The cap in m/s towards robots with the same rule: each may use half of the room.

    As `closing_cap`, with others at rest and a reaction of two ticks plus the time unseen. After
    barrier certificates that share the distance (Wang, Ames and Egerstedt, IEEE T-RO 2017).
    """
    half: cython.double = 0.5 * maximum(room, 0.0)
    first: cython.double = braking * (2.0 * DECISION_PERIOD + unseen)
    return maximum(sqrt(first * first + 2.0 * braking * half) - first, 0.0)


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def closing_deceleration(
    linear: cython.double, lever: cython.double, slowing: cython.double, turning: cython.double
) -> cython.double:
    """m/s2: the rate at which the closing speed of a constraint can fall.

    `slowing` m/s2 and `turning` rad/s2 are the rates at which the two speeds can fall.
    """
    braking: cython.double = fabs(linear) * slowing
    braking += fabs(lever) * turning
    return maximum(braking, MIN_BRAKING)
