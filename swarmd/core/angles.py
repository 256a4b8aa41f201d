"""Arithmetic of angles in radians.

A kernel (see `kernels.py`) that is a part of each unit that uses it. `import` gives the
interpreted form, which gives the same bits.
"""

from __future__ import annotations

import math

from swarmd.core.cython_shadow import fabs, fmod

PI = math.pi
TURN = 2.0 * math.pi


def mod_turn(angle: float) -> float:
    """The angle modulo a full turn, with the bits of numpy's %."""
    if 0.0 <= angle < TURN:
        return angle
    if -TURN < angle < 0.0:  # as fmod, which is exact and slow
        return angle + TURN
    if TURN <= angle < 2.0 * TURN:
        return angle - TURN
    rest = fmod(angle, TURN)
    if rest < 0.0:
        rest += TURN
    return rest


def wrap(angle: float) -> float:
    """The same direction within [-pi, pi)."""
    return mod_turn(angle + PI) - PI


def angle_between(first: float, second: float) -> float:
    """The angle between two directions."""
    return fabs(wrap(first - second))


def difference(to: float, origin: float) -> float:
    """The turn from `origin` to `to`, within [-pi, pi), counter-clockwise positive."""
    return wrap(to - origin)
