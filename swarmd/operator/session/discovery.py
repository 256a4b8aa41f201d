"""The query of an operator for all members of a swarm (a look). Pure: datagrams and times in.

A look combines four sources: beacons that the operator hears (`membership.py`), the reports of
robots on other robots, the robots' own statuses by datagram or by Zenoh (`member_reports.py`), and
rosters. A look is complete once every
expected robot has answered, and one of two conditions holds: the answers agree on the members, or
nothing new has come for `quiet_time`.
A look in which a robot does not answer ends after a time that follows from the measured round trip
and loss of datagrams (`ends_at`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Generic, TypeVar

from swarmd.core import codec
from swarmd.core.errors import CodecError
from swarmd.core.keys import is_id
from swarmd.core.messages import PeerView, Presence, Status, StatusHeader
from swarmd.core.record import RecordKind, generation_of
from swarmd.link.datagram import Address, Beacon, MemberList, StatusPart
from swarmd.link.members.membership import MAX_MEMBERS, Change, Membership
from swarmd.operator.session.clocks import QUIET_TIME, RoundTrips
from swarmd.operator.session.member_reports import (
    EARLIER,
    FRESH_TIME,
    INDIRECT_TIME,
    LIST,
    VIEW,
    MemberReports,
    PeerReport,
    StatusAnswer,
    StatusParts,
    StatusTable,
    decode_status,
    most_certain,
    present_member,
    reports_of_view,
    silent_member,
)
from swarmd.operator.session.members_view import Contact, MembersView, SeenMember

MAX_COPIES = 128  # unicast copies of one datagram: false reports may name many addresses
MAX_INDIRECT_DIALS = 64  # robots dialled at a time that only other robots report
FORGET_PERIOD = 1.0  # s between two searches for robots that no list names any more

# s between two requests for member lists: once all robots heard have sent their lists, and before.
LISTS_PERIOD = 2.0
LIST_REPEAT_PERIOD = 0.25

# How long a look waits for a robot: *_WAIT in s, *_TRIPS in round trips.
# s for a first robot: on a network, on loopback
FIRST_ROBOT_TIMEOUT = 3.0
DEV_WAIT = 1.0
# for a robot that is heard, after the last became known
ANSWER_WAIT = 2.0
ANSWER_TRIPS = 14.0
SECURED_WAIT = 1.5  # factor of ANSWER_WAIT in a secured swarm: both ends sign and verify a link
# for a robot that only other robots hear
UNREACHABLE_WAIT = 2.0
UNREACHABLE_TRIPS = 6.0
# for a robot that failed, or is on a roster and was not heard
GONE_WAIT = 0.5
GONE_TRIPS = 4.0
LOSS_WAIT = 15.0  # s, times the share of solicits without answer: TCP repeats after 1, 3 and 7 s
LOOK_CAP = 45.0  # s: the bound of a look, which no datagram can raise
# s of a look within which each new robot prolongs the look. A robot that is found later prolongs it
# only if another robot reports that robot, or if that robot has answered.
PROLONGING_TIME = 3.0

T = TypeVar("T")


class _Memo(Generic[T]):
    """A value that is found once for each key; each turn of a look asks for it several times.

    The key is the count of events, with what else the value depends on.
    """

    def __init__(self) -> None:
        self._found: tuple[object, T] | None = None  # the last key, and the value

    def at(self, key: object, find: Callable[[], T]) -> T:
        """The value of this key, which `find` finds."""
        found = self._found
        if found is None or found[0] != key:
            found = key, find()
            self._found = found
        return found[1]


class Discovery:
    """The robots that one look of an operator has found.

    - `roster`: robots that are expected in any case.
    - `first_robot_timeout`: how long to wait for a first robot, in s.
    - `earlier`: the result of an earlier look. Its robots stay expected, and count as failed until
      they are heard again.
    - `is_local`: all robots are on this machine, by the loopback interface.
    - `is_secured`: the swarm is secured, so that links take longer to open.
    - `needs_status` True: a robot has answered once its status has come. False: a robot has
      answered also without a status, once it has sent a whole member list and a beacon that
      answers a solicit.
    - `asks_by_datagram` True: robots are asked for their statuses by datagram, and only those that
      do not tell it so are dialled. False: each robot is dialled.
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
        asks_by_datagram: bool = False,
    ) -> None:
        """Begin a look (a query of all members) at `now` in s; the class explains the arguments."""
        self.started = now
        self._answer_wait = ANSWER_WAIT * (SECURED_WAIT if is_secured else 1.0)
        self._needs_status = needs_status
        self.asks_by_datagram = asks_by_datagram
        self._first_robot_wait = first_robot_timeout
        self.found_at = now  # when a robot was last newly heard or newly reported
        self._news_at = now  # when anything new was last heard or reported of any robot
        # When anything new was last heard or reported of a robot that prolongs the look: after
        # PROLONGING_TIME only a robot that did not come too late (`_prolongs`).
        self._prolonging_news_at = now
        self._roster = set(roster)
        self._programs: set[str] = set()  # Zenoh programs that robots hear
        self._members = Membership("", FRESH_TIME)  # the robots whose beacons are heard here
        self._trips = RoundTrips()  # the times from each solicit to the beacons that answer it
        self._reports = MemberReports(is_local=is_local)  # what robots report of other robots
        self._statuses = StatusTable()
        self._status_parts = StatusParts()
        self._linked: set[str] = set()  # the robots that answered on a link
        self._known_since: dict[str, float] = {}  # each robot heard or reported, and since when
        # When a robot last sent a member list, or was last named in a list or view. `_forget` drops
        # a robot that no list has named for long. A robot with the time inf is never forgotten.
        self._last_named_at: dict[str, float] = {}
        # The robots that have said, or of which others have said, that they leave. A dict, for its
        # order. What came later may deny it.
        self._may_have_left: dict[str, None] = {}
        self._forgot_at = now
        self._lists_at = -float("inf")  # when the last request for member lists began
        self._events = 0  # the count of events that changed what is known
        self._heard = _Memo[frozenset[str]]()
        self._answered = _Memo[frozenset[str]]()
        self._unlisted = _Memo[tuple[str, ...]]()
        self._left = _Memo[frozenset[str]]()
        if earlier is not None:
            self._expect_earlier(earlier, now)

    def _expect_earlier(self, earlier: MembersView, now: float) -> None:
        """Let the members of an earlier look count as failed until they are heard again."""
        for robot, member in earlier.members.items():
            if member.presence is Presence.LEFT:
                continue
            was_heard_here = not member.by  # `by`: the robot that reported a member not heard here
            self._known_since[robot] = now
            self._last_named_at[robot] = float("inf") if was_heard_here else now
            report = PeerReport(member.instance, Presence.FAILED, now - member.age)
            self._reports.store(robot, reporter="", way=EARLIER, reports=[report])

    # Events

    def begin_list_request(self, now: float) -> bool:
        """Begin a request for member lists if a request is due; True: the solicit at `now` asks.

        Lists are long. So a solicit asks for lists only at the start, soon again while a robot that
        is heard has not sent its list, and every LISTS_PERIOD once all lists have come.
        """
        has_all_lists = bool(self.heard) and not self.unlisted
        period = LISTS_PERIOD if has_all_lists else max(LIST_REPEAT_PERIOD, 1.5 * self.round_trip)
        if now - self._lists_at < period:
            return False
        self._lists_at = now
        return True

    def on_solicit(
        self, echo: int, now: float, *, wants_status: bool = False, is_to_all: bool = True
    ) -> None:
        """Note that a `Solicit` with this number is sent now.

        `is_to_all` False: some robots are asked, so that the silence of others is no loss.
        """
        if is_to_all:
            self._trips.on_solicit(echo, now)
        if wants_status:
            self._status_parts.on_asked(echo)

    def begin_status_request(self) -> bool:
        """True if the solicit that is sent now asks all robots for their statuses: the first."""
        return self.asks_by_datagram and not self._status_parts.has_asked

    def to_ask(self, now: float) -> tuple[Address, ...]:
        """The robots to ask again for their status now, at most MAX_COPIES; the call notes it."""
        lacking = (
            (robot, instance)
            for robot in self.heard
            for instance in self.holders(robot) - self._statuses.instances(robot).keys()
            if instance in self._members.lives(robot)
        )
        asked = self._status_parts.begin_asks(lacking, now, self.round_trip, MAX_COPIES)
        lives = [self._members.lives(robot)[instance] for robot, instance in asked]
        return tuple(life.address for life in lives)

    def on_beacon(self, beacon: Beacon, address: Address, now: float) -> bool:
        """Take a robot's beacon; a beacon of a robot that does not own its id is ignored.

        False if the beacon shows only what was known of its robot, and need wake nobody: most
        beacons are the answers to repeated solicits.
        """
        robot = beacon.robot
        instance = beacon.instance.hex()
        if not self._has_room(robot):
            return False
        is_same = self._is_known_by(beacon, address, now)
        left_at = self._members.left_at(robot, beacon.instance)
        is_answer = left_at is not None and self._trips.is_after(beacon.echo, left_at)
        change = self._members.take(beacon, address, now, is_answer=is_answer)
        if change is Change.LEFT:
            self._may_have_left[robot] = None
            self._lists_at = -float("inf")  # ask at once whether the other robots confirm it
            self._statuses.drop(robot, instance)
            self._on_news(robot, now)
        elif change is Change.FOUND:
            self._note_known(robot, now)
            self._on_news(robot, now)
            self.found_at = now
        if instance in self._members.lives(robot):
            self._trips.on_echo(robot, instance, beacon.echo, now, beacon.clock)
            self._status_parts.on_beacon(beacon, now)
        self._events += 1
        return change in (Change.FOUND, Change.LEFT) or not is_same

    def _is_known_by(self, beacon: Beacon, address: Address, now: float) -> bool:
        """True if the only life of a robot has this address, and has answered as this beacon does.

        A beacon of one of several lives may show which of them lives, also of a life that counts as
        the earlier one of a robot that left. A beacon after FRESH_TIME shows that the robot is not
        gone.
        """
        robot = beacon.robot
        lives = self._members.lives(robot)
        instance = beacon.instance.hex()
        if self.asks_by_datagram or lives.keys() != {instance} or not self._is_fresh(robot, now):
            return False
        if self.holders(robot) != {instance}:
            return False
        has_answered = not beacon.echo or self._trips.has_answered(beacon.robot, instance)
        return has_answered and lives[instance].address == address

    def on_member_list(self, word: MemberList, now: float) -> None:
        """Take a part of a robot's member list."""
        if word.part >= word.parts or not self._has_room(word.robot):
            return
        self._note_known(word.robot, now)
        self._note_named(word.robot, now)
        if not self._reports.has_list(word.robot):
            self._on_news(word.robot, now)
        reports, adds = self._reports.add_list(word, now)
        self._roster.update(word.roster if len(self._roster) < MAX_MEMBERS else ())
        self._store_reports(word.robot, LIST, reports, now, adds=adds)
        if self._is_fresh(word.robot, now) and now - self._forgot_at >= FORGET_PERIOD:
            self._forgot_at = now
            self._forget(now)
        self._events += 1

    def on_view(self, view: PeerView, now: float) -> None:
        """Take the answer of a robot: its status and its members."""
        self._take_answer(view.robot, StatusAnswer(view.status, view.members, now), now)
        self._note_linked(view.robot)
        if len(self._roster) < MAX_MEMBERS:
            self._roster.update(name for name in view.roster if is_id(name))
        self._take_programs(view.status)
        self._store_reports(view.robot, VIEW, reports_of_view(view, now), now)
        self._events += 1

    def on_header(self, header: StatusHeader, now: float) -> None:
        """Take the status of a robot of another version, as far as it can be read."""
        self._take_answer(header.robot, StatusAnswer(header, (), now), now)
        self._note_linked(header.robot)
        self._events += 1

    def on_status_part(self, part: StatusPart, now: float) -> None:
        """Take a part of a robot's status; a part of an instance that has left is ignored.

        Raises CodecError if the whole status cannot be read, or is that of another robot.
        """
        if self._members.left_at(part.robot, part.instance) is not None:
            return
        content = self._status_parts.add(part)
        if content is None:
            return
        status = decode_status(content)
        if (status.robot, status.instance) != (part.robot, part.instance.hex()):
            raise CodecError(f"{part.robot} sent the status of {status.robot}")
        self._take_answer(part.robot, StatusAnswer(status, (), now), now)
        if isinstance(status, Status):
            self._take_programs(status)
        self._events += 1

    def _note_linked(self, robot: str) -> None:
        if robot in self._statuses.robots:
            self._linked.add(robot)

    def _take_programs(self, status: Status) -> None:
        if len(self._programs) < MAX_MEMBERS:
            self._programs.update(name for name in status.programs if is_id(name))

    # What is known

    @property
    def round_trip(self) -> float:
        """The round trip, in s, as `RoundTrips` measures it."""
        return self._trips.round_trip

    @property
    def heard(self) -> frozenset[str]:
        """The robots that the operator has heard itself."""
        return self._heard.at(self._events, lambda: self._members.heard)

    @property
    def known(self) -> frozenset[str]:
        """Every name that was heard, reported or is on a roster."""
        return frozenset(self._known_since.keys() | self._roster)

    @property
    def roster(self) -> frozenset[str]:
        """The robots that are expected in any case: by this operator, or by a robot's settings."""
        return frozenset(self._roster)

    def left(self, now: float) -> frozenset[str]:
        """The robots that have left, as `result` shows them.

        A stop asks at each arrival: of a robot that is heard, or that nobody says has left, the
        reports are not looked at. They are N**2 of N robots.
        """
        candidates = tuple(robot for robot in self._may_have_left if not self._is_fresh(robot, now))
        key = self._events, candidates
        return self._left.at(key, lambda: frozenset(self._left_of(candidates, now)))

    def _left_of(self, robots: Iterable[str], now: float) -> Iterator[str]:
        for robot in robots:
            member = self._member(robot, now)
            if member is not None and member.presence is Presence.LEFT:
                yield robot

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
            for robot in self._known_since
            for instance in self._members.farewells(robot)
            if self._reports.is_alive(robot, instance)
        )

    @property
    def answered(self) -> frozenset[str]:
        """The robots that have answered: every living instance, if several hold one id.

        A status by datagram has no members: such a robot has answered once its list has come, too.
        """
        return self._answered.at(self._events, self._find_answered)

    def _find_answered(self) -> frozenset[str]:
        answered = {
            robot
            for robot in self._statuses.robots
            if (answers := self._statuses.instances(robot))
            and self.holders(robot) <= answers.keys()
            and self._has_told_members(robot)
        }
        if not self._needs_status:
            unanswered = self.heard - answered
            answered |= {robot for robot in unanswered if self._answered_by_datagram(robot)}
        return frozenset(answered)

    def _has_told_members(self, robot: str) -> bool:
        """True if a robot with a status has told which others it hears: on a link, or by list."""
        return robot in self._linked or self._reports.has_full_list(robot)

    def _answered_by_datagram(self, robot: str) -> bool:
        """True if the robot has one living instance, which echoed a solicit and sent its list.

        False for an id that two daemons hold: a request needs a link to each of the two.
        """
        if not self._reports.has_full_list(robot):
            return False
        holders = self.holders(robot)
        is_echoed = all(self._trips.has_answered(robot, instance) for instance in holders)
        return len(holders) == 1 and is_echoed

    def holders(self, robot: str) -> frozenset[str]:
        """The living instances of an id that beacons or the report of any robot show."""
        holders = self._members.holders(robot)
        doubles = self._reports.doubles(robot)
        if not doubles:  # as of nearly all robots
            return holders
        return holders | (doubles - self._members.farewells(robot).keys())

    def address(self, robot: str) -> Address | None:
        """The source of a robot's beacons, else the address in the newest report, else None."""
        heard = self._members.last_heard(robot)
        if heard is not None:
            return heard.address
        reports = [report for report in self._all_reports(robot) if report.address is not None]
        return max(reports, key=lambda report: report.at).address if reports else None

    def to_dial(self, now: float) -> dict[tuple[str, str], Address]:
        """The addresses of all robots that are not known to be gone, by robot and instance.

        1. Robots that are heard here: each living instance, since two daemons may have one id.
        2. Robots that other robots report as alive, and that have answered.
        3. Of the other reported robots at most MAX_INDIRECT_DIALS: those with the most reporters.
        """
        to_dial: dict[tuple[str, str], Address] = {}
        unproven: dict[tuple[str, str], Address] = {}  # case 3: perhaps invented by a robot
        for robot in self._known_since:
            heard = self._members.lives(robot)  # the lives of the robot, by instance
            for instance, life in heard.items():
                if instance in self.holders(robot):
                    to_dial[robot, instance] = life.address
            if not heard and (report := self._present_report(robot, now)) is not None:
                address = self.address(robot)
                group = to_dial if robot in self._statuses.robots else unproven
                if address is not None:
                    group[robot, report.instance] = address
        return to_dial | self._most_reported(unproven)

    def to_link(self, now: float) -> dict[tuple[str, str], Address]:
        """Of `to_dial` those to dial for their status: robots that tell it by datagram are not."""
        if not self.asks_by_datagram:
            return self.to_dial(now)
        answered = self.answered
        asked_until = now - self._status_parts.wait(self.round_trip)
        refusing = {robot for robot, _ in self._status_parts.refusing}
        lacking = {
            robot
            for robot, since in self._known_since.items()
            if robot not in answered and (robot in refusing or since <= asked_until)
        }
        if not lacking:  # as in most turns of a look: nothing is looked up then
            return {}
        return {
            (robot, instance): address
            for (robot, instance), address in self.to_dial(now).items()
            if robot in lacking
            and (
                (robot, instance) in self._status_parts.refusing
                or self._known_since[robot] <= asked_until
            )
        }

    def _present_report(self, robot: str, now: float) -> PeerReport | None:
        """The report that a robot is alive, if it is the most certain and not too old."""
        report = most_certain(self._all_reports(robot))
        if report is None or report.presence is not Presence.ALIVE:
            return None
        return report if now - report.at <= INDIRECT_TIME else None

    def _most_reported(
        self, addresses: Mapping[tuple[str, str], Address]
    ) -> dict[tuple[str, str], Address]:
        """At most MAX_INDIRECT_DIALS robots: those that most robots heard here report."""
        heard_here = self.heard

        def count_reporters(robot_and_instance: tuple[str, str]) -> int:
            robot, _ = robot_and_instance
            return len(self._reports.reporters(robot) & heard_here)

        most_reported = sorted(addresses, key=count_reporters, reverse=True)[:MAX_INDIRECT_DIALS]
        return {pair: addresses[pair] for pair in most_reported}

    def to_solicit(self) -> tuple[Address, ...]:
        """The addresses of robots that only other robots report, in turns of MAX_COPIES."""
        known = {self.address(robot) for robot in self._known_since.keys() - self.heard}
        addresses = sorted(address for address in known if address is not None)
        first = 0
        if len(addresses) > MAX_COPIES:
            first = self._trips.solicits * MAX_COPIES % len(addresses)
        return tuple((addresses[first:] + addresses[:first])[:MAX_COPIES])

    # When to end

    @property
    def quiet_time(self) -> float:
        """Seconds without news after which a look with all answers is complete."""
        return max(QUIET_TIME, 2.0 * self.round_trip)

    def is_complete(self, now: float) -> bool:
        """True once every expected robot answered, and the views agree or the quiet time passed."""
        answered = self.answered
        if not answered or not self.heard <= answered or not self._is_settled(answered, now):
            return False
        view = self.result(now)  # last: it walks over all reports
        return view.expected <= answered.intersection(view.alive)

    def _is_settled(self, answered: Collection[str], now: float) -> bool:
        """True once the views or lists of robots agree, or nothing new came for `quiet_time`."""
        if not self._needs_status:
            return self.has_all_lists(now)
        if now - self._news_at >= self.quiet_time or self._statuses.agree(answered):
            return True
        return self.asks_by_datagram and self.has_all_lists(now)

    @property
    def unlisted(self) -> tuple[str, ...]:
        """The robots heard of which no whole member list has come, sorted."""
        return self._unlisted.at(self._events, self._find_unlisted)

    def _find_unlisted(self) -> tuple[str, ...]:
        return tuple(
            sorted(robot for robot in self.heard if not self._reports.has_full_list(robot))
        )

    def has_all_lists(self, now: float) -> bool:
        """True once all robots heard have sent their member lists, and the lists are settled.

        The lists are settled if each list names all other robots heard as alive. Otherwise the
        lists are settled once nothing new has come for `quiet_time`.
        """
        heard = self.heard
        if not heard or self.unlisted:
            return False
        agree = len(heard) > 1 and all(
            heard - {reporter} <= self._reports.listed_alive(reporter) for reporter in heard
        )
        return agree or now - self._news_at >= self.quiet_time

    def ends_at(self, now: float, lacking: Iterable[str]) -> float:
        """The time in s until which the look waits for answers of the robots in `lacking`.

        A robot becomes known when it is first heard or first reported by another robot. The robots
        of an earlier look and of the roster are known from the start. The latest of these ends
        counts:

        1. `quiet_time` after the last news of a robot.
        2. For a robot in `lacking` that is heard: ANSWER_WAIT after the last of all robots became
           known, since robots are dialled together. This wait grows with the loss of datagrams.
        3. For a robot in `lacking` that only other robots report as alive: UNREACHABLE_WAIT after
           this robot became known.
        4. For any other robot in `lacking`: GONE_WAIT after this robot became known.
        5. While no robot is heard: the timeout for the first robot, after the start of the look.

        The waits 1 to 4 grow with the round trip. An attacker may invent robots, so the ends 1 to 4
        leave out robots that do not prolong a look (`_prolongs`).
        """
        first_robot_end = self.started + self._first_robot_wait
        if not self._known_since:
            return first_robot_end
        trip = self.round_trip
        loss = self._loss(now)
        answer_wait = max(self._answer_wait, ANSWER_TRIPS * trip) + LOSS_WAIT * loss
        known_at = [at for robot, at in self._known_since.items() if self._prolongs(robot)]
        last_known_at = max(known_at, default=self.started)
        ends = [self._prolonging_news_at + self.quiet_time]
        for robot in filter(self._prolongs, lacking):
            since = self._known_since.get(robot, self.started)
            if self._is_fresh(robot, now):
                ends.append(max(since, last_known_at) + answer_wait)
            elif self._is_reported_alive(robot):
                ends.append(since + (UNREACHABLE_WAIT + UNREACHABLE_TRIPS * trip))
            else:
                ends.append(since + (GONE_WAIT + GONE_TRIPS * trip))
        if not self.heard:
            ends.append(first_robot_end)
        return max(ends)

    def _is_reported_alive(self, robot: str) -> bool:
        """True if any report says so: it is the most certain one (`most_certain`)."""
        return self._reports.is_any_alive(robot, but=self._members.farewells(robot))

    def is_over(self, now: float) -> bool:
        """True once the look need not wait longer for the robots that have not answered."""
        if now - self.started < GONE_WAIT:
            return False
        if now - self.started >= LOOK_CAP:
            return True
        lacking = self.result(now).expected - self.answered
        return now >= self.ends_at(now, lacking)

    # The result

    def links(self, now: float) -> frozenset[tuple[str, str]]:
        """Pairs of robots, in order of their names, that report each other as alive."""
        return self._reports.links(now)

    def result(self, now: float) -> MembersView:
        """The members as known so far."""
        members = {robot: self._member(robot, now) for robot in sorted(self._known_since)}
        seen = {robot: member for robot, member in members.items() if member is not None}
        of_other_version = {
            name for name, member in seen.items() if member.contact is Contact.OTHER_VERSION
        }
        alive = {name for name, member in seen.items() if member.presence is Presence.ALIVE}
        holders = {robot: self.holders(robot) for robot in alive}
        return MembersView(
            programs=frozenset(self._programs),
            members=seen,
            answered=frozenset((self.answered & alive) | of_other_version),
            roster=frozenset(self._roster),
            duplicates={
                robot: tuple(sorted(instances))
                for robot, instances in holders.items()
                if len(instances) > 1
            },
            round_trip=self.round_trip,
            loss=self._loss(now),
            seconds=now - self.started,
            goal_generation=max(self._generations(), default=0),
            clock_leads=dict(self._trips.clock_leads),
        )

    def _generations(self) -> Iterator[int]:
        """The generations of the goals that robots show in beacons and statuses."""
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
        """True if a beacon of a robot came within FRESH_TIME."""
        heard = self._members.last_heard(robot)
        return heard is not None and now - heard.heard <= FRESH_TIME

    def _loss(self, now: float) -> float:
        """The largest share of solicits that an instance heard now did not answer, from 0 to 1."""
        heard = (
            (robot, instance)
            for robot in self.heard
            for instance, life in self._members.lives(robot).items()
            if now - life.heard <= FRESH_TIME
        )
        return self._trips.loss(heard, now)

    def _on_news(self, robot: str, now: float) -> None:
        self._news_at = now
        if now - self.started <= PROLONGING_TIME or self._prolongs(robot):
            self._prolonging_news_at = now

    def _prolongs(self, robot: str) -> bool:
        """True if the look waits for a robot: found early, or reported, or with an answer."""
        if self._known_since.get(robot, self.started) - self.started <= PROLONGING_TIME:
            return True
        return (
            robot in self._statuses.robots
            or self._reports.is_reported(robot)
            or any(
                self._trips.has_answered(robot, instance) for instance in self._members.lives(robot)
            )
        )

    def _has_room(self, robot: str) -> bool:
        return robot in self._known_since or len(self._known_since) < MAX_MEMBERS

    def _note_known(self, robot: str, now: float) -> bool:
        """Note that a name is known; True if it is new."""
        if robot in self._known_since or len(self._known_since) >= MAX_MEMBERS:
            return False
        self._known_since[robot] = now
        return True

    def _note_named(self, robot: str, now: float) -> None:
        """Note that a robot is named now; inf (never forgotten) stays."""
        self._last_named_at[robot] = max(now, self._last_named_at.get(robot, now))

    def _forget(self, now: float) -> None:
        """Drop the robots that were never heard, and that no list named for INDIRECT_TIME."""
        for robot, at in list(self._last_named_at.items()):
            is_seen = self._members.was_heard(robot) or robot in self._statuses.robots
            if now - at > INDIRECT_TIME and not is_seen:
                del self._last_named_at[robot]
                self._known_since.pop(robot, None)
                self._may_have_left.pop(robot, None)
                self._reports.forget(robot)

    def _store_reports(
        self,
        reporter: str,
        way: str,
        reports: Mapping[str, list[PeerReport]],
        now: float,
        *,
        adds: bool = False,
    ) -> None:
        """Replace the reports of `reporter` that came by one way (LIST, VIEW or EARLIER).

        `adds`: keep the reports that came before.
        """
        if not adds:
            self._reports.drop(reporter, way)
        for robot, some in reports.items():
            if robot == reporter:
                continue
            is_new = self._note_known(robot, now)
            if robot in self._known_since:
                self._note_named(robot, now)
                self._reports.store(robot, reporter, way, some, adds=adds)
                if any(report.presence is Presence.LEFT for report in some):
                    self._may_have_left[robot] = None
            if is_new:
                self._on_news(robot, now)
                self.found_at = now

    def _take_answer(self, robot: str, answer: StatusAnswer, now: float) -> None:
        if not self._has_room(robot):
            return
        is_new = self._statuses.add(robot, answer)
        self._note_known(robot, now)
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
