"""The arena of a simulated world, as a page shows it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.scalar_fields import Field, sample
from swarmd.view.source import ShownArena

CELLS = 48
"""Cells of a field along the longer side of the arena."""
MAX_LINKS = 5000


def shown_arena(arena: Arena, fields: Sequence[Field] = ()) -> ShownArena:
    """Walls, fixed boxes, poles and fields."""
    return ShownArena(
        (arena.length, arena.width),
        [box.corners for _, box in arena.fixed],
        [(pole.x, pole.y, pole.radius) for pole in arena.poles],
        _grids(arena, fields),
    )


def _grids(arena: Arena, fields: Sequence[Field]) -> dict[str, Array]:
    """Each field (rows, columns) at the middles of cells."""
    cell = max(arena.length, arena.width) / CELLS
    columns, rows = (max(1, round(side / cell)) for side in (arena.length, arena.width))
    x = ((np.arange(columns) + 0.5) / columns - 0.5) * arena.length
    y = ((np.arange(rows) + 0.5) / rows - 0.5) * arena.width
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return {name: values.reshape(rows, columns) for name, values in sample(fields, places).items()}


def links_within(reach: float, indices: NDArray[Any], places: Array) -> list[tuple[int, int]]:
    """Pairs of `indices` (n,) whose `places` (n, 2) are within `reach` m; at most MAX_LINKS."""
    gaps = np.linalg.norm(places[:, None] - places[None], axis=2)
    first, second = np.nonzero(np.triu(gaps <= reach, 1))
    pairs = np.stack((indices[first], indices[second]), axis=1)[:MAX_LINKS].astype(int)
    return [(a, b) for a, b in pairs.tolist()]
