"""The highest speed at which the outline may close on an obstacle: the caps of mode `barrier`.

Part of the unit of barrier.py. Units: m, s, rad.
"""

from __future__ import annotations

from swarmd.core.clock import TICK
from swarmd.core.cython_shadow import fabs, sqrt
from swarmd.robot.protection.comparisons import at_least

DECISION_PERIOD = TICK
"""s between two decisions, for which a command stands."""
CREEP_SPEED = 0.015
"""m/s: the highest speed of any corner in contact, where part of the obstacle may be unseen.

A robot may also creep at this speed towards an obstacle that stops any faster robot.
"""
WALL_MARGIN = 0.03
"""m before a wall that stands, beside all margins, within which the outline closes slowly."""
WALL_SPEED = 0.05
"""m/s at which the outline may close on a wall within WALL_MARGIN: noise would else stop a robot
that slides along the wall."""
MIN_BRAKING = 0.02
"""m/s2: the least braking assumed, for places that hardly close on an obstacle at any speed."""


def closing_cap(room: float, braking: float, unseen: float, others: float) -> float:
    """The highest closing speed in m/s from which the robot can stop in time.

    The speed s solves s * tick + s^2 / (2 b) + V (unseen + tick + s / b) = room. The first two
    terms are the way of the robot: a tick at this speed, then braking at the rate b. The third term
    is the way of the obstacle at the speed V, from its measurement until the robot stands. After
    the dynamic window with moving obstacles and "passive safety" (Mitsch, Ghorbal, Vogelbacher and
    Platzer, IJRR 2017).

    Args:
        room: m that robot and obstacle together may use: the gap less the distance that must stay
            free.
        braking: m/s2, b, at which the closing speed can fall.
        unseen: s since the obstacle was seen.
        others: m/s, V, at which the obstacle approaches.
    """
    # The positive root of s^2 + 2 half_slope s = 2 b room_left; 0 without room left.
    room_left = room - others * (unseen + DECISION_PERIOD)
    half_slope = braking * DECISION_PERIOD + others
    root = sqrt(half_slope * half_slope + 2.0 * braking * at_least(room_left, 0.0))
    return at_least(root - half_slope, 0.0)


def wall_cap(room: float, braking: float, unseen: float, error_speed: float) -> float:
    """As `closing_cap`, towards a wall that stands: slow within the last WALL_MARGIN m.

    `error_speed`: m/s at which the place of the wall may be wrong for each s of its age.
    """
    cap = closing_cap(room - WALL_MARGIN, braking, unseen, error_speed)
    if cap > WALL_SPEED:
        return cap
    cap = closing_cap(room, braking, unseen, error_speed)
    return WALL_SPEED if cap > WALL_SPEED else cap  # NaN stays NaN


def reciprocal_cap(room: float, braking: float, unseen: float) -> float:
    """The highest closing speed in m/s towards a robot that keeps the same rule.

    Each of the two robots may use half of the room. The equation is that of `closing_cap` with
    V = 0, half of the room, and a reaction time of two ticks plus `unseen`. After barrier
    certificates that share the distance (Wang, Ames and Egerstedt, IEEE T-RO 2017).
    """
    half_room = 0.5 * at_least(room, 0.0)
    half_slope = braking * (2.0 * DECISION_PERIOD + unseen)  # as in `closing_cap`
    root = sqrt(half_slope * half_slope + 2.0 * braking * half_room)
    return at_least(root - half_slope, 0.0)


def closing_deceleration(linear: float, lever: float, slowing: float, turning: float) -> float:
    """The rate in m/s2 at which the closing speed of a place of the outline can fall.

    `linear` (from -1 to 1) and `lever` in m: the closing speed per m/s of linear and per rad/s of
    angular speed. `slowing` in m/s2: the rate at which the linear speed can fall. `turning` in
    rad/s2: the rate at which the angular speed can fall.
    """
    braking = fabs(linear) * slowing
    braking += fabs(lever) * turning
    return at_least(braking, MIN_BRAKING)
