"""Questions of a robot to the clocks of its peers, and the answers. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from swarmd.core.clock import ClockSample
from swarmd.link.datagram import Address, ClockQuery, ClockReply

# s between two rounds of questions: FIRST_CLOCK_PERIOD at the begin of a recording, then twice as
# long each time, up to CLOCK_PERIOD.
CLOCK_PERIOD = 10.0
FIRST_CLOCK_PERIOD = 1.0
_NANOSECOND = 1e-9  # s

Queries = list[tuple[ClockQuery, Address]]


class PeerClocks:
    """The clocks of the peers of `robot`; `clock`: the id of the robot's own clock, in hex."""

    def __init__(self, robot: str, clock: str) -> None:
        self._robot = robot
        self._clock = bytes.fromhex(clock)
        self._due_at = -math.inf
        self._pause = FIRST_CLOCK_PERIOD
        self._asked: dict[str, int] = {}  # by robot, the time in ns at which the question was sent

    def queries(self, alive: Iterable[tuple[str, Address]], now: float) -> Queries:
        """Questions for the clocks of some robots, with their addresses; empty if none is due.

        `alive`: the other robots that are alive. All robots form a ring in the order of their
        names. Each robot asks the robots that are 1, 2, 4, 8, ... places further in the ring: some
        log2(N) of N robots. So at most log2(N) comparisons of clocks connect any two robots.
        """
        if now < self._due_at:
            return []
        # Only recordings call this: after a pause in the calls a new recording has begun.
        is_first = now > self._due_at + FIRST_CLOCK_PERIOD
        self._pause = FIRST_CLOCK_PERIOD if is_first else min(2 * self._pause, CLOCK_PERIOD)
        self._due_at = now + self._pause
        addresses = dict(alive)
        ring = sorted([*addresses, self._robot])
        place = ring.index(self._robot)
        asked = [ring[(place + 2**k) % len(ring)] for k in range((len(ring) - 1).bit_length())]
        query = _query(now)
        self._asked = dict.fromkeys(asked, query.sent)
        return [(query, addresses[robot]) for robot in dict.fromkeys(asked)]

    def pings(
        self, robots: Iterable[str], alive: Iterable[tuple[str, Address]], now: float
    ) -> Queries:
        """Questions to those of these robots that are alive, for their round trips."""
        addresses: Mapping[str, Address] = dict(alive)
        asked = [robot for robot in robots if robot in addresses]
        query = _query(now)
        self._asked |= dict.fromkeys(asked, query.sent)
        return [(query, addresses[robot]) for robot in asked]

    def reply(self, query: ClockQuery, now: float) -> ClockReply:
        """The answer to a question."""
        return ClockReply(
            robot=self._robot,
            clock=self._clock,
            sent=query.sent,
            answered=max(round(1e9 * now), 0),
        )

    def sample(self, reply: ClockReply, now: float) -> ClockSample | None:
        """The reading of a peer's clock in an answer; None if no question waits for the answer."""
        if self._asked.get(reply.robot) != reply.sent:
            return None
        del self._asked[reply.robot]
        sent = _NANOSECOND * reply.sent
        answered = _NANOSECOND * reply.answered
        return ClockSample(reply.robot, reply.clock.hex(), sent, answered, now)


def _query(now: float) -> ClockQuery:
    return ClockQuery(sent=max(round(1e9 * now), 0))
