"""The order of the rays of a scan by rising angle.

A kernel (see `kernels.py`) that is a part of each unit that uses it.
"""

from __future__ import annotations

import numpy as np

from swarmd.core.buffers import checked, checked_indices, wrapped_index
from swarmd.core.cython_shadow import Doubles, Indices, isfinite

# Moves of the insertion sort for each ray, after which angles count as unsorted.
_MOVES_A_RAY = 16


def sort_rays(angles: Doubles, count: int, rising: Doubles, order: Indices) -> None:
    """Sort the first `count` of `angles`: sets `rising`, and `order`, the indices of its rays.

    Rays of the same angle are in the order of their indices; NaN is last. The three buffers differ.

    An insertion sort is fast here: from the smallest angle on, the angles of most sensors rise,
    with few exceptions, along or against the index.
    """
    ray = 0
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
    index_step = 1
    if before < given[wrapped_index(ray + 1, count)]:
        index_step = count - 1  # angles fall with the index: one back, modulo the number

    # 2. Inserts each angle.
    moves_left = _MOVES_A_RAY * count
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
    found: Indices = np.argsort(np.asarray(angles)[:count], kind="stable")
    for i in range(count):
        order[i] = found[i]
        rising[i] = angles[found[i]]
