"""The zones in which a robot's configuration allows patterns to touch obstacles.

Imports no numpy, since swarmctl reads swarm.yaml, too.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

MAX_TOUCH_SPEED = 0.3  # m/s: a nudge, not a ram
MAX_TOUCH_HALF_WIDTH_DEG = 60.0


class TouchSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The directions in which a pattern may press against obstacles, and its speed in m/s.

    A wider zone or a higher speed lets a faulty pattern push harder and more often.

    - `bearing_deg`: the center of the directions, 0 ahead, 90 to the left.
    - `half_width_deg`: half the width of the zone.
    - `speed`: the highest speed in these directions while the pattern runs.
    """

    bearing_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] = 0.0
    half_width_deg: Annotated[float, Meta(gt=0.0, le=MAX_TOUCH_HALF_WIDTH_DEG)]
    speed: Annotated[float, Meta(gt=0.0, le=MAX_TOUCH_SPEED)]


TouchGrants = dict[str, TouchSection | None]
"""By pattern; None revokes the grant of a weaker source."""
