"""Arithmetic of angles in radians.

A kernel (see `kernels.py`) that is a part of each unit that uses it. `import` gives the
interpreted form, which gives the same bits.
"""

from __future__ import annotations

import math

from swarmd.core import cython_shadow as cython
from swarmd.core.cython_shadow import fabs, fmod

PI = cython.declare(cython.double, math.pi)
TURN = cython.declare(cython.double, 2.0 * math.pi)


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def mod_turn(angle: cython.double) -> cython.double:
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


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def wrap(angle: cython.double) -> cython.double:
    """The same direction within [-pi, pi)."""
    return mod_turn(angle + PI) - PI


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def angle_between(first: cython.double, second: cython.double) -> cython.double:
    """The angle between two directions."""
    return fabs(wrap(first - second))


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def difference(to: cython.double, origin: cython.double) -> cython.double:
    """The turn from `origin` to `to`, within [-pi, pi), counter-clockwise positive."""
    return wrap(to - origin)
