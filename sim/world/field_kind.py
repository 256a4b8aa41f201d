"""What all kinds of fields have: a name, and the bounds of their numbers."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

Name = Annotated[
    str,
    Meta(
        pattern="^[A-Za-z_][A-Za-z0-9_]*$",
        max_length=63,
        extra_json_schema={"description": "up to 63 letters, digits and _"},
    ),
]
Level = Annotated[float, Meta(ge=-1e6, le=1e6)]
Coordinate = Annotated[float, Meta(ge=-10_000.0, le=10_000.0)]
Extent = Annotated[float, Meta(ge=0.001, le=10_000.0)]
Degrees = Annotated[float, Meta(ge=-360.0, le=360.0)]
Point = tuple[Coordinate, Coordinate]


class FieldKind(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind"):
    """A field by `name`, which is that of its reading."""

    name: Name
