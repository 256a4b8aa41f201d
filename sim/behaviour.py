"""What the robots of a run did: a hash of their motion, and the rules that acted on it.

Two runs with equal hashes had the same poses, commands, decisions and reports, bit by bit. A
refactor keeps the hash; what changes a command, by however little, changes it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swarmd.core.avoided import WayState
from swarmd.robot.protection.decision import Decision
from swarmd.sim.trace import Trace

RUN_DIGITS = 12
"""Hexadecimal digits of the hash of a run: two of 1e6 runs are equal by chance with 2e-3."""
RULES = "rules"
"""The key of a trace's `meta` with the rules that no array tells (`rules_of_decision`)."""

AVOIDANCE = "avoidance"
"""Steering led a robot past an object."""
OPENING = "opening"
"""Steering led a robot to, through or out of an opening, or let it give way there."""
FENCE = "fence"
"""A layer, such as the fence, changed a command."""
SLOWED = "slowed"
"""A robot got a share of the command, since an assumption was violated."""
RECOVERY = "recovery"
"""Steering led a blocked robot."""
TOUCHING = "touching"
"""The tightest constraint was that of an obstacle without a gap."""
CONTACT = "contact"
"""A body touched another one or the arena."""
_RUNNING = "running"


def hash_of(
    trace: Trace,
    digits: int = RUN_DIGITS,
    *,
    robot: int | None = None,
    instants: NDArray[np.intp] | None = None,
) -> str:
    """The first hexadecimal digits of a SHA-256 of what robots did.

    It covers poses, requested and safe commands, states, reasons, and what patterns report; of all
    robots also the poses of movable boxes. `robot`: the row of one robot; None: all. `instants`:
    these rows in time; None: all.
    """
    digest = hashlib.sha256()
    for values in _columns(trace, robot):
        some = values if instants is None else values[instants]
        digest.update(np.ascontiguousarray(some).tobytes())
    return digest.hexdigest()[:digits]


def _columns(trace: Trace, robot: int | None) -> Iterator[NDArray[Any]]:
    """The arrays that the hash covers, of one robot or of all."""
    arrays = (
        *(trace.pose, trace.requested, trace.safe, trace.state, trace.reason),
        *(trace.report[name] for name in sorted(trace.report)),
        *(trace.words[name] for name in sorted(trace.words)),
    )
    for values in arrays:
        if values is not None:
            yield values if robot is None else values[:, robot]
    if robot is None and trace.box_pose is not None:
        yield trace.box_pose


def rules_of_decision(decision: Decision) -> Iterator[str]:
    """The rules that acted in a decision and that no array of a trace tells."""
    if decision.avoided is not None:
        yield AVOIDANCE if decision.avoided.way is WayState.NONE else OPENING
    if decision.is_bounded:
        yield FENCE
    if decision.speed_share < 1.0:
        yield SLOWED


def rules_of(trace: Trace) -> tuple[str, ...]:
    """The names of the rules of protection and steering that acted at samples of a run, sorted.

    These are the modes of protection that changed a command, the reasons for which a running robot
    stood, and the constants of this module. A trace without decisions has none but CONTACT.
    """
    found: set[str] = set(trace.meta.get(RULES, ()))
    if trace.active is not None:
        acting: list[bool] = np.asarray(trace.active.any(axis=0)).tolist()
        modes = trace.meta.get("modes", {})
        found |= {
            str(modes[platform])
            for platform, is_acting in zip(trace.platforms, acting, strict=True)
            if is_acting and platform in modes
        }
    if trace.reason is not None and trace.state is not None:
        reasons = np.unique(trace.reason[trace.state == _RUNNING])
        found |= {str(reason) for reason in reasons if reason}
    if trace.recovering is not None and trace.recovering.any():
        found.add(RECOVERY)
    if trace.bound is not None and (trace.bound[..., 1] <= 0.0).any():
        found.add(TOUCHING)
    if len(trace.contact_t):
        found.add(CONTACT)
    return tuple(sorted(found))
