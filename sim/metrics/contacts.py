"""Contact episodes of robots, and which robot was moving.

An episode counts once, however many steps it lasts. A pair has a new episode after a pause of
`EPISODE_GAP` (`world/contacts.py`). Absent robots count too: they stand in the arena. The
definitions are ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from swarmd.sim.metrics.metric import Metric
from swarmd.sim.trace import ARENA, Trace
from swarmd.sim.world.contacts import EPISODE_GAP

WALLS = "the arena"
"""The name of walls, fixed boxes and poles among ids; no id contains a blank."""
MOVING = 0.01
"""Speed in m/s above which a surface is moving towards the other."""

Kind = Literal["robot", "arena", "box"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceContact:
    """One contact episode."""

    start: float  # s of the trace
    end: float
    a: str  # a robot's id
    b: str  # by `kind`: another robot's id, WALLS, or the name of a movable box
    kind: Kind
    closing_speed: float  # m/s, the highest during the episode
    is_a_moving: bool  # at the highest closing speed, a's surface moved towards b above MOVING
    is_b_moving: bool  # the same of b's surface


def contact_list(trace: Trace, gap: float = EPISODE_GAP) -> list[TraceContact]:
    """The contact episodes of the run, by start and then by robots; `gap`: the pause in s."""
    if len(trace.contact_t) == 0:
        return []
    # Sort each pair by index, except that the arena and boxes, whose indices are negative, come
    # second.
    pair = trace.contact_pair
    speed = trace.contact_speed
    is_turned = (pair[:, 1] >= 0) & (pair[:, 1] < pair[:, 0])
    pair = np.where(is_turned[:, None], pair[:, ::-1], pair)
    speed = np.where(is_turned[:, None], speed[:, ::-1], speed)
    order = np.lexsort((trace.contact_t, pair[:, 1], pair[:, 0]))
    time = trace.contact_t[order]
    pair = pair[order]
    speed = speed[order]
    is_new = np.ones(len(time), dtype=bool)
    is_new[1:] = (pair[1:] != pair[:-1]).any(axis=1) | (np.diff(time) > gap)
    starts = np.flatnonzero(is_new)
    stops = np.append(starts[1:], len(time))
    contacts = []
    for start, stop in zip(starts, stops, strict=True):
        fastest = start + int(speed[start:stop].sum(axis=1).argmax())
        ends = float(time[start]), float(time[stop - 1])
        contacts.append(_contact(trace, ends, pair[start], speed[fastest]))
    return sorted(contacts, key=lambda contact: contact.start)


def count_of(trace: Trace, kind: Kind) -> int:
    """The number of contacts of a kind."""
    return sum(contact.kind == kind for contact in contact_list(trace))


def hardest_contact(trace: Trace) -> float | None:
    """The fastest approach in m/s of any contact of two robots; None without a contact."""
    speeds = [contact.closing_speed for contact in contact_list(trace) if contact.kind == "robot"]
    return max(speeds, default=None)


def _contact(
    trace: Trace, ends: tuple[float, float], pair: np.ndarray, speed: np.ndarray
) -> TraceContact:
    """The episode of a pair from `ends[0]` to `ends[1]` s, with the speeds (2,) of its surfaces."""
    a = int(pair[0])
    b = int(pair[1])
    kind: Kind
    if b >= 0:
        kind = "robot"
        partner = trace.ids[b]
    elif b == ARENA:
        kind = "arena"
        partner = WALLS
    else:  # movable box m has the index ARENA - 1 - m
        kind = "box"
        partner = trace.movable_boxes[ARENA - 1 - b]
    return TraceContact(
        start=ends[0],
        end=ends[1],
        a=trace.ids[a],
        b=partner,
        kind=kind,
        closing_speed=float(speed[0] + speed[1]),
        is_a_moving=bool(speed[0] > MOVING),
        is_b_moving=bool(speed[1] > MOVING),
    )


_OURS = "ours"

METRICS = (
    Metric("robot_contacts", "", "contacts of two robots, each counted once", _OURS,
           lambda trace: count_of(trace, "robot"), better="less"),
    Metric("arena_contacts", "", "contacts of a robot with a wall, fixed box or pole", _OURS,
           lambda trace: count_of(trace, "arena"), better="less"),
    Metric("box_contacts", "", "contacts of a robot with a movable box", _OURS,
           lambda trace: count_of(trace, "box") if trace.movable_boxes else None),
    Metric("hardest_contact", "m/s", "fastest approach in any contact of two robots", _OURS,
           hardest_contact, better="less"),
)  # fmt: skip
