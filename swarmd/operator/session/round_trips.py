"""Round trips of an operator's solicits, and the share of solicits without an answer. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import Struct

from swarmd.core.bounds import keep_newest
from swarmd.link.members.membership import MAX_MEMBERS

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
