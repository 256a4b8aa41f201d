"""Kinds of items on the floor: their places, and the readings that robots have of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

from msgspec import Meta, Struct

from swarmd.core.values import Platform
from swarmd.sim.world.arena import Item
from swarmd.sim.world.field_kind import Coordinate, Extent, Name, Point

HELD = "held"
DELIVERED = "delivered"
"""Readings of a robot: 1 while it holds an item; the items that it has dropped in a nest."""
Disc = tuple[Coordinate, Coordinate, Extent]
_MOST = 10_000


class ItemKind(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Items of one kind: `count` items at random in the disc `source`, or an item at each of `at`.

    Discs are x, y, radius in m. A robot has three readings of the items within `range` m: their
    number `<name>`, and the nearest item's `<name>_distance` and `<name>_bearing`, which are 0
    without an item.

    Without a `mass` in kg an item is flat: robots drive over the item, and grippers pick it up. A
    flat item that is dropped in the disc `nest` is delivered, and reappears in `source`. With a
    mass an item is a round puck of diameter `size` m, which robots push.
    """

    name: Name
    count: Annotated[int, Meta(ge=1, le=_MOST)] | None = None
    at: Annotated[list[Point], Meta(max_length=_MOST)] = []
    source: Disc | None = None
    nest: Disc | None = None
    range: Extent = 0.6
    size: Annotated[float, Meta(ge=0.01, le=10.0)] = 0.05
    mass: Annotated[float, Meta(ge=0.001, le=1000.0)] | None = None

    def __post_init__(self) -> None:
        """Check that the items have places, and that no puck has a nest."""
        if (self.count is None) != bool(self.at):
            raise ValueError("has not one of count and at; expected count, or the places at")
        if self.source is None and (self.count is not None or self.nest is not None):
            raise ValueError("has no source; expected x, y, radius of the disc where they appear")
        if self.nest is not None and self.mass is not None:
            raise ValueError("has both a nest and a mass; a gripper takes no puck: leave one out")

    @property
    def things(self) -> tuple[Item, ...]:
        """The items as parts of an arena; those of a `count` have no places yet."""
        places = self.at or [(0.0, 0.0)] * (self.count or 0)
        digits = len(str(len(places)))
        return tuple(
            Item(x, y, self.size, f"{self.name}-{number:0{digits}}", self.mass)
            for number, (x, y) in enumerate(places, start=1)
        )

    @property
    def readings(self) -> tuple[str, ...]:
        """The names of the readings of these items."""
        own = (self.name, f"{self.name}_distance", f"{self.name}_bearing")
        return own if self.mass is not None else (*own, HELD, DELIVERED)


def with_items(platform: Platform, kinds: Sequence[ItemKind]) -> Platform:
    """The platform with the readings of items."""
    words = {f"reading:{name}" for kind in kinds for name in kind.readings}
    return replace(platform, provides=platform.provides | words)
