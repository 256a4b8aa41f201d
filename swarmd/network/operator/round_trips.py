"""Round trips of an operator's solicits, and the share of them without an answer. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import Struct

# An answer takes at most this long beside the round trip, in s.
QUIET_TIME = 0.1
MAX_ECHOES = 256
# The bound of the round trip, in s, which is the longest of a few robots and the median of many.
MAX_ROUND_TRIP, FEW_ROBOTS = 5.0, 8
LEAST_ASKED = 4  # solicits from which on a share without an answer says something


class _Answers(Struct):
    """The solicits that an instance answered, and how many were sent before it was first heard."""

    asked: int
    echoes: set[int] = set()


class RoundTrips:
    """What the robots' beacons tell of the way to them; instances are `(robot, instance)`."""

    def __init__(self) -> None:
        self.solicits = 0  # that were sent
        self._sent: dict[int, float] = {}
        self._answers: dict[tuple[str, str], _Answers] = {}
        self._trips: dict[str, float] = {}

    def on_solicit(self, echo: int, now: float) -> None:
        """A `Solicit` with this number is sent now."""
        self.solicits += 1
        self._sent[echo] = now
        if len(self._sent) > MAX_ECHOES:
            del self._sent[next(iter(self._sent))]

    def on_echo(self, robot: str, instance: str, echo: int, now: float) -> None:
        """A beacon of an instance that did not leave; `echo`: the number that it answers."""
        known = self._answers.setdefault((robot, instance), _Answers(self.solicits))
        sent = self._sent.get(echo)
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
        """The round trip, in s: the longest, the median of many robots; 0 without an answer.

        Robots that answered one solicit alone count only while no robot answered two.
        """
        twice = {robot for (robot, _), answers in self._answers.items() if len(answers.echoes) > 1}
        trips = sorted(trip for robot, trip in self._trips.items() if not twice or robot in twice)
        if not trips:
            return 0.0
        trip = trips[-1] if len(trips) <= FEW_ROBOTS else trips[len(trips) // 2]
        return min(trip, MAX_ROUND_TRIP)

    def loss(self, instances: Iterable[tuple[str, str]], now: float) -> float:
        """The largest share of solicits, 0 to 1, that one of these instances left unanswered."""
        trip, worst = self.round_trip, 0.0
        recent = sum(1 for at in self._sent.values() if now - at <= trip + QUIET_TIME)
        for who in instances:
            if known := self._answers.get(who):
                asked = self.solicits - recent - max(known.asked - 1, 0)
                if asked >= LEAST_ASKED:
                    worst = max(worst, 1.0 - len(known.echoes) / asked)
        return min(max(worst, 0.0), 1.0)
