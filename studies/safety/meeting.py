"""Contact points of two convex outlines, and the direction between them."""

from __future__ import annotations

import numpy as np

from swarmd.core.values import Array

_SLACK = 0.02
"""Tolerance in m of contact points: instants of a trace are up to 0.05 s apart."""


def meeting(one: Array, other: Array) -> tuple[Array, Array]:
    """(p, 2) points in m at which `one` (k, 2) may touch `other` (m, 2), and a direction (2,).

    Counter-clockwise corners in one frame. The unit direction is the one with the largest distance
    or the least overlap (separating axis theorem). The points are corners of either.
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
    """(k, 2) outward unit normals of the edges."""
    edges = np.roll(corners, -1, axis=0) - corners
    normals = np.stack((edges[:, 1], -edges[:, 0]), axis=1)
    lengths: Array = np.hypot(edges[:, 0], edges[:, 1])
    outward: Array = normals / lengths[:, None]
    return outward
