"""The members of a swarm: alive, left or failed. Pure: datagrams and times in.

The lease (`link/settings.py`) is the silence after which a member has failed. Each robot or
operator judges for itself. A member is

- alive while its beacons (datagrams, one a second) are heard. A silent member is solicited (asked
  for a beacon) before its lease ends.
- left once its latest instance (life of its daemon) sent a beacon with Flag.LEFT,
- failed when its lease ended without a beacon with Flag.LEFT. A failed member stays listed until it
  returns or is forgotten.

An indirect member is a robot that only the member lists of other robots name: its beacons do not
arrive here. A robot hands indirect members on with their age and the number of hops. Indirect
members are no neighbors. An operator keeps the reports of robots in `operator/member_reports.py`.
Times are in s on the caller's monotonic clock.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Collection, Iterable, Iterator, Mapping
from enum import Enum, auto

from msgspec import Struct
from msgspec.structs import replace

from swarmd.core.bounds import MAX_SECONDS
from swarmd.core.messages import Body, Member, Presence
from swarmd.core.record import RecordKind
from swarmd.link.datagram import (
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
MAX_INSTANCES = 8
# A member that is silent for this share of its lease is solicited, once per PROBE_PERIOD.
PROBE_SHARE = 0.5
PROBE_PERIOD = 0.25
LATE_TIME = 1.5  # s for which a beacon with a lower number than the last counts as delayed
# A failed member that was heard for less than STRANGER_TIME s was a stranger.
STRANGER_TIME = 10.0
STRANGER_KEPT = 120.0  # s after which a stranger that is gone is dropped
MEMBER_KEPT = 600.0  # s for which any other member that is gone keeps its place


class Life(Struct):
    """One life of a robot."""

    since: float  # the time of the first beacon of the robot as the owner of its id
    heard: float  # the time of the newest beacon
    beacon: Beacon  # the newest beacon
    address: Address  # the address of the newest beacon
    version: str = ""  # the version of the package, once a beacon has shown it
    left: float | None = None  # the time of the farewell
    has_returned: bool = False  # a beacon came after the farewell, which was false

    def take(self, beacon: Beacon, address: Address, now: float, *, is_answer: bool) -> bool:
        """Take a beacon; False if the beacon is ignored: a delayed beacon, or a false farewell.

        1. A beacon whose number is not above the number of the newest beacon counts as delayed for
           LATE_TIME after the newest beacon came. After this time the beacon is taken: a forged
           beacon with a high number must not hide the robot for long.
        2. `is_answer`: the beacon answers a question that was asked after the farewell (Flag.LEFT)
           of this life. Such a beacon never counts as delayed.
        3. A beacon after a farewell shows that the farewell was false. From then on each farewell
           of this life counts as false.
        """
        is_farewell = bool(beacon.flags & Flag.LEFT)
        is_delayed = beacon.sequence <= self.beacon.sequence and now - self.heard < LATE_TIME
        answers_after_farewell = self.left is not None and is_answer
        if is_delayed and not answers_after_farewell:
            return False
        if is_farewell and self.has_returned:
            return False
        self.has_returned |= self.left is not None and not is_farewell
        self.heard = now
        self.beacon = beacon
        self.address = address
        self.version = beacon.version or self.version
        self.left = now if is_farewell else None
        return True


class Change(Enum):
    """What a beacon has changed in the membership."""

    IGNORED = auto()  # the beacon has changed nothing
    REFRESHED = auto()  # the time, address and content of a known life
    FOUND = auto()  # a new life, or a life whose farewell was false
    LEFT = auto()  # the life has ended by its farewell


class _Robot(Struct):
    """The lives of one robot."""

    first: float  # the time of the first beacon
    lives: dict[bytes, Life] = {}  # the lives by instance, in the order of their first beacons
    body: BodyReport | None = None  # the body that the latest life with a body reports
    shown: tuple[bytes, Presence] | None = None  # the instance and presence that were last reported
    since: float = 0.0  # the time of that report
    probed: float = 0.0  # the time of the last solicit

    @property
    def is_stranger(self) -> bool:
        """True if the robot was heard for a short time only."""
        return self.latest.heard - self.first < STRANGER_TIME

    @property
    def latest(self) -> Life:
        """The life that appeared last."""
        return next(reversed(self.lives.values()))

    def living(self, lease: float, now: float) -> list[bytes]:
        """The instances that were heard within `lease` s and did not leave, the newest first.

        An older instance is included only if it was heard after the first beacon of the newest
        instance: a robot that restarts is no duplicate of itself.
        """
        newest = self.latest
        return [
            name
            for name, life in reversed(self.lives.items())
            if life.left is None
            and now - life.heard <= lease
            and (life is newest or life.heard > newest.since)
        ]


class IndirectMember(Struct, frozen=True):
    """A robot that other robots know."""

    report: MemberReport  # the newest report of another robot
    by: str  # the robot that sent the report
    at: float  # the time at which the report came

    def age(self, now: float) -> float:
        """Seconds since any robot heard the reported robot directly; at most MAX_SECONDS."""
        return min(self.report.age / 1000.0 + max(now - self.at, 0.0), MAX_SECONDS)


class Membership:
    """The other robots of a swarm, as this robot or operator hears them.

    `own`: the name of this robot, which is never a member; empty for an operator. `lease`: s of
    silence after which a member has failed. Beyond MAX_MEMBERS robots, a new robot replaces the
    robot that left or failed first, if that robot may be dropped (`_make_room`). Otherwise the new
    robot is ignored, and counted in `ignored`.
    """

    def __init__(self, own: str, lease: float) -> None:
        self._own = own
        self._lease = lease
        self._robots: dict[str, _Robot] = {}
        self._indirect: dict[str, IndirectMember] = {}
        self.ignored = 0

    def on_beacon(self, beacon: Beacon, address: Address, now: float) -> bool:
        """Take a beacon; True if the presence or instance of its robot changed."""
        change = self.take(beacon, address, now)
        return change is not Change.IGNORED and self._settle(self._robots[beacon.robot], now)

    def take(
        self, beacon: Beacon, address: Address, now: float, *, is_answer: bool = False
    ) -> Change:
        """Take a beacon; returns what the beacon has changed.

        A *life* is the time from start to end of one daemon, marked by its random `instance`. A
        *farewell* is the last beacon of a life (Flag.LEFT). `is_answer`: the robot sent a farewell,
        was then asked whether it is alive, and answers by this beacon. Returns IGNORED for

        - a beacon in the name of this robot,
        - a beacon of a robot that still claims its id,
        - the farewell of an unknown life,
        - a beacon of a new robot, while MAX_MEMBERS robots are known and none may be replaced,
        - a delayed beacon of a known life (`Life.take`),
        - a farewell of a known life whose earlier farewell was false (`Life.take`).
        """
        if beacon.robot == self._own or beacon.flags & Flag.JOINING:
            return Change.IGNORED
        robot = self._robots.get(beacon.robot)
        life = None if robot is None else robot.lives.get(beacon.instance)
        if life is None:
            change = self._begin_life(beacon, address, now)
        else:
            change = _continue_life(life, beacon, address, now, is_answer=is_answer)
        if change is not Change.IGNORED:
            self._take_body(beacon)
        return change

    def _begin_life(self, beacon: Beacon, address: Address, now: float) -> Change:
        """Take the first beacon of a life, perhaps of a new robot."""
        name = beacon.robot
        if beacon.flags & Flag.LEFT:
            return Change.IGNORED
        robot = self._robots.get(name)
        if robot is None:
            if len(self._robots) >= MAX_MEMBERS and not self._make_room(now):
                self.ignored += 1
                return Change.IGNORED
            robot = self._robots[name] = _Robot(first=now)
        self._indirect.pop(name, None)  # the robot is heard directly from now on
        life = Life(now, now, beacon, address, beacon.version)  # appeared and heard now
        robot.lives[beacon.instance] = life  # behind the earlier lives: the latest
        for oldest_instance in list(robot.lives)[:-MAX_INSTANCES]:  # all but the newest
            del robot.lives[oldest_instance]
        return Change.FOUND

    def _take_body(self, beacon: Beacon) -> None:
        """Take the body (outline of the base) that a beacon of a known life reports.

        The body comes from the latest life. A beacon of an earlier life, which may still arrive,
        gives the body only while no body is known.
        """
        robot = self._robots[beacon.robot]
        is_latest = robot.lives[beacon.instance] is robot.latest
        if beacon.body is not None and (robot.body is None or is_latest):
            robot.body = beacon.body

    def on_member_list(self, members: MemberList, now: float) -> None:
        """Take a part of a robot's member list: keep the newest report on each indirect member."""
        for heard in members.members:
            robot = self._robots.get(heard.robot)
            is_heard_here = robot is not None and robot.shown is not None
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
        """End the leases that are over; returns the robots whose presence changed."""
        changed = [robot for robot, known in self._robots.items() if self._settle(known, now)]
        for robot, known in list(self._robots.items()):
            if _is_gone(known) and known.is_stranger and now - known.since > STRANGER_KEPT:
                del self._robots[robot]
        for robot, indirect in list(self._indirect.items()):
            if now - indirect.at > STRANGER_KEPT:
                del self._indirect[robot]
        return changed

    def to_probe(self, now: float) -> list[Address]:
        """The addresses of silent members that are to be solicited now."""
        overdue = []
        for known in self._robots.values():
            if _is_gone(known) or known.shown is None:
                continue
            silence = now - known.latest.heard
            if silence > PROBE_SHARE * self._lease and now - known.probed >= PROBE_PERIOD:
                known.probed = now
                overdue.append(known.latest.address)
        return overdue

    def forget(self, robot: str) -> bool:
        """Remove a robot; False if it is alive or unknown."""
        self._indirect.pop(robot, None)
        known = self._robots.get(robot)
        if known is None or not _is_gone(known):
            return False
        del self._robots[robot]
        return True

    def keep_only(self, robots: Collection[str]) -> None:
        """Remove all robots that are not in `robots`, alive or not: the roster lacks them."""
        for known in (self._robots, self._indirect):
            for robot in known.keys() - set(robots):
                del known[robot]

    def member(self, robot: str, now: float) -> Member | None:
        """One member; None for a robot that was never heard or is forgotten."""
        known = self._robots.get(robot)
        if known is None or known.shown is None:
            return None
        instance, presence = known.shown
        return Member(
            robot=robot,
            instance=instance.hex(),
            presence=presence,
            age=max(0.0, now - known.since),
        )

    def lost_beacon(self, robot: str) -> Beacon | None:
        """The last beacon of a robot that is shown as failed; None for any other robot."""
        known = self._robots.get(robot)
        if known is None or known.shown is None or known.shown[1] is not Presence.FAILED:
            return None
        return known.latest.beacon

    def members(self, now: float) -> dict[str, Member]:
        """All members by id, in the order of their names."""
        members = ((robot, self.member(robot, now)) for robot in sorted(self._robots))
        return {robot: member for robot, member in members if member is not None}

    def bodies(self) -> dict[str, Body | None]:
        """By robot, the body (outline and sensor heights) that the robot reported; None without.

        Members that left or failed are included until they are forgotten: such robots still stand
        somewhere. The report of an earlier instance holds until a newer instance reports a body.
        """
        return {
            robot: None if known.body is None else known.body.body
            for robot, known in self._robots.items()
            if known.shown is not None
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
        return None if indirect is None else (indirect.report.host, indirect.report.port)

    def is_present(self, robot: str, instance: bytes) -> bool:
        """True if this instance is shown as alive."""
        known = self._robots.get(robot)
        return known is not None and known.shown == (instance, Presence.ALIVE)

    def goals(self) -> Iterator[tuple[bytes, bytes]]:
        """The instance of each robot that is alive, and the digest of the goal that it shows."""
        for known in self._robots.values():
            if known.shown is not None and known.shown[1] is Presence.ALIVE:
                instance = known.shown[0]
                yield instance, known.lives[instance].beacon.digest(RecordKind.GOAL)

    def latches_of(self, robot: str, instance: bytes) -> bytes | None:
        """The digest of latches in the newest beacon of an instance that is alive."""
        if not self.is_present(robot, instance):
            return None
        return self._robots[robot].lives[instance].beacon.digest(RecordKind.LATCH)

    def is_established(self, robot: str) -> bool:
        """True if the robot was heard here for longer than a stranger."""
        known = self._robots.get(robot)
        return known is not None and known.shown is not None and not known.is_stranger

    def knows(self, robot: str) -> bool:
        """True if the robot was heard here or by others."""
        return robot in self._robots or robot in self._indirect

    def address(self, robot: str) -> Address | None:
        """The address from which a member was last heard."""
        known = self._robots.get(robot)
        return None if known is None or known.shown is None else known.latest.address

    def alive_addresses(self) -> Iterable[tuple[str, Address]]:
        """The members that are alive, with their addresses."""
        for robot, known in self._robots.items():
            if known.shown is not None and known.shown[1] is Presence.ALIVE:
                yield robot, known.latest.address

    def reports(self, now: float) -> tuple[MemberReport, ...]:
        """The member list for other robots: the robots heard here, then the indirect members.

        An indirect member is a robot that only other robots hear. The report on a robot that is
        alive has the ms since its last beacon as `age`, any other report the ms since the robot
        left or failed. `hops`: how many robots have handed on the report.
        """
        reports = []
        for robot, entry in sorted(self._robots.items()):
            if entry.shown is None:  # not yet reported as a member
                continue
            instance, presence = entry.shown
            latest = entry.latest
            since = latest.heard if presence is Presence.ALIVE else entry.since
            reports.append(
                MemberReport(
                    robot=robot,
                    instance=instance,
                    presence=PRESENCES.index(presence),
                    age=round(max(now - since, 0.0) * 1000),
                    host=latest.address[0].partition("%")[0],  # without the scope, known only here
                    port=latest.address[1],
                )
            )
        for robot, indirect in sorted(self._indirect.items()):
            report = indirect.report
            age = round(indirect.age(now) * 1000)
            reports.append(replace(report, robot=robot, age=age, hops=report.hops + 1))
        return tuple(reports)

    def duplicates(self, now: float) -> Mapping[str, tuple[str, ...]]:
        """Robot ids that more than one living instance holds, with those instances."""
        living_of = {
            robot: tuple(sorted(name.hex() for name in known.living(self._lease, now)))
            for robot, known in self._robots.items()
        }
        return {robot: living for robot, living in living_of.items() if len(living) > 1}

    # Of one robot, by instance

    @property
    def heard(self) -> frozenset[str]:
        """The robots that were heard and did not leave."""
        return frozenset(
            name
            for name, robot in self._robots.items()
            if any(life.left is None for life in robot.lives.values())
        )

    def was_heard(self, robot: str) -> bool:
        """True if a life of the robot was heard, also if it left."""
        return robot in self._robots

    def lives(self, robot: str) -> dict[str, Life]:
        """The lives of a robot that were heard and did not leave."""
        known = self._robots.get(robot)
        lives = {} if known is None else known.lives
        return {name.hex(): life for name, life in lives.items() if life.left is None}

    def farewells(self, robot: str) -> dict[str, float]:
        """The times of the farewells of the instances of a robot that left."""
        known = self._robots.get(robot)
        lives = {} if known is None else known.lives
        return {name.hex(): life.left for name, life in lives.items() if life.left is not None}

    def left_at(self, robot: str, instance: bytes) -> float | None:
        """The time of an instance's farewell; None without."""
        known = self._robots.get(robot)
        life = None if known is None else known.lives.get(instance)
        return None if life is None else life.left

    def last_heard(self, robot: str) -> Life | None:
        """The life of a robot that was heard last, and did not leave."""
        known = self._robots.get(robot)
        if known is None:
            return None
        lives = known.lives.values()
        if len(lives) == 1:  # as of nearly all robots; an operator asks for each at each beacon
            (life,) = lives
            return life if life.left is None else None
        present = (life for life in lives if life.left is None)
        return max(present, key=lambda life: life.heard, default=None)

    def holders(self, robot: str) -> frozenset[str]:
        """The living instances of a robot when it was heard last; several hold one id."""
        last = self.last_heard(robot)
        if last is None:
            return frozenset()
        known = self._robots[robot]
        if len(known.lives) == 1:
            return frozenset(name.hex() for name in known.lives)
        living = known.living(self._lease, last.heard)
        return frozenset(name.hex() for name in living)

    # Parts

    def _make_room(self, now: float) -> bool:
        """Drop a stranger that is gone, or a member that is gone for long."""
        gone = [
            (known.since, robot)
            for robot, known in self._robots.items()
            if _is_gone(known) and (known.is_stranger or now - known.since > MEMBER_KEPT)
        ]
        if gone:
            del self._robots[min(gone)[1]]
        return bool(gone)

    def _settle(self, known: _Robot, now: float) -> bool:
        """Update the reported instance and presence of a robot; True if these have changed."""
        living = known.living(self._lease, now)
        name, latest = next(reversed(known.lives.items()))
        if living:
            present = living[0], Presence.ALIVE
        else:
            present = name, Presence.LEFT if latest.left is not None else Presence.FAILED
        if present == known.shown:
            return False
        known.shown = present
        known.since = now
        return True


def _continue_life(
    life: Life, beacon: Beacon, address: Address, now: float, *, is_answer: bool
) -> Change:
    """Take a further beacon of a known life; returns what the beacon has changed."""
    had_left = life.left is not None
    if not life.take(beacon, address, now, is_answer=is_answer):
        return Change.IGNORED
    if beacon.flags & Flag.LEFT:
        return Change.LEFT
    return Change.FOUND if had_left else Change.REFRESHED


def _is_gone(known: _Robot) -> bool:
    return known.shown is not None and known.shown[1] is not Presence.ALIVE


def _is_ip_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True
