"""What steering leads a robot past: a moving object, or an opening before which it gives way."""

from __future__ import annotations

import math
from enum import Enum

from msgspec import Struct


class WayState(Enum):
    """The state of right of way before an opening; right_of_way.py has the transitions."""

    NONE = ""  # no opening on the way
    GO = "go"  # drives to the place at which it lines up
    APPROACH = "approach"  # lined up before that place
    LINE = "line"  # lined up, drives into the opening
    WAIT = "wait"  # stands for others
    ASIDE = "aside"  # clears the way of others
    IN = "in"  # in the opening
    BACK = "back"  # backs out


_AT_OPENING = {
    WayState.GO: "drives to an opening",
    WayState.APPROACH: "drives to an opening",
    WayState.LINE: "drives to an opening",
    WayState.WAIT: "gives way at an opening",
    WayState.ASIDE: "gives way at an opening",
    WayState.IN: "passes an opening",
    WayState.BACK: "backs out of an opening",
}


class Avoided(Struct, frozen=True):
    """The object that avoidance leads the robot past, or the opening that the robot is to pass."""

    bearing: float
    """rad, of the middle"""
    distance: float
    """m, from the axle to the middle"""
    way: WayState = WayState.NONE
    """The state before an opening; NONE for an object."""

    @property
    def text(self) -> str:
        """Such as `avoiding an object at -30 deg` or `gives way at an opening, 0.8 m`."""
        if self.way is WayState.NONE:
            return f"avoiding an object at {round(math.degrees(self.bearing))} deg"
        text = _AT_OPENING[self.way]
        is_inside = self.way in (WayState.IN, WayState.BACK)
        return text if is_inside else f"{text}, {self.distance:.1f} m"
