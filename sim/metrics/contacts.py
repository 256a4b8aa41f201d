"""Touches as people count them: once each, however many steps they last, and who ran into whom.

Every body counts, whether its robot is present or not. The definitions are ours: `EPISODE_GAP` in
`world/contacts.py` says when the same two contact anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from swarmd.sim.metrics.metric import Metric
from swarmd.sim.trace import ARENA, Trace
from swarmd.sim.world.contacts import EPISODE_GAP

WALLS = "the arena"
"""Stands for walls, fixed boxes and poles among ids; no id holds a blank."""
MOVING = 0.01
"""A surface that comes nearer by more than so many m/s is moving towards the other."""

Kind = Literal["robot", "arena", "box"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """One contact, from `start` to `end` in the trace's s.

    `a` is a robot's id, `b` another one's, WALLS or the name of a movable box; `kind` says what b
    is. `closing_speed` in m/s is the fastest approach of the contact, and the two moved then if
    their own surface came towards the other at more than MOVING.
    """

    start: float
    end: float
    a: str
    b: str
    kind: Kind
    closing_speed: float
    is_a_moving: bool
    is_b_moving: bool


def contact_list(trace: Trace, gap: float = EPISODE_GAP) -> list[Contact]:
    """Each contact of the run, in order of its beginning, then of the robots."""
    if len(trace.contact_t) == 0:
        return []
    # The lower index first, but the arena and boxes, which are negative, always second.
    pair, speed = trace.contact_pair, trace.contact_speed
    is_turned = (pair[:, 1] >= 0) & (pair[:, 1] < pair[:, 0])
    pair = np.where(is_turned[:, None], pair[:, ::-1], pair)
    speed = np.where(is_turned[:, None], speed[:, ::-1], speed)
    order = np.lexsort((trace.contact_t, pair[:, 1], pair[:, 0]))
    time, pair, speed = trace.contact_t[order], pair[order], speed[order]
    is_new = np.ones(len(time), dtype=bool)
    is_new[1:] = (pair[1:] != pair[:-1]).any(axis=1) | (np.diff(time) > gap)
    starts = np.flatnonzero(is_new)
    stops = np.append(starts[1:], len(time))
    found = []
    for start, stop in zip(starts, stops, strict=True):
        fastest = start + int(speed[start:stop].sum(axis=1).argmax())
        ends = float(time[start]), float(time[stop - 1])
        found.append(_touch(trace, ends, pair[start], speed[fastest]))
    return sorted(found, key=lambda one: one.start)


def contact_episodes(trace: Trace) -> dict[tuple[str, str], int]:
    """How often each pair touched, its names in order; WALLS stands for walls, boxes and poles."""
    counts: dict[tuple[str, str], int] = {}
    for contact in contact_list(trace):
        pair = (min(contact.a, contact.b), max(contact.a, contact.b))
        counts[pair] = counts.get(pair, 0) + 1
    return counts


def count(trace: Trace, kind: Kind) -> int:
    """The number of touches of a robot with another one, the arena or a movable box."""
    return sum(contact.kind == kind for contact in contact_list(trace))


def contacts_between_robots(trace: Trace) -> int:
    """The number of touches of two robots."""
    return count(trace, "robot")


def contacts_with_arena(trace: Trace) -> int:
    """The number of touches of a robot with a wall, fixed box or pole."""
    return count(trace, "arena")


def contacts_with_boxes(trace: Trace) -> int | None:
    """The number of touches of a robot with a movable box; None if there is none."""
    return count(trace, "box") if trace.movable_boxes else None


def hardest_contact(trace: Trace) -> float | None:
    """The fastest approach in m/s of any contact of two robots; None if none touched."""
    speeds = [contact.closing_speed for contact in contact_list(trace) if contact.kind == "robot"]
    return max(speeds, default=None)


def _touch(trace: Trace, ends: tuple[float, float], pair: np.ndarray, speed: np.ndarray) -> Contact:
    a, b = int(pair[0]), int(pair[1])
    kind: Kind = "robot" if b >= 0 else "arena" if b == ARENA else "box"
    # Below ARENA stand the movable boxes: -2 is the first of `movable_boxes`.
    other = trace.ids[b] if b >= 0 else WALLS if b == ARENA else trace.movable_boxes[ARENA - 1 - b]
    return Contact(
        start=ends[0],
        end=ends[1],
        a=trace.ids[a],
        b=other,
        kind=kind,
        closing_speed=float(speed[0] + speed[1]),
        is_a_moving=bool(speed[0] > MOVING),
        is_b_moving=bool(speed[1] > MOVING),
    )


_OURS = "ours"

METRICS = (
    Metric(
        "robot_contacts",
        "",
        "touches of two robots, each once however long",
        _OURS,
        contacts_between_robots,
        None,
        "less",
    ),
    Metric(
        "arena_contacts",
        "",
        "touches of a robot with a wall, fixed box or pole",
        _OURS,
        contacts_with_arena,
        None,
        "less",
    ),
    Metric(
        "box_contacts",
        "",
        "touches of a robot with a movable box",
        _OURS,
        contacts_with_boxes,
    ),
    Metric(
        "hardest_contact",
        "m/s",
        "fastest approach in any contact of two robots",
        _OURS,
        hardest_contact,
        None,
        "less",
    ),
)
