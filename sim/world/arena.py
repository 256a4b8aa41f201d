"""Arenas: a walled rectangle around the origin, with boxes, poles and inner walls in it."""

from __future__ import annotations

import math
import re
from dataclasses import astuple, dataclass

import numpy as np

from swarmd.core.errors import ConfigError
from swarmd.core.keys import check_id
from swarmd.core.numbers import finite_number
from swarmd.core.values import Array
from swarmd.sim.world.geometry import transform

MIN_MASS = 0.001
MAX_MASS = 1e6
"""kg of a movable box; the heaviest is as immovable as a wall."""

_WANTED = (
    "expected a value such as 6x6, 6.6x4.8 or 6x6,box:1:0:0.5:0.3:45,pole:-1:2:0.1,segment:0:1:2:1"
)
_SIZE = re.compile(r"([0-9.]+)x([0-9.]+)")
_THICKNESS = 0.01
_CORNERS_OF_A_POLE = 16


@dataclass(frozen=True, slots=True)
class Box:
    """A box as high as the walls: centre and side lengths in m, yaw in rad.

    A box with a `mass` in kg is movable: it starts at this pose and slides on the floor when
    pushed. `is_placed` False: the movable box is not in the arena at first. Contacts name a box
    `box/<name>`, or `box/<index>` without a name.
    """

    x: float
    y: float
    length: float
    width: float
    yaw: float = 0.0
    name: str = ""
    mass: float | None = None
    is_placed: bool = True

    @property
    def shape(self) -> Array:
        """The corners (4, 2) in the box's own frame, counter-clockwise, in m."""
        half = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) / 2.0
        return half * (self.length, self.width)

    @property
    def corners(self) -> Array:
        """The corners (4, 2) in the arena, counter-clockwise, in m."""
        return transform(self.shape, np.array([self.x, self.y, self.yaw]))


@dataclass(frozen=True, slots=True)
class Item:
    """A low object on the floor: centre and size in m; it blocks no lidar, lamp or radio.

    With a `mass` in kg the item is a round puck, without a mass it is flat.
    """

    x: float
    y: float
    size: float
    name: str
    mass: float | None = None

    @property
    def shape(self) -> Array:
        """The corners (4, 2) of the square around it, counter-clockwise, in m."""
        return Box(0.0, 0.0, self.size, self.size).shape


@dataclass(frozen=True, slots=True)
class Pole:
    """A fixed round pole: centre and radius in m; as high as the walls."""

    x: float
    y: float
    radius: float

    @property
    def corners(self) -> Array:
        """The corners (16, 2) of a regular polygon around it, in m."""
        angle = 2.0 * math.pi * np.arange(_CORNERS_OF_A_POLE) / _CORNERS_OF_A_POLE
        reach = self.radius / math.cos(math.pi / _CORNERS_OF_A_POLE)
        away = reach * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
        return np.array([self.x, self.y]) + away


@dataclass(frozen=True, slots=True)
class Segment:
    """A thin inner wall, 1 cm thick, around the line between two points in m."""

    x1: float
    y1: float
    x2: float
    y2: float

    @property
    def box(self) -> Box:
        """The segment as a box."""
        x = self.x2 - self.x1
        y = self.y2 - self.y1
        middle = (self.x1 + self.x2) / 2.0, (self.y1 + self.y2) / 2.0
        return Box(*middle, math.hypot(x, y), _THICKNESS, math.atan2(y, x))

    @property
    def corners(self) -> Array:
        """The corners (4, 2), counter-clockwise, in m."""
        return self.box.corners


@dataclass(frozen=True, slots=True)
class Arena:
    """The space between four walls, `length` m along x and `width` m along y.

    Raises ConfigError for duplicate or invalid box names and for masses out of bounds.
    """

    length: float
    width: float
    boxes: tuple[Box, ...] = ()
    poles: tuple[Pole, ...] = ()
    segments: tuple[Segment, ...] = ()
    items: tuple[Item, ...] = ()

    def __post_init__(self) -> None:
        known = set[str]()
        for name in (*(name for name, _ in self.named_boxes), *(item.name for item in self.items)):
            check_id(name, "box name")
            if name in known:
                raise ConfigError(f"arena has two boxes named {name!r}; every box needs its own")
            known.add(name)
        for name, box in self.named_boxes:
            if box.mass is None and not box.is_placed:
                raise ConfigError(f"box {name} is not in the arena and has no mass; give it one")
            if box.mass is not None and not MIN_MASS <= box.mass <= MAX_MASS:
                raise ConfigError(
                    f"box {name} has a mass of {box.mass:g} kg;"
                    f" expected {MIN_MASS:g} to {MAX_MASS:g} kg"
                )

    @property
    def named_boxes(self) -> tuple[tuple[str, Box], ...]:
        """Every box with its name; without a name, with its index."""
        return tuple((box.name or str(index), box) for index, box in enumerate(self.boxes))

    @property
    def movable_boxes(self) -> tuple[tuple[str, Box], ...]:
        """The movable boxes with their names."""
        return tuple((name, box) for name, box in self.named_boxes if box.mass is not None)

    @property
    def fixed(self) -> tuple[tuple[str, Box], ...]:
        """Fixed boxes and segments with their names in contacts, without the outer walls."""
        boxes = [(f"box/{name}", box) for name, box in self.named_boxes if box.mass is None]
        inner = [(f"segment/{index}", wall.box) for index, wall in enumerate(self.segments)]
        return (*boxes, *inner)

    @property
    def surfaces(self) -> Array:
        """Every fixed flat surface as (k, 2, 2) start and end in m, with the solid on its left."""
        x = self.length / 2.0
        y = self.width / 2.0
        walls = np.array([[-x, -y], [-x, y], [x, y], [x, -y]])
        loops = [walls, *(box.corners for _, box in self.fixed)]
        return np.concatenate(
            [np.stack((loop, np.roll(loop, -1, axis=0)), axis=1) for loop in loops]
        )

    @property
    def circles(self) -> Array:
        """Every pole as (k, 3) x, y and radius in m."""
        return np.array([[p.x, p.y, p.radius] for p in self.poles]).reshape(-1, 3)

    @property
    def text(self) -> str:
        """The text from which `parse_arena` makes the same arena."""
        words = [f"{_text(self.length)}x{_text(self.width)}"]
        words += [_box_text(box) for box in self.boxes]
        words += [":".join(("pole", *map(_text, astuple(pole)))) for pole in self.poles]
        words += [":".join(("segment", *map(_text, astuple(wall)))) for wall in self.segments]
        words += [_item_text(item) for item in self.items]
        return ",".join(words)


def _box_text(box: Box) -> str:
    words = [f"box/{box.name}" if box.name else "box"]
    words += [_text(value) for value in (box.x, box.y, box.length, box.width)]
    if box.yaw or box.mass is not None:
        words.append(_degrees(box.yaw))
    if box.mass is not None:
        words.append(_text(box.mass))
    if not box.is_placed:
        words.append("out")
    return ":".join(words)


def _item_text(item: Item) -> str:
    values = (item.x, item.y, item.size, *(() if item.mass is None else (item.mass,)))
    return ":".join((f"item/{item.name}", *map(_text, values)))


def _degrees(yaw: float) -> str:
    """In degrees; in rad if no number of degrees converts to exactly this yaw."""
    for degrees in (round(math.degrees(yaw), 9), math.degrees(yaw)):
        if math.radians(degrees) == yaw:
            return _text(degrees)
    return f"{_text(yaw)}rad"


def _text(value: float) -> str:
    short = f"{value:.12g}"
    return short if float(short) == value else repr(float(value))


def parse_arena(text: str) -> Arena:
    """Parse an arena of the command line; raises ConfigError.

    `LxW` in m, then any number of these parts, with lengths in m:

    - `,box:x:y:length:width:yaw_deg:mass`. Yaw and mass may be left out; a box without a mass in kg
      is fixed. `:out` after the mass leaves the box out of the arena at first.
    - `,box/NAME:...`: the same with a name.
    - `,pole:x:y:radius` and `,segment:x1:y1:x2:y2`.
    - `,item/NAME:x:y:size:mass`. The mass may be left out.
    """
    try:
        return _parsed(text)
    except _TextError as error:
        raise ConfigError(f"arena {text!r}: {error}; {_WANTED}") from error


class _TextError(ValueError):
    pass


def _parsed(text: str) -> Arena:
    """The arena of a text in the form of `parse_arena`; _TextError names the part that is wrong."""
    size, *parts = text.split(",")
    match = _SIZE.fullmatch(size)
    if match is None:
        raise _TextError(f"{size!r} is no length and width")
    boxes = list[Box]()
    poles = list[Pole]()
    segments = list[Segment]()
    items = list[Item]()
    for part in parts:
        head, *words = part.split(":")
        kind, _, name = head.partition("/")
        if kind == "box" and 4 <= len(words) <= 7:
            boxes.append(_box(name, words))
        elif kind == "item" and 3 <= len(words) <= 4:
            x, y, side, *mass = map(_number, words)
            items.append(Item(x, y, _size(side), name, *mass))
        elif head == "pole" and len(words) == 3:  # poles and segments have no name
            x, y, radius = map(_number, words)
            poles.append(Pole(x, y, _size(radius)))
        elif head == "segment" and len(words) == 4:
            segment = Segment(*map(_number, words))
            _size(segment.box.length)  # _TextError for a segment without length
            segments.append(segment)
        else:
            raise _TextError(f"{part!r} is not a valid box, pole, segment or item")
    length, width = (_size(_number(word)) for word in match.groups())
    return Arena(length, width, tuple(boxes), tuple(poles), tuple(segments), tuple(items))


def _box(name: str, words: list[str]) -> Box:
    is_out = len(words) == 7
    if is_out and words.pop() != "out":
        raise _TextError("after a box's mass only 'out' may follow")
    x, y, length, width = map(_number, words[:4])
    yaw = 0.0
    if len(words) > 4:
        word = words[4].removesuffix("rad")
        yaw = _number(word) if word != words[4] else math.radians(_number(word))
    mass = _number(words[5]) if len(words) > 5 else None
    return Box(x, y, _size(length), _size(width), yaw, name, mass, is_placed=not is_out)


def _number(word: str) -> float:
    value = finite_number(word)
    if math.isnan(value):
        raise _TextError(f"{word!r} is no number")
    return value


def _size(value: float) -> float:
    if not 0.01 <= value <= 10_000.0:
        raise _TextError(f"a size is {value:g} m; possible are 0.01 to 10000 m")
    return value
