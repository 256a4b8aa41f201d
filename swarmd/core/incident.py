"""Incidents: what went wrong on a robot, told to all robots, so that each keeps its last minute.

The table `BEGINS` says which reasons of a robot begin an incident, and when. What a table does not
list begins none: an operator's stop, a finished run, an obstacle, a hold by design.

Robots that meet one incident give it one id without asking each other: the id of an emergency stop
follows from its latch, that of a robot that is no longer heard from its instance and revision.

In a secured swarm the robot that tells an incident signs it, and an operator signs a mark, so
that a robot that hands it on cannot put words into a mouth.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from swarmd.core.bounds import IncidentId, Line, Name, Seconds, Word
from swarmd.core.messages import Reason, State, Status

Wall = Annotated[float, Meta(ge=0.0, le=1e11)]
Signature = Annotated[bytes, Meta(max_length=64)]
OperatorName = Annotated[str, Meta(max_length=128)]
MAX_TEXT = 300
"""Characters of the words of an incident."""


class IncidentKind(StrEnum):
    """The kinds of incidents, with what begins each."""

    ESTOP = "estop"  # an emergency stop latches
    FAULT = "fault"  # a pattern is quarantined, or a second daemon has the id
    HAZARD = "hazard"  # a hazard of the base ends a run
    DRIVER = "driver_lost"  # the base is lost while the robot runs
    STALL = "loop_stalled"  # the daemon stood still during a run
    FENCE = "fence"  # the robot is outside its fence
    ASSUMPTION = "assumption"  # brakes or sensors are not as protection assumes
    SILENT = "silent"  # peers declare a running robot failed, or its daemon has died
    MARK = "mark"  # an operator's words


class When(StrEnum):
    """When a reason begins an incident."""

    ALWAYS = "always"
    IN_A_RUN = "in a run"  # also as a hold
    ENDS_A_RUN = "at the end of a run"


BEGINS: Mapping[Reason, tuple[IncidentKind, When]] = {
    Reason.ESTOP: (IncidentKind.ESTOP, When.ALWAYS),
    Reason.QUARANTINED: (IncidentKind.FAULT, When.ALWAYS),
    Reason.DUPLICATE_ID: (IncidentKind.FAULT, When.ALWAYS),
    Reason.HAZARD: (IncidentKind.HAZARD, When.ENDS_A_RUN),
    Reason.DRIVER_LOST: (IncidentKind.DRIVER, When.IN_A_RUN),
    Reason.LOOP_STALLED: (IncidentKind.STALL, When.ENDS_A_RUN),
    # Protection found the range sensor false, or lost it.
    Reason.FROZEN_SCAN: (IncidentKind.ASSUMPTION, When.ENDS_A_RUN),
    Reason.INVALID_SCAN: (IncidentKind.ASSUMPTION, When.ENDS_A_RUN),
    Reason.STALE_SCAN: (IncidentKind.ASSUMPTION, When.ENDS_A_RUN),
    Reason.LATE_SCAN: (IncidentKind.ASSUMPTION, When.ENDS_A_RUN),
    Reason.NO_SCAN: (IncidentKind.ASSUMPTION, When.ENDS_A_RUN),
}


class Incident(Struct, frozen=True, kw_only=True):
    """An incident as it spreads.

    - `robot`: the robot that had it. `by`: the robot that tells it first.
    - `text`: why, in a line. `wall`: s since 1970 by the clock of `by`; 0: not set.
    - Of a mark, `operator`: who marked it, as `by` says. `marked`: s since 1970 by the clock of the
      operator. `signature`: the operator's, of `mark_part`; empty in a swarm without keys, and from
      an older version.
    """

    id: IncidentId
    robot: Name
    kind: Word
    text: Line
    by: Name
    wall: Wall = 0.0
    operator: OperatorName = ""
    marked: Wall = 0.0
    signature: Signature = b""

    def line(self, at: float) -> str:
        """The incident in a line; `at`: its time in s on the timeline of a recording."""
        return f"incident {self.id} of {self.robot} at {at:.3f} s: {self.kind}: {self.text}"


def mark_part(id: str, operator: str, text: str, marked: float) -> bytes:
    """The bytes of a mark that its operator signs."""
    return msgspec.msgpack.encode((id, operator, text, marked))


class ToldIncident(Struct, frozen=True, kw_only=True):
    """An incident as a robot hands it on: `age` s ago.

    `content`: the encoded `Incident`, as `by` signed it with the key of `certificate` (PEM).
    Both are empty in a swarm without keys.
    """

    content: Annotated[bytes, Meta(max_length=2048)]
    age: Seconds
    signature: Signature = b""
    certificate: Annotated[bytes, Meta(max_length=2048)] = b""


class Found(Struct, frozen=True):
    """An incident that a robot has found; `id` empty: it concerns this robot alone."""

    kind: IncidentKind
    text: str
    id: str = ""


def id_of(*parts: object) -> str:
    """The id of an incident that several robots find: 12 hex digits."""
    return hashlib.blake2b("\n".join(map(str, parts)).encode(), digest_size=6).hexdigest()


def silent_id(robot: str, instance: str, revision: int) -> str:
    """The id of the incident that a robot is no longer heard since this revision of it."""
    return id_of(IncidentKind.SILENT, robot, instance, revision)


def found(before: Status | None, now: Status) -> Found | None:
    """The incident between two statuses of a robot; None without one. Pure.

    `before` None: the first status, in which only a later change counts.
    """
    if before is None:
        return None
    for name, latch in now.latches.items():
        if name not in before.latches:
            text = f"emergency stop by {latch.issuer}"
            if latch.reason:
                text += f" ({latch.reason})"
            return Found(IncidentKind.ESTOP, text, id_of(IncidentKind.ESTOP, name))
    kind = _begun_by_reason(before, now)
    if kind is not None:
        epoch = before.epoch
        is_silent = kind is IncidentKind.STALL
        id = silent_id(now.robot, epoch.instance, epoch.revision) if is_silent else ""
        # A base that is lost says why in an event.
        logged = [one.text for one in now.events if one.at > before.uptime]
        why = now.detail or (logged[-1] if logged else "")
        return Found(kind, f"{now.state} ({now.reason}) {why}".rstrip(), id)
    for finding in now.findings:
        if finding not in before.findings:
            return Found(IncidentKind.ASSUMPTION, finding)
    if _is_outside(now) and not _is_outside(before):
        assert now.fence is not None
        return Found(IncidentKind.FENCE, f"outside its fence: {now.fence.clearance:.2f} m")
    return None


def _begun_by_reason(before: Status, now: Status) -> IncidentKind | None:
    """The kind of incident that the reason of the state begins; None if it begins none."""
    if now.reason is None or now.reason not in BEGINS:
        return None
    kind, when = BEGINS[now.reason]
    is_new_reason = now.reason is not before.reason
    is_new_state = now.state is not before.state
    has_run = before.state is State.RUNNING
    is_running = now.state is State.RUNNING
    match when:
        case When.ALWAYS:
            begins = is_new_reason or is_new_state
        case When.IN_A_RUN:
            begins = has_run and is_new_reason
        case When.ENDS_A_RUN:
            begins = has_run and not is_running
    return kind if begins else None


def _is_outside(status: Status) -> bool:
    """True if the robot is surely outside its fence."""
    fence = status.fence
    return fence is not None and fence.clearance is not None and fence.clearance < -fence.error
