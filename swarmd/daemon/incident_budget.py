"""Whose incidents give way to whose: budgets by origin, in the files of a robot and in its list.

A robot that tells many incidents, also false ones, displaces only what it told itself. Pure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

from swarmd.core.incident import Incident, IncidentKind
from swarmd.core.verbs import KeptIncident

MAX_KEPT = 20
MAX_BYTES = 64 * 2**20
"""Files that a robot keeps, and their bytes; marks take at most half of both, and no file but
another mark of an operator displaces one that an operator has made."""


SECOND_HAND = ""
"""The origin of what a peer hands on for another robot: no name of a robot."""


def rate_of(incident: Incident, source: str) -> tuple[str, bool, str]:
    """What begins at most so many incidents: a robot by itself, its deaths, lost peers, marks.

    Daemons that die again and again, and words on an incident, which follow it at once, must not
    hide what befalls the robot itself. `source`: the peer that handed it on for `incident.by`; old
    tales that a peer tells again use up nothing of what their robot tells itself.
    """
    is_own = incident.robot == incident.by
    if incident.kind not in (IncidentKind.SILENT, IncidentKind.MARK):
        return incident.by, bool(source), "" if is_own else "peers"
    return incident.by, bool(source), f"{incident.kind} {'itself' if is_own else 'peers'}"


def teller_of(incident: Incident, source: str) -> str:
    """Whose budget an incident uses: that of the robot that told it itself, else SECOND_HAND.

    What is handed on has one budget in all: its age is not signed, and neither the robot that it is
    of nor the one that hands it on answers for it.
    """
    return SECOND_HAND if source else incident.by


def origin_of(one: KeptIncident) -> str:
    """Whose budget a file uses: a mark that of its operator, another one that of its teller."""
    return one.operator or teller_of(one.incident, one.source)


def to_remove(kept: Sequence[KeptIncident], new: KeptIncident) -> list[str]:
    """The ids of the files that give way to the file `new`. `kept`: the oldest first.

    1. Marks take at most half. Beyond it those give way first that no operator is known to have
       made, then those of the operator with most marks.
    2. No other file displaces a mark of an operator.
    3. Beyond the limits of all files, one of the robot with most files gives way, by `origin_of`;
       of equal ones that of `new`.
    4. Of its files the oldest goes first; the first file of each kind goes last. At second hand
       those go first whose robot has most.
    """
    left = [one for one in kept if one.incident.id != new.incident.id]
    removed: list[str] = []
    while (pool := _pool(left, new)) is not None:
        victim = _victim(pool, new)
        left.remove(victim)
        removed.append(victim.incident.id)
    return removed


def _pool(left: Sequence[KeptIncident], new: KeptIncident) -> list[KeptIncident] | None:
    """The files of which one gives way to `new`; None: there is room."""
    operators = [one for one in left if one.operator]
    others = [one for one in left if not one.operator]
    claimed = [one for one in others if one.incident.kind == IncidentKind.MARK]
    if new.operator and _is_full(operators, new.size, 2):
        return operators
    is_mark = new.incident.kind == IncidentKind.MARK
    if is_mark and claimed and _is_full([*operators, *claimed], new.size, 2):
        return claimed
    if _is_full(left, new.size, 1):
        return others or (operators if new.operator else None)
    return None


def teller_to_give_way(tellers: Mapping[str, str], new: str, own: str) -> str | None:
    """The id of the incident that gives way in a full list; None: the new one is not taken.

    `tellers`: by id its `teller_of`, the oldest first. `new`: that of the new one.
    Those of the robot itself, `own`, give way to its own ones alone, and last.
    """
    counts = Counter(tellers.values())
    others = {teller: count for teller, count in counts.items() if teller != own}
    worst = max(others, key=lambda teller: others[teller], default=own)
    if new != own and (worst == own or others[worst] <= counts[new] + 1):
        return None
    return next(id for id, teller in tellers.items() if teller == worst)


def _victim(files: Sequence[KeptIncident], new: KeptIncident) -> KeptIncident:
    """The file that gives way."""
    is_among = bool(files[0].operator) is bool(new.operator)
    its = _of_most(files, origin_of, origin_of(new) if is_among else None)
    if not its[0].operator and origin_of(its[0]) == SECOND_HAND:
        its = _of_most(its, _told_by, new.incident.by if new.source else None)
    firsts = {one.incident.kind: one.incident.id for one in reversed(files)}
    kept_last = {firsts[kind] for kind in IncidentKind if kind in firsts}
    return next((one for one in its if one.incident.id not in kept_last), its[0])


def _told_by(one: KeptIncident) -> str:
    return one.incident.by


def _of_most(
    files: Sequence[KeptIncident], group_of: Callable[[KeptIncident], str], new: str | None
) -> list[KeptIncident]:
    """The files of the group with most of them; `new`: that of the new file, if it is in one."""
    counts = Counter(map(group_of, files))
    most = max(counts.values())
    if new is not None and new in counts and counts[new] + 1 >= most:
        group = new
    else:
        group = next(one for one in counts if counts[one] == most)
    return [one for one in files if group_of(one) == group]


def _is_full(files: Sequence[KeptIncident], size: int, part: int) -> bool:
    """True if another file of `size` bytes exceeds one `part`-th of the limits."""
    total = sum(one.size for one in files) + size
    return bool(files) and (len(files) >= MAX_KEPT // part or total > MAX_BYTES // part)
