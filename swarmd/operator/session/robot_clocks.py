"""The clocks of robots, as an operator reads them: for starts at one moment, and for leases.

`read_clocks` asks robots for their clocks. A robot reads its clock at some time between the
operator's query and the arrival of its answer. So the offset is estimated from the middle of the
round trip, with an error of at most half of the round trip (Cristian, Probabilistic clock
synchronization, Distributed Computing 3, 1989). Of several exchanges with a robot, the exchange
with the shortest round trip counts (the clock filter of NTP, RFC 5905, section 10).

`RobotClocks` takes what the clocks show at the least from the beacons that answer solicits. A robot
of a secured swarm takes a run lease only if the lease states a time on the robot's own clock
(`link/members/lease_freshness.py`). The true time is later than the time that is read, by the way
of the answer.

All times are CLOCK_BOOTTIME, in s.
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, NamedTuple

from swarmd.core.bounds import keep_newest
from swarmd.core.clock import boottime
from swarmd.link.datagram import Beacon, ClockQuery, ClockReply

if TYPE_CHECKING:
    from swarmd.operator.session.operator import Operator

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
MAX_ECHOES = 256
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
