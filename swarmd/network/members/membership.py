"""The members of a swarm as one robot hears them. Pure: datagrams and times in, members out.

A robot is

- alive while its beacons are heard: a silent one is solicited before its lease ends,
- left once its latest instance sent a beacon with Flag.LEFT,
- failed when its lease ended without that; it stays listed until it returns or is forgotten.

The lists of others name robots whose beacons do not arrive here. These indirect members are handed
on with their age and their distance, and are no neighbours.
Times are in s on the caller's monotonic clock.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from msgspec.structs import replace

from swarmd.core.messages import Body, Member, Presence
from swarmd.core.record import RecordKind
from swarmd.network.datagram import (
    MAX_HOPS,
    PRESENCES,
    Address,
    Beacon,
    BodyReport,
    Flag,
    MemberList,
    MemberReport,
)

MAX_MEMBERS = 1024
MAX_INSTANCES = 4
# A member that is silent for this share of its lease is solicited, once per PROBE_PERIOD.
PROBE_SHARE = 0.5
PROBE_PERIOD = 0.25
# A beacon with a lower number than the last is a delayed one for this long, in s.
LATE_TIME = 1.5
# A failed member that was heard for less than this was a stranger, and is dropped after a while.
STRANGER_TIME = 10.0
STRANGER_KEPT = 120.0
MEMBER_KEPT = 600.0  # s for which one that is gone and was no stranger keeps its place


@dataclass(slots=True)
class _Instance:
    """One life of a robot. `since`: first beacon as the owner of its id."""

    since: float
    heard: float
    beacon: Beacon
    address: Address
    has_left: bool = False


@dataclass(slots=True)
class _Record:
    """`shown`: the instance and presence at the last event, and `since` when.

    `body`: what the latest instance that tells its body told of it.
    """

    instances: dict[bytes, _Instance] = field(default_factory=dict)
    body: BodyReport | None = None
    shown: tuple[bytes, Presence] | None = None
    since: float = 0.0
    first: float = 0.0
    probed: float = 0.0

    @property
    def is_stranger(self) -> bool:
        """True if the robot was heard for a short time only."""
        return self.latest.heard - self.first < STRANGER_TIME

    @property
    def latest(self) -> _Instance:
        """The instance that appeared last."""
        return next(reversed(self.instances.values()))

    def living(self, lease: float, now: float) -> list[bytes]:
        """The living instances, the newest first.

        An older one counts only if it was heard after the newest appeared: a robot that restarts
        is no duplicate of itself.
        """
        newest = self.latest
        return [
            name
            for name, one in reversed(self.instances.items())
            if not one.has_left
            and now - one.heard <= lease
            and (one is newest or one.heard > newest.since)
        ]


@dataclass(frozen=True, slots=True)
class IndirectMember:
    """A robot that others know: their description, by whom and when it came."""

    heard: MemberReport
    by: str
    at: float

    def age(self, now: float) -> float:
        """Seconds since the robot was heard by whoever hears it directly."""
        return self.heard.age / 1000.0 + max(now - self.at, 0.0)


class Membership:
    """The other robots of a swarm; `own` is never among them.

    Bounded: beyond MAX_MEMBERS a new robot replaces the one that is gone the longest, and is
    ignored and counted in `ignored` if all are alive.
    """

    def __init__(self, own: str, lease: float) -> None:
        self._own = own
        self._lease = lease
        self._records: dict[str, _Record] = {}
        self._indirect: dict[str, IndirectMember] = {}
        self.ignored = 0

    def on_beacon(self, beacon: Beacon, address: Address, now: float) -> bool:
        """A robot that owns its id sent a beacon; True if its presence or instance changed."""
        if beacon.robot == self._own or beacon.flags & Flag.JOINING:
            return False
        record = self._records.get(beacon.robot)
        if record is None:
            if beacon.flags & Flag.LEFT:
                return False
            if len(self._records) >= MAX_MEMBERS and not self._make_room(now):
                self.ignored += 1
                return False
            record = self._records[beacon.robot] = _Record(first=now)
        self._indirect.pop(beacon.robot, None)
        instance = record.instances.get(beacon.instance)
        if instance is None:
            instance = _Instance(now, now, beacon, address)
            record.instances[beacon.instance] = instance
            for old in list(record.instances)[:-MAX_INSTANCES]:
                del record.instances[old]
        elif beacon.sequence <= instance.beacon.sequence and now - instance.heard < LATE_TIME:
            return False  # delayed; after that time a forged number must not hide the robot
        instance.heard, instance.beacon, instance.address = now, beacon, address
        instance.has_left = bool(beacon.flags & Flag.LEFT)
        if beacon.body is not None and (record.body is None or instance is record.latest):
            record.body = beacon.body
        return self._settle(record, now)

    def on_member_list(self, members: MemberList, now: float) -> None:
        """A robot sent a part of its list of members."""
        for heard in members.members:
            record = self._records.get(heard.robot)
            is_heard_here = record is not None and record.shown is not None
            if heard.robot == self._own or heard.hops >= MAX_HOPS or is_heard_here:
                continue
            known = self._indirect.get(heard.robot)
            if not _is_ip_address(heard.host):
                heard = replace(heard, host="", port=0)
            indirect = IndirectMember(heard, members.robot, now)
            if known is None and len(self._indirect) >= MAX_MEMBERS:
                self.ignored += 1
            elif known is None or indirect.age(now) < known.age(now):
                self._indirect[heard.robot] = indirect

    def advance(self, now: float) -> list[str]:
        """End the leases that are over; the robots whose presence changed."""
        changed = [robot for robot, record in self._records.items() if self._settle(record, now)]
        for robot, record in list(self._records.items()):
            if _is_gone(record) and record.is_stranger and now - record.since > STRANGER_KEPT:
                del self._records[robot]
        for robot, indirect in list(self._indirect.items()):
            if now - indirect.at > STRANGER_KEPT:
                del self._indirect[robot]
        return changed

    def to_probe(self, now: float) -> list[Address]:
        """The addresses of members whose beacons are overdue."""
        found = []
        for record in self._records.values():
            if _is_gone(record) or record.shown is None:
                continue
            silence = now - record.latest.heard
            if silence > PROBE_SHARE * self._lease and now - record.probed >= PROBE_PERIOD:
                record.probed = now
                found.append(record.latest.address)
        return found

    def forget(self, robot: str) -> bool:
        """Remove a robot; False if it is alive or unknown."""
        self._indirect.pop(robot, None)
        record = self._records.get(robot)
        if record is None or not _is_gone(record):
            return False
        del self._records[robot]
        return True

    def keep_only(self, robots: Collection[str]) -> None:
        """Remove all other robots, alive or not: they are no longer on the roster."""
        for known in (self._records, self._indirect):
            for robot in known.keys() - set(robots):
                del known[robot]

    def member(self, robot: str, now: float) -> Member | None:
        """One member, or None if it was never heard or is forgotten."""
        record = self._records.get(robot)
        if record is None or record.shown is None:
            return None
        instance, presence = record.shown
        return Member(
            robot=robot,
            instance=instance.hex(),
            presence=presence,
            age=max(0.0, now - record.since),
        )

    def members(self, now: float) -> dict[str, Member]:
        """All members by id, in the order of their names."""
        found = ((robot, self.member(robot, now)) for robot in sorted(self._records))
        return {robot: member for robot, member in found if member is not None}

    def bodies(self) -> dict[str, Body | None]:
        """What each member that was heard here tells of its body; None: nothing so far.

        Also of those that left or failed, until they are forgotten: they still stand somewhere. An
        instance that tells nothing of its body does not take back what another one told.
        """
        return {
            robot: None if record.body is None else record.body.body
            for robot, record in self._records.items()
            if record.shown is not None
        }

    @property
    def indirect(self) -> Mapping[str, IndirectMember]:
        """The robots that only others hear."""
        return self._indirect

    def is_address(self, address: Address) -> bool:
        """True if a member that is alive was last heard from this address."""
        return any(address == known for _, known in self.alive_addresses())

    def indirect_address(self, robot: str) -> Address | None:
        """The address at which others hear a robot that is not heard here."""
        indirect = self._indirect.get(robot)
        return None if indirect is None else (indirect.heard.host, indirect.heard.port)

    def is_present(self, robot: str, instance: bytes) -> bool:
        """True if this instance is shown as alive."""
        record = self._records.get(robot)
        return record is not None and record.shown == (instance, Presence.ALIVE)

    def goals(self) -> Iterator[tuple[bytes, bytes]]:
        """The instance of each robot that is alive, and the digest of the goal that it shows."""
        for record in self._records.values():
            if record.shown is not None and record.shown[1] is Presence.ALIVE:
                instance = record.shown[0]
                yield instance, record.instances[instance].beacon.digest(RecordKind.GOAL)

    def latches_of(self, robot: str, instance: bytes) -> bytes | None:
        """The digest of latches in the newest beacon of an instance that is alive."""
        if not self.is_present(robot, instance):
            return None
        return self._records[robot].instances[instance].beacon.digest(RecordKind.LATCH)

    def is_established(self, robot: str) -> bool:
        """True if the robot was heard here for longer than a stranger."""
        record = self._records.get(robot)
        return record is not None and record.shown is not None and not record.is_stranger

    def knows(self, robot: str) -> bool:
        """True if the robot was heard here or by others."""
        return robot in self._records or robot in self._indirect

    def address(self, robot: str) -> Address | None:
        """The address from which a member was last heard."""
        record = self._records.get(robot)
        return None if record is None or record.shown is None else record.latest.address

    def alive_addresses(self) -> Iterable[tuple[str, Address]]:
        """The members that are alive, with their addresses."""
        for robot, record in self._records.items():
            if record.shown is not None and record.shown[1] is Presence.ALIVE:
                yield robot, record.latest.address

    def reports(self, now: float) -> tuple[MemberReport, ...]:
        """The list for others: the robots heard here, then those that only others hear."""
        known = []
        for robot, record in sorted(self._records.items()):
            if record.shown is None:
                continue
            presence, latest = record.shown[1], record.latest
            since = latest.heard if presence is Presence.ALIVE else record.since
            known.append(
                MemberReport(
                    robot=robot,
                    instance=record.shown[0],
                    presence=PRESENCES.index(presence),
                    age=round(max(now - since, 0.0) * 1000),
                    host=latest.address[0].partition("%")[0],
                    port=latest.address[1],
                )
            )
        for robot, indirect in sorted(self._indirect.items()):
            heard = indirect.heard
            age = round(indirect.age(now) * 1000)
            known.append(
                MemberReport(
                    robot=robot,
                    instance=heard.instance,
                    presence=heard.presence,
                    age=age,
                    hops=heard.hops + 1,
                    host=heard.host,
                    port=heard.port,
                )
            )
        return tuple(known)

    def duplicates(self, now: float) -> Mapping[str, tuple[str, ...]]:
        """Robot ids that more than one living instance holds, with those instances."""
        found = {
            robot: tuple(sorted(name.hex() for name in record.living(self._lease, now)))
            for robot, record in self._records.items()
        }
        return {robot: living for robot, living in found.items() if len(living) > 1}

    def _make_room(self, now: float) -> bool:
        """Drop a stranger that is gone, or a member that is gone for long."""
        gone = [
            (record.since, robot)
            for robot, record in self._records.items()
            if _is_gone(record) and (record.is_stranger or now - record.since > MEMBER_KEPT)
        ]
        if gone:
            del self._records[min(gone)[1]]
        return bool(gone)

    def _settle(self, record: _Record, now: float) -> bool:
        living = record.living(self._lease, now)
        name, latest = next(reversed(record.instances.items()))
        if living:
            shown = living[0], Presence.ALIVE
        else:
            shown = name, Presence.LEFT if latest.has_left else Presence.FAILED
        if shown == record.shown:
            return False
        record.shown, record.since = shown, now
        return True


def _is_gone(record: _Record) -> bool:
    return record.shown is not None and record.shown[1] is not Presence.ALIVE


def _is_ip_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True
