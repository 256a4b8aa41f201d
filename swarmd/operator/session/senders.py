"""Sends requests and stops, and repeats each until every robot has replied or its time is over.

`RequestSender` sends the requests and queries of an operator.

`StopOrigin` numbers stops, in a small file beside the operator's identity. `PendingStop` is a stop
under way: the robots without an ack, and the end of sending (pure). `StopSender` sends it, and
repeats it. A robot acks (acknowledges) a stop at once, and the ack shows whether the robot's base
is known to rest. The stop is repeated to the robot until the base rests, or until the robot reports
that the base has not stopped.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace

from swarmd.core import codec
from swarmd.core.clock import boottime
from swarmd.core.codec import MAX_CONTROL, Decoder, encode, version_of
from swarmd.core.keys import ANY, CONTROL
from swarmd.core.messages import Code, Epoch, Reply, ReplyHeader
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import AnyRequest, starts_motion
from swarmd.link.datagram import Ack, Address, Stop
from swarmd.link.stops.stop_freshness import REPLAYED
from swarmd.operator.session.carriers import OperatorDatagrams, OperatorSessions
from swarmd.operator.session.clocks import SOLICIT_PACE, Arrivals, LoopWatch, RepeatTimer
from swarmd.operator.session.discovery import Discovery
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.outcome import Acks, Outcome
from swarmd.operator.session.roster import RosterFollower

# s after which a request without a reply is repeated: a congested or closing link may lose it.
REPEAT_PERIOD = 0.5
# By default a request waits for the sum of the first three, at most for REQUEST_CAP.
REQUEST_WAIT = 5.0  # s
REQUEST_TRIPS = 8.0  # round trips, as measured by `discovery.py`
REQUEST_LOSS_WAIT = 15.0  # s, times the share of solicits that were lost
REQUEST_CAP = 45.0  # s
# s between two checks for new links while a robot has none.
LINK_PERIOD = 0.003
LEAST_PAUSE = 0.001  # s for which the sender waits in any case before it sends again
# s, and round trips, after which robots of another version are not waited for.
OTHER_VERSION_WAIT = 1.0
OTHER_VERSION_TRIPS = 6.0


_reply_header = Decoder(ReplyHeader, any_version=True)
_reply = Decoder(Reply, MAX_CONTROL)


def request_timeout(view: MembersView, least_timeout: float) -> float:
    """Seconds for which a request waits for replies; they grow with round trip and loss.

    At least `least_timeout`, and at most the greater of REQUEST_CAP and `least_timeout`.
    """
    timeout = least_timeout + REQUEST_TRIPS * view.round_trip + REQUEST_LOSS_WAIT * view.loss
    return min(timeout, max(least_timeout, REQUEST_CAP))


class RequestSender:
    """Sends by the sessions of an operator."""

    def __init__(self, sessions: OperatorSessions, arrivals: Arrivals, loops: LoopWatch) -> None:
        self._sessions = sessions
        self._arrivals = arrivals
        self._loops = loops

    def send(
        self,
        request: AnyRequest,
        targets: Mapping[str, Epoch | None],
        asked: Collection[str],
        view: MembersView,
        discovery: Discovery | None,
        timeout: float,
        is_ended: Callable[[], bool] = lambda: False,
    ) -> tuple[Outcome, set[str]]:
        """Send a request to the robots in `asked`, and repeat it until all have replied.

        Each copy gets its age when it is sent: the s since `request.issued` on the own clock.
        `targets`: all robots that the outcome is about; targets that are not in `asked` count as
        missing. `view`: the members by the last look (query of all members). Robots without a Zenoh
        link are dialled as `discovery` finds them. Sending ends after `timeout` s, or once
        `is_ended` returns True. If only robots of another version are missing, which may never
        reply, sending ends after a short time. A start is not sent again after this process stood
        still (`LoopWatch`): the outcome has a warning then. Returns the outcome, and the robots
        in `asked` with a link.
        """
        of_other_version = set(asked) & set(view.of_other_version())
        other_version_wait = OTHER_VERSION_WAIT + OTHER_VERSION_TRIPS * view.round_trip
        acks = Acks(request.id)
        started = now = boottime()
        repeat_at = now  # the first query is due at once
        links = self._sessions.question_links(request.verb)  # which robots a query would reach
        unlinked = set(asked) if self._sessions.needs_links else set[str]()
        missing = tuple(asked)
        pause = 0.0
        stood = 0.0
        self._loops.begin(now)
        while missing and (time_left := started + timeout - now) > 0:
            newly_linked = self._sessions.linked(links, unlinked)
            unlinked -= newly_linked
            receivers = newly_linked
            if now >= repeat_at:
                repeat_at = now + REPEAT_PERIOD
                receivers = set(missing) - unlinked
            # One query to all robots replaces many: robots that are no targets ignore the query.
            names = [ANY] if len(receivers) == len(asked) else sorted(receivers)
            # With the age at its arrival: a robot refuses a start that is too old.
            age = now - request.issued + view.round_trip
            present_request = replace(request, age=age)
            self._query(present_request, names, time_left, acks)
            if unlinked and discovery is not None:
                self._sessions.dial(discovery, now, only=unlinked)
            pause = min(time_left, repeat_at - now, LINK_PERIOD if unlinked else REPEAT_PERIOD)
            pause = max(pause, LEAST_PAUSE)
            with self._arrivals.lock:
                self._arrivals.lock.wait_for(lambda: not acks.missing(asked), pause)
                missing = acks.missing(asked)
                now = boottime()
            stood = self._loops.turn(now, pause) if starts_motion(request) else 0.0
            lacks_only_other_version = of_other_version.issuperset(missing)
            is_in_vain = lacks_only_other_version and now - started >= other_version_wait
            if stood or is_ended() or is_in_vain:
                break
        links.close()
        with self._arrivals.lock:
            if stood:  # replies that came meanwhile are handed over only now
                self._arrivals.lock.wait_for(lambda: not acks.missing(asked), REPEAT_PERIOD)
            # A robot of another version that has not replied counts as refusing.
            for name in acks.missing(of_other_version):
                acks.on_reply(name, _refused(request.id, name, view.members[name].wire))
            outcome = acks.outcome(targets, seconds=now - started, reached=len(asked))
        if stood and outcome.missing:
            outcome = replace(
                outcome,
                warnings=(stood_still(stood, "it was not sent again; see which robots run"),),
            )
        return outcome, set(asked) - unlinked

    def _query(
        self, request: AnyRequest, robots: Sequence[str], timeout: float, acks: Acks
    ) -> None:
        """Send the request to each robot in `robots` (ANY: to all); the replies go to `acks`."""
        if not robots:
            return
        payload = encode(request)
        for robot in robots:
            self._sessions.get(robot, CONTROL, request.verb, payload, timeout, _collect(acks))

    def ask(
        self, robots: Iterable[str], name: str, payload: bytes, timeout: float
    ) -> dict[str, bytes]:
        """The answers to the query `control/<name>`, by robot, within `timeout` s.

        Robots that did not answer are left out.
        """
        asked = sorted(set(robots))
        answers = dict[str, bytes]()
        until = boottime() + timeout
        self._loops.begin(boottime())
        while len(answers) < len(asked) and (time_left := until - boottime()) > 0:
            for robot in asked:
                if robot not in answers:  # `setdefault`: the first answer of a robot counts
                    self._sessions.get(robot, CONTROL, name, payload, time_left, answers.setdefault)
            with self._arrivals.lock:
                self._arrivals.lock.wait_for(
                    lambda: len(answers) == len(asked), min(time_left, REPEAT_PERIOD)
                )
            self._loops.turn(boottime(), REPEAT_PERIOD)
        with self._arrivals.lock:
            return dict(answers)


def stood_still(seconds: float, consequence: str) -> str:
    """The line for the user after this process stood still."""
    text = f"this program stood still for {seconds:.1f} s (stopped, or its computer suspended)"
    return f"{text}: {consequence}"


def _collect(acks: Acks) -> Callable[[str, bytes], object]:
    """The handler of replies; a reply of another version counts as refused, with its text."""

    def take(robot: str, payload: bytes) -> None:
        if version_of(payload) == codec.VERSION:
            acks.on_reply(robot, _reply(payload))
            return
        header = _reply_header(payload)
        reply = Reply(
            id=header.id,
            robot=header.robot,
            code=Code.REFUSED,
            refusal=Refusal.OTHER_VERSION,
            text=header.text,
        )
        acks.on_reply(robot, reply)

    return take


def _refused(request: str, robot: str, wire: int | None) -> Reply:
    """The refusal that stands for the missing reply of a robot of another version."""
    return Reply(
        id=request,
        robot=robot,
        code=Code.REFUSED,
        refusal=Refusal.OTHER_VERSION,
        text=f"{robot} speaks {'another' if wire is None else wire}, this swarmctl {codec.VERSION}",
    )


ORIGIN_BYTES = 4
ORIGIN_FILE = "stops"
_MAX_COUNTER = 2**52  # a file with a greater counter is damaged


class _Record(Struct, frozen=True, array_like=True):
    origin: Annotated[bytes, Meta(min_length=ORIGIN_BYTES, max_length=ORIGIN_BYTES)]
    counter: Annotated[int, Meta(ge=0, le=_MAX_COUNTER)]


class StopOrigin:
    """Gives each stop an origin and a counter (`stop_freshness.py`); never raises or waits.

    Without a `folder`, or if the file cannot be read, locked and written: a random origin.
    """

    def __init__(self, folder: Path | None, clock: Callable[[], float] = time.time) -> None:
        self._path = None if folder is None else folder / ORIGIN_FILE
        self._clock = clock

    def next(self, *, is_new: bool = False) -> tuple[bytes, int]:
        """The origin and counter of one stop; `is_new`: take an origin that was never used."""
        least = max(int(1000.0 * self._clock()), 1)
        fresh = _Record(os.urandom(ORIGIN_BYTES), least)
        if self._path is None:
            return fresh.origin, fresh.counter
        try:
            handle = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError:
            return fresh.origin, fresh.counter
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            record = fresh if is_new else _following(os.pread(handle, 64, 0), fresh)
            content = msgspec.msgpack.encode(record)
            os.ftruncate(handle, 0)
            if os.pwrite(handle, content, 0) != len(content):
                return fresh.origin, fresh.counter
            return record.origin, record.counter
        except OSError:  # the disk is full, or another command holds the lock right now
            return os.urandom(ORIGIN_BYTES), least
        finally:
            os.close(handle)


def _following(content: bytes, fresh: _Record) -> _Record:
    """The record after the record in the file; `fresh` if the file is damaged."""
    try:
        last = msgspec.msgpack.decode(content, type=_Record)
    except msgspec.MsgspecError:
        return fresh
    return _Record(last.origin, min(max(last.counter + 1, fresh.counter), _MAX_COUNTER))


Select = Callable[[Collection[str]], Collection[str]]
Renew = Callable[[], tuple[bytes, int]]
"""Returns an origin that was never used, and a counter (`stop_freshness.py`)."""
RENEW_PERIOD = 0.5  # s between two new origins: refusals of the origin before may still arrive
# Bytes for target names in one datagram, beside an operator's name and a reason of full length.
_MAX_TARGET_BYTES = 400
_NAME_OVERHEAD = 2  # bytes of MessagePack before a name
# By default a stop goes on for at least STOP_WAIT s and STOP_TRIPS round trips.
STOP_WAIT = 3.0
STOP_TRIPS = 8.0
# A stop ends at the latest after STOP_CAP s and STOP_TRIPS round trips. A round trip counts as at
# most MAX_STOP_TRIP s, so that no datagram can raise this bound.
STOP_CAP = 20.0
MAX_STOP_TRIP = 2.0


class PendingStop:
    """A stop or emergency stop that is repeated until every expected robot has acked.

    - `discovery`: the robots that are known so far.
    - `select` picks the targets from the names known so far. None: all robots are targets, and
      the stop needs no list of names.
    - `names`: targets from the start, whether or not they are known.
    - `renew` returns a new origin and counter: by these a robot of a secured swarm detects replayed
      stops. The stop is repeated with new numbers if a robot refuses it as replayed.

    Every repeat has the same id.
    """

    def __init__(
        self,
        stop: Stop,
        discovery: Discovery,
        started: float,
        *,
        select: Select | None = None,
        names: Collection[str] = (),
        renew: Renew | None = None,
    ) -> None:
        self.acks = Acks(stop.id)
        self._stop = stop
        self._discovery = discovery
        self._started = started
        self._select = select
        self._names = frozenset(names)
        self._renew = renew
        self._renewed = started - RENEW_PERIOD

    def datagrams(
        self, now: float, names: Collection[str] | None = None
    ) -> Iterator[tuple[Stop, tuple[Address, ...]]]:
        """The stop datagrams to send now, each with the addresses of its targets that lack an ack.

        The caller sends each datagram by multicast, and by unicast to these addresses. A stop of
        all robots is one datagram. A stop of named targets is as many datagrams as the names need,
        and none while no target is known. `names`: only for these targets; None: all targets.
        """
        # `age`: s since the stop was issued. `repeated`: the age at which the operator itself sent
        # the copy. Both are equal here; a robot that relays the copy raises only `age`.
        age_ms = round((now - self._started) * 1000)
        stop = replace(self._stop, age=age_ms, repeated=age_ms)
        lacking = set(self.lacking(now))
        if names is not None:
            lacking &= set(names)
        if self._select is None:
            yield stop, self._addresses(lacking)
            return
        for targets in _in_datagrams(sorted(self.selected() if names is None else names)):
            addresses = self._addresses(lacking.intersection(targets))
            yield replace(stop, targets=targets), addresses

    def _addresses(self, names: Collection[str]) -> tuple[Address, ...]:
        addresses = {self._discovery.address(name) for name in names}
        return tuple(sorted(address for address in addresses if address is not None))

    def on_ack(self, ack: Ack, now: float) -> bool:
        """Take an ack; False if the ack is not kept.

        An ack of another request is not kept. An ack that refuses the stop as replayed is not kept
        either: the robot has heard a later stop of the same origin (random bytes that mark this
        operator's installation). The next repeat of the stop then gets an origin that was never
        used, which no robot refuses as replayed.
        """
        if ack.refusal != REPLAYED or self._renew is None:
            return self.acks.on_ack(ack)
        if ack.id == self._stop.id and now - self._renewed >= RENEW_PERIOD:
            self._renewed = now
            origin, counter = self._renew()
            self._stop = replace(self._stop, origin=origin, counter=counter)
        return False

    def selected(self) -> frozenset[str]:
        """The targets among the names known so far."""
        known = self._discovery.known
        return known if self._select is None else self._names | frozenset(self._select(known))

    def lacking(self, now: float) -> tuple[str, ...]:
        """The expected robots that have not acked, or whose ack says that the base still moves."""
        return tuple(name for name in sorted(self._expected(now)) if self._is_lacking(name))

    def silent(self, now: float) -> tuple[str, ...]:
        """The expected robots without an ack; if two daemons hold an id, both must ack."""
        return tuple(name for name in sorted(self._expected(now)) if self._is_silent(name))

    def _is_lacking(self, name: str) -> bool:
        if self._is_silent(name):
            return True
        if self.acks.is_moving(name):
            self.acks.forget_ended(name, self._discovery.holders(name))
        return self.acks.is_moving(name)

    def _is_silent(self, name: str) -> bool:
        # The holders of an id take long to find, and matter only once the robot has acked.
        if not self.acks.has_reply(name):
            return True
        return self.acks.lacks(name, self._discovery.holders(name))

    def is_done(self, now: float) -> bool:
        """True once the membership is known and every expected robot has acked and rests.

        Each datagram that arrives asks. The first robot that lacks an ack is an answer.
        """
        expected = self._expected(now)
        if not expected or any(map(self._is_lacking, expected)):
            return False
        return self._discovery.has_all_lists(now)  # takes the time of N**2 reports

    def is_over(self, now: float) -> bool:
        """True once the stop need not be repeated longer for robots that lack an ack."""
        trip = self._discovery.round_trip
        if now - self._started >= STOP_CAP + STOP_TRIPS * min(trip, MAX_STOP_TRIP):
            return True
        earliest_end = self._started + STOP_WAIT + STOP_TRIPS * trip
        if now < earliest_end:
            return False
        is_without_robots = not self._discovery.heard or not self._expected(now)
        return is_without_robots or now >= self._discovery.ends_at(now, self.lacking(now))

    def outcome(self, now: float) -> Outcome:
        """The outcome if the stop ended now."""
        is_open = self._select is None or not self.selected() <= self._names
        return self.acks.outcome(
            self._expected(now),
            silent=self.silent(now),
            seconds=now - self._started,
            reached=len(self._discovery.heard),
            unlisted=self._discovery.unlisted if is_open else (),
        )

    def _expected(self, now: float) -> frozenset[str]:
        """The robots that must ack: all selected robots except those that left.

        A robot has left if it sent a farewell (its last beacon). A robot of the roster must ack
        even then. A farewell may be forged: a robot that another robot lists as alive must ack,
        too. Failed robots must ack, since a robot that cannot be reached may move.
        """
        left = self._discovery.left(now)
        excused = left - self._discovery.roster - self._discovery.doubted if left else left
        return self.selected() - excused


def _in_datagrams(names: Iterable[str]) -> Iterator[tuple[str, ...]]:
    """The names in groups of at most _MAX_TARGET_BYTES, at least one name a group."""
    group: list[str] = []
    size = 0  # bytes of `group` in a datagram
    for name in names:
        name_size = len(name) + _NAME_OVERHEAD
        if group and size + name_size > _MAX_TARGET_BYTES:
            yield tuple(group)
            group = []
            size = 0
        group.append(name)
        size += name_size
    if group:
        yield tuple(group)


STOP_PACE = ((1.0, 0.1), (float("inf"), 0.25))  # steps of a RepeatTimer
PROGRESS_PERIOD = 3.0  # s between two reports of robots without an ack
END_PERIOD = 0.05  # s between two tests of the end


class _Progress:
    """Reports to the user which robots have not stopped, whenever these change."""

    def __init__(self, now: float) -> None:
        self._timer = RepeatTimer(now + 1.0, ((float("inf"), PROGRESS_PERIOD),))
        # By `_rest_time` each base rests, or its robot has reported that the base has not stopped.
        self._rest_time = now + STOP_WAIT
        self._unstopped: tuple[str, ...] = ()
        self._is_any_moving = False
        self._reported: tuple[str, ...] | None = None

    def take(self, pending: PendingStop, now: float) -> None:
        """Note the robots that have not stopped; with the lock held.

        Before `_rest_time` these are only the robots without an ack, since a base needs time to
        stop. From `_rest_time` on, robots whose last ack says "moving" are added.
        """
        lacking = pending.lacking(now)  # robots without an ack, and robots that still move
        self._unstopped = lacking if now >= self._rest_time else pending.silent(now)
        self._is_any_moving = bool(lacking)

    def report(self, on_progress: Callable[[tuple[str, ...]], None], now: float) -> None:
        """Call `on_progress` if the noted robots are new, at most once per PROGRESS_PERIOD."""
        # The user takes an empty list as the end of the stop: not while a base still moves.
        is_premature = not self._unstopped and self._is_any_moving
        is_new = self._unstopped != self._reported
        if is_new and not is_premature and self._timer.is_due(now):
            self._reported = self._unstopped
            on_progress(self._unstopped)


class StopSender:
    """Sends one stop at a time. `rosters` may take a newer roster meanwhile."""

    def __init__(
        self, datagrams: OperatorDatagrams, rosters: RosterFollower, arrivals: Arrivals
    ) -> None:
        self._datagrams = datagrams
        self._rosters = rosters
        self._arrivals = arrivals
        self._pending: PendingStop | None = None

    def on_ack(self, ack: Ack, now: float) -> bool:
        """Take an ack, with the lock held; False if it is not of the stop under way."""
        return self._pending is not None and self._pending.on_ack(ack, now)

    def send(
        self,
        pending: PendingStop,
        discovery: Discovery,
        until: float | None,
        *,
        until_all: bool,
        on_progress: Callable[[tuple[str, ...]], None],
        is_ended: Callable[[], bool],
    ) -> Outcome:
        """Send a stop, and repeat it until all targets have acked and rest; returns the outcome.

        `pending`: the stop, with its targets and the acks that other threads put there.
        `discovery`: the robots that are found meanwhile. Sending ends earlier

        - once `is_ended` returns True,
        - at the time `until` in s,
        - if `until` is None and `until_all` is False: once a longer wait is of no use
          (`PendingStop.is_over`),
        - on a KeyboardInterrupt, which is raised again only if `until_all` is False.

        `on_progress` is called only if `until_all` is True: it gets the robots that have not
        stopped, whenever these robots change.
        """
        with self._arrivals.lock:
            self._pending = pending
        now = boottime()
        solicit_timer = RepeatTimer(now, SOLICIT_PACE)
        stop_timer = RepeatTimer(now, STOP_PACE)
        end_timer = RepeatTimer(now, ((float("inf"), END_PERIOD),))
        progress = _Progress(now)
        known_targets: frozenset[str] = frozenset()
        try:
            while True:
                with self._arrivals.lock:
                    now = boottime()
                    count = self._arrivals.count
                    if until is not None:
                        is_over = now >= until
                    else:  # each datagram that arrives begins a turn: not in each of these
                        is_over = not until_all and end_timer.is_due(now) and pending.is_over(now)
                    if is_over or is_ended() or pending.is_done(now):
                        break
                    if until_all:
                        progress.take(pending, now)
                    targets = pending.selected()
                    new_targets = targets - known_targets
                    known_targets = targets
                    # A repeat goes to all targets (None); between two repeats, to new targets only.
                    is_repeat_due = stop_timer.is_due(now)
                    stops: tuple[tuple[Stop, tuple[Address, ...]], ...] = ()
                    if is_repeat_due or new_targets:
                        names = None if is_repeat_due else new_targets
                        stops = tuple(pending.datagrams(now, names))
                for stop_part, addresses in stops:
                    self._datagrams.send(stop_part, addresses, is_to_all=is_repeat_due)
                self._rosters.begin()  # if a robot shows a newer roster, a thread takes this roster
                if solicit_timer.is_due(now):
                    self._datagrams.solicit(discovery, now)
                if until_all:
                    progress.report(on_progress, now)
                pause = min(solicit_timer.pause(now), stop_timer.pause(now))
                to_end_check = END_PERIOD if until is None else until - now
                self._arrivals.wait(count, min(pause, to_end_check))
        except KeyboardInterrupt:
            if not until_all:
                raise  # `_pending` stays until the next stop: the caller ends and reads no acks
        with self._arrivals.lock:
            self._pending = None
            return pending.outcome(boottime())
