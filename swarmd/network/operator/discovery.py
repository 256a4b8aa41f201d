"""The members of a swarm as an operator finds them. Pure: datagrams, views and times in.

Four sources are put together: beacons that the operator hears itself (`membership.py`), the words
of robots about the others (`member_reports.py`), the robots' own statuses by Zenoh
(`status_table.py`), and rosters. A look is complete once every expected robot has answered for
itself and no news has come for a while, or all views agree. Until then it goes on for a time that
follows from the measured round trip and loss.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from swarmd.core import codec
from swarmd.core.keys import is_id
from swarmd.core.messages import PeerView, Presence, StatusHeader
from swarmd.core.record import RecordKind, generation_of
from swarmd.network.datagram import Address, Beacon, MemberList
from swarmd.network.members.membership import MAX_MEMBERS, Change, Membership
from swarmd.network.operator.member_reports import (
    EARLIER,
    FRESH_TIME,
    LIST,
    VIEW,
    MemberReports,
    PeerReport,
    most_certain,
    reports_of_view,
)
from swarmd.network.operator.members_view import Contact, MembersView, SeenMember
from swarmd.network.operator.round_trips import QUIET_TIME, RoundTrips
from swarmd.network.operator.seen_member import INDIRECT_TIME, present_member, silent_member
from swarmd.network.operator.status_table import StatusAnswer, StatusTable

MAX_COPIES = 128  # of one datagram to single addresses: false words name many
MAX_INDIRECT_DIALS = 64  # robots at a time that are dialled by the word of others alone
FORGET_PERIOD = 1.0  # between two searches for robots that no list names any more, in s

# Between requests for member lists, in s: while all robots heard have sent theirs, and else.
LISTS_PERIOD, LIST_REPEAT_PERIOD = 2.0, 0.25

# How long a look waits, in s, and in round trips.
FIRST_ROBOT_TIMEOUT, DEV_WAIT = 3.0, 1.0  # no robot is heard; on loopback
ANSWER_WAIT, ANSWER_TRIPS = 2.0, 14.0  # since the last robot was found that is heard directly
SECURED_WAIT = 1.5  # times ANSWER_WAIT with keys: both ends sign and verify a link
UNREACHABLE_WAIT, UNREACHABLE_TRIPS = 2.0, 6.0  # a robot that only other robots hear
GONE_WAIT, GONE_TRIPS = 0.5, 4.0  # a robot that failed, or is on a roster and was not seen
LOSS_WAIT = 15.0  # times the share of solicits without an answer: TCP repeats after 1, 3 and 7 s
LOOK_CAP = 45.0  # the bound of a look, in s, that no datagram can raise
# A robot that is found later than this in a look, in s, prolongs it only if another robot knows it
# or it answered.
PROLONGING_TIME = 3.0


class Discovery:
    """What one look of an operator has found.

    - `roster`: robots that are expected in any case.
    - `first_robot_timeout`: how long to wait for a first robot, in s.
    - `earlier`: the result of an earlier look, whose robots stay expected, and count as failed
      until they are heard again.
    - `is_local`: all robots are on this machine, by the loopback interface.
    - `is_secured`: links take longer to open.
    - `needs_status`: only a status is an answer. Without, a beacon that echoes a solicit is an
      answer, too, with a whole member list.
    """

    def __init__(
        self,
        now: float,
        roster: Iterable[str] = (),
        *,
        first_robot_timeout: float = FIRST_ROBOT_TIMEOUT,
        earlier: MembersView | None = None,
        is_local: bool = False,
        is_secured: bool = False,
        needs_status: bool = True,
    ) -> None:
        self.started = now
        self._answer_wait = ANSWER_WAIT * (SECURED_WAIT if is_secured else 1.0)
        self._needs_status = needs_status
        self._nobody_wait = first_robot_timeout
        self.found_at = now  # when the last robot was found
        self._news = self._prolonging_news = now
        self._roster = set(roster)
        self._programs: set[str] = set()
        self._members = Membership("", FRESH_TIME)
        self._trips = RoundTrips()
        self._reports = MemberReports(is_local=is_local)
        self._statuses = StatusTable()
        self._mentioned: dict[str, float] = {}
        # When a robot that is known by the word of others was last named; never, if seen before.
        self._named: dict[str, float] = {}
        self._forgot_at = now
        self._lists_at = -float("inf")
        for robot, member in (earlier.members if earlier else {}).items():
            if member.presence is not Presence.LEFT:
                self._mentioned[robot] = now
                self._named[robot] = now if member.by else float("inf")
                report = PeerReport(member.instance, Presence.FAILED, now - member.age)
                self._reports.store(robot, "", EARLIER, [report])

    # Events

    def wants_members(self, now: float) -> bool:
        """True if robots are to be asked for their member lists now, which are long.

        All are asked at the start, and soon again while a robot heard has not sent its list.
        """
        has_all_lists = bool(self.heard) and not self.unlisted
        period = LISTS_PERIOD if has_all_lists else max(LIST_REPEAT_PERIOD, 1.5 * self.round_trip)
        if now - self._lists_at < period:
            return False
        self._lists_at = now
        return True

    def on_solicit(self, echo: int, now: float) -> None:
        """A `Solicit` with this number is sent now."""
        self._trips.on_solicit(echo, now)

    def on_beacon(self, beacon: Beacon, address: Address, now: float) -> None:
        """A robot's own beacon; a robot that does not own its id yet is no member."""
        robot, instance = beacon.robot, beacon.instance.hex()
        if not self._has_room(robot):
            return
        left = self._members.left_at(robot, beacon.instance)
        is_answer = left is not None and self._trips.is_after(beacon.echo, left)
        change = self._members.take(beacon, address, now, is_answer=is_answer)
        if change is Change.LEFT:
            self._lists_at = -float("inf")  # ask at once whether the other robots know
            self._statuses.drop(robot, instance)
            self._on_news(robot, now)
        elif change is Change.FOUND:
            self._mention(robot, now)
            self._on_news(robot, now)
            self.found_at = now
        if instance in self._members.lives(robot):
            self._trips.on_echo(robot, instance, beacon.echo, now)

    def on_member_list(self, word: MemberList, now: float) -> None:
        """A part of a robot's member list."""
        if word.part >= word.parts or not self._has_room(word.robot):
            return
        self._mention(word.robot, now)
        self._name(word.robot, now)
        if not self._reports.has_list(word.robot):
            self._on_news(word.robot, now)
        reports = self._reports.add_list(word, now)
        self._roster.update(word.roster if len(self._roster) < MAX_MEMBERS else ())
        self._store_reports(word.robot, LIST, reports, now)
        if self._is_fresh(word.robot, now) and now - self._forgot_at >= FORGET_PERIOD:
            self._forgot_at = now
            self._forget(now)

    def on_view(self, view: PeerView, now: float) -> None:
        """A robot answered with its status and its members."""
        self._take_answer(view.robot, StatusAnswer(view.status, view.members, now), now)
        if len(self._roster) < MAX_MEMBERS:
            self._roster.update(name for name in view.roster if is_id(name))
        if len(self._programs) < MAX_MEMBERS:
            self._programs.update(name for name in view.status.programs if is_id(name))
        self._store_reports(view.robot, VIEW, reports_of_view(view, now), now)

    def on_header(self, header: StatusHeader, now: float) -> None:
        """A robot of another version answered with its status."""
        self._take_answer(header.robot, StatusAnswer(header, (), now), now)

    # What is known

    @property
    def round_trip(self) -> float:
        """The round trip, in s, as `RoundTrips` measures it."""
        return self._trips.round_trip

    @property
    def heard(self) -> frozenset[str]:
        """The robots that the operator has heard itself."""
        return self._members.heard

    @property
    def known(self) -> frozenset[str]:
        """Every name that was heard, mentioned or is on a roster."""
        return frozenset(self._mentioned.keys() | self._roster)

    @property
    def of_other_version(self) -> frozenset[str]:
        """The robots whose beacons show another version of requests."""
        return frozenset(
            robot
            for robot in self.heard
            if any(
                life.beacon.wire != codec.VERSION for life in self._members.lives(robot).values()
            )
        )

    @property
    def doubted(self) -> frozenset[str]:
        """The robots that left by a beacon, and are alive in the newest list of another robot."""
        return frozenset(
            robot
            for robot in self._mentioned
            for instance in self._members.farewells(robot)
            if self._reports.is_alive(robot, instance)
        )

    @property
    def settled(self) -> frozenset[str]:
        """The robots of which every living instance has answered: both, if two hold one id."""
        settled = {
            robot
            for robot in self._statuses.robots
            if (answers := self._statuses.instances(robot))
            and self.holders(robot) <= answers.keys()
        }
        if not self._needs_status:
            unsettled = self.heard - settled
            settled |= {robot for robot in unsettled if self._answered_by_datagram(robot)}
        return frozenset(settled)

    def _answered_by_datagram(self, robot: str) -> bool:
        """True if its only instance echoed a solicit and listed its members.

        Of an id that two daemons hold, both must be linked before a request goes out.
        """
        holders = self.holders(robot)
        is_echoed = all(self._trips.has_answered(robot, instance) for instance in holders)
        return len(holders) == 1 and is_echoed and self._reports.has_full_list(robot)

    def holders(self, robot: str) -> frozenset[str]:
        """The living instances of an id, by beacons and by the word of any one robot."""
        told = self._reports.doubles(robot) - self._members.farewells(robot).keys()
        return self._members.holders(robot) | told

    def address(self, robot: str) -> Address | None:
        """Where a robot is: the source of its beacons, else what others say."""
        heard = self._members.last_heard(robot)
        if heard is not None:
            return heard.address
        reports = [report for report in self._all_reports(robot) if report.address is not None]
        return max(reports, key=lambda report: report.at).address if reports else None

    def to_dial(self, now: float) -> dict[tuple[str, str], Address]:
        """The addresses of all robots that are not known to be gone, by robot and instance.

        Of the robots that only other robots have heard and that did not answer, at most
        MAX_INDIRECT_DIALS, those with the most reporters.
        """
        direct: dict[tuple[str, str], Address] = {}
        indirect: dict[tuple[str, str], Address] = {}
        for robot in self._mentioned:
            heard = self._members.lives(robot)
            if heard:
                for instance in self.holders(robot) & heard.keys():
                    direct[robot, instance] = heard[instance].address
            elif (address := self.address(robot)) is not None:
                best = most_certain(self._all_reports(robot))
                is_alive = best is not None and best.presence is Presence.ALIVE
                if best is not None and is_alive and now - best.at <= INDIRECT_TIME:
                    has_answered = robot in self._statuses.robots
                    (direct if has_answered else indirect)[robot, best.instance] = address
        heard_here = self.heard
        first = sorted(indirect, key=lambda who: -len(self._reports.reporters(who[0]) & heard_here))
        return direct | {who: indirect[who] for who in first[:MAX_INDIRECT_DIALS]}

    def to_solicit(self) -> tuple[Address, ...]:
        """The addresses of robots that are known by the word of others alone, some at a time."""
        known = {self.address(robot) for robot in self._mentioned.keys() - self.heard}
        addresses = sorted(address for address in known if address is not None)
        first = (
            self._trips.solicits * MAX_COPIES % len(addresses) if len(addresses) > MAX_COPIES else 0
        )
        return tuple((addresses[first:] + addresses[:first])[:MAX_COPIES])

    # When to end

    @property
    def quiet_time(self) -> float:
        """How long no news must come, in s."""
        return max(QUIET_TIME, 2.0 * self.round_trip)

    def is_complete(self, now: float) -> bool:
        """True once every expected robot answered, and the views agree or the quiet time passed."""
        settled = self.settled
        if not settled or not self.heard <= settled:
            return False
        view = self.result(now)
        if not view.expected <= settled.intersection(view.alive):
            return False
        if not self._needs_status:
            return self.has_all_lists(now)
        return self._statuses.agree(settled) or now - self._news >= self.quiet_time

    @property
    def unlisted(self) -> tuple[str, ...]:
        """The robots heard that did not list the members that they know."""
        return tuple(
            sorted(robot for robot in self.heard if not self._reports.has_full_list(robot))
        )

    def has_all_lists(self, now: float) -> bool:
        """True once all robots heard have sent their lists, and agree or the quiet time passed."""
        heard = self.heard
        if not heard or self.unlisted:
            return False
        agree = len(heard) > 1 and all(
            heard - {reporter} <= self._reports.listed_alive(reporter) for reporter in heard
        )
        return agree or now - self._news >= self.quiet_time

    def ends_at(self, now: float, lacking: Iterable[str]) -> float:
        """When to stop waiting for the robots in `lacking`, as far as is known now."""
        if not self._mentioned:
            return self.started + self._nobody_wait
        trip, loss = self.round_trip, self._loss(now)
        ends = [self._prolonging_news + self.quiet_time]
        prolonging = {robot for robot in self._mentioned if self._prolongs(robot)}
        found_at = max((self._mentioned[robot] for robot in prolonging), default=self.started)
        for robot in lacking:
            if robot in self._mentioned and robot not in prolonging:
                continue
            since = self._mentioned.get(robot, self.started)
            best = most_certain(self._all_reports(robot))
            if self._is_fresh(robot, now):
                wait = max(self._answer_wait, ANSWER_TRIPS * trip) + LOSS_WAIT * loss
                since = max(since, found_at)
            elif best is not None and best.presence is Presence.ALIVE:
                wait = UNREACHABLE_WAIT + UNREACHABLE_TRIPS * trip
            else:
                wait = GONE_WAIT + GONE_TRIPS * trip
            ends.append(since + wait)
        if not self.heard:
            ends.append(self.started + self._nobody_wait)
        return max(ends)

    def is_over(self, now: float) -> bool:
        """True once a look has waited long enough for the robots that have not answered."""
        if now - self.started < GONE_WAIT:
            return False
        if now - self.started >= LOOK_CAP:
            return True
        lacking = self.result(now).expected - self.settled
        return now >= self.ends_at(now, lacking)

    # The result

    def links(self, now: float) -> frozenset[tuple[str, str]]:
        """Pairs of robots, in order of their names, that report each other as alive."""
        return self._reports.links(now)

    def result(self, now: float) -> MembersView:
        """The members as known so far."""
        members = {robot: self._member(robot, now) for robot in sorted(self._mentioned)}
        seen = {robot: member for robot, member in members.items() if member is not None}
        others = {name for name, member in seen.items() if member.contact is Contact.OTHER_VERSION}
        alive = {name for name, member in seen.items() if member.presence is Presence.ALIVE}
        holders = {robot: self.holders(robot) for robot in alive}
        return MembersView(
            programs=frozenset(self._programs),
            members=seen,
            answered=frozenset((self.settled & alive) | others),
            roster=frozenset(self._roster),
            duplicates={
                robot: tuple(sorted(some)) for robot, some in holders.items() if len(some) > 1
            },
            round_trip=self.round_trip,
            loss=self._loss(now),
            seconds=now - self.started,
            goal_generation=max(self._generations(), default=0),
        )

    def _generations(self) -> Iterator[int]:
        """Those of the goals that robots show in beacons and in statuses."""
        for robot in self.heard:
            instances = self._members.lives(robot).values()
            yield from (generation_of(life.beacon.digest(RecordKind.GOAL)) for life in instances)
        for _, status, _ in self._statuses.statuses():
            if status.goal is not None and status.goal.held is not None:
                yield status.goal.held.goal.generation

    def _member(self, robot: str, now: float) -> SeenMember | None:
        heard = self._members.last_heard(robot)
        answer = self._statuses.newest(robot, self.holders(robot))
        if self._is_fresh(robot, now) or (answer is not None and heard is None):
            return present_member(robot, heard, answer, now)
        report = most_certain(self._all_reports(robot))
        return silent_member(robot, heard, answer, report, now)

    # Parts

    def _is_fresh(self, robot: str, now: float) -> bool:
        """True if a beacon of a robot came lately."""
        heard = self._members.last_heard(robot)
        return heard is not None and now - heard.heard <= FRESH_TIME

    def _loss(self, now: float) -> float:
        """The largest share of solicits that an instance which is heard left unanswered, 0 to 1."""
        heard = (
            (robot, instance)
            for robot in self.heard
            for instance, life in self._members.lives(robot).items()
            if now - life.heard <= FRESH_TIME
        )
        return self._trips.loss(heard, now)

    def _on_news(self, robot: str, now: float) -> None:
        self._news = now
        if now - self.started <= PROLONGING_TIME or self._prolongs(robot):
            self._prolonging_news = now

    def _prolongs(self, robot: str) -> bool:
        """True if a look waits for a robot: found early, known to another, or it answered."""
        if self._mentioned.get(robot, self.started) - self.started <= PROLONGING_TIME:
            return True
        return (
            robot in self._statuses.robots
            or self._reports.is_reported(robot)
            or any(
                self._trips.has_answered(robot, instance) for instance in self._members.lives(robot)
            )
        )

    def _has_room(self, robot: str) -> bool:
        return robot in self._mentioned or len(self._mentioned) < MAX_MEMBERS

    def _mention(self, robot: str, now: float) -> bool:
        """Note that a name is known; True if it is new."""
        if robot in self._mentioned or len(self._mentioned) >= MAX_MEMBERS:
            return False
        self._mentioned[robot] = now
        return True

    def _name(self, robot: str, now: float) -> None:
        self._named[robot] = max(now, self._named.get(robot, now))

    def _forget(self, now: float) -> None:
        """Drop the robots that were never seen, and that no list has named for a while."""
        for robot, at in list(self._named.items()):
            is_seen = self._members.was_heard(robot) or robot in self._statuses.robots
            if now - at > INDIRECT_TIME and not is_seen:
                del self._named[robot]
                self._mentioned.pop(robot, None)
                self._reports.forget(robot)

    def _store_reports(
        self, reporter: str, way: str, reports: Mapping[str, list[PeerReport]], now: float
    ) -> None:
        """Replace the earlier reports of a robot that came by one way."""
        self._reports.drop(reporter, way)
        for robot, some in reports.items():
            if robot == reporter:
                continue
            is_new = self._mention(robot, now)
            if robot in self._mentioned:
                self._name(robot, now)
                self._reports.store(robot, reporter, way, some)
            if is_new:
                self._on_news(robot, now)
                self.found_at = now

    def _take_answer(self, robot: str, answer: StatusAnswer, now: float) -> None:
        if not self._has_room(robot):
            return
        is_new = self._statuses.add(robot, answer)
        self._mention(robot, now)
        if is_new:
            self._on_news(robot, now)

    def _all_reports(self, robot: str) -> list[PeerReport]:
        """The reports of other robots about a robot, and its own last beacon before it left."""
        gone = self._members.farewells(robot)
        left = [PeerReport(instance, Presence.LEFT, at) for instance, at in gone.items()]
        return [
            *left,
            *(report for report in self._reports.of(robot) if report.instance not in gone),
        ]
