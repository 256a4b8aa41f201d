"""Times of an operator: late input, standing still, waits, round trips, and the clocks of robots.

- `InputWatch` bounds how long a command waited for a program that was busy or frozen. A program
  that does not run, as after SIGSTOP or while its computer sleeps, reads its input late and cannot
  see when the input was written. So a reader notes each moment at which no input waited.
- `LoopWatch` detects that a process stood still: SIGSTOP, Ctrl-Z, a closed lid, a suspended
  computer. A program that commands robots looks again and again while it works: it waits for
  answers, for a canary, or for the next call. If it did not look for more than MAX_GAP beyond its
  wait, it stood still, and its user may have given a later order elsewhere. Then it starts no
  motion. Time for which a thread of the process waited for a processor is no gap: on a loaded
  computer a program is slow without standing still, also where the waiting thread holds what the
  loop needs. The kernel counts this time, and does not count it for a stopped process. A robot
  bounds the age of each start in any case (`verbs.MAX_AGE`).
- `Arrivals` and `RepeatTimer` are the wait of a call: for what an operator receives on other
  threads, and until a repeat is due.
- `RoundTrips` measures the round trips of solicits, and the share of solicits without an answer.
- `read_clocks` asks robots for their clocks, for starts at one moment. A robot reads its clock at
  some time between the operator's query and the arrival of its answer. So the offset is estimated
  from the middle of the round trip, with an error of at most half of the round trip (Cristian,
  Probabilistic clock synchronization, Distributed Computing 3, 1989). Of several exchanges with a
  robot, the exchange with the shortest round trip counts (the clock filter of NTP, RFC 5905,
  section 10).
- `RobotClocks` takes what the clocks show at the least from the beacons that answer solicits. A
  robot of a secured swarm takes a run lease only if the lease states a time on the robot's own
  clock (`link/members/lease_freshness.py`). The true time is later than the time that is read, by
  the way of the answer.

All times are CLOCK_BOOTTIME, in s.
"""

from __future__ import annotations

import contextlib
import math
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import TYPE_CHECKING, NamedTuple

from msgspec import Struct

from swarmd.core.bounds import keep_newest
from swarmd.core.clock import boottime
from swarmd.link.datagram import Beacon, ClockQuery, ClockReply
from swarmd.link.members.membership import MAX_MEMBERS

if TYPE_CHECKING:
    from swarmd.operator.session.operator import Operator


MAX_INPUT_GAP = 1.0
"""Seconds without a look after which waiting input has an unknown age."""
MAX_LATENESS = 3.0
"""Seconds from the arrival of a command that starts or changes motion to its carrying out."""
TOO_LATE = "it came too late; look at the robots and send it again"


class InputWatch:
    """The looks of a reader at its input. Times are in s on the clock since boot."""

    def __init__(self, now: float) -> None:
        self._looked_at = now
        self._unbroken_since = now
        """The first of the looks that follow each other within MAX_INPUT_GAP."""

    def look(self, now: float) -> None:
        """Note that no input waited at `now`; the reader looks several times in MAX_INPUT_GAP."""
        if now - self._looked_at > MAX_INPUT_GAP:
            self._unbroken_since = now
        self._looked_at = now

    def arrival(self, now: float) -> float:
        """When input that is read at `now` arrived: `now`, or -inf if its age is unknown."""
        return now if now - self._looked_at <= MAX_INPUT_GAP else -math.inf

    def is_unbroken(self, since: float, now: float) -> bool:
        """True if the reader looked within each MAX_INPUT_GAP from `since` to `now`."""
        return since >= self._unbroken_since and now - self._looked_at <= MAX_INPUT_GAP

    def is_fresh(self, at: float, now: float) -> bool:
        """True if a command that arrived `at` may start motion at `now`.

        False after MAX_LATENESS, and if the reader did not look for MAX_INPUT_GAP since `at`.
        """
        return self.is_unbroken(at, now) and now - at < MAX_LATENESS


MAX_GAP = 1.0
"""Seconds without a look, beyond the wait and the time without a processor."""
READ_PERIOD = 0.5  # s after which the waits are read again; 20 threads take some 0.5 ms
MAX_LOOPS = 64  # loops that are remembered
START_TIME = 3.0
"""Seconds between an order and the first look that count as work: the start of a program."""


def processor_waits() -> dict[str, float]:
    """Seconds for which each thread has waited for a processor so far; empty if not known."""
    waits = {}
    with contextlib.suppress(OSError):
        for thread in os.listdir("/proc/self/task"):
            path = f"/proc/self/task/{thread}/schedstat"
            with contextlib.suppress(OSError, ValueError, IndexError), open(path, "rb", 0) as file:
                waits[thread] = 1e-9 * int(file.read().split()[1])
    return waits


class LoopWatch:
    """Watches the loops of one thread; times in s on one clock.

    Call `begin` before a loop, and `turn` in each turn of it.
    """

    def __init__(self, waited: Callable[[], Mapping[str, float]] = processor_waits) -> None:
        """`waited`: s for which each thread has waited for a processor so far."""
        self._processor_waits = waited
        self._waited: Mapping[str, float] = {}
        self._read_at = -math.inf
        self._loops = deque[tuple[float, float]](maxlen=MAX_LOOPS)  # begin and last turn of each
        self._stops = deque[tuple[float, float]](maxlen=MAX_LOOPS)  # end of a standstill, and s

    def begin(self, now: float) -> None:
        """A loop begins."""
        self._read(now)
        self._loops.append((now, now))

    def turn(self, now: float, pause: float = 0.0) -> float:
        """Note a turn of the loop; returns the s for which the process stood still before it, or 0.

        `pause`: s for which the loop wanted to wait at most since its last turn.
        """
        begun, last = self._loops[-1]
        gap = now - last - pause
        if gap > MAX_GAP or now - self._read_at > READ_PERIOD:
            gap -= self._read(now)
        if gap <= MAX_GAP:
            self._loops[-1] = begun, now
            return 0.0
        self._stops.append((now, gap))
        self._loops.append((now, now))
        return gap

    def _read(self, now: float) -> float:
        """The longest wait of a thread in s since the last call."""
        before = self._waited
        self._waited = self._processor_waits()
        self._read_at = now
        return max(
            (wait - before.get(thread, 0.0) for thread, wait in self._waited.items()), default=0.0
        )

    def stood(self, since: float) -> float:
        """The longest standstill in s that ended after `since`; 0 without one."""
        return max((gap for end, gap in self._stops if end > since), default=0.0)

    def worked(self, since: float) -> float:
        """Seconds since `since` that loops took, and those before the first loop (START_TIME)."""
        loops = [(max(begun, since), last) for begun, last in self._loops if last >= since]
        start = min(loops[0][0] - since, START_TIME) if loops else 0.0
        return start + sum(last - begun for begun, last in loops)


class Arrivals:
    """A lock over tables that other threads fill, and a count of what has arrived.

    Zenoh's threads and the carrier's thread hold `lock` while they put what they receive into
    tables, then call `notify`. The caller's thread waits.
    """

    def __init__(self) -> None:
        self.lock = threading.Condition()
        self.count = 0

    def notify(self) -> None:
        """Wake the thread that waits; the lock is held."""
        self.count += 1
        self.lock.notify_all()

    def wait(self, count: int, timeout: float) -> None:
        """Wait until something arrives after `count` was read, at most `timeout` s."""
        with self.lock:
            self.lock.wait_for(lambda: self.count != count, max(0.001, timeout))


# Of solicits, as `steps` of a timer: often at first, then sparing the network.
SOLICIT_PACE = ((0.5, 0.1), (float("inf"), 0.5))


class RepeatTimer:
    """When to do something again; `steps`: (until, period) in s since the start."""

    def __init__(self, now: float, steps: tuple[tuple[float, float], ...]) -> None:
        self._started = now
        self._next = now
        self._steps = steps

    def age(self, now: float) -> float:
        """Seconds since the start."""
        return now - self._started

    def is_due(self, now: float) -> bool:
        """True once a period: the call then begins the next period."""
        if now < self._next:
            return False
        age = now - self._started
        self._next = now + next(period for until, period in self._steps if age < until)
        return True

    def pause(self, now: float) -> float:
        """Seconds until it is due."""
        return max(0.001, self._next - now)


QUIET_TIME = 0.1  # s that an answer takes at most beyond the round trip
MAX_ECHOES = 256
MAX_ROUND_TRIP = 5.0  # s: bound of the round trip
FEW_ROBOTS = 8  # up to this number the longest round trip counts, beyond it the median
ROUNDING_MS = 0.5  # by which a clock in whole ms may be too great
MOST_INSTANCES = 2 * MAX_MEMBERS
"""Instances of which a look keeps a value: forged beacons may name any number."""
LEAST_ASKED = 4  # solicits to an instance from which on its loss is measured


class _Answers(Struct):
    """The solicits that an instance answered."""

    asked: int  # solicits sent until the instance was first heard
    echoes: set[int] = set()  # numbers of the solicits that it answered


class RoundTrips:
    """Measures round trip and loss from beacons that echo solicits.

    An instance is a pair (robot, instance).
    """

    def __init__(self) -> None:
        self.solicits = 0  # the count of solicits that were sent
        self._sent: dict[int, float] = {}
        self._answers: dict[tuple[str, str], _Answers] = {}
        self._trips: dict[str, float] = {}
        # By instance, the s by which its clock is at least ahead of the operator's clock.
        self.clock_leads: dict[tuple[str, str], float] = {}

    def on_solicit(self, echo: int, now: float) -> None:
        """Note that a `Solicit` with this number is sent now."""
        self.solicits += 1
        self._sent[echo] = now
        if len(self._sent) > MAX_ECHOES:
            del self._sent[next(iter(self._sent))]

    def on_echo(self, robot: str, instance: str, echo: int, now: float, clock_ms: int = 0) -> None:
        """Note a beacon of an instance.

        `echo`: the number of the solicit that it answers, or 0. `clock_ms`: the clock of the
        instance when it sent the answer, rounded to ms; 0 if the beacon does not show it.
        """
        known = self._answers.get((robot, instance))
        if known is None:
            known = _Answers(self.solicits)
            keep_newest(self._answers, (robot, instance), known, MOST_INSTANCES)
        sent = self._sent.get(echo)
        if sent is not None and clock_ms:
            # The way of the answer took some time, by which the true lead is greater.
            lead = (clock_ms - ROUNDING_MS) / 1000.0 - now
            lead = max(lead, self.clock_leads.get((robot, instance), lead))
            keep_newest(self.clock_leads, (robot, instance), lead, MOST_INSTANCES)
        if sent is not None and echo not in known.echoes:
            known.echoes.add(echo)
            trip = max(now - sent, 0.0)
            self._trips[robot] = min(trip, self._trips.get(robot, trip))

    def is_after(self, echo: int, at: float) -> bool:
        """True if the solicit with this number was sent after that time."""
        return self._sent.get(echo, at) > at

    def has_answered(self, robot: str, instance: str) -> bool:
        """True if an instance answered a solicit."""
        known = self._answers.get((robot, instance))
        return known is not None and bool(known.echoes)

    @property
    def round_trip(self) -> float:
        """The round trip to the robots in s; 0 without an answer.

        The shortest round trip of each robot counts. With up to FEW_ROBOTS robots the result is the
        longest of these, with more robots their median, and at most MAX_ROUND_TRIP. Once any robot
        has answered two solicits, robots with a single answer are left out.
        """
        twice = {robot for (robot, _), answers in self._answers.items() if len(answers.echoes) > 1}
        trips = sorted(trip for robot, trip in self._trips.items() if not twice or robot in twice)
        if not trips:
            return 0.0
        trip = trips[-1] if len(trips) <= FEW_ROBOTS else trips[len(trips) // 2]
        return min(trip, MAX_ROUND_TRIP)

    def loss(self, instances: Iterable[tuple[str, str]], now: float) -> float:
        """The largest share of solicits, 0 to 1, that an instance in `instances` did not answer.

        Solicits of the last round trip are left out: their answers may still come.
        """
        trip = self.round_trip
        worst = 0.0
        recent = sum(1 for at in self._sent.values() if now - at <= trip + QUIET_TIME)
        for instance in instances:
            if known := self._answers.get(instance):
                asked = self.solicits - recent - max(known.asked - 1, 0)
                if asked >= LEAST_ASKED:
                    worst = max(worst, 1.0 - len(known.echoes) / asked)
        return min(max(worst, 0.0), 1.0)


EXCHANGES = 8
PERIOD = 0.03
"""Exchanges with each robot, and s between two: a robot answers 30 queries a second."""
TIMEOUT = 0.6
TRIPS = 3.0
"""The wait for answers: s, and round trips."""
MAX_DRIFT = 500e-6
"""The largest difference of the rates of two clocks, relative to a clock's rate."""
_NANOSECOND = 1e-9  # s
ANSWER_TIME = 5.0
"""Seconds for which an answer is taken: less than `ECHO_TIME`, for which the operator knows that
the robot itself has signed the answer."""
MAX_INSTANCES = 4096
_ROUNDING = 0.0005  # s, by which a clock in whole ms may be wrong


class ClockOffset(NamedTuple):
    """The offset of a robot's clock."""

    offset: float  # s: the robot's clock minus the operator's clock
    error: float  # s: bound of the error of `offset` at the time `at`
    at: float  # s on the operator's clock

    def error_at(self, moment: float) -> float:
        """The bound of the error at another time: clocks drift."""
        return self.error + MAX_DRIFT * abs(moment - self.at)


class ClockReadings:
    """The offsets of robots by the exchanges so far. Pure."""

    def __init__(self) -> None:
        self.offsets: dict[str, ClockOffset] = {}
        self._sent: set[int] = set()
        self._clocks: dict[str, bytes] = {}
        self._answers: dict[str, int] = {}

    def query(self, now: float) -> ClockQuery:
        """The query that is sent to a robot now."""
        query = ClockQuery(sent=max(round(1e9 * now), 0))
        self._sent.add(query.sent)
        return query

    def on_reply(self, reply: ClockReply, now: float) -> None:
        """Take an answer; an answer to no question is ignored."""
        if reply.sent not in self._sent:
            return
        sent = _NANOSECOND * reply.sent
        answered = _NANOSECOND * reply.answered
        if self._clocks.setdefault(reply.robot, reply.clock) != reply.clock:
            # The robot was booted again, or two daemons hold one id: earlier readings are void.
            self._clocks[reply.robot] = reply.clock
            self.offsets.pop(reply.robot, None)
        self._answers[reply.robot] = self._answers.get(reply.robot, 0) + 1
        error = max(now - sent, 0.0) / 2.0
        known = self.offsets.get(reply.robot)
        if known is None or error < known.error:
            self.offsets[reply.robot] = ClockOffset(answered - (sent + now) / 2.0, error, now)

    def lacking(self, robots: Collection[str]) -> set[str]:
        """The robots with which there were fewer than EXCHANGES exchanges."""
        return {robot for robot in robots if self._answers.get(robot, 0) < EXCHANGES}


def read_clocks(operator: Operator, robots: Collection[str]) -> dict[str, ClockOffset]:
    """The offsets of the clocks of robots that the operator's last look has heard.

    A robot that does not answer is left out. Takes some 0.25 s, and longer on long round trips.
    """
    readings = ClockReadings()
    operator.listen(ClockReply, readings.on_reply)
    try:
        begun = now = boottime()
        operator.loops.begin(now)
        until = begun + TIMEOUT + TRIPS * operator.seen().round_trip
        while now < until and (lacking := readings.lacking(robots)):
            operator.send_to_robots(lambda: readings.query(boottime()), lacking)
            time.sleep(PERIOD)
            now = boottime()
            operator.loops.turn(now, PERIOD)
    finally:
        operator.listen(ClockReply, None)
    return {robot: readings.offsets[robot] for robot in robots if robot in readings.offsets}


def start_times(
    offsets: Mapping[str, ClockOffset], moment: float
) -> tuple[dict[str, float], float]:
    """The start time in s on the clock of each robot, for a start of all robots at one moment.

    `moment`: s on the operator's clock. Also returns a bound in s of the time between the starts of
    any two robots: the sum of the two greatest errors of the offsets.
    """
    starts = {robot: moment + offset.offset for robot, offset in offsets.items()}
    errors = sorted((offset.error_at(moment) for offset in offsets.values()), reverse=True)
    return starts, sum(errors[:2]) if len(errors) > 1 else 0.0


class _Lead(NamedTuple):
    """By how many s the clock of a robot is at least ahead of the operator's clock."""

    lead: float
    at: float  # s on the operator's clock

    def least(self, now: float) -> float:
        """The lead at `now`, at least: clocks drift."""
        return self.lead - MAX_DRIFT * (now - self.at)


class RobotClocks:
    """The clock of each instance (robot, and the life of its daemon) that has answered."""

    def __init__(self) -> None:
        self._asked: dict[int, float] = {}  # by the echo of a solicit, when it was sent
        self._leads: dict[tuple[str, bytes], _Lead] = {}

    def on_solicit(self, echo: int, now: float) -> None:
        """Note that a `Solicit` with this number is sent now."""
        keep_newest(self._asked, echo, now, MAX_ECHOES)

    def on_beacon(self, beacon: Beacon, now: float) -> None:
        """Take an accepted beacon; one that answers no solicit of the last ANSWER_TIME is ignored.

        Of several answers that with the shortest way counts, as far as clocks do not drift.
        """
        asked = self._asked.get(beacon.echo)
        if asked is None or now - asked > ANSWER_TIME or not beacon.clock:
            return
        key = beacon.robot, beacon.instance
        clock = beacon.clock / 1000.0  # ms
        lead = clock - _ROUNDING - now
        greatest = clock + _ROUNDING - asked
        known = self._leads.get(key)
        # An earlier lead that is too great now is wrong: the operator's clock has jumped.
        if known is not None and known.least(now) <= greatest:
            lead = max(lead, known.least(now))
        keep_newest(self._leads, key, _Lead(lead, now), MAX_INSTANCES)

    def reading(self, robot: str, instance: bytes, now: float) -> int | None:
        """What the clock of the instance shows now at the least, in ms; None: it is not known."""
        known = self._leads.get((robot, instance))
        if known is None:
            return None
        return max(math.floor(1000.0 * (now + known.least(now))), 0)
