"""The order of the rays of a scan by rising angle.

A kernel (see `kernels.py`) that is a part of each unit that uses it.
"""

from __future__ import annotations

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.buffers import checked, checked_indices, wrapped_index
from swarmd.core.cython_shadow import isfinite

# Moves of the insertion sort for each ray, after which angles count as unsorted.
_MOVES_A_RAY = cython.declare(cython.Py_ssize_t, 16)


@cython.cfunc
def sort_rays(
    angles: cython.double[::1],
    count: cython.Py_ssize_t,
    rising: cython.double[::1],
    order: cython.longlong[::1],
) -> None:
    """Sort the first `count` of `angles`: sets `rising`, and `order`, the indices of its rays.

    Rays of the same angle are in the order of their indices; NaN is last. The three buffers differ.

    An insertion sort is fast here: from the smallest angle on, the angles of most sensors rise,
    with few exceptions, along or against the index.
    """
    i: cython.Py_ssize_t
    k: cython.Py_ssize_t
    ray: cython.Py_ssize_t = 0
    if count == 0:
        return
    given = checked(angles, count)
    risen = checked(rising, count)
    rays = checked_indices(order, count)

    # 1. Begins at the smallest angle, in the direction in which angles rise.
    for i in range(count):
        if given[i] < given[ray]:
            ray = i
    before = given[ray - 1 if ray else count - 1]
    index_step: cython.Py_ssize_t = 1
    if before < given[wrapped_index(ray + 1, count)]:
        index_step = count - 1  # angles fall with the index: one back, modulo the number

    # 2. Inserts each angle.
    moves_left: cython.Py_ssize_t = _MOVES_A_RAY * count
    for i in range(count):
        angle = given[ray]
        k = i
        while k > 0 and (risen[k - 1] > angle or (risen[k - 1] == angle and rays[k - 1] > ray)):
            risen[k] = risen[k - 1]
            rays[k] = rays[k - 1]
            k = k - 1
            moves_left = moves_left - 1
        risen[k] = angle
        rays[k] = ray
        if moves_left < 0 or not isfinite(angle):
            break
        ray = wrapped_index(ray + index_step, count)
    else:
        return

    # 3. Too many exceptions: sorts by numpy.
    found: cython.longlong[::1] = np.argsort(np.asarray(angles)[:count], kind="stable")
    for i in range(count):
        order[i] = found[i]
        rising[i] = angles[found[i]]
