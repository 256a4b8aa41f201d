"""What robots tell a look of themselves and of others. Pure.

- `MemberReports`: what robots report of other robots, by member lists and by views.
- `StatusParts`: the statuses that robots tell by datagram. A robot that tells its status announces
  the number of parts in the beacon that answers the solicit (`Beacon.status_parts`), and sends the
  parts after it. A robot of an earlier version, of a secured swarm, or with a long status announces
  none: its status is asked for on a link. So is that of a robot whose parts do not arrive within a
  time.
- `StatusTable`: the statuses with which robots answered. A `SeenMember` is made from a robot's
  beacons, its status and the reports of other robots.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Collection, Iterable, Iterator, KeysView, Mapping
from functools import cache, lru_cache
from math import inf

from msgspec import Struct

from swarmd.core import codec
from swarmd.core.bounds import keep_newest
from swarmd.core.codec import Decoder, version_of
from swarmd.core.messages import Epoch, Member, PeerView, Presence, Status, StatusHeader
from swarmd.link.datagram import (
    PRESENCES,
    STATES,
    Address,
    Beacon,
    MemberList,
    MemberReport,
    StatusPart,
)
from swarmd.link.members.membership import MAX_INSTANCES, MAX_MEMBERS, Life
from swarmd.operator.session.clocks import MOST_INSTANCES
from swarmd.operator.session.members_view import Contact, SeenMember

FRESH_TIME = 3.0  # s for which a beacon counts, and a report of a beacon
MAX_PARTIAL_LISTS = 4  # lists of one robot, with missing parts, that are kept

LIST = "list"
VIEW = "view"
EARLIER = "earlier"
"""The ways of a report: a member list, a view, an earlier look of the operator (with reporter "").

The list of a robot counts before its view: only the list says when a living robot was heard.
"""


class PeerReport(Struct, frozen=True):
    """The report of one robot on another."""

    instance: str
    presence: Presence
    at: float  # s at which the robot was heard (alive), left or failed
    by: str = ""  # the robot that reports
    address: Address | None = None  # the address of the reported robot


@lru_cache(maxsize=2048)  # each robot is in the list of each other robot
def reported_address(host: str, port: int, *, is_local: bool) -> Address | None:
    """The address of a robot in the report of another robot; None if the address is not valid.

    A valid host is an IP address, but no multicast address. Only a link-local IPv6 address may have
    a scope, which must be a number. `is_local` True: all robots are on this machine, so the host
    must be in 127.0.0.0/8. False: the host must not be a loopback address.
    """
    try:
        ip = ipaddress.ip_address(host)
    except ValueError:
        return None
    scope = ip.scope_id if isinstance(ip, ipaddress.IPv6Address) else None
    if scope is not None and not (ip.is_link_local and scope.isascii() and scope.isdecimal()):
        return None
    if ip.is_unspecified or ip.is_multicast or not 1 <= port <= 65535:
        return None
    if ip.is_loopback is not is_local or (is_local and ip.version != 4):
        return None
    return host, port


def most_certain(reports: Iterable[PeerReport]) -> PeerReport | None:
    """The most certain of the reports on one robot; None without reports.

    1. The newest report that the robot is alive, if there is one.
    2. Else only reports on one instance (life of the daemon) count: the instance in the newest
       report. Of these, the newest report that the instance has left the swarm, if there is one.
    3. Else the newest of these reports, which says that the instance failed.
    """
    on_robot = list(reports)
    alive = [report for report in on_robot if report.presence is Presence.ALIVE]
    if alive:
        return max(alive, key=lambda report: report.at)
    newest = max(on_robot, key=lambda report: report.at, default=None)
    if newest is None:
        return None
    on_instance = [report for report in on_robot if report.instance == newest.instance]
    return max(on_instance, key=lambda report: (report.presence is Presence.LEFT, report.at))


def reports_of_view(view: PeerView, now: float) -> dict[str, list[PeerReport]]:
    """The reports in a view, by the robot that they concern."""
    reports: dict[str, list[PeerReport]] = {}
    for member in view.members:
        at = now if member.presence is Presence.ALIVE else now - member.age
        reports.setdefault(member.robot, []).append(
            PeerReport(member.instance, member.presence, at, by=view.robot)
        )
    return reports


class MemberReports:
    """The newest reports of each robot on each of the others.

    `is_local`: all robots are on this machine, by the loopback interface.
    """

    def __init__(self, *, is_local: bool) -> None:
        self._is_local = is_local
        # By robot, then by echo and part: a list in parts counts once it is whole.
        self._lists: dict[str, dict[tuple[int, int], tuple[MemberList, float]]] = {}
        # By the robot reported, then by reporter and way.
        self._reports: dict[str, dict[tuple[str, str], list[PeerReport]]] = {}
        # By robot id, then by reporter: the instances, if the reporter has several alive.
        self._doubles: dict[str, dict[str, frozenset[str]]] = {}

    # Events

    def add_list(
        self, new_part: MemberList, now: float
    ) -> tuple[dict[str, list[PeerReport]], bool]:
        """Keep a part of a robot's member list; returns reports by robot, and whether they add.

        A list comes in parts, in several datagrams; the `echo` of the solicit marks the parts of
        one list. `_drop_old_parts` decides which parts are kept. True: all parts that were kept
        before are kept, and the reports of the new part come in addition. False: the reports are
        those of all kept parts.
        """
        parts = self._lists.setdefault(new_part.robot, {})
        number = (new_part.echo, new_part.part)
        is_new = number not in parts
        kept_before = len(parts)
        parts[number] = (new_part, now)
        _drop_old_parts(parts)
        adds = is_new and len(parts) == kept_before + 1
        counted = [parts[number]] if adds else parts.values()
        reports: dict[str, list[PeerReport]] = {}
        for part, at in counted:
            for member in part.members:
                # A greater number is a presence of a later version.
                if member.presence < len(PRESENCES):
                    report = self._report(member, new_part.robot, at)
                    reports.setdefault(member.robot, []).append(report)
        return reports, adds

    def _report(self, member: MemberReport, reporter: str, at: float) -> PeerReport:
        """The report in a member list that came at `at` s."""
        return PeerReport(
            instance=member.instance.hex(),
            presence=PRESENCES[member.presence],
            at=at - member.age / 1000.0,
            by=reporter,
            address=reported_address(member.host, member.port, is_local=self._is_local),
        )

    def drop(self, reporter: str, way: str) -> None:
        """Drop what a robot reported by one way, before its newer reports are stored."""
        for known in self._reports.values():
            known.pop((reporter, way), None)
        for doubles in self._doubles.values():
            doubles.pop(reporter, None)

    def store(
        self, robot: str, reporter: str, way: str, reports: list[PeerReport], *, adds: bool = False
    ) -> None:
        """Keep what `reporter` reports of `robot` by one way (LIST, VIEW or EARLIER).

        `adds`: in addition to what it has reported of the robot by that way.
        """
        known = self._reports.setdefault(robot, {})
        if adds:
            reports = [*known.get((reporter, way), ()), *reports]
        known[reporter, way] = reports[:MAX_INSTANCES]
        alive = {report.instance for report in reports if report.presence is Presence.ALIVE}
        if len(alive) > 1:
            self._doubles.setdefault(robot, {})[reporter] = frozenset(alive)

    def forget(self, robot: str) -> None:
        """Drop the reports on a robot, and its own member list."""
        for known in (self._reports, self._doubles, self._lists):
            known.pop(robot, None)

    # What is known

    def of(self, robot: str) -> list[PeerReport]:
        """The reports on a robot: from each reporter's list, or, without a list, from its view."""
        reporters = self._reports.get(robot, {})
        return [
            report
            for (reporter, way), reports in reporters.items()
            if way == LIST or (reporter, LIST) not in reporters
            for report in reports
        ]

    def is_reported(self, robot: str) -> bool:
        """True if there is a report on a robot."""
        return any(self._reports.get(robot, {}).values())

    def is_alive(self, robot: str, instance: str) -> bool:
        """True if any robot reports this instance of `robot` as alive."""
        return any(
            report.instance == instance and report.presence is Presence.ALIVE
            for reports in self._reports.get(robot, {}).values()
            for report in reports
        )

    def is_any_alive(self, robot: str, *, but: Collection[str]) -> bool:
        """True if a report in `of` says that an instance of `robot` that is not in `but` is alive.

        Stops at the first such report: a stop asks for each robot that lacks an ack.
        """
        reporters = self._reports.get(robot, {})
        return any(
            report.presence is Presence.ALIVE and report.instance not in but
            for (reporter, way), reports in reporters.items()
            if way == LIST or (reporter, LIST) not in reporters
            for report in reports
        )

    def reporters(self, robot: str) -> frozenset[str]:
        """The robots that report a robot."""
        return frozenset(reporter for reporter, _ in self._reports.get(robot, {}))

    def doubles(self, robot: str) -> frozenset[str]:
        """The instances of an id that a single robot reports as alive at the same time."""
        return frozenset[str]().union(*self._doubles.get(robot, {}).values())

    def listed_alive(self, reporter: str) -> frozenset[str]:
        """The robots that a robot lists as alive."""
        return frozenset(
            robot
            for robot, reporters in self._reports.items()
            if any(
                report.presence is Presence.ALIVE for report in reporters.get((reporter, LIST), ())
            )
        )

    def has_list(self, robot: str) -> bool:
        """True if at least a part of a robot's member list has come."""
        return bool(self._lists.get(robot))

    def has_full_list(self, robot: str) -> bool:
        """True if all parts of a member list of the robot have come."""
        parts = self._lists.get(robot, {})
        return any(_has_all(parts, echo) for echo, _ in parts)

    def links(self, now: float) -> frozenset[tuple[str, str]]:
        """Pairs of robots, in order of their names, that report each other as alive."""
        alive = {
            (reporter, robot)
            for robot, reports in self._reports.items()
            for (reporter, _), on_robot in reports.items()
            if any(
                report.presence is Presence.ALIVE and now - report.at <= FRESH_TIME
                for report in on_robot
            )
        }
        return frozenset(pair for pair in alive if pair[0] < pair[1] and pair[::-1] in alive)


def _drop_old_parts(parts: dict[tuple[int, int], tuple[MemberList, float]]) -> None:
    """Drop the parts of one robot's lists that came before the oldest list to keep.

    The oldest list to keep is the last list of which all parts have come. While no list is whole,
    the last MAX_PARTIAL_LISTS lists are kept. `parts`: by echo and number, in order of arrival.
    """
    whole_lists = [echo for echo, _ in parts if _has_all(parts, echo)]
    newest_lists = list(dict.fromkeys(echo for echo, _ in parts))[-MAX_PARTIAL_LISTS:]
    oldest_kept = whole_lists[-1] if whole_lists else newest_lists[0]
    for echo, number in list(parts):
        if echo == oldest_kept:
            break
        del parts[echo, number]


def _has_all(parts: Mapping[tuple[int, int], tuple[MemberList, float]], echo: int) -> bool:
    """True if all parts of the answer to the solicit with this echo have come."""
    answer = [word for (number, _), (word, _) in parts.items() if number == echo]
    return bool(answer) and len(answer) >= answer[0].parts


# How long a look waits for the datagrams of a status before it dials the robot: s, and round trips.
PARTS_WAIT = 0.3
PARTS_TRIPS = 4.0
# A robot is asked again after these s, or after this number of round trips if that is longer.
ASK_PERIOD = 0.1
ASK_TRIPS = 1.5

Instance = tuple[str, str]
"""A robot, and one life of its daemon in hex."""


class StatusParts:
    """The parts that came of each instance, and which instances tell none."""

    def __init__(self) -> None:
        self._asked: set[int] = set()  # the numbers of the solicits that asked for statuses
        self._asked_at: dict[Instance, float] = {}
        # By robot and instance: the parts of the answer to the last solicit that it answered.
        self._parts: dict[str, dict[str, dict[int, StatusPart]]] = {}
        self.refusing: dict[Instance, None] = {}
        """The instances whose last answer announced no parts: they are asked on a link."""

    @property
    def has_asked(self) -> bool:
        """True once a solicit has asked for statuses."""
        return bool(self._asked)

    def on_asked(self, echo: int) -> None:
        """Note that the solicit with this number asks for statuses."""
        self._asked.add(echo)

    def begin_asks(
        self, instances: Iterable[Instance], now: float, round_trip: float, most: int
    ) -> list[Instance]:
        """Of `instances` those to ask again now, at most `most`; the call notes that they are.

        Those that were asked longest ago come first, so that in a large swarm each gets its turn.
        """
        period = max(ASK_PERIOD, ASK_TRIPS * round_trip)
        due = [
            (self._asked_at.get(one, -inf), one)
            for one in instances
            if one not in self.refusing and now - self._asked_at.get(one, -inf) >= period
        ]
        begun = [one for _, one in sorted(due)[:most]]
        for one in begun:
            keep_newest(self._asked_at, one, now, MOST_INSTANCES)
        return begun

    def on_beacon(self, beacon: Beacon, now: float) -> None:
        """Note what an answer announces; the beacon of an instance that is heard."""
        if beacon.echo not in self._asked:
            return
        instance = (beacon.robot, beacon.instance.hex())
        if instance not in self._asked_at:
            keep_newest(self._asked_at, instance, now, MOST_INSTANCES)
        if beacon.status_parts:
            self.refusing.pop(instance, None)
        else:
            keep_newest(self.refusing, instance, None, MOST_INSTANCES)

    def add(self, part: StatusPart) -> bytes | None:
        """Keep a part; the encoded status once all parts of one answer have come.

        The parts of the last solicit that was answered are kept: a status is never put together of
        two answers. A part that answers no solicit of this look is dropped.
        """
        if part.echo not in self._asked or part.part >= part.parts:
            return None
        if part.robot not in self._parts and len(self._parts) >= MAX_MEMBERS:
            return None
        instances = self._parts.setdefault(part.robot, {})
        instance = part.instance.hex()
        if instance not in instances and len(instances) >= MAX_INSTANCES:
            return None
        parts = instances.setdefault(instance, {})
        known = next(iter(parts.values()), part)
        if part.echo < known.echo:
            return None
        if part.echo > known.echo or part.parts != known.parts:
            parts.clear()
        parts[part.part] = part
        if len(parts) < part.parts:
            return None
        content = b"".join(parts[number].content for number in range(part.parts))
        parts.clear()
        return content

    @staticmethod
    def wait(round_trip: float) -> float:
        """How many s after a robot became known its status is asked for on a link."""
        return PARTS_WAIT + PARTS_TRIPS * round_trip


def decode_status(content: bytes) -> Status | StatusHeader:
    """An encoded status; of another version its header. CodecError if it cannot be read."""
    if version_of(content) == codec.VERSION:
        return _status_decoder()(content)
    return _header_decoder()(content)


# Made at the first status: most verbs read none.
@cache
def _status_decoder() -> Decoder[Status]:
    return Decoder(Status)


@cache
def _header_decoder() -> Decoder[StatusHeader]:
    return Decoder(StatusHeader, any_version=True)


class StatusAnswer(Struct, frozen=True):
    """The answer of a robot to a query of its status."""

    status: Status | StatusHeader  # a header from a robot of another version
    members: tuple[Member, ...]  # the members as the robot sees them
    at: float  # when the status came, in s


class StatusTable:
    """The newest answer of each instance."""

    def __init__(self) -> None:
        self._answers: dict[str, dict[str, StatusAnswer]] = {}

    def add(self, robot: str, answer: StatusAnswer) -> bool:
        """Keep an answer; True if it is the first answer of its instance."""
        known = self._answers.setdefault(robot, {})
        instance = answer.status.instance
        is_new = instance not in known
        if not is_new or len(known) < MAX_INSTANCES:
            known[instance] = answer
            return is_new
        return False

    def drop(self, robot: str, instance: str) -> None:
        """Drop the answer of an instance that left."""
        self._answers.get(robot, {}).pop(instance, None)

    @property
    def robots(self) -> KeysView[str]:
        """The robots of which an instance has answered, whether or not that instance left."""
        return self._answers.keys()

    def instances(self, robot: str) -> Mapping[str, StatusAnswer]:
        """The answers of the instances of a robot that did not leave."""
        return self._answers.get(robot, {})

    def newest(self, robot: str, living: Collection[str]) -> StatusAnswer | None:
        """The newest answer of a robot; only of instances in `living`, unless that is empty."""
        answers = self.instances(robot).values()
        counted = [answer for answer in answers if not living or answer.status.instance in living]
        return max(counted, key=lambda answer: answer.at, default=None)

    def statuses(self) -> Iterator[tuple[str, Status, tuple[Member, ...]]]:
        """The robot, the status and the members of each answer of this version."""
        for robot, answers in self._answers.items():
            for answer in answers.values():
                if isinstance(answer.status, Status):
                    yield robot, answer.status, answer.members

    def agree(self, robots: Collection[str]) -> bool:
        """True if at least two robots answered, and each lists all of `robots` as alive."""
        views = [(robot, members) for robot, _, members in self.statuses()]
        if len(robots) < 2 or len(views) < 2:
            return False
        return all(
            set(robots)
            <= {robot} | {member.robot for member in members if member.presence is Presence.ALIVE}
            for robot, members in views
        )


INDIRECT_TIME = 10.0  # s for which a robot that only other robots heard counts as alive


def present_member(
    robot: str, heard: Life | None, answer: StatusAnswer | None, now: float
) -> SeenMember:
    """The member `robot`, which is heard or has answered, at `now` in s.

    `heard`: the life of the robot whose beacons this operator hears; None without a beacon.
    `answer`: the robot's answer to a query of its status; None without an answer. Of a robot of
    another version only the head of the status can be read. Values of the status count before
    values of the beacon.
    """
    if answer is None:
        return _member_by_beacon(robot, heard, now)
    status = answer.status
    beacon = heard.beacon if heard is not None else None
    is_other_version = isinstance(status, StatusHeader) or _is_other_version(beacon)
    return SeenMember(
        robot=robot,
        instance=status.instance,
        presence=Presence.ALIVE,
        age=max(now - answer.at, 0.0),
        status=status if isinstance(status, Status) else None,
        contact=Contact.OTHER_VERSION if is_other_version else Contact.ANSWERED,
        state=status.state,
        wire=beacon.wire if beacon else None,
        version=status.version,
        header=status if isinstance(status, StatusHeader) else None,
        epoch=status.epoch if isinstance(status, Status) else _epoch_of(beacon),
    )


def _member_by_beacon(robot: str, heard: Life | None, now: float) -> SeenMember:
    """The member `robot`, which has not answered; `heard`: the life of its newest beacon."""
    beacon = heard.beacon if heard is not None else None
    has_known_state = beacon is not None and beacon.state < len(STATES)
    is_other_version = _is_other_version(beacon)
    return SeenMember(
        robot=robot,
        instance="unknown" if beacon is None else beacon.instance.hex(),
        presence=Presence.ALIVE,
        age=0.0 if heard is None else max(now - heard.heard, 0.0),
        status=None,
        contact=Contact.OTHER_VERSION if is_other_version else Contact.NO_ANSWER,
        state=STATES[beacon.state] if beacon is not None and has_known_state else "",
        wire=beacon.wire if beacon else None,
        version=heard.version if heard else "",
        epoch=_epoch_of(beacon),
    )


def _is_other_version(beacon: Beacon | None) -> bool:
    return beacon is not None and beacon.wire != codec.VERSION


def _epoch_of(beacon: Beacon | None) -> Epoch | None:
    return None if beacon is None else Epoch(beacon.instance.hex(), beacon.revision)


def silent_member(
    robot: str,
    heard: Life | None,
    answer: StatusAnswer | None,
    report: PeerReport | None,
    now: float,
) -> SeenMember | None:
    """The member `robot`, whose beacons do not arrive at this operator now.

    `heard`: the last life (start to end of a daemon) that this operator heard, and that did not
    leave. `answer`: the last answer to a query of the robot's status. `report`: the most certain
    report on the robot, by other robots or by its own farewell. Returns None for a robot that was
    neither heard nor reported.

    1. If the last beacon of the robot reached this operator after the report, the robot has failed.
    2. A robot that another robot heard within INDIRECT_TIME is alive and unreachable.
    3. Any other robot that is reported alive has failed.
    4. Else the robot has left or failed, as reported.
    """
    if heard is not None and (report is None or report.at <= heard.heard):
        report = PeerReport(heard.beacon.instance.hex(), Presence.FAILED, heard.heard)
    if report is None:
        return None
    presence = report.presence
    contact = Contact.GONE
    is_recent = now - report.at <= INDIRECT_TIME
    if presence is Presence.ALIVE and is_recent:
        contact = Contact.UNREACHABLE
    elif presence is Presence.ALIVE:
        presence = Presence.FAILED
    return SeenMember(
        robot=robot,
        instance=report.instance,
        presence=presence,
        age=max(now - report.at, 0.0),
        status=answer.status if answer and isinstance(answer.status, Status) else None,
        contact=contact,
        by=report.by,
    )
