"""Detection of replayed beacons without a shared clock. Pure: beacons and times in.

Only secured swarms use this module. A beacon is the datagram that a robot sends each second to show
that it is alive. A signed beacon may be an old beacon that an attacker replays. An *instance* is
one life (start to end) of a robot's daemon.

1. An instance that is unknown, or was silent for longer than the lease, must answer a question
   (`Solicit`) first. The answer is a beacon with the `echo` of the question, a number that was
   never used before. The answer to a question before the silence does not count.
2. After the answer a beacon of the instance is accepted if its sequence is greater than the
   sequence of the last beacon.

`membership.py` decides after which silence a member has failed.
"""

from __future__ import annotations

from collections.abc import Callable

from msgspec import Struct

from swarmd.core.record import RecordKind
from swarmd.core.token_bucket import TokenBucket
from swarmd.link.datagram import Beacon, Flag, Solicit
from swarmd.link.signature import Flaw

ECHO_TIME = 10.0  # s for which an answer to a question is accepted: twice MAX_ROUND_TRIP
MAX_ECHOES = 4096
MAX_INSTANCES = 2048
# Questions to instances that are not proven: per second to all together, and at once.
QUESTION_RATE = 20.0
QUESTION_BURST = 40.0
# s between two questions to one instance. The time doubles with each question, so that replayed
# beacons of many earlier lives leave room for robots that join.
QUESTION_PERIOD = 0.2
LAST_QUESTION_PERIOD = 8.0
LATCH_TIME = 1.0  # s for which a robot that joins waits for the answer of an instance with latches

_Key = tuple[str, bytes]


class _ProvenLife(Struct):
    """An instance that has answered."""

    sequence: int  # the sequence number of the last beacon
    heard: float
    said: int  # messages up to this number were sent before the answer
    clock: int  # ms; places and kin reports up to this time were sent before the answer
    latest: dict[type, int] = {}  # ms, of the last datagram by kind


class _Asked(Struct, frozen=True):
    """The last question to an instance."""

    at: float
    period: float  # s until the next question
    has_latches: bool  # the beacon of the instance shows latches


class BeaconFreshness:
    """The instances that have answered; `echoes` returns a number that was never used before."""

    def __init__(self, lease: float, echoes: Callable[[], int]) -> None:
        self._lease = lease
        self._new_number = echoes
        self._echoes: dict[int, float] = {}
        self._known: dict[_Key, _ProvenLife] = {}
        self._asked: dict[_Key, _Asked] = {}
        self._questions = TokenBucket(QUESTION_RATE, QUESTION_BURST)

    def new_echo(self, now: float) -> int:
        """The number of a question that is asked now."""
        echo = self._new_number()
        self.note_echo(echo, now)
        return echo

    def note_echo(self, echo: int, now: float) -> None:
        """Note that a question with this number is asked now."""
        self._echoes[echo] = now
        if len(self._echoes) > MAX_ECHOES:
            del self._echoes[next(iter(self._echoes))]

    def is_own_echo(self, echo: int, now: float, after: float = -1e9) -> bool:
        """True if a question with this number was asked within ECHO_TIME, and after `after`."""
        asked = self._echoes.get(echo)
        return asked is not None and asked > after and now - asked <= ECHO_TIME

    def on_beacon(self, beacon: Beacon, now: float) -> Flaw | None:
        """Take a beacon; returns the flaw of a beacon that is refused, or None."""
        key = beacon.robot, beacon.instance
        proven = self._known.get(key)
        if proven is not None and now - proven.heard <= self._lease:
            if beacon.sequence <= proven.sequence:
                return Flaw.REPEATED
            proven.sequence = beacon.sequence
            proven.heard = now
            return None
        after = -1e9 if proven is None else proven.heard
        if beacon.flags & Flag.LEFT or not self.is_own_echo(beacon.echo, now, after):
            return Flaw.UNPROVEN
        self._asked.pop(key, None)
        self._known.pop(key, None)
        self._known[key] = _ProvenLife(beacon.sequence, now, beacon.said, beacon.clock)
        if len(self._known) > MAX_INSTANCES:
            del self._known[min(self._known, key=lambda instance: self._known[instance].heard)]
        return None

    def question(self, beacon: Beacon, now: float) -> Solicit | None:
        """The question to the sender of an unproven beacon; None if it must not be asked now."""
        key = beacon.robot, beacon.instance
        last = self._asked.get(key)
        is_due = last is None or now - last.at >= last.period
        if beacon.flags & Flag.LEFT or not is_due or not self._questions.take(1.0, now):
            return None
        period = QUESTION_PERIOD if last is None else min(2.0 * last.period, LAST_QUESTION_PERIOD)
        self._asked.pop(key, None)
        self._asked[key] = _Asked(now, period, bool(beacon.digest(RecordKind.LATCH)))
        if len(self._asked) > MAX_INSTANCES:
            del self._asked[next(iter(self._asked))]
        return Solicit(echo=self.new_echo(now), robot=beacon.robot)

    def awaits_latches(self, now: float) -> bool:
        """True if an instance with latches was asked within LATCH_TIME and has not answered."""
        return any(
            asked.has_latches and now - asked.at < LATCH_TIME for asked in self._asked.values()
        )

    def knows(self, robot: str, instance: bytes) -> bool:
        """True if the instance has answered."""
        return (robot, instance) in self._known

    def is_new_message(self, robot: str, instance: bytes, sequence: int) -> bool:
        """True if a pattern's message was sent after its instance had answered the question."""
        known = self._known.get((robot, instance))
        return known is not None and sequence > known.said

    def is_later(self, robot: str, instance: bytes, kind: type, sent: int) -> bool:
        """True if a datagram was sent later than all earlier ones of its instance and kind.

        Notes it. `sent`: ms on the clock of the beacon.
        """
        known = self._known.get((robot, instance))
        if known is None or sent <= known.latest.get(kind, known.clock):
            return False
        known.latest[kind] = sent
        return True
