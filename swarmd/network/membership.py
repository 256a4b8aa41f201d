"""The members of a swarm as one peer sees them. Pure: events in, members out.

A liveliness token shows that an instance is there, a status shows its state. The two come on
different threads and may overtake each other; the result does not depend on their order. A robot is

- alive while at least one of its instances holds a token and has not published `has_left`,
- left when its latest instance published `has_left`, before or after its token vanished,
- failed when its last token vanished without that; it stays listed until it is forgotten.

Times are in s on the caller's monotonic clock.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from swarmd.core.messages import Member, Presence, Status

# Each may hold a status of 64 kB.
MAX_MEMBERS = 256
MAX_INSTANCES = 4


@dataclass(slots=True)
class _Record:
    """`seen`: instances that held a token, oldest first; `statuses` may come before the token."""

    seen: list[str] = field(default_factory=list)
    alive: set[str] = field(default_factory=set)
    left: set[str] = field(default_factory=set)
    statuses: dict[str, Status] = field(default_factory=dict)
    shown: tuple[str, Presence] | None = None
    since: float = 0.0

    @property
    def is_gone(self) -> bool:
        return self.shown is not None and self.shown[1] is not Presence.ALIVE


class Membership:
    """The other robots of a swarm; `own` is never among them.

    Each event method returns True if a member's instance or presence changed. Bounded: beyond
    `MAX_MEMBERS` robots a new one replaces the one that vanished the longest ago, and is ignored
    if all are alive. Of one robot's many instances the oldest are dropped.
    """

    def __init__(self, own: str) -> None:
        self._own = own
        self._records: dict[str, _Record] = {}

    def on_alive(self, robot: str, instance: str, now: float) -> bool:
        """A token appeared."""
        record = self._record(robot, has_token=True)
        if record is None:
            return False
        if instance not in record.alive:
            record.alive.add(instance)
            record.seen = [*(name for name in record.seen if name != instance), instance]
        return self._settle(record, now)

    def on_gone(self, robot: str, instance: str, now: float) -> bool:
        """A token vanished: its holder left, died, or cannot be reached."""
        record = self._records.get(robot)
        if record is None or instance not in record.alive:
            return False
        record.alive.discard(instance)
        return self._settle(record, now)

    def on_status(self, status: Status, now: float) -> bool:
        """A robot published its status; `has_left` in it means that the robot is leaving."""
        record = self._record(status.robot)
        if record is None:
            return False
        record.statuses.pop(status.instance, None)
        record.statuses[status.instance] = status
        if status.has_left:
            record.left.add(status.instance)
        return self._settle(record, now)

    def forget(self, robot: str) -> bool:
        """Remove a robot; False if it is alive or unknown."""
        record = self._records.get(robot)
        if record is None or not record.is_gone:
            return False
        del self._records[robot]
        return True

    def member(self, robot: str, now: float) -> Member | None:
        """One member, or None if it was never seen or is forgotten."""
        record = self._records.get(robot)
        if record is None or record.shown is None:
            return None
        instance, presence = record.shown
        return Member(
            robot=robot,
            instance=instance,
            presence=presence,
            age=max(0.0, now - record.since),
            status=record.statuses.get(instance),
        )

    def members(self, now: float) -> dict[str, Member]:
        """All members by id, in the order of their names."""
        found = ((robot, self.member(robot, now)) for robot in sorted(self._records))
        return {robot: member for robot, member in found if member is not None}

    @property
    def duplicates(self) -> Mapping[str, tuple[str, ...]]:
        """Robot ids that more than one living instance holds, with those instances."""
        return {
            robot: tuple(sorted(record.alive - record.left))
            for robot, record in self._records.items()
            if len(record.alive - record.left) > 1
        }

    def _record(self, robot: str, *, has_token: bool = False) -> _Record | None:
        if robot == self._own:
            return None
        record = self._records.get(robot)
        if record is None:
            if len(self._records) >= MAX_MEMBERS and not self._make_room(has_token):
                return None
            record = self._records[robot] = _Record()
        return record

    def _make_room(self, has_token: bool) -> bool:
        """Drop a robot that never held a token; for a token also the one that vanished first."""
        for robot, record in self._records.items():
            if record.shown is None:
                del self._records[robot]
                return True
        if not has_token:
            return False
        gone = [(record.since, robot) for robot, record in self._records.items() if record.is_gone]
        if gone:
            del self._records[min(gone)[1]]
        return bool(gone)

    def _settle(self, record: _Record, now: float) -> bool:
        _prune(record)
        shown = _shown(record)
        if shown == record.shown:
            return False
        record.shown, record.since = shown, now
        return True


def _shown(record: _Record) -> tuple[str, Presence] | None:
    for instance in reversed(record.seen):
        if instance in record.alive and instance not in record.left:
            return instance, Presence.ALIVE
    if not record.seen:
        return None
    last = record.seen[-1]
    return last, Presence.LEFT if last in record.left else Presence.FAILED


def _prune(record: _Record) -> None:
    for instance in record.seen[:-MAX_INSTANCES]:
        record.alive.discard(instance)
    del record.seen[:-MAX_INSTANCES]
    known = set(record.seen)
    for strange in [name for name in record.statuses if name not in known][:-MAX_INSTANCES]:
        del record.statuses[strange]
    if len(record.left) > 4 * MAX_INSTANCES:
        record.left &= known
