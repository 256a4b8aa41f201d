"""Which robots are mute or deaf for messages, as robots tell one another. Pure.

A robot cannot know whether its messages arrive, nor whether it misses those of others. Its beacons
count what it has sent (`Beacon.sent`): messages of patterns, places and kin reports. A receiver
that hears these beacons, and none of the messages, tells so in its own beacons (`Report`). From the
reports of all robots each robot names the same faults:

1. A robot is *mute* if more than half of the others miss its messages, two others at least.
2. A robot is *deaf* if it misses more robots than it hears, two at least, which are not mute, and
   two others or more hear messages.
3. The reports of a deaf robot do not count against others.
4. What this robot alone misses, and no rule names, is *unheard*: it suspects the other, or itself.

Nothing is told of a robot that sends no messages. No motion depends on these faults.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Set
from typing import NamedTuple

from msgspec import Struct

from swarmd.core.messages import DEAF, MUTE, UNHEARD, PeerFault
from swarmd.link.datagram import MAX_UNHEARD

# A robot's messages are missed after so many messages, beacons and s without any of them. Beacons
# that tell of further messages count alone, so one lost burst is no evidence. A bad link loses
# beacons and messages alike: docs/evidence/faults.md has the count of false alarms.
MISSED_MESSAGES = 10
MISSED_BEACONS = 5
MISSED_TIME = 5.0
SILENCE = 3.0
"""Seconds without a beacon after which the count of missed messages begins again: what does not
arrive then is the link, and not the messages alone."""
SENDS_FOR = 10.0
"""Seconds after its last message for which a robot counts as one that sends messages."""
MAX_PEERS = 1024
JUDGE_PERIOD = 1.0
"""Seconds between two judgements."""
_LEAST = 2  # others that must tell a fault before it is named


class Report(NamedTuple):
    """Whose messages a robot misses, and of how many robots it hears messages."""

    unheard: Set[str] = frozenset()
    heard: int = 0

    @property
    def judges(self) -> bool:
        """True if the robot can tell anything: others send messages."""
        return bool(self.unheard or self.heard)


class Verdict(NamedTuple):
    """`by` robots of the `of` robots that could tell tell a fault of one of these kinds."""

    kind: str
    by: int
    of: int


NO_REPORT = Report()


class _Peer(Struct):
    """What is known of the messages of one instance of a robot."""

    instance: bytes
    number: int  # of its last beacon to all
    at: float  # s, of that beacon
    sent: int  # messages that it had sent by then
    sent_at: float = -math.inf  # s, when `sent` rose last
    counted: int = 0  # messages that it had sent at `counted_at`
    counted_at: float = 0.0  # s, from which missed messages count
    beacons: int = 0  # since `counted_at`, those that tell of further messages
    has_message: bool = False  # since the last beacon
    heard_at: float = -math.inf  # s, of its last message
    report: Report = NO_REPORT

    def begin_count(self, now: float) -> None:
        """Count missed messages from now on."""
        self.counted = self.sent
        self.counted_at = now
        self.beacons = 0

    def is_present(self, now: float) -> bool:
        """True if beacons arrive."""
        return now - self.at <= SILENCE

    def is_missed(self, now: float) -> bool:
        """True if beacons tell of messages, and none arrives."""
        return (
            self.beacons >= MISSED_BEACONS
            and self.sent - self.counted >= MISSED_MESSAGES
            and now - self.counted_at >= MISSED_TIME
            and now - self.sent_at <= SENDS_FOR
            and not self.has_message
        )


class Hearing:
    """What the robot `own` hears of its peers' messages, and the faults that follow.

    `report`: for the own beacons. `faults`: the present faults. Both as of the last `advance`.
    """

    def __init__(self, own: str) -> None:
        self._own = own
        self._peers: dict[str, _Peer] = {}
        self._judged_at = -math.inf
        self._since: dict[tuple[str, str], float] = {}
        self.report = NO_REPORT
        self.faults: tuple[PeerFault, ...] = ()

    def on_message(self, robot: str, instance: bytes, now: float) -> None:
        """Note that a message, place or kin report of a robot arrived."""
        peer = self._peers.get(robot)
        if peer is not None and peer.instance == instance:
            peer.has_message = True
            peer.heard_at = now

    def on_beacon(
        self, robot: str, instance: bytes, number: int, sent: int, report: Report, now: float
    ) -> None:
        """Note a beacon to all by its number; a copy of an earlier beacon changes nothing.

        `sent`: messages that the instance has sent; 0 from an older version. `report`: what it
        tells of others.
        """
        peer = self._peers.get(robot)
        if peer is None or peer.instance != instance:
            self._peers.pop(robot, None)
            while len(self._peers) >= MAX_PEERS:
                del self._peers[min(self._peers, key=lambda name: self._peers[name].at)]
            peer = self._peers[robot] = _Peer(instance, number, now, sent, report=report)
            peer.begin_count(now)
            return
        if number <= peer.number:
            return
        is_new_count = peer.has_message or not peer.is_present(now)
        has_sent = sent > peer.sent
        if has_sent:
            peer.sent_at = now
        peer.number = number
        peer.at = now
        peer.sent = sent
        peer.report = report
        peer.has_message = False
        if is_new_count:
            peer.begin_count(now)
        else:
            peer.beacons += has_sent

    def advance(self, now: float) -> bool:
        """Judge anew if it is time; True if `faults` differ in more than their times."""
        if now - self._judged_at < JUDGE_PERIOD:
            return False
        self._judged_at = now
        present = {name: peer for name, peer in self._peers.items() if peer.is_present(now)}
        missed = {name: peer for name, peer in present.items() if peer.is_missed(now)}
        heard = sum(
            now - peer.heard_at <= SENDS_FOR and name not in missed
            for name, peer in present.items()
        )
        self.report = Report(frozenset(sorted(missed)[:MAX_UNHEARD]), heard)
        reports = {name: peer.report for name, peer in present.items()}
        reports[self._own] = self.report
        if not any(report.unheard for report in reports.values()):  # the case of a sound swarm
            had_faults = bool(self.faults)
            self.faults = ()
            self._since.clear()
            return had_faults
        began = {name: peer.counted_at for name, peer in missed.items()}
        return self._take(dict(_verdicts(self._own, reports)), began, now)

    def _take(
        self, verdicts: Mapping[str, Verdict], began: Mapping[str, float], now: float
    ) -> bool:
        """Make the faults of these verdicts; `began`: s from which this robot misses a robot."""
        before = [(one.robot, one.kind, one.by, one.of) for one in self.faults]
        keys = {(robot, verdict.kind) for robot, verdict in verdicts.items()}
        self._since = {
            (robot, kind): self._since.get((robot, kind), began.get(robot, now))
            for robot, kind in keys
        }
        self.faults = tuple(
            PeerFault(
                robot=robot,
                kind=verdict.kind,
                by=verdict.by,
                of=verdict.of,
                since=max(now - self._since[robot, verdict.kind], 0.0),
            )
            for robot, verdict in sorted(verdicts.items())
        )
        return before != [(one.robot, one.kind, one.by, one.of) for one in self.faults]


def _verdicts(own: str, reports: Mapping[str, Report]) -> Iterator[tuple[str, Verdict]]:
    """The robots with a fault by the reports of all present robots, each once."""
    judges = {name for name, report in reports.items() if report.judges}
    accused = sorted({robot for report in reports.values() for robot in report.unheard})
    muted = {robot for robot in accused if _is_mute(_against(robot, judges, reports))}
    deaf = _deaf(judges, muted, reports)
    sound = judges - deaf.keys()
    for robot in accused:
        verdict = _against(robot, sound, reports)
        if _is_mute(verdict):
            yield robot, verdict
            deaf.pop(robot, None)
        elif own in sound and robot in reports[own].unheard and robot not in deaf:
            yield robot, Verdict(UNHEARD, verdict.by - 1, verdict.of - 1)  # of others
    yield from sorted(deaf.items())


def _against(robot: str, judges: Set[str], reports: Mapping[str, Report]) -> Verdict:
    """How many of the judges miss the messages of a robot."""
    others = judges - {robot}
    by = sum(robot in reports[name].unheard for name in others)
    return Verdict(MUTE, by, len(others))


def _is_mute(verdict: Verdict) -> bool:
    """True if two robots or more miss the messages, and more than half of all that could."""
    return verdict.by >= _LEAST and 2 * verdict.by > verdict.of


def _deaf(judges: Set[str], muted: Set[str], reports: Mapping[str, Report]) -> dict[str, Verdict]:
    """The judges that miss more robots than they hear, without those that are mute."""
    found: dict[str, Verdict] = {}
    for robot in judges:
        missed = len(reports[robot].unheard - muted)
        hearing = sum(reports[name].heard > 0 for name in judges - {robot})
        if missed >= _LEAST and missed > reports[robot].heard and hearing >= _LEAST:
            found[robot] = Verdict(DEAF, hearing, len(judges) - 1)
    return found
