"""The arena of a simulated world, as a page shows it."""

from __future__ import annotations

import struct
import zlib
from base64 import b64encode
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.operator.view.source import ShownArena
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.floor import FloorField, floor_pixels
from swarmd.sim.world.line_of_sight import LineOfSight
from swarmd.sim.world.scalar_fields import Field, sample

CELLS = 48
"""Cells of a field along the longer side of the arena."""
MAX_LINKS = 5000


def shown_arena(arena: Arena, fields: Sequence[Field] = ()) -> ShownArena:
    """Walls, fixed boxes, poles, fields and the floor."""
    size = arena.length, arena.width
    pixels = floor_pixels(fields, size)
    return ShownArena(
        size,
        [box.corners for _, box in arena.fixed],
        [(pole.x, pole.y, pole.radius) for pole in arena.poles],
        _grids(arena, [field for field in fields if not isinstance(field, FloorField)]),
        "" if pixels is None else f"data:image/png;base64,{b64encode(png_of(pixels)).decode()}",
    )


def _grids(arena: Arena, fields: Sequence[Field]) -> dict[str, Array]:
    """Each field (rows, columns) at the middles of cells."""
    cell = max(arena.length, arena.width) / CELLS
    columns, rows = (max(1, round(side / cell)) for side in (arena.length, arena.width))
    x = ((np.arange(columns) + 0.5) / columns - 0.5) * arena.length
    y = ((np.arange(rows) + 0.5) / rows - 0.5) * arena.width
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    values_of = sample(fields, places, None, LineOfSight(arena).is_clear)
    return {name: values.reshape(rows, columns) for name, values in values_of.items()}


def png_of(pixels: NDArray[np.uint8]) -> bytes:
    """A picture (rows, columns, 3) as PNG."""
    rows, columns = pixels.shape[:2]
    lines = np.concatenate((np.zeros((rows, 1), np.uint8), pixels.reshape(rows, -1)), axis=1)
    head = struct.pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0)
    chunks = (b"IHDR", head), (b"IDAT", zlib.compress(lines.tobytes(), 9)), (b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


def links_within(reach: float, indices: NDArray[Any], places: Array) -> list[tuple[int, int]]:
    """Pairs of `indices` (n,) whose `places` (n, 2) are within `reach` m; at most MAX_LINKS."""
    gaps = np.linalg.norm(places[:, None] - places[None], axis=2)
    first, second = np.nonzero(np.triu(gaps <= reach, 1))
    pairs = np.stack((indices[first], indices[second]), axis=1)[:MAX_LINKS].astype(int)
    return [(a, b) for a, b in pairs.tolist()]
