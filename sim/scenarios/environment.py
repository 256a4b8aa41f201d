"""The environment of a scenario: arena, fields and radio."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, get_args

from swarmd.core.errors import ConfigError, PluginError, unknown
from swarmd.settings.layered import Keys, Layered, dotted
from swarmd.sim.scenarios.schema import ArenaSection
from swarmd.sim.world.arena import Arena, Box, Pole, Segment
from swarmd.sim.world.floor import FloorField
from swarmd.sim.world.item_kind import DELIVERED, HELD, ItemKind
from swarmd.sim.world.scalar_fields import Field


@contextmanager
def blamed(layers: Layered, *keys: str | int, prefix: str = "") -> Iterator[None]:
    """Add the file or option that gives the keys to a ConfigError or PluginError raised within."""
    try:
        yield
    except (ConfigError, PluginError) as error:
        raise layers.error(keys, f"{prefix}{error}") from error


def arena_of(
    layers: Layered,
    section: ArenaSection,
    items: Sequence[ItemKind] = (),
    fields: Sequence[Field] = (),
) -> Arena:
    """The arena of the file's section `arena`, with the items of the section `items`.

    `layers`: the file and its overrides, which an error names as the source of the faulty key.
    ConfigError for duplicate names, for places outside the walls, and if a reading of items has the
    name of a reading of fields.
    """
    _check_readings(layers, items, fields)
    _check_places(layers, section, items)
    boxes = tuple(
        Box(
            *(box.at or (0.0, 0.0)),
            *box.size,
            math.radians(box.yaw_deg),
            box.name,
            box.mass,
            is_placed=box.at is not None,
        )
        for box in section.boxes
    )
    # A ConfigError of `Arena` is about its boxes, such as duplicate names.
    with blamed(layers, "arena", "boxes", prefix="arena.boxes: "):
        return Arena(
            *section.size,
            boxes=boxes,
            poles=tuple(Pole(*pole.at, pole.radius) for pole in section.poles),
            segments=tuple(Segment(*wall.start, *wall.end) for wall in section.segments),
            items=tuple(item for kind in items for item in kind.things),
        )


def _check_places(layers: Layered, section: ArenaSection, items: Sequence[ItemKind]) -> None:
    """Raise ConfigError for a place outside the walls, and for a wall without length."""
    for index, kind in enumerate(items):
        areas = [disc[:2] for disc in (kind.source, kind.nest) if disc is not None]
        for place in (*areas, *kind.at):
            check_inside(layers, section, ("items", index), place)
    for index, box in enumerate(section.boxes):
        if box.at is not None:
            check_inside(layers, section, ("arena", "boxes", index, "at"), box.at)
    for index, pole in enumerate(section.poles):
        check_inside(layers, section, ("arena", "poles", index, "at"), pole.at)
    for index, wall in enumerate(section.segments):
        keys: Keys = ("arena", "segments", index)
        check_inside(layers, section, (*keys, "from"), wall.start)
        check_inside(layers, section, (*keys, "to"), wall.end)
        if wall.start == wall.end:
            text = f"{dotted(keys)} begins and ends at {list(wall.start)}; expected two points"
            raise layers.error(keys, text)


def _check_readings(layers: Layered, items: Sequence[ItemKind], fields: Sequence[Field]) -> None:
    """Raise ConfigError if a kind of items gives a reading that exists already."""
    taken = {HELD, DELIVERED}
    field_names = {field.name for field in fields}
    for index, kind in enumerate(items):
        readings = kind.readings[:3]  # the others are HELD and DELIVERED, common to all kinds
        for reading in readings:
            if reading in taken or {reading, _sensor_of(reading)} & field_names:
                text = f"items[{index}].name gives a reading {reading!r} a second time"
                raise layers.error(("items", index, "name"), f"{text}; expected another name")
        taken.update(readings)


def _sensor_of(reading: str) -> str:
    """The name of the field of a reading `<field>_<number>` of one sensor; else empty."""
    name, _, number = reading.rpartition("_")
    return name if number.isdigit() else ""


def check_inside(
    layers: Layered, section: ArenaSection, keys: Keys, place: Sequence[float]
) -> None:
    """Raise ConfigError if the place, x and y in m, is outside the walls."""
    x = section.size[0] / 2.0
    y = section.size[1] / 2.0
    if abs(place[0]) > x or abs(place[1]) > y:
        text = f"{dotted(keys)} is {list(place)}; expected within the walls"
        raise layers.error(keys, f"{text}, x up to {x:g} and y up to {y:g} either way")


def fields_of(
    layers: Layered, sections: Sequence[Mapping[str, Any]], keys: Keys = ("fields",)
) -> tuple[Field, ...]:
    """The fields of the section `keys`; ConfigError for the first invalid one."""
    kinds = {kind.__struct_config__.tag: kind for kind in get_args(Field)}
    fields: list[Field] = []
    for index, section in enumerate(sections):
        at = (*keys, index)
        # `<file>: fields[0]`
        where = str(layers.error(at, dotted(at)))
        data = dict(section)
        kind = str(data.pop("kind", ""))
        if kind not in kinds:
            raise ConfigError(f"{where}.kind: {unknown('kind of field', kind, kinds)}")
        field: Field = Layered((where, data)).build(kinds[kind])
        if isinstance(field, FloorField):
            with blamed(layers, *at, prefix=f"{dotted(at)}: "):
                field.check()
        fields.append(field)
    return tuple(fields)
