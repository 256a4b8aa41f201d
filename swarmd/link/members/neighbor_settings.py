"""The settings of a robot's neighborhood. No numpy: the schema of files needs them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from msgspec import Meta, Struct


class NeighborSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which robots are neighbors, so that a pattern gets their messages.

    - `neighborhood`: `all`: all robots. `range`: robots within `range` m, measured by hardware for
      range and bearing, or by poses in a shared frame. `link`: robots with a good radio link.
    - `range`: m between the axles. A robot whose distance is unknown for a second is no neighbor.
    - `quality`: with `link`, the share of a robot's beacons that must arrive, of its last 32.
    - `signal`: with `link`, the least signal strength in dBm, where the radio reports it, as
      `iw` does. For a robot whose signal is unknown, `quality` alone counts.
    - `programs`: whether a pattern gets the messages of Zenoh programs, too.
    """

    neighborhood: Literal["all", "range", "link"] = "all"
    range: Annotated[float, Meta(ge=0.01, le=100_000.0)] | None = None
    quality: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.8
    signal: Annotated[float, Meta(ge=-120.0, le=0.0)] | None = None
    programs: bool = True

    def faults(self) -> Iterator[tuple[str, str]]:
        """The keys that contradict `neighborhood`, each with the text of the fault."""
        if self.neighborhood == "range" and self.range is None:
            yield "range", "is missing; neighborhood: range wants one in m"
        if self.neighborhood != "range" and self.range is not None:
            text = f"is {self.range:g}, but neighborhood is {self.neighborhood}; set it to range"
            yield "range", text
        if self.neighborhood != "link" and self.signal is not None:
            text = f"is {self.signal:g}, but neighborhood is {self.neighborhood}; set it to link"
            yield "signal", text
