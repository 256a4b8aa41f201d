"""The numbers of tracks, for tests that compare them: tracks of kernels have no equality."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from swarmd.robot.steering.tracks import Track


def numbers_of(tracks: Iterable[Track]) -> list[tuple[float, ...]]:
    """Of each track its id, place in m, velocity in m/s and radius in m."""
    return [(one.id, one.x, one.y, one.vx, one.vy, one.radius) for one in tracks]
