"""The keys of `swarmctl drive`, and what it says. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

from swarmd.core.messages import Reason, State

if TYPE_CHECKING:
    from swarmd.core.messages import Status

HELP = (
    "arrows or w a s d drive, + and - set the speed, space stands;"
    " Enter releases, x stops robot and run, q leaves"
)
SLOWEST = 0.02  # m/s
FASTEST = 1.0  # m/s
STEP = 1.25  # factor of + and -
TURN = 5.0  # rad/s of a turn for each m/s: 0.5 rad/s at 0.1 m/s
MAX_TURN = 1.5  # rad/s


class Key(Enum):
    """What a key asks."""

    FORWARD = "forward"
    BACK = "back"
    LEFT = "left"
    RIGHT = "right"
    STAND = "stand"
    FASTER = "faster"
    SLOWER = "slower"
    RELEASE = "release"
    STOP = "stop"
    LEAVE = "leave"


_ESCAPES = {b"A": Key.FORWARD, b"B": Key.BACK, b"C": Key.RIGHT, b"D": Key.LEFT}
_KEYS = {
    b"w": Key.FORWARD,
    b"s": Key.BACK,
    b"a": Key.LEFT,
    b"d": Key.RIGHT,
    b" ": Key.STAND,
    b"+": Key.FASTER,
    b"=": Key.FASTER,
    b"-": Key.SLOWER,
    b"\r": Key.RELEASE,
    b"\n": Key.RELEASE,
    b"x": Key.STOP,
    b"q": Key.LEAVE,
    b"\x03": Key.LEAVE,
    b"\x04": Key.LEAVE,
}
_DIRECTIONS = {
    Key.FORWARD: (1.0, 0.0),
    Key.BACK: (-1.0, 0.0),
    Key.LEFT: (0.0, 1.0),
    Key.RIGHT: (0.0, -1.0),
}


class Motion(NamedTuple):
    """m/s ahead, and rad/s to the left."""

    forward: float
    turn: float


def keys_of(data: bytes) -> Iterator[Key]:
    """The keys in what a terminal sent, in order; others are left out.

    `[*keys_of(b"w\\x1b[D")] == [Key.FORWARD, Key.LEFT]`
    """
    at = 0
    while at < len(data):
        is_escape = data[at : at + 2] in (b"\x1b[", b"\x1bO")
        code = data[at + 2 : at + 3] if is_escape else data[at : at + 1].lower()
        key = (_ESCAPES if is_escape else _KEYS).get(code)
        at += 3 if is_escape else 1
        if key is not None:
            yield key


def motion_of(key: Key, speed: float) -> Motion | None:
    """The motion that a key asks at a speed in m/s; None for a key that asks none."""
    if key is Key.STAND:
        return Motion(0.0, 0.0)
    direction = _DIRECTIONS.get(key)
    if direction is None:
        return None
    forward, turn = direction
    return Motion(forward * speed, turn * min(TURN * speed, MAX_TURN))


def speed_after(key: Key, speed: float) -> float:
    """The speed in m/s after a key."""
    if key is Key.FASTER:
        return min(speed * STEP, FASTEST)
    if key is Key.SLOWER:
        return max(speed / STEP, SLOWEST)
    return speed


def line_of(robot: str, status: Status | None, speed: float) -> str:
    """One line: who drives, what the base is commanded, and why it does not do what is asked."""
    if status is None:
        return f"{robot}: taken; {speed:.2f} m/s"
    decision = status.decision
    parts = [
        f"{robot}: {speed:.2f} m/s",
        f"does {decision.safe_linear:.2f} m/s, {decision.safe_angular:.2f} rad/s",
        _limit_of(status),
    ]
    if status.state is State.RUNNING:
        parts.append(f"{status.pattern} waits")
    return "; ".join(filter(None, parts))


def _limit_of(status: Status) -> str:
    """Why the base does not do what the hand asks; empty if it does."""
    if status.reason is Reason.NO_REQUESTED_COMMAND or not status.driven_by:
        return ""
    if status.reason is Reason.PROTECTION or (status.reason is None and status.decision.is_active):
        gap = status.decision.min_gap
        return "protection limits it" + ("" if gap is None else f", {gap:.2f} m to the nearest")
    return "" if status.reason is None else f"held: {status.reason} {status.detail}".rstrip()
