"""Where two convex outlines touch, and which way the one faces the other there."""

from __future__ import annotations

import numpy as np

from swarmd.core.values import Array

_SLACK = 0.02
"""m: places that are no further from the other than the nearest and this may touch it as well: a
trace's instants are up to 0.05 s apart."""


def meeting(one: Array, other: Array) -> tuple[Array, Array]:
    """(p, 2) places in m at which `one` (k, 2) may touch `other` (m, 2), and the (2,) way there.

    Counter-clockwise corners in one frame. The way is that in which the two are furthest apart, or
    overlap least (separating axis theorem); of length 1. The places are corners of either.
    """
    ways = np.concatenate((_outward(one), -_outward(other)))
    heights = (other @ ways.T).min(axis=0) - (one @ ways.T).max(axis=0)
    way = ways[int(heights.argmax())]
    rest = np.array([-way[1], way[0]])
    near = one[one @ way >= (one @ way).max() - _SLACK]
    met = other[other @ way <= (other @ way).min() + _SLACK]
    low, high = (near @ rest).min(), (near @ rest).max()
    beside = met[(met @ rest >= low - _SLACK) & (met @ rest <= high + _SLACK)]
    low, high = (met @ rest).min() - _SLACK, (met @ rest).max() + _SLACK
    own = near[(near @ rest >= low) & (near @ rest <= high)]
    places = np.concatenate((own, beside))
    return (places if len(places) else near), way


def _outward(corners: Array) -> Array:
    """(k, 2) of length 1, out of each edge."""
    edges = np.roll(corners, -1, axis=0) - corners
    normals = np.stack((edges[:, 1], -edges[:, 0]), axis=1)
    lengths: Array = np.hypot(edges[:, 0], edges[:, 1])
    outward: Array = normals / lengths[:, None]
    return outward
