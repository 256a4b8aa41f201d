"""The members of a swarm as an operator finds them. Pure: datagrams, views and times in.

Four sources are put together: beacons that the operator hears itself, the words of robots about
the others, the robots' own statuses (`PeerView`, by Zenoh), and rosters. A look is complete once
every expected robot has answered for itself and no news has come for a while, or all views agree.
Until then it goes on for a time that follows from the measured round trip and loss.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable, Iterator, Mapping

from msgspec import Struct

from swarmd.core import codec
from swarmd.core.goal import generation_of
from swarmd.core.keys import is_id
from swarmd.core.messages import Epoch, Member, PeerView, Presence, Status, StatusHeader
from swarmd.network import datagram
from swarmd.network.datagram import PRESENCES, STATES, Address, Beacon, Flag
from swarmd.network.members_view import Contact, MembersView, SeenMember

# Without two views that agree, this long must pass without news, in s; or two round trips.
QUIET_TIME = 0.1
MAX_ROBOTS = 1024
MAX_INSTANCES = 8
MAX_ECHOES = 256
MAX_COPIES = 128  # of one datagram to single addresses: false words name many
MAX_INDIRECT_DIALS = 64  # robots at a time that are dialled by the word of others alone
# A beacon counts for this long, in s; a robot that others hear, for so long after they did.
FRESH_TIME = 3.0
INDIRECT_TIME = 10.0
FORGET_PERIOD = 1.0  # between two searches for robots that no list names any more, in s

# Between requests for member lists, in s: while all robots heard have sent theirs, and else.
LISTS_PERIOD, LIST_REPEAT_PERIOD = 2.0, 0.25

# How long a look waits, in s, and in round trips.
FIRST_ROBOT_TIMEOUT, DEV_WAIT = 3.0, 1.0  # nobody is heard; on loopback
ANSWER_WAIT, ANSWER_TRIPS = 2.0, 14.0  # since the last robot was found that is heard directly
SECURED_WAIT = 1.5  # times that with keys: a link is signed and verified by both ends
UNREACHABLE_WAIT, UNREACHABLE_TRIPS = 2.0, 6.0  # one that is alive by the word of others
GONE_WAIT, GONE_TRIPS = 0.5, 4.0  # one that failed, or is on a roster and was not seen
LOSS_WAIT = 15.0  # times the share of solicits without an answer: TCP repeats after 1, 3 and 7 s
# Bounds that no datagram can raise, in s: of a look, and of the round trip, which is the longest
# of a few robots and the median of many.
LOOK_CAP, MAX_ROUND_TRIP, FEW_ROBOTS = 45.0, 5.0, 8
# A robot that is found later than this in a look, in s, prolongs it only if another robot knows it
# or it answered.
PROLONGING_TIME = 3.0


class _DirectMember(Struct):
    """An instance that the operator hears itself."""

    beacon: Beacon
    address: Address
    first: float
    last: float
    asked: int  # solicits that were sent before it was first heard
    echoes: set[int] = set()
    version: str = ""


class _Report(Struct, frozen=True):
    """What one robot says of another; `at`: when that was so."""

    instance: str
    presence: Presence
    at: float
    by: str
    address: Address | None


class _Answer(Struct, frozen=True):
    status: Status | StatusHeader
    members: tuple[Member, ...]
    at: float


def reported_address(host: str, port: int, *, is_local: bool) -> Address | None:
    """The address of a robot by the word of another; None if it is none that a robot can have.

    The host must be an IP literal, with a numeric scope only if it is local to its link. With
    `is_local` it must be in 127.0.0.0/8, else it must not be this machine itself.
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


class Discovery:
    """What one look of an operator has found; `roster`: robots that are expected in any case.

    `first_robot_timeout`: how long to wait for a first robot, in s. `earlier`: the result of an
    earlier look: its robots stay expected, and count as failed until they are heard again.
    `is_local`: all robots are on this machine, by the loopback interface. `is_secured`: links take
    longer to open. `needs_status`: only a
    status is an answer; else also a beacon that echoes a solicit, with a whole member list.
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
        self._is_local = is_local
        self._answer_wait = ANSWER_WAIT * (SECURED_WAIT if is_secured else 1.0)
        self._needs_status = needs_status
        self._nobody_wait = first_robot_timeout
        self.found_at = now  # when the last robot was found
        self._news = self._prolonging_news = now
        self._roster = set(roster)
        self._heard: dict[str, dict[str, _DirectMember]] = {}
        # The instances that said that they leave: when, and the sequence of that beacon.
        self._gone: dict[tuple[str, str], tuple[float, int]] = {}
        # Those that were heard after that: it was not their own beacon.
        self._returned: set[tuple[str, str]] = set()
        self._answers: dict[str, dict[str, _Answer]] = {}
        # By robot, then by echo and part: a list in parts counts once it is whole.
        self._lists: dict[str, dict[tuple[int, int], tuple[datagram.MemberList, float]]] = {}
        # What each robot says of a robot, by word and in its view, of which the word is the better:
        # it says when a living robot was heard.
        self._reports: dict[str, dict[tuple[str, str], list[_Report]]] = {}
        # The ids of which one robot says that several instances are alive.
        self._doubles: dict[str, dict[str, frozenset[str]]] = {}
        self._mentioned: dict[str, float] = {}
        # When a robot that is known by the word of others was last named; never, if seen before.
        self._named: dict[str, float] = {}
        self._forgot_at = now
        self._lists_at = -float("inf")
        self._echoes: dict[int, float] = {}
        self._solicits = 0
        self._trips: dict[str, float] = {}
        for robot, member in (earlier.members if earlier else {}).items():
            if member.presence is not Presence.LEFT:
                self._mentioned[robot] = now
                self._named[robot] = now if member.by else float("inf")
                found = _Report(member.instance, Presence.FAILED, now - member.age, "", None)
                self._reports[robot] = {("", "earlier"): [found]}

    # Events

    def wants_members(self, now: float) -> bool:
        """True if robots are to be asked for their member lists now, which are long.

        All are asked at the start, and soon again while a robot heard has not sent its list.
        """
        has_all_lists = bool(self.heard) and all(self._has_full_list(robot) for robot in self.heard)
        period = LISTS_PERIOD if has_all_lists else max(LIST_REPEAT_PERIOD, 1.5 * self.round_trip)
        if now - self._lists_at < period:
            return False
        self._lists_at = now
        return True

    def on_solicit(self, echo: int, now: float) -> None:
        """A `Solicit` with this number is sent now."""
        self._solicits += 1
        self._echoes[echo] = now
        if len(self._echoes) > MAX_ECHOES:
            del self._echoes[next(iter(self._echoes))]

    def on_beacon(self, beacon: Beacon, address: Address, now: float) -> None:
        """A robot's own beacon; one that does not own its id yet is no member."""
        instance = beacon.instance.hex()
        known = self._heard.get(beacon.robot, {})
        who = (beacon.robot, instance)
        if beacon.flags & Flag.LEFT:
            is_newest = instance in known and beacon.sequence >= known[instance].beacon.sequence
            if is_newest and who not in self._returned:
                del known[instance]
                self._gone[who] = (now, beacon.sequence)
                self._lists_at = -float("inf")  # do the others know?
                while len(self._gone) > MAX_ROBOTS:
                    del self._gone[next(iter(self._gone))]
                self._answers.get(beacon.robot, {}).pop(instance, None)
                self._on_news(beacon.robot, now)
            return
        if who in self._gone:
            left_at, sequence = self._gone[who]
            has_answered = self._echoes.get(beacon.echo, left_at) > left_at
            if beacon.sequence <= sequence and not has_answered:
                return  # a delayed beacon of a robot that has left
            del self._gone[who]
            if len(self._returned) < MAX_ROBOTS:
                self._returned.add(who)
        is_full = len(known) >= MAX_INSTANCES or not self._has_room(beacon.robot)
        if beacon.flags & Flag.JOINING or (instance not in known and is_full):
            return
        if instance not in known:
            known = self._heard.setdefault(beacon.robot, known)
            known[instance] = _DirectMember(beacon, address, now, now, self._solicits)
            self._mention(beacon.robot, now)
            self._on_news(beacon.robot, now)
            self.found_at = now
        heard = known[instance]
        heard.last = now
        if beacon.sequence >= heard.beacon.sequence:  # not one that was overtaken on the way
            heard.address, heard.beacon = address, beacon
        heard.version = beacon.version or heard.version
        sent = self._echoes.get(beacon.echo)
        if sent is not None and beacon.echo not in heard.echoes:
            heard.echoes.add(beacon.echo)
            trip = max(now - sent, 0.0)
            self._trips[beacon.robot] = min(trip, self._trips.get(beacon.robot, trip))

    def on_member_list(self, word: datagram.MemberList, now: float) -> None:
        """A robot's word about others; the parts of one come one by one."""
        if not self._has_room(word.robot):
            return
        self._mention(word.robot, now)
        self._name(word.robot, now)
        parts = self._lists.setdefault(word.robot, {})
        if not parts:
            self._on_news(word.robot, now)
        if word.part < word.parts:
            parts[word.echo, word.part] = (word, now)
        whole = [echo for echo, _ in parts if self._has_all(parts, echo)]
        oldest = whole[-1] if whole else list(dict.fromkeys(echo for echo, _ in parts))[-4:][0]
        for key in list(parts):
            if key[0] == oldest:
                break
            del parts[key]
        self._roster.update(word.roster if len(self._roster) < MAX_ROBOTS else ())
        reports: dict[str, list[_Report]] = {}
        for part, at in parts.values():
            for one in part.members:
                if one.presence < len(PRESENCES):
                    found = _Report(
                        one.instance.hex(),
                        PRESENCES[one.presence],
                        at - one.age / 1000.0,
                        word.robot,
                        reported_address(one.host, one.port, is_local=self._is_local),
                    )
                    reports.setdefault(one.robot, []).append(found)
        self._store_reports(word.robot, reports, now)
        if self._is_heard(word.robot, now) and now - self._forgot_at >= FORGET_PERIOD:
            self._forgot_at = now
            self._forget(now)

    def on_view(self, view: PeerView, now: float) -> None:
        """A robot answered with its status and its members."""
        self._take_answer(view.robot, _Answer(view.status, view.members, now), now)
        if len(self._roster) < MAX_ROBOTS:
            self._roster.update(name for name in view.roster if is_id(name))
        reports: dict[str, list[_Report]] = {}
        for one in view.members:
            at = now if one.presence is Presence.ALIVE else now - one.age
            found = _Report(one.instance, one.presence, at, view.robot, None)
            reports.setdefault(one.robot, []).append(found)
        self._store_reports(view.robot, reports, now, way="view")

    def on_header(self, header: StatusHeader, now: float) -> None:
        """A robot of another version answered with its status."""
        self._take_answer(header.robot, _Answer(header, (), now), now)

    # What is known

    @property
    def round_trip(self) -> float:
        """The round trip, in s: the longest, the median of many robots; 0 if nobody answered.

        Robots that answered one solicit alone count only while no robot answered two.
        """
        twice = {
            robot
            for robot, instances in self._heard.items()
            if any(len(one.echoes) > 1 for one in instances.values())
        }
        trips = sorted(trip for robot, trip in self._trips.items() if not twice or robot in twice)
        if not trips:
            return 0.0
        trip = trips[-1] if len(trips) <= FEW_ROBOTS else trips[len(trips) // 2]
        return min(trip, MAX_ROUND_TRIP)

    @property
    def heard(self) -> frozenset[str]:
        """The robots that the operator has heard itself."""
        return frozenset(robot for robot, instances in self._heard.items() if instances)

    @property
    def known(self) -> frozenset[str]:
        """Every name that was heard, mentioned or is on a roster."""
        return frozenset(self._mentioned.keys() | self._roster)

    @property
    def of_other_version(self) -> frozenset[str]:
        """The robots whose beacons show another version of requests."""
        return frozenset(
            robot
            for robot, instances in self._heard.items()
            if any(one.beacon.wire != codec.VERSION for one in instances.values())
        )

    @property
    def doubted(self) -> frozenset[str]:
        """The robots that left by a beacon, and are alive in the newest list of another robot."""
        return frozenset(
            robot
            for robot, instance in self._gone
            for some in self._reports.get(robot, {}).values()
            for one in some
            if one.instance == instance and one.presence is Presence.ALIVE
        )

    @property
    def settled(self) -> frozenset[str]:
        """The robots of which every living instance has answered: both, if two hold one id."""
        found = {
            robot
            for robot, answers in self._answers.items()
            if answers and self.holders(robot) <= answers.keys()
        }
        if not self._needs_status:
            found |= {robot for robot in self.heard - found if self._answered_by_datagram(robot)}
        return frozenset(found)

    def _answered_by_datagram(self, robot: str) -> bool:
        """True if its only instance echoed a solicit and listed its members.

        Of an id that two daemons hold, both must be linked before a request goes out.
        """
        heard, holders = self._heard[robot], self.holders(robot)
        is_echoed = all(one in heard and heard[one].echoes for one in holders)
        return len(holders) == 1 and is_echoed and self._has_full_list(robot)

    def holders(self, robot: str) -> frozenset[str]:
        """The living instances of an id, by beacons and by the word of any one robot."""
        heard = self._heard.get(robot, {})
        newest = max((one.first for one in heard.values()), default=0.0)
        latest = max((one.last for one in heard.values()), default=0.0)
        # An older one counts if it was heard after the newest appeared: a restart is no duplicate.
        living = {
            instance
            for instance, one in heard.items()
            if one.first == newest or (one.last > newest and latest - one.last <= FRESH_TIME / 2)
        }
        for double in self._doubles.get(robot, {}).values():
            living |= {one for one in double if (robot, one) not in self._gone}
        return frozenset(living)

    def address(self, robot: str) -> Address | None:
        """Where a robot is: the source of its beacons, else what others say."""
        heard = self._heard.get(robot)
        if heard:
            return max(heard.values(), key=lambda one: one.last).address
        reports = [one for one in self._all_reports(robot) if one.address is not None]
        return max(reports, key=lambda one: one.at).address if reports else None

    def to_dial(self, now: float) -> dict[tuple[str, str], Address]:
        """The addresses of all robots that are not known to be gone, by robot and instance.

        Of those that are known by the word of others alone and did not answer, the most reported.
        """
        found: dict[tuple[str, str], Address] = {}
        indirect: dict[tuple[str, str], Address] = {}
        for robot in self._mentioned:
            heard = self._heard.get(robot)
            if heard:
                for instance in self.holders(robot) & heard.keys():
                    found[robot, instance] = heard[instance].address
            elif (address := self.address(robot)) is not None:
                best = self._best(robot)
                is_alive = best is not None and best.presence is Presence.ALIVE
                if best is not None and is_alive and now - best.at <= INDIRECT_TIME:
                    has_answered = robot in self._answers
                    (found if has_answered else indirect)[robot, best.instance] = address
        first = sorted(indirect, key=lambda who: -self._reporters(who[0]))[:MAX_INDIRECT_DIALS]
        return found | {who: indirect[who] for who in first}

    def _reporters(self, robot: str) -> int:
        """How many robots that are heard report a robot."""
        reporters = {reporter for reporter, _ in self._reports.get(robot, {})}
        return sum(1 for reporter in reporters if self._heard.get(reporter))

    def to_solicit(self) -> tuple[Address, ...]:
        """The addresses of robots that are known by the word of others alone, some at a time."""
        names = (robot for robot in self._mentioned if not self._heard.get(robot))
        known = {self.address(robot) for robot in names}
        found = sorted(one for one in known if one is not None)
        first = self._solicits * MAX_COPIES % len(found) if len(found) > MAX_COPIES else 0
        return tuple((found[first:] + found[:first])[:MAX_COPIES])

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
        if not self.result(now).expected <= settled:
            return False
        if not self._needs_status:
            return self.has_all_lists(now)
        return self._views_agree(settled) or now - self._news >= self.quiet_time

    @property
    def unlisted(self) -> tuple[str, ...]:
        """The robots heard that did not list the members that they know."""
        return tuple(sorted(robot for robot in self.heard if not self._has_full_list(robot)))

    def has_all_lists(self, now: float) -> bool:
        """True once all robots heard have sent their lists, and agree or the quiet time passed."""
        heard = self.heard
        if not heard or self.unlisted:
            return False
        agree = len(heard) > 1 and all(
            heard - {reporter} <= self._alive_by(reporter) for reporter in heard
        )
        return agree or now - self._news >= self.quiet_time

    def ends_at(self, now: float, lacking: Iterable[str]) -> float:
        """When to stop waiting for the robots in `lacking`, as far as is known now."""
        if not self._mentioned:
            return self.started + self._nobody_wait
        trip = self.round_trip
        ends = [self._prolonging_news + self.quiet_time]
        prolonging = {robot for robot in self._mentioned if self._prolongs(robot)}
        found_at = max((self._mentioned[robot] for robot in prolonging), default=self.started)
        for robot in lacking:
            if robot in self._mentioned and robot not in prolonging:
                continue
            since = self._mentioned.get(robot, self.started)
            best = self._best(robot)
            if self._is_heard(robot, now):
                wait = max(self._answer_wait, ANSWER_TRIPS * trip) + LOSS_WAIT * self._loss(now)
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
        """True once a look has waited long enough for those that have not answered."""
        if now - self.started < GONE_WAIT:
            return False
        if now - self.started >= LOOK_CAP:
            return True
        lacking = self.result(now).expected - self.settled
        return now >= self.ends_at(now, lacking)

    # The result

    def links(self, now: float) -> frozenset[tuple[str, str]]:
        """Pairs of robots, in order of their names, that report each other as alive."""
        alive = {
            (reporter, robot)
            for robot, reports in self._reports.items()
            for (reporter, _), some in reports.items()
            if any(one.presence is Presence.ALIVE and now - one.at <= FRESH_TIME for one in some)
        }
        return frozenset(pair for pair in alive if pair[0] < pair[1] and pair[::-1] in alive)

    def result(self, now: float) -> MembersView:
        """The members as known so far."""
        members = {robot: self._member(robot, now) for robot in sorted(self._mentioned)}
        seen = {robot: member for robot, member in members.items() if member is not None}
        others = {name for name, one in seen.items() if one.contact is Contact.OTHER_VERSION}
        alive = {name for name, one in seen.items() if one.presence is Presence.ALIVE}
        holders = {robot: self.holders(robot) for robot in alive}
        return MembersView(
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
        for instances in self._heard.values():
            yield from (generation_of(one.beacon.goal) for one in instances.values())
        for answers in self._answers.values():
            for answer in answers.values():
                goal = answer.status.goal if isinstance(answer.status, Status) else None
                if goal is not None and goal.held is not None:
                    yield goal.held.goal.generation

    def _member(self, robot: str, now: float) -> SeenMember | None:
        answer = self._answer_of(robot)
        if self._is_heard(robot, now) or (answer is not None and not self._heard.get(robot)):
            return self._present(robot, answer, now)
        best = self._best(robot)
        heard = self._heard.get(robot)
        if heard:  # it was heard, and is silent now
            last = max(one.last for one in heard.values())
            if best is None or best.at <= last:
                instance = max(heard, key=lambda name: heard[name].last)
                best = _Report(instance, Presence.FAILED, last, "", None)
        if best is None:
            return None
        is_alive = best.presence is Presence.ALIVE and now - best.at <= INDIRECT_TIME
        presence = Presence.FAILED if best.presence is Presence.ALIVE else best.presence
        return SeenMember(
            robot=robot,
            instance=best.instance,
            presence=Presence.ALIVE if is_alive else presence,
            age=max(now - best.at, 0.0),
            status=answer.status if answer and isinstance(answer.status, Status) else None,
            contact=Contact.UNREACHABLE if is_alive else Contact.GONE,
            by=best.by,
        )

    def _present(self, robot: str, answer: _Answer | None, now: float) -> SeenMember:
        heard = max(self._heard.get(robot, {}).values(), key=lambda one: one.last, default=None)
        status = answer.status if answer is not None else None
        at = answer.at if answer is not None else heard.last if heard is not None else now
        beacon = heard.beacon if heard is not None else None
        contact = Contact.ANSWERED if isinstance(status, Status) else Contact.NO_ANSWER
        if isinstance(status, StatusHeader) or (beacon and beacon.wire != codec.VERSION):
            contact = Contact.OTHER_VERSION
        shown = STATES[beacon.state] if beacon and beacon.state < len(STATES) else ""
        return SeenMember(
            robot=robot,
            instance=status.instance if status else beacon.instance.hex() if beacon else "unknown",
            presence=Presence.ALIVE,
            age=max(now - at, 0.0),
            status=status if isinstance(status, Status) else None,
            contact=contact,
            state=status.state if status else shown,
            wire=beacon.wire if beacon else None,
            version=status.version if status else heard.version if heard else "",
            header=status if isinstance(status, StatusHeader) else None,
            epoch=_epoch(status, beacon),
        )

    # Parts

    def _on_news(self, robot: str, now: float) -> None:
        self._news = now
        if now - self.started <= PROLONGING_TIME or self._prolongs(robot):
            self._prolonging_news = now

    def _prolongs(self, robot: str) -> bool:
        """True if a look waits for a robot: found early, known to another, or it answered."""
        if self._mentioned.get(robot, self.started) - self.started <= PROLONGING_TIME:
            return True
        heard = self._heard.get(robot, {}).values()
        return (
            robot in self._answers
            or any(self._reports.get(robot, {}).values())
            or any(one.echoes for one in heard)
        )

    def _has_room(self, robot: str) -> bool:
        return robot in self._mentioned or len(self._mentioned) < MAX_ROBOTS

    def _mention(self, robot: str, now: float) -> bool:
        """Note that a name is known; True if it is new."""
        if robot in self._mentioned or len(self._mentioned) >= MAX_ROBOTS:
            return False
        self._mentioned[robot] = now
        return True

    def _name(self, robot: str, now: float) -> None:
        self._named[robot] = max(now, self._named.get(robot, now))

    def _forget(self, now: float) -> None:
        """Drop the robots that were never seen, and that no list has named for a while."""
        seen = self.heard | self._answers.keys() | {robot for robot, _ in self._gone}
        for robot, at in list(self._named.items()):
            if now - at > INDIRECT_TIME and robot not in seen:
                del self._named[robot]
                for known in (self._mentioned, self._reports, self._doubles, self._lists):
                    known.pop(robot, None)

    def _store_reports(
        self, reporter: str, reports: Mapping[str, list[_Report]], now: float, way: str = "word"
    ) -> None:
        """Replace the earlier reports of a robot."""
        for known in self._reports.values():
            known.pop((reporter, way), None)
        for doubles in self._doubles.values():
            doubles.pop(reporter, None)
        for robot, some in reports.items():
            if robot == reporter:
                continue
            is_new = self._mention(robot, now)
            if robot in self._mentioned:
                self._name(robot, now)
                self._reports.setdefault(robot, {})[reporter, way] = some[:MAX_INSTANCES]
            if is_new:
                self._on_news(robot, now)
                self.found_at = now
            if robot in self._mentioned:
                alive = {one.instance for one in some if one.presence is Presence.ALIVE}
                if len(alive) > 1:
                    self._doubles.setdefault(robot, {})[reporter] = frozenset(alive)

    def _take_answer(self, robot: str, answer: _Answer, now: float) -> None:
        if not self._has_room(robot):
            return
        known = self._answers.setdefault(robot, {})
        instance = answer.status.instance
        is_new = instance not in known
        if is_new and len(known) >= MAX_INSTANCES:
            return
        known[instance] = answer
        self._mention(robot, now)
        if is_new:
            self._on_news(robot, now)

    def _answer_of(self, robot: str) -> _Answer | None:
        """The newest answer of a robot, of a living instance if one is heard."""
        answers, living = self._answers.get(robot, {}), self.holders(robot)
        some = [one for one in answers.values() if not living or one.status.instance in living]
        return max(some, key=lambda one: one.at, default=None)

    def _is_heard(self, robot: str, now: float) -> bool:
        return any(now - one.last <= FRESH_TIME for one in self._heard.get(robot, {}).values())

    def _all_reports(self, robot: str) -> list[_Report]:
        reporters = self._reports.get(robot, {})
        found = [
            one
            for (reporter, way), some in reporters.items()
            if way == "word" or (reporter, "word") not in reporters
            for one in some
        ]
        left = [
            _Report(instance, Presence.LEFT, at, "", None)
            for (name, instance), (at, _) in self._gone.items()
            if name == robot
        ]
        gone = {one.instance for one in left}
        return [*left, *(one for one in found if one.instance not in gone)]

    def _best(self, robot: str) -> _Report | None:
        """The most certain word on a robot: alive first, then the newest, `left` before failed."""
        reports = self._all_reports(robot)
        alive = [one for one in reports if one.presence is Presence.ALIVE]
        if alive:
            return max(alive, key=lambda one: one.at)
        newest = max(reports, key=lambda one: one.at, default=None)
        if newest is None:
            return None
        same = [one for one in reports if one.instance == newest.instance]
        return max(same, key=lambda one: (one.presence is Presence.LEFT, one.at))

    def _has_full_list(self, robot: str) -> bool:
        parts = self._lists.get(robot, {})
        return any(self._has_all(parts, echo) for echo, _ in parts)

    @staticmethod
    def _has_all(
        parts: Mapping[tuple[int, int], tuple[datagram.MemberList, float]], echo: int
    ) -> bool:
        """True if all parts of the answer to one solicit are there."""
        some = [word for (number, _), (word, _) in parts.items() if number == echo]
        return bool(some) and len(some) >= some[0].parts

    def _alive_by(self, reporter: str) -> frozenset[str]:
        return frozenset(
            robot
            for robot, reporters in self._reports.items()
            if any(one.presence is Presence.ALIVE for one in reporters.get((reporter, "word"), ()))
        )

    def _views_agree(self, settled: frozenset[str]) -> bool:
        views = [
            (robot, one)
            for robot, answers in self._answers.items()
            for one in answers.values()
            if isinstance(one.status, Status)
        ]
        if len(settled) < 2 or len(views) < 2:
            return False
        return all(settled <= _seen_alive(one.members) | {robot} for robot, one in views)

    def _loss(self, now: float) -> float:
        """The largest share of solicits that a robot which is heard left unanswered, 0 to 1."""
        trip, worst = self.round_trip, 0.0
        recent = sum(1 for at in self._echoes.values() if now - at <= trip + QUIET_TIME)
        for instances in self._heard.values():
            for one in instances.values():
                asked = self._solicits - recent - max(one.asked - 1, 0)
                if asked >= 4 and now - one.last <= FRESH_TIME:
                    worst = max(worst, 1.0 - len(one.echoes) / asked)
        return min(max(worst, 0.0), 1.0)


def _epoch(status: Status | StatusHeader | None, beacon: Beacon | None) -> Epoch | None:
    if isinstance(status, Status):
        return status.epoch
    return None if beacon is None else Epoch(beacon.instance.hex(), beacon.revision)


def _seen_alive(members: tuple[Member, ...]) -> frozenset[str]:
    return frozenset(one.robot for one in members if one.presence is Presence.ALIVE)
