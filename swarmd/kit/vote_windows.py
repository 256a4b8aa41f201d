"""Counting votes: windows of time, rounds, majorities, ties. Pure; the time is handed in.

Source: Kaiser et al., ICRA 2022 (tumbling windows: of fixed length, one after the other; sliding
windows and synchronised updates as variants); a vote that counts is the latest of its sender, the
voter's own is not among them, as in ROS2swarm.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Literal, NamedTuple, TypeAlias

from numpy.random import Generator

Ties: TypeAlias = Literal["random", "keep", "lowest"]
Windows: TypeAlias = Literal["tumbling", "sliding", "rounds"]

ROUNDS = 1 << 16
"""Rounds are numbered modulo this; what is less than half of it ahead is later."""


class Ballot(NamedTuple):
    """What a robot says under rounds: its vote of a round, and that of the round before."""

    round: int
    opinion: int
    previous: int


class VoteWindow:
    """A tumbling window of `length` s that opens at `now` and reopens whenever it is closed.

    At its end a vote that was heard before it opened, or over `expiry` s ago, does not count. The
    first one ends after the part `first` of its length.
    """

    def __init__(
        self, length: float, *, now: float, expiry: float = math.inf, first: float = 1.0
    ) -> None:
        self.length = length
        self.expiry = expiry
        self._opened = now
        self._end = now + first * length
        self._votes: dict[str, tuple[int, float]] = {}

    def add(self, sender: str, opinion: int, heard_at: float) -> None:
        """Count a vote; an older one of the same sender is replaced."""
        known = self._votes.get(sender)
        if known is None or heard_at >= known[1]:
            self._votes[sender] = (opinion, heard_at)

    def add_ballot(self, sender: str, ballot: Ballot, heard_at: float) -> None:
        """Count the vote of a robot that goes by rounds, whichever round it is in."""
        self.add(sender, ballot.opinion, heard_at)

    def forget(self, sender: str) -> None:
        """The sender has gone, and its vote with it."""
        self._votes.pop(sender, None)

    def close(self, now: float) -> Mapping[str, int] | None:
        """The votes by sender if the window has ended, and a new one opens; else None.

        The windows stay in step with the first: several that ended unseen are closed as one.
        """
        if now < self._end:
            return None
        self._end = _next(self._end, self.length, now)
        votes = self._since(max(self._opened, now - self.expiry))
        self._opened = now
        self._votes.clear()
        return votes

    def _since(self, oldest: float) -> Mapping[str, int]:
        return {
            sender: opinion
            for sender, (opinion, heard_at) in self._votes.items()
            if heard_at >= oldest
        }


class SlidingWindow(VoteWindow):
    """Every `period` s the votes of the last `length` s count, those of the last time included.

    The first time after the part `first` of a period.
    """

    def __init__(
        self,
        length: float,
        period: float,
        *,
        now: float,
        expiry: float = math.inf,
        first: float = 1.0,
    ) -> None:
        super().__init__(length, now=now, expiry=expiry)
        self.period = period
        self._end = now + first * period

    def close(self, now: float) -> Mapping[str, int] | None:
        """The votes by sender if a period has ended; else None."""
        if now < self._end:
            return None
        self._end = _next(self._end, self.period, now)
        votes = self._since(now - min(self.length, self.expiry))
        self._votes = {sender: self._votes[sender] for sender in votes}
        return votes


class Rounds:
    """Synchronised updates: everybody's votes of one round decide, then the next round begins.

    A round lasts at least `pause` s. It then ends as soon as nobody is behind of those that were
    heard in the last `expiry` s, after `length` s in any case. A robot that is one round ahead has
    its vote of this round in its ballot; one that is further ahead is not waited for. If more than
    half are further ahead, it is this robot that has fallen behind, and it catches up. So a lost
    message, a robot that left or one that names wild rounds blocks nobody.

    Source: the synchroniser alpha of Awerbuch, J. ACM 32(4), 1985. Ours: ballots that are repeated
    and hold the previous vote take the place of acknowledgements.
    """

    def __init__(
        self, length: float, pause: float, *, now: float, expiry: float = math.inf
    ) -> None:
        self.length = length
        self.period = pause
        self.expiry = expiry
        self.round = 0
        self._began = now
        self._plain: dict[str, tuple[int, float]] = {}
        self._ballots: dict[str, tuple[Ballot, float]] = {}

    def add(self, sender: str, opinion: int, heard_at: float) -> None:
        """Count the vote of a robot that does not go by rounds: it holds in every round."""
        self._ballots.pop(sender, None)
        known = self._plain.get(sender)
        if known is None or heard_at >= known[1]:
            self._plain[sender] = (opinion, heard_at)

    def add_ballot(self, sender: str, ballot: Ballot, heard_at: float) -> None:
        """Take a ballot; one of an earlier round than the sender's last comes late: ignored."""
        self._plain.pop(sender, None)
        known = self._ballots.get(sender)
        if known is not None:
            lead = _lead(ballot.round, known[0].round)
            if lead < 0 or (lead == 0 and heard_at < known[1]):
                return
        self._ballots[sender] = (ballot, heard_at)

    def forget(self, sender: str) -> None:
        """The sender has gone: its vote with it, and it is no longer waited for."""
        self._plain.pop(sender, None)
        self._ballots.pop(sender, None)

    def close(self, now: float) -> Mapping[str, int] | None:
        """The votes by sender if the round has ended, and the next one begins; else None.

        None of them if it ended because this robot catches up.
        """
        elapsed = now - self._began
        if elapsed < min(self.period, self.length):
            return None
        self._expire(now - self.expiry)
        leads = sorted(_lead(ballot.round, self.round) for ballot, _ in self._ballots.values())
        median = leads[(len(leads) - 1) // 2] if leads else 0
        if median > 1:
            return self._begin(self.round + median, {}, now)
        votes = self._votes()
        is_waiting = not votes or (bool(leads) and leads[0] < 0)
        if is_waiting and elapsed < self.length:
            return None
        return self._begin(self.round + 1, votes, now)

    def _begin(self, number: int, votes: Mapping[str, int], now: float) -> Mapping[str, int]:
        self.round, self._began = number % ROUNDS, now
        return votes

    def _expire(self, oldest: float) -> None:
        self._plain = {k: v for k, v in self._plain.items() if v[1] >= oldest}
        self._ballots = {k: v for k, v in self._ballots.items() if v[1] >= oldest}

    def _votes(self) -> Mapping[str, int]:
        votes = {sender: opinion for sender, (opinion, _) in self._plain.items()}
        for sender, (ballot, _) in self._ballots.items():
            lead = _lead(ballot.round, self.round)
            if lead in (0, 1):
                votes[sender] = ballot.opinion if lead == 0 else ballot.previous
        return votes


def tally(opinions: Iterable[int]) -> Mapping[int, int]:
    """How often each opinion occurs, most frequent first, equals by the opinion."""
    counts = Counter(opinions)
    return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def majority(opinions: Iterable[int], current: int, *, ties: Ties, rng: Generator) -> int:
    """The most frequent opinion; `current` if there are none.

    Between equals: a random one of them, `current` (whether or not it is one of them), or the
    lowest of them.
    """
    counts = tally(opinions)
    if not counts:
        return current
    most = max(counts.values())
    leaders = [opinion for opinion, count in counts.items() if count == most]
    if len(leaders) == 1 or ties == "lowest":
        return leaders[0]
    return current if ties == "keep" else int(rng.choice(leaders))


def read_opinion(value: object, count: int) -> int | None:
    """The opinion that a message carries; None unless it is a whole number in [0, count)."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < count:
        return None
    return value


def read_ballot(value: object, count: int) -> Ballot | None:
    """The ballot that a message carries: [round, opinion, previous]; None for anything else."""
    if not isinstance(value, list) or len(value) != len(Ballot._fields):
        return None
    number = read_opinion(value[0], ROUNDS)
    opinion, previous = (read_opinion(part, count) for part in value[1:])
    if number is None or opinion is None or previous is None:
        return None
    return Ballot(number, opinion, previous)


def _next(end: float, length: float, now: float) -> float:
    """The first end after `now` on the grid of those that are `length` s apart."""
    return end + length * (math.floor((now - end) / length) + 1)


def _lead(number: int, other: int) -> int:
    """By how many rounds `number` is ahead of `other`; negative if it is behind."""
    return (number - other + ROUNDS // 2) % ROUNDS - ROUNDS // 2
