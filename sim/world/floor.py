"""A floor of grey and coloured patches, tiles and pictures, read by sensors under a robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError, PluginError
from swarmd.core.files import open_regular
from swarmd.core.values import Array
from swarmd.sim.world.field_kind import Coordinate, Degrees, Extent, FieldKind, Point

Shade = Annotated[float, Meta(ge=0.0, le=1.0)]
# msgspec 0.22 crashes on a number where a union has a bounded number and a tuple.
Colour = Shade | Annotated[list[Shade], Meta(min_length=3, max_length=3)]
"""Black 0 to white 1, or red, green and blue."""
COLOURS = ("red", "green", "blue")
MAX_TILES = 1_000_000
MAX_PIXELS = 16_000_000
"""The most pixels of a picture; a pixel takes 24 bytes."""
_GREY = np.array([0.299, 0.587, 0.114])
"""Weights of red, green and blue in the grey of a colour (ITU-R BT.601)."""


class Patch(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A part of the floor with one of three shapes; lengths in m."""

    disc: tuple[Coordinate, Coordinate, Extent] | None = None  # x, y, radius
    rectangle: tuple[Coordinate, Coordinate, Extent, Extent] | None = None  # x, y, length, width
    polygon: Annotated[list[Point], Meta(min_length=3, max_length=1000)] | None = None
    yaw_deg: Degrees = 0.0  # of a rectangle
    image: str | None = None  # the file of a picture that fills a rectangle
    tiles: Extent | None = None  # the side of square tiles that fill a rectangle
    share: Shade = 0.5  # of the tiles that have `colour`; the remaining tiles show the floor below
    seed: Annotated[int, Meta(ge=0, le=2**31)] = 0  # of the draw of these tiles
    colour: Colour = 0.0

    def __post_init__(self) -> None:
        """Check that the patch has one shape, and that its tiles fill a rectangle."""
        if sum(shape is not None for shape in (self.disc, self.rectangle, self.polygon)) != 1:
            raise ValueError("has not one shape; expected disc, rectangle or polygon")
        inner = [name for name in ("image", "tiles") if getattr(self, name) is not None]
        if inner and (self.rectangle is None or len(inner) == 2):
            raise ValueError(f"has {' and '.join(inner)}; expected one of them in a rectangle")
        if math.prod(self._grid) > MAX_TILES:
            raise ValueError(f"has {math.prod(self._grid)} tiles; expected {MAX_TILES} at most")

    def paint(self, places: Array, colours: Array) -> None:
        """Write the patch's colours into `colours` (k, 3) where it covers the `places` (k, 2)."""
        if self.rectangle is None:
            colours[self._covers(places)] = self.colour
            return
        x, y, length, width = self.rectangle
        cos = math.cos(math.radians(self.yaw_deg))
        sin = math.sin(math.radians(self.yaw_deg))
        dx = places[:, 0] - x
        dy = places[:, 1] - y
        # Shares of the sides, from the corner of least x and y.
        u = (cos * dx + sin * dy) / length + 0.5
        v = (cos * dy - sin * dx) / width + 0.5
        inside = (u >= 0.0) & (u < 1.0) & (v >= 0.0) & (v < 1.0)
        u = u[inside]
        v = v[inside]
        if self.image is not None:
            pixels = picture(self.image)
            rows, columns = pixels.shape[:2]
            row = (rows * (1.0 - v)).astype(int)
            column = (columns * u).astype(int)
            colours[inside] = pixels[np.minimum(row, rows - 1), column]
            return
        if self.tiles is not None:
            columns, rows = self._grid
            tile = (columns * u).astype(int) + columns * (rows * v).astype(int)
            # Of the places inside, only those on tiles that were drawn have the colour.
            inside[inside] = drawn_tiles(columns * rows, self.share, self.seed)[tile]
        colours[inside] = self.colour

    def _covers(self, places: Array) -> NDArray[np.bool_]:
        if self.disc is not None:
            x, y, radius = self.disc
            return np.hypot(places[:, 0] - x, places[:, 1] - y) <= radius
        inside = np.zeros(len(places), dtype=np.bool_)
        corners = self.polygon or []
        for (x1, y1), (x2, y2) in zip(corners, corners[1:] + corners[:1], strict=True):
            if y1 != y2:  # an edge that a line to the right of the place crosses
                across = (places[:, 1] < y1) != (places[:, 1] < y2)
                at = x1 + (places[:, 1] - y1) * (x2 - x1) / (y2 - y1)
                inside ^= across & (places[:, 0] < at)
        return inside

    @property
    def _grid(self) -> tuple[int, int]:
        """The numbers of tiles along length and width; the side is rounded to whole tiles."""
        if self.tiles is None or self.rectangle is None:
            return 0, 0
        _, _, length, width = self.rectangle
        return max(1, round(length / self.tiles)), max(1, round(width / self.tiles))


class FloorField(FieldKind, frozen=True, kw_only=True, tag="floor"):
    """A floor of `colour` with `patches`, each above those before it: 0 black to 1 white.

    A floor with a colour has besides its grey the readings `<name>_red`, `_green` and `_blue`.
    """

    colour: Colour = 1.0
    patches: tuple[Patch, ...] = ()

    def at(self, places: Array) -> Array:
        """The greys (k,) at `places` (k, 2) in m."""
        colours = self.colours(places)
        grey: Array = colours @ _GREY if self.is_coloured else colours[:, 0]
        return grey

    def colours(self, places: Array) -> Array:
        """Red, green and blue (k, 3) at `places` (k, 2) in m."""
        colours = np.empty((len(places), 3))
        colours[:] = self.colour
        for patch in self.patches:
            patch.paint(places, colours)
        return colours

    @property
    def is_coloured(self) -> bool:
        """Whether anything of it is given as red, green and blue."""
        return isinstance(self.colour, list) or any(
            isinstance(patch.colour, list) or patch.image is not None for patch in self.patches
        )

    @property
    def channels(self) -> tuple[str, ...]:
        """The names of its readings."""
        colours = COLOURS if self.is_coloured else ()
        return (self.name, *(f"{self.name}_{colour}" for colour in colours))

    def check(self) -> None:
        """ConfigError if a picture cannot be read."""
        for patch in self.patches:
            if patch.image is not None:
                picture(patch.image)


def floor_pixels(
    fields: Sequence[FieldKind], size: tuple[float, float], longest: int = 600
) -> NDArray[np.uint8] | None:
    """A picture (rows, columns, 3) of the first floor among `fields`, top row first.

    `size`: length and width of the arena in m; the longer side has `longest` pixels. None without a
    floor.
    """
    floor = next((field for field in fields if isinstance(field, FloorField)), None)
    if floor is None:
        return None
    pixel = max(size) / longest
    columns, rows = (max(1, round(side / pixel)) for side in size)
    x = ((np.arange(columns) + 0.5) / columns - 0.5) * size[0]
    y = (0.5 - (np.arange(rows) + 0.5) / rows) * size[1]
    colours = floor.colours(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    return np.round(255.0 * colours).astype(np.uint8).reshape(rows, columns, 3)


@lru_cache(maxsize=16)
def drawn_tiles(count: int, share: float, seed: int) -> NDArray[np.bool_]:
    """(count,) whether a tile has the colour: a random choice of round(share * count) tiles."""
    drawn = np.arange(count) < round(share * count)
    np.random.default_rng(seed).shuffle(drawn)
    drawn.flags.writeable = False
    return drawn


FORMATS = ("PNG", "JPEG", "BMP", "GIF", "PPM", "TIFF", "WEBP")
"""Formats that Pillow may detect in a file: for PostScript, Pillow would start Ghostscript."""


@lru_cache(maxsize=16)
def picture(path: str) -> Array:
    """The pixels (rows, columns, 3) of a picture, 0 to 1, the top row first.

    ConfigError if the file cannot be read or is too large. PluginError without Pillow.
    """
    try:
        from PIL import Image
    except ImportError as error:
        raise PluginError("a floor with a picture needs pillow; install swarmd[plot]") from error
    try:
        with open_regular(path) as file, Image.open(file, formats=FORMATS) as image:
            width, height = image.size
            if width * height > MAX_PIXELS:
                text = f"has {width} x {height} pixels; expected {MAX_PIXELS} at most"
                raise ConfigError(f"image {path!r} {text}")
            return np.asarray(image.convert("RGB"), dtype=np.float64) / 255.0
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise ConfigError(f"image {path!r} is no picture that can be read: {error}") from error
