"""Hazards that a base reports: their kinds, and their places on the base."""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct


class HazardKind(StrEnum):
    """The kinds of hazard; `robot/hazard_holds.py` has the hold of each kind and its end."""

    BUMP = "bump"  # the bumper is pressed
    CLIFF = "cliff"  # no floor below a sensor
    STALL = "stall"  # the motors drive, and the wheels do not turn
    WHEEL_DROP = "wheel_drop"  # a wheel hangs out of its well
    LIFTED = "lifted"  # the base does not stand on the floor: a person carries it
    NOT_HEARD = "not_heard"  # the source is silent: a hazard may be there


ENDS_RUN = frozenset({HazardKind.WHEEL_DROP, HazardKind.LIFTED})
"""Kinds that end the run: a person holds the robot, which must stand when it is put down."""


class Hazard(Struct, frozen=True, array_like=True):
    """A present hazard. `place`: where on the base, such as `front left`; empty if unknown.

    For NOT_HEARD, `place` names the silent source, such as a topic.
    """

    kind: HazardKind
    place: str = ""

    @property
    def text(self) -> str:
        """The hazard in words, such as `bump front left`."""
        return f"{self.kind.replace('_', ' ')} {self.place}".rstrip()
