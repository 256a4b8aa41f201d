"""What a robot's configuration grants to a pattern beyond what every pattern may.

No numpy here: swarmctl reads swarm.yaml too.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

MAX_TOUCH_SPEED = 0.3  # m/s: a nudge, not a ram
MAX_TOUCH_HALF_WIDTH_DEG = 60.0


class TouchSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """In which directions a pattern may press against what is near, and how fast in m/s."""

    bearing_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] = 0.0
    half_width_deg: Annotated[float, Meta(gt=0.0, le=MAX_TOUCH_HALF_WIDTH_DEG)]
    speed: Annotated[float, Meta(gt=0.0, le=MAX_TOUCH_SPEED)]


# By pattern; None takes away what a weaker source grants.
TouchGrants = dict[str, TouchSection | None]
