"""What the clocks of robots show at the least, by the beacons that answer an operator. Pure.

A robot of a secured swarm takes a run lease only if the lease states a time on the robot's own
clock (`link/members/lease_freshness.py`). The operator reads this clock from the answers to its
solicits. The true time is later than the time that is read, by the way of the answer.

All times are CLOCK_BOOTTIME, in s.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from swarmd.core.bounds import keep_newest
from swarmd.link.datagram import Beacon
from swarmd.operator.session.clock_query import MAX_DRIFT

ANSWER_TIME = 5.0
"""Seconds for which an answer is taken: less than `ECHO_TIME`, for which the operator knows that
the robot itself has signed the answer."""
MAX_ECHOES = 256
MAX_INSTANCES = 4096
_ROUNDING = 0.0005  # s, by which a clock in whole ms may be wrong


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
