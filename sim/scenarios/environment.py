"""The environment of a scenario: arena, fields and radio."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, get_args

from swarmd.core.errors import ConfigError, unknown
from swarmd.settings.layered import Keys, Layered, dotted
from swarmd.sim.scenarios.schema import ArenaSection, BoxSection, Point
from swarmd.sim.world.arena import Arena, Box, Pole, Segment
from swarmd.sim.world.radio import RadioSettings, check_radio
from swarmd.sim.world.scalar_fields import Field


def arena_of(layers: Layered, section: ArenaSection) -> Arena:
    """The arena; ConfigError for duplicate box names and for places outside the walls."""
    boxes = [(index, box.at) for index, box in enumerate(section.boxes) if box.at is not None]
    for index, place in boxes:
        check_inside(layers, section, ("arena", "boxes", index, "at"), place)
    for index, pole in enumerate(section.poles):
        check_inside(layers, section, ("arena", "poles", index, "at"), pole.at)
    for index, wall in enumerate(section.segments):
        check_inside(layers, section, ("arena", "segments", index, "from"), wall.start)
        check_inside(layers, section, ("arena", "segments", index, "to"), wall.end)
        if wall.start == wall.end:
            raise layers.error(
                ("arena", "segments", index),
                f"arena.segments[{index}] begins and ends at {list(wall.start)}; wanted two points",
            )
    try:
        return Arena(
            *section.size,
            boxes=tuple(_box(box) for box in section.boxes),
            poles=tuple(Pole(*pole.at, pole.radius) for pole in section.poles),
            segments=tuple(Segment(*wall.start, *wall.end) for wall in section.segments),
        )
    except ConfigError as error:
        raise layers.error(("arena", "boxes"), f"arena.boxes: {error}") from error


def check_inside(
    layers: Layered, section: ArenaSection, keys: Keys, place: Sequence[float]
) -> None:
    """Raise ConfigError if the place, x and y in m, is outside the walls."""
    half: Point = (section.size[0] / 2.0, section.size[1] / 2.0)
    if abs(place[0]) > half[0] or abs(place[1]) > half[1]:
        text = f"{dotted(keys)} is {list(place)}; wanted within the walls"
        raise layers.error(keys, f"{text}, x up to {half[0]:g} and y up to {half[1]:g} either way")


def fields_of(layers: Layered, sections: Sequence[Mapping[str, Any]]) -> tuple[Field, ...]:
    """The fields; ConfigError for the first invalid one."""
    return tuple(_field(layers, index, dict(data)) for index, data in enumerate(sections))


def check_radio_section(layers: Layered, radio: RadioSettings) -> None:
    """Raise ConfigError if the settings of the radio contradict each other."""
    try:
        check_radio(radio)
    except ConfigError as error:
        raise layers.error(("radio",), str(error)) from error


def _box(box: BoxSection) -> Box:
    yaw, is_placed = math.radians(box.yaw_deg), box.at is not None
    return Box(*(box.at or (0.0, 0.0)), *box.size, yaw, box.name, box.mass, is_placed)


def _field(layers: Layered, index: int, data: dict[str, Any]) -> Field:
    kinds = {kind.__struct_config__.tag: kind for kind in get_args(Field)}
    keys, key = ("fields", index), f"fields[{index}]"
    if "kind" not in data:
        text = f"{key}.kind is missing; wanted {' or '.join(kinds)}"
        raise layers.error(keys, text)
    kind = str(data.pop("kind"))
    if kind not in kinds:
        raise layers.error(keys, f"{key}: {unknown('kind of field', kind, kinds)}")
    name = data.get("name", "")
    if isinstance(name, str) and name and not name.isidentifier():
        raise layers.error(keys, f"{key}.name is {name!r}; wanted letters, digits and _")
    field: Field = Layered((str(layers.error(keys, key)), data)).build(kinds[kind])
    return field
