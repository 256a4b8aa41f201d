"""Blind sectors: rays that return nothing although others return something in the same direction.

A covered or broken part of a range sensor looks like open space. While the robot turns, its rays
pass over the same things: where a static thing returns other rays before and after, a ray without a
return has missed it. A sector is blind once its rays have missed things in many directions and have
returned nothing meanwhile. An open field, a door and a surface that no ray sees give no return to
any ray; a thing that moves is not the same before and after; and one return clears its sector.

`BlindSectors` is a class of the kernel of scans.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array

SECTORS = 90
"""Sectors of 4 degrees, of the sensor and of the directions around it."""


def blind_text(is_blind: NDArray[np.bool_], returned_at: Array, now: float) -> str:
    """The blind sectors in degrees, and since when; both arrays (90,) by sector."""
    if not is_blind.any():
        return ""
    start = int(is_blind.argmin())  # one that is not blind, so that none wraps around
    blind = np.roll(is_blind, -start)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], blind, [False])).astype(np.int8)))
    width = 360 // SECTORS
    names = [
        f"{(first + start) * width % 360}..{(end + start) * width % 360}"
        for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    ]
    since = now - float(returned_at[is_blind].max())
    return (
        f"rays {', '.join(names)} deg have not returned anything for {since:.0f} s while others"
        " did: they count as unknown; clean or uncover the sensor"
    )
