"""The robots of a swarm as a table, and a line for each problem."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from swarmd.core import codec
from swarmd.core.goal import GoalState
from swarmd.core.messages import SUSPICIONS, PeerFault, Presence, State, Status
from swarmd.operator.session.members_view import Contact, SeenMember
from swarmd.operator.texts.keys import key_warnings
from swarmd.operator.texts.values import NOTHING, number, seconds
from swarmd.operator.texts.why import SILENT, activity, state_word, stop_text

if TYPE_CHECKING:
    from swarmd.core.values import Scalar
    from swarmd.operator.session.members_view import MembersView

HEADER = ("NAME", "STATE", "REASON", "PATTERN", "PROTECTION", "SEEN", "REPORT")
WIDE = ("GEN", "SCAN", "LOOP99", "CPU", "VERSION", "LABELS", "GOAL")
BY_DATAGRAMS = (
    "by datagrams alone: reasons, patterns, protection, reports, faults and emergency stops were"
    " not asked; without --quick they are"
)
_NOW = 1.0  # figures that are newer than this are `now`, in s


def row(member: SeenMember) -> tuple[str, ...]:
    """The cells of a member's line in the table, below HEADER.

    A member that answered shows its status. A member that is heard here without a status gives no
    answer. Any other member is silent, or has left, and REASON says how it is known. Of another
    version, STATE is that of the beacon, and REASON and PATTERN come from the head of the status,
    which is readable. A cell without a value shows NOTHING.
    """
    status = member.status
    status_head = member.header
    if member.contact is Contact.ANSWERED and status is not None:
        return (
            member.robot,
            state_word(status),
            status.reason or NOTHING,
            status.pattern or NOTHING,
            activity(status.decision),
            _seen(member),
            _report(status.report if status.state is State.RUNNING else {}),
        )
    has_left = member.presence is Presence.LEFT
    states = {
        Contact.GONE: member.presence.value if has_left else SILENT,
        Contact.NO_ANSWER: Contact.NO_ANSWER.value,
        Contact.OTHER_VERSION: member.state or "other version",
    }
    reasons = {
        Contact.GONE: None if has_left else member.presence.value,
        Contact.NO_ANSWER: None,
        Contact.OTHER_VERSION: status_head.reason if status_head else None,
    }
    return (
        member.robot,
        states.get(member.contact, SILENT),
        reasons.get(member.contact, member.contact.value) or NOTHING,
        (status_head.pattern if status_head else None) or NOTHING,
        NOTHING,
        _seen(member),
        NOTHING,
    )


def heard_row(member: SeenMember) -> tuple[str, ...]:
    """The cells of a member of a look by datagrams alone: STATE is that of its last beacon."""
    cells = row(member)
    if member.contact is not Contact.NO_ANSWER:
        return cells
    return (cells[0], member.state or NOTHING, *cells[2:])


def wide_cells(member: SeenMember) -> tuple[str, ...]:
    """The cells of a member below WIDE; the goal with the state of its run."""
    status = member.status
    if status is None or member.contact is not Contact.ANSWERED:
        return *(NOTHING,) * 4, member.version or NOTHING, NOTHING, NOTHING
    goal = status.goal
    own = goal.own if goal is not None else None
    text = NOTHING if own is None or goal is None else f"{own.goal.text} ({goal.state})"
    return (
        str(status.generation),
        f"{status.health.scan_rate:.1f} Hz",
        seconds(status.health.loop_p99),
        _cpu(status),
        status.version or NOTHING,
        " ".join(status.labels) or NOTHING,
        text,
    )


def _cpu(status: Status) -> str:
    """The processor time of daemon and pattern host; 100% is one core."""
    usages = [status.health.usage, status.health.pattern_usage]
    shares = [usage.cpu for usage in usages if usage is not None]
    return f"{sum(shares):.0%}" if shares else NOTHING


def health(view: MembersView) -> Iterator[str]:
    """Lines on the swarm: the number of living robots, then a line for each problem."""
    alive = [view.members[name] for name in view.alive]
    statuses = [member.status for member in alive if member.status is not None]
    yield f"{len(alive)}/{len(view.members.keys() | view.roster)} alive"
    if view.programs:
        yield f"programs: {', '.join(sorted(view.programs))}"
    yield from _missing(view, alive)
    yield from _emergency_stops(view, statuses)
    yield from _reported_faults(statuses)
    yield from incompatible(statuses)
    yield from told_by_peers(statuses)
    yield from _held(statuses)
    if driven := [f"{one.robot} (by {one.driven_by})" for one in statuses if one.driven_by]:
        yield f"driven by hand: {', '.join(driven)}"
    yield from offered(statuses)
    yield from key_warnings(statuses, time.time())
    if insecure := [s.robot for s in statuses if s.profile != "dev" and not s.is_secured]:
        yield f"WARNING: insecure: anyone on this network can drive {', '.join(insecure)}"


def _missing(view: MembersView, alive: Iterable[SeenMember]) -> Iterator[str]:
    """A line for each kind of robots whose status this machine cannot get, and for shared ids.

    `alive` are the living robots of `view`.
    """
    alive = tuple(alive)
    for presence in (Presence.FAILED, Presence.LEFT):
        gone = [m for m in view.members.values() if m.presence is presence]
        if gone:
            yield f"{presence}: " + ", ".join(f"{m.robot} ({seconds(m.age)} ago)" for m in gone)
    # A robot in `answered` without a status was asked by datagrams alone, and has answered.
    silent = [m for m in alive if m.contact is Contact.NO_ANSWER and m.robot not in view.answered]
    if silent:
        heard = (f"{m.robot} (heard {seconds(m.age)} ago, {m.state})" for m in silent)
        yield f"alive, but no answer: {', '.join(heard)}"
    distant = [m for m in alive if m.contact is Contact.UNREACHABLE]
    if distant:  # another robot hears these robots
        relayed = (f"{m.robot} (alive by {m.by}'s word, {seconds(m.age)} ago)" for m in distant)
        yield f"not reachable from here: {', '.join(relayed)}"
    for m in alive:
        if m.contact is Contact.OTHER_VERSION:
            yield f"other version: {m.robot} speaks {m.wire}, this swarmctl {codec.VERSION}"
    if view.absent:
        yield f"in the roster and never seen: {', '.join(view.absent)}"
    if view.duplicates:
        yield f"two daemons have one id: {', '.join(sorted(view.duplicates))}; stop one of each"


def _reported_faults(statuses: Iterable[Status]) -> Iterator[str]:
    """A line for each fault of drivers or of storage, with the robots that report the fault."""
    statuses = tuple(statuses)
    lost = ((s.robot, s.health.driver or s.driver) for s in statuses if not s.health.driver_up)
    for text, names in _by_text(lost).items():
        yield f"driver lost: {', '.join(names)} ({text})"
    for text, names in _by_text((s.robot, s.health.storage) for s in statuses).items():
        yield f"an emergency stop would not outlive a restart: {', '.join(names)} ({text})"


def _emergency_stops(view: MembersView, statuses: Sequence[Status]) -> Iterator[str]:
    """A line for each emergency stop, with the robots that it holds.

    A robot holds a bounded number of them (`MAX_HELD` in robot/latches.py).
    """
    for latch_id, latch in view.latches(view.alive).items():
        names = ", ".join(status.robot for status in statuses if latch_id in status.latches)
        yield f"emergency stop: {names} ({stop_text(latch)})"


def _by_text(pairs: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """The robots of each text; those without a text are left out."""
    robots: dict[str, list[str]] = {}
    for robot, text in pairs:
        if text:
            robots.setdefault(text, []).append(robot)
    return robots


def offered(statuses: Iterable[Status]) -> Iterator[str]:
    """A line for each goal that robots were offered."""
    waiting: dict[tuple[str, str], list[str]] = {}
    latched = set[str]()
    for status in statuses:
        goal = status.goal
        if status.state in (State.ESTOPPED, State.FAULTED):
            latched.add(status.robot)
        if goal is not None and goal.own is not None and goal.state is GoalState.OFFERED:
            own = goal.own.goal
            until = "" if own.lease is None else f" while {own.issuer} is heard"
            waiting.setdefault((own.text, until), []).append(status.robot)
    for (text, until), names in waiting.items():
        line = f"offered {text}: {', '.join(names)}; swarmctl resume {' '.join(names)}{until}"
        held = [name for name in names if name in latched]
        yield f"{line}; first reset {', '.join(held)}" if held else line


def incompatible(statuses: Iterable[Status]) -> Iterator[str]:
    """A line for each kind of peer that robots may not see, or that is faster than they assume."""
    pairs: dict[tuple[bool, str], tuple[list[str], list[str]]] = {}
    for status in statuses:
        for peer in status.peers:
            own, peers = pairs.setdefault((peer.holds, peer.text), ([], []))
            if status.robot not in own:
                own.append(status.robot)
            if peer.robot not in peers:
                peers.append(peer.robot)
    for (holds, text), (own, peers) in pairs.items():
        yield f"{', '.join(own)} {'held by' if holds else 'beside'} {', '.join(peers)}: {text}"


def told_by_peers(statuses: Iterable[Status]) -> Iterator[str]:
    """A line for each fault that peers tell of a robot, with the most robots that tell it."""
    faults: dict[tuple[str, str], tuple[PeerFault, list[str]]] = {}
    for status in statuses:
        for fault in status.peer_faults:
            told, tellers = faults.setdefault((fault.robot, fault.kind), (fault, []))
            tellers.append(status.robot)
            if fault.by > told.by:
                faults[fault.robot, fault.kind] = fault, tellers
    for fault, tellers in faults.values():
        told_by = f" (told by {', '.join(tellers)})" if fault.kind in SUSPICIONS else ""
        yield f"{fault.robot} {fault.text}; for {seconds(fault.since)}{told_by}"


def _held(statuses: Iterable[Status]) -> Iterator[str]:
    """A line for the robots that protection has kept in place for long, with free floor."""
    held = [(one.robot, one.held_for) for one in statuses if one.held_for is not None]
    if held:
        names = ", ".join(f"{robot} ({seconds(time_held)})" for robot, time_held in held)
        yield f"held by protection, with free floor: {names}; swarmctl describe {held[0][0]}"


def _report(report: Mapping[str, Scalar]) -> str:
    """The report of the pattern."""
    return ", ".join(f"{name} {number(value)}" for name, value in report.items()) or NOTHING


def _seen(member: SeenMember) -> str:
    if member.contact is Contact.UNREACHABLE:
        return f"{seconds(member.age)} ago by {member.by}"
    if member.presence is Presence.ALIVE and member.age < _NOW:
        return "now" if member.contact is not Contact.NO_ANSWER else f"{seconds(member.age)} ago"
    return f"{seconds(member.age)} ago"
