"""When a decision is taken, and what the pattern in force may do.

What the arbiter decided, and on what grounds.
"""

from __future__ import annotations

from msgspec import Struct

from swarmd.core.messages import Reason, Row
from swarmd.core.values import Odometry, TouchZone, Twist


class DecisionContext(Struct, frozen=True):
    """The time of a decision in s on the robot's clock, and how old what it rests on is then.

    `scan_age` and `odometry_age` in s since they arrived; None: never.
    """

    now: float
    scan_age: float | None = None
    odometry: Odometry | None = None
    odometry_age: float | None = None


class Permit(Struct, frozen=True):
    """What the running pattern may: be helped when it is stuck, and touch things, where granted."""

    may_recover: bool = False
    touch: TouchZone | None = None


NO_PERMIT = Permit()


__all__ = ["Decision", "ModeDecision", "Row"]


class ModeDecision(Struct, frozen=True):
    """An arbiter's answer to a wish; `is_active` if the wish did not pass as it was."""

    twist: Twist
    is_active: bool
    rows: tuple[Row, ...] = ()


class Decision(Struct, frozen=True):
    """A decision with its grounds.

    `wish` is within the platform's limits, `safe` is what the driver gets. `reason` is the hold
    that zeroed the command, or why the robot stands although it runs; None while it moves, and
    outside `running`. `min_gap` in m from the footprint to the nearest return (None: nothing
    seen), `scan_age` in s (None: no scan yet), `scan_seq` -1 without a scan. `is_recovering`: what
    was judged is not the wish but a way around what blocks it. `rows`: what bounds the command,
    the tightest first.
    """

    mode: str
    requested: Twist
    safe: Twist
    reason: Reason | None
    is_active: bool
    rows: tuple[Row, ...]
    min_gap: float | None
    scan_age: float | None
    scan_seq: int
    is_recovering: bool = False
