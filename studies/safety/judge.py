"""Collisions of a trace and the robot at fault, from MuJoCo's contacts and not from protection.

A collision is a contact of two robots, at least one of them protected. A contact counts once for
each second that it lasts. A protected robot is at fault if its own surface moved towards the other
robot at more than 2 cm/s. A resting robot that is rammed is not at fault. A robot that moves
although its command has been zero for half a second is pushed and not at fault; such collisions are
counted separately.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np
from msgspec import Struct

from swarmd.core.values import Array
from swarmd.sim.metrics.contacts import WALLS
from swarmd.sim.trace import ARENA, Trace

FAULT = 0.02
"""Upper bound in m/s of the closing speed of a protected surface in a contact."""
ONCE = 1.0
"""Seconds of contact that count as one collision."""
WINDOW = 10.0
STUCK = 0.05
"""A robot is stuck in a window of the first number of s if it stays within the second number of m
of its position at the start of the window."""

_REST_TIME = 0.5  # s within which each base comes to rest, including the delay of commands
_APART = 0.5  # s without contact after which two that started in contact are treated like others
_START = 0.1  # s: contacts until then come from the start poses
_ROUNDING = 1e-9


class Collision(Struct, frozen=True):
    """One counted part of a contact.

    - `a`: a robot's id. `b`: the id of another robot, the name of a movable box, or WALLS.
    - `own_speed`: m/s, the highest speed of a protected robot's own surface towards the other body;
      `robot`: the id of this robot.
    - `pushed_speed`: m/s, the same of a robot whose command is zero.
    - `first_speed`: m/s, `own_speed` at the first step of a contact, before a robot can have been
      pushed; 0 in later counts.
    """

    time: float
    a: str
    b: str
    own_speed: float
    pushed_speed: float
    first_speed: float
    robot: str

    @property
    def text(self) -> str:
        """One line: time, the two, and the speeds of the robot's own surface in cm/s."""
        return (
            f"{self.time:8.2f} s  {self.a} and {self.b}: {self.robot} closes at"
            f" {100.0 * self.own_speed:.1f} cm/s, {100.0 * self.first_speed:.1f} at the first step,"
            f" pushed at {100.0 * self.pushed_speed:.1f}"
        )

    @property
    def is_fault(self) -> bool:
        """Whether a protected robot drove into the other."""
        return self.own_speed > FAULT

    @property
    def is_hit(self) -> bool:
        """Whether the contact began with a protected robot that drove into the other."""
        return self.first_speed > FAULT

    @property
    def is_pushed(self) -> bool:
        """Whether the robot closed on the other only because it was pushed."""
        return self.own_speed <= FAULT < self.pushed_speed


def collisions(trace: Trace, unprotected: Collection[str] = ()) -> list[Collision]:
    """All counted contacts of protected robots, in order of time."""
    is_protected = np.array([robot not in unprotected for robot in trace.ids], dtype=bool)
    first, second = trace.contact_pair.T
    # Only protected robots can be at fault, not the arena, boxes or other robots.
    can_be_at_fault = np.stack((is_protected[first], (second >= 0) & is_protected[second]), axis=1)
    own = np.where(can_be_at_fault, trace.contact_speed, -np.inf)
    is_commanded = _is_commanded(trace)
    # Last axis: with a command to move, and without one.
    own = np.stack(
        (np.where(is_commanded, own, -np.inf), np.where(is_commanded, -np.inf, own)), axis=-1
    )
    found = []
    pairs = np.unique(np.sort(trace.contact_pair[can_be_at_fault.any(axis=1)], axis=1), axis=0)
    for low, high in pairs.tolist():
        of = np.flatnonzero(
            ((first == low) & (second == high)) | ((first == high) & (second == low))
        )
        of = of[np.argsort(trace.contact_t[of], kind="stable")]
        for part in _counts(trace.contact_t[of], float(trace.t[0])):
            is_new = part.start == 0 or np.diff(trace.contact_t[of])[part.start - 1] > _APART
            found.append(_collision(trace, of[part], own, is_new=bool(is_new)))
    return sorted(found, key=lambda one: one.time)


def stuck_windows(trace: Trace, rows: np.ndarray) -> tuple[int, int]:
    """How many whole windows the robots `rows` had, and in how many of them they were stuck."""
    starts = np.arange(trace.t[0], trace.t[-1] - WINDOW + _ROUNDING, WINDOW)
    stuck = 0
    for start in starts:
        is_in = (trace.t >= start - _ROUNDING) & (trace.t <= start + WINDOW + _ROUNDING)
        place = trace.pose[is_in][:, rows, :2]
        away = place - place[0]
        stuck += int((np.hypot(away[..., 0], away[..., 1]).max(axis=0) < STUCK).sum())
    return len(starts) * len(rows), stuck


def _counts(times: Array, begin: float) -> Iterator[slice]:
    """The parts of a pair's sorted contact times (k,) that count once each."""
    start = 0
    if times[0] <= begin + _START:  # in contact from the start
        gaps = np.flatnonzero(np.diff(times) > _APART)
        start = int(gaps[0]) + 1 if len(gaps) else len(times)
    while start < len(times):
        stop = int(np.searchsorted(times, times[start] + ONCE - _ROUNDING))
        yield slice(start, stop)
        start = stop


def _is_commanded(trace: Trace) -> np.ndarray:
    """(c, 2) whether a command shortly before a contact moved a point of the outline."""
    commanded = np.zeros(trace.safe.shape[:2])
    for row in range(len(trace.ids)):
        linear, angular, lateral = trace.safe[:, row].T
        for x, y in trace.footprint(row):
            speed = np.hypot(linear - angular * y, lateral + angular * x)
            np.maximum(commanded[:, row], speed, out=commanded[:, row])
    since = np.searchsorted(trace.t, trace.contact_t - _REST_TIME)
    until = np.searchsorted(trace.t, trace.contact_t + _ROUNDING)
    is_commanded = np.zeros(trace.contact_pair.shape, dtype=bool)
    for touch, (first, stop) in enumerate(zip(since, np.maximum(until, since + 1), strict=True)):
        most = commanded[first:stop].max(axis=0)
        is_commanded[touch] = most[trace.contact_pair[touch]] > FAULT
    return is_commanded


def _collision(trace: Trace, rows: np.ndarray, own: Array, *, is_new: bool) -> Collision:
    """The rows of one count; `own` (c, 2, 2): the speeds of protected robots."""
    by_itself, pushed = own[rows, :, 0], own[rows, :, 1]
    shown = by_itself if by_itself.max() > FAULT or not pushed.max() > FAULT else pushed
    row, side = divmod(int(shown.argmax()), 2)
    pair = trace.contact_pair[rows[row]].tolist()
    a, b = pair if pair[1] < 0 or pair[0] <= pair[1] else pair[::-1]
    return Collision(
        time=float(trace.contact_t[rows[0]]),
        a=trace.ids[a],
        b=_name(trace, b),
        own_speed=max(float(by_itself.max()), 0.0),
        pushed_speed=max(float(pushed.max()), 0.0),
        first_speed=max(float(by_itself[0].max()), 0.0) if is_new else 0.0,
        robot=trace.ids[pair[side]],
    )


def _name(trace: Trace, index: int) -> str:
    if index >= 0:
        return trace.ids[index]
    return WALLS if index == ARENA else trace.movable_boxes[ARENA - 1 - index]
