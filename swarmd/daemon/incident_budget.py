"""Whose incidents give way to whose: budgets by origin, in the files of a robot and in its list.

A robot that tells many incidents, also false ones, displaces only what it told itself. Pure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from swarmd.core.incident import Incident, IncidentKind
from swarmd.core.verbs import KeptIncident

MAX_KEPT, MAX_BYTES = 20, 64 * 2**20
"""Files that a robot keeps, and their bytes; marks take at most half of both, and no file but
another mark of an operator displaces one that an operator has made."""


def rate_of(incident: Incident, source: str) -> tuple[str, str, str]:
    """What begins at most so many incidents: a robot by itself, its deaths, lost peers, marks.

    Daemons that die again and again, and words on an incident, which follow it at once, must not
    hide what befalls the robot itself. `source`: the peer that handed it on for `incident.by`; old
    tales that a peer tells again use up nothing of the robot that they are of.
    """
    is_own = incident.robot == incident.by
    if incident.kind not in (IncidentKind.SILENT, IncidentKind.MARK):
        return incident.by, source, "" if is_own else "peers"
    return incident.by, source, f"{incident.kind} {'itself' if is_own else 'peers'}"


def origin_of(one: KeptIncident) -> str:
    """Whose budget a file uses: a mark that of its operator, another one that of its teller.

    The teller is the peer that handed it on for another robot, or the robot that told it itself.
    """
    return one.operator or one.source or one.incident.by


def to_remove(kept: Sequence[KeptIncident], new: KeptIncident) -> list[str]:
    """The ids of the files that give way to the file `new`. `kept`: the oldest first.

    1. Marks take at most half. Beyond it those give way first that no operator is known to have
       made, then those of the operator with most marks.
    2. No other file displaces a mark of an operator.
    3. Beyond the limits of all files, one of the robot with most files gives way, by `origin_of`;
       of equal ones that of `new`.
    4. Of its files the oldest goes first; the first file of each kind goes last.
    """
    left = [one for one in kept if one.incident.id != new.incident.id]
    removed: list[str] = []
    while (pool := _pool(left, new)) is not None:
        victim = _victim(
            pool, origin_of(new), is_among=bool(pool[0].operator) is bool(new.operator)
        )
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

    `tellers`: by id the robot that answers for it, the oldest first. `new`: that of the new one.
    Those of the robot itself, `own`, give way to its own ones alone, and last.
    """
    counts = Counter(tellers.values())
    others = {teller: count for teller, count in counts.items() if teller != own}
    worst = max(others, key=lambda teller: others[teller], default=own)
    if new != own and (worst == own or others[worst] <= counts[new] + 1):
        return None
    return next(id for id, teller in tellers.items() if teller == worst)


def _victim(files: Sequence[KeptIncident], new: str, *, is_among: bool) -> KeptIncident:
    """The file that gives way to one of the origin `new`; `is_among`: which will be among them."""
    counts = Counter(origin_of(one) for one in files)
    most = max(counts.values())
    is_own = is_among and new in counts and counts[new] + 1 >= most
    origin = new if is_own else next(one for one in counts if counts[one] == most)
    firsts = {one.incident.kind: one.incident.id for one in reversed(files)}
    kept_last = {firsts[kind] for kind in IncidentKind if kind in firsts}
    its = [one for one in files if origin_of(one) == origin]
    return next((one for one in its if one.incident.id not in kept_last), its[0])


def _is_full(files: Sequence[KeptIncident], size: int, part: int) -> bool:
    """True if another file of `size` bytes exceeds one `part`-th of the limits."""
    total = sum(one.size for one in files) + size
    return bool(files) and (len(files) >= MAX_KEPT // part or total > MAX_BYTES // part)
