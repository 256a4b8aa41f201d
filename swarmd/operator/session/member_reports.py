"""What robots report of other robots to an operator, by member lists and by views. Pure."""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable, Mapping
from functools import lru_cache

from msgspec import Struct

from swarmd.core.messages import PeerView, Presence
from swarmd.link.datagram import PRESENCES, Address, MemberList, MemberReport
from swarmd.link.members.membership import MAX_INSTANCES

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
