"""The zone in which a pattern may touch obstacles: directions, and a speed. Pure.

A pattern declares a zone and the robot's configuration grants a zone; their intersection is in
effect. No request from the network changes the zone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from swarmd.core.angles import difference, wrap
from swarmd.core.errors import PluginError
from swarmd.core.values import TouchZone
from swarmd.kit.touch_config import (
    MAX_TOUCH_HALF_WIDTH_DEG,
    MAX_TOUCH_SPEED,
    TouchGrants,
    TouchSection,
)


def granted_zones(touch: TouchGrants) -> Mapping[str, TouchZone]:
    """The granted zones by pattern."""
    return {name: _zone(section) for name, section in touch.items() if section is not None}


def check_zone(pattern: str, zone: object) -> None:
    """PluginError if a pattern declares a zone that no configuration can grant."""
    if zone is None:
        return
    if not isinstance(zone, TouchZone):
        raise PluginError(f"pattern {pattern!r}: touches is {zone!r}; expected a TouchZone or None")
    limit = math.radians(MAX_TOUCH_HALF_WIDTH_DEG)
    is_sound = (
        math.isfinite(zone.bearing)
        and 0.0 < zone.half_width <= limit
        and 0.0 < zone.speed <= MAX_TOUCH_SPEED
    )
    if not is_sound:
        raise PluginError(
            f"pattern {pattern!r}: touches is {zone!r}; expected a bearing in rad, a half_width "
            f"above 0 and up to {limit:.3f} rad and a speed above 0 and up to "
            f"{MAX_TOUCH_SPEED:g} m/s"
        )


def intersection(asked: TouchZone, granted: TouchZone) -> TouchZone | None:
    """The zone of the directions that lie in both zones, at the lower speed; None without any.

    The result lies within `granted` for every `asked`.
    """
    aside = difference(asked.bearing, granted.bearing)
    low = max(aside - asked.half_width, -granted.half_width)
    high = min(aside + asked.half_width, granted.half_width)
    speed = min(asked.speed, granted.speed)
    if not (high > low and speed > 0.0):
        return None
    return TouchZone(wrap(granted.bearing + 0.5 * (low + high)), 0.5 * (high - low), speed)


def effective_zone(
    pattern: str, asked: TouchZone | None, granted: TouchZone | None
) -> tuple[TouchZone | None, str]:
    """The zone in which a pattern may touch, and a line about the zone; "" without a request."""
    if asked is None:
        return None, ""
    if granted is None:
        text = f"asks to touch {describe_zone(asked)}, which is not granted: protection prevents it"
        where = f"`touch: {{{pattern}: ...}}` in the robot's configuration grants it"
        return None, f"{text}; {where}"
    zone = intersection(asked, granted)
    if zone is None:
        text = f"asks to touch {describe_zone(asked)}, but granted is {describe_zone(granted)}"
        return None, f"{text}: protection prevents both"
    return zone, f"may touch: {describe_zone(zone)}"


def describe_zone(zone: TouchZone) -> str:
    """A zone in words, such as `+-20 deg ahead at up to 0.10 m/s`."""
    bearing = round(math.degrees(wrap(zone.bearing)))
    where = {0: "ahead", 180: "behind", -180: "behind"}.get(bearing, f"around {bearing} deg")
    return f"+-{math.degrees(zone.half_width):.0f} deg {where} at up to {zone.speed:.2f} m/s"


def _zone(section: TouchSection) -> TouchZone:
    bearing = math.radians(section.bearing_deg)
    half_width = math.radians(section.half_width_deg)
    return TouchZone(bearing, half_width, section.speed)
