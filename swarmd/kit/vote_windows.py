"""Counting votes in windows of time or in rounds, and deciding by majority. Pure.

Source: Kaiser et al., ICRA 2022: tumbling windows (of fixed length, one after the other). Sliding
windows and synchronised rounds are variants. The latest vote of each sender counts. The robot's own
vote does not count, as in ROS2swarm.
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
"""Round numbers wrap at this; a round is later if it is less than half of this ahead."""


class RoundVote(NamedTuple):
    """A robot's vote in a round, and its vote in the round before."""

    round: int
    opinion: int
    previous: int


class VoteWindow:
    """Collects votes in a window of `length` s: tumbling, or sliding if there is a `period`.

    - A tumbling window is followed by the next window, which begins without votes.
    - A sliding window ends every `period` s, and counts the votes of the last `length` s, also
      votes that an earlier window has counted.
    - Votes received more than `expiry` s before the end of a window do not count.
    - The first window (or period) lasts only the share `first` of its length.
    """

    def __init__(
        self,
        length: float,
        *,
        now: float,
        period: float | None = None,
        expiry: float = math.inf,
        first: float = 1.0,
    ) -> None:
        self.length = length
        self.period = period
        self.expiry = expiry
        self._opened = now
        self._end = now + first * (length if period is None else period)
        self._votes: dict[str, tuple[int, float]] = {}

    def add(self, sender: str, opinion: int, received_at: float) -> None:
        """Count a vote; it replaces an older vote of the same sender."""
        known = self._votes.get(sender)
        if known is None or received_at >= known[1]:
            self._votes[sender] = (opinion, received_at)

    def add_round_vote(self, sender: str, vote: RoundVote, received_at: float) -> None:
        """Count the vote of a robot that votes in rounds, whichever round it is in."""
        self.add(sender, vote.opinion, received_at)

    def forget(self, sender: str) -> None:
        """Drop the vote of a robot that has left."""
        self._votes.pop(sender, None)

    def close(self, now: float) -> Mapping[str, int] | None:
        """The votes by sender if the window or period has ended; else None.

        Windows end on a fixed grid of times. If several windows have ended since the last call, the
        votes of all are returned together.
        """
        if now < self._end:
            return None
        every = self.length if self.period is None else self.period
        self._end += every * (math.floor((now - self._end) / every) + 1)
        # A tumbling window counts votes since it opened, a sliding window those of `length` s.
        opened = self._opened if self.period is None else now - self.length
        oldest = max(opened, now - self.expiry)
        votes = {sender: vote for sender, vote in self._votes.items() if vote[1] >= oldest}
        self._opened = now
        self._votes = {} if self.period is None else votes
        return {sender: opinion for sender, (opinion, _) in votes.items()}


class Rounds:
    """Synchronised updates: the votes of one round decide, then the next round begins.

    1. A round lasts at least `pause` s and at most `length` s. In between, the round ends once no
       robot that was heard in the last `expiry` s is in an earlier round.
    2. A robot that is one round ahead counts with its vote of this round, since its messages hold
       the votes of two rounds. A robot that is two rounds ahead or more does not count.
    3. If more than half of the robots are two rounds ahead or more, this robot has fallen behind,
       and jumps to the median round of the robots.

    So no robot waits for ever for a lost message, for a robot that has left, or for a robot that
    sends arbitrary rounds.

    Source: the synchroniser alpha of Awerbuch, J. ACM 32(4), 1985. Ours: instead of
    acknowledgements, votes are repeated, together with the previous vote.
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
        self._round_votes: dict[str, tuple[RoundVote, float]] = {}

    def add(self, sender: str, opinion: int, received_at: float) -> None:
        """Count the vote of a robot that does not vote in rounds: it counts in every round."""
        self._round_votes.pop(sender, None)
        known = self._plain.get(sender)
        if known is None or received_at >= known[1]:
            self._plain[sender] = (opinion, received_at)

    def add_round_vote(self, sender: str, vote: RoundVote, received_at: float) -> None:
        """Count a vote, unless the sender has already voted in a later round."""
        self._plain.pop(sender, None)
        known = self._round_votes.get(sender)
        if known is not None:
            lead = _lead(vote.round, known[0].round)
            if lead < 0 or (lead == 0 and received_at < known[1]):
                return
        self._round_votes[sender] = (vote, received_at)

    def forget(self, sender: str) -> None:
        """Drop the vote of a robot that has left, and wait for it no longer."""
        self._plain.pop(sender, None)
        self._round_votes.pop(sender, None)

    def close(self, now: float) -> Mapping[str, int] | None:
        """The votes by sender if the round has ended; None while the round continues.

        The next round begins with the end. Returns {} if the round ended by a jump to a later
        round.
        """
        elapsed = now - self._began
        if elapsed < min(self.period, self.length):
            return None
        self._expire(now - self.expiry)
        # By how many rounds each other robot is ahead; negative: behind. The lower median of an
        # even number, so that a jump needs more than half of the robots ahead.
        leads = sorted(_lead(vote.round, self.round) for vote, _ in self._round_votes.values())
        median = leads[(len(leads) - 1) // 2] if leads else 0
        if median > 1:
            return self._begin(self.round + median, {}, now)
        votes = self._votes()
        is_waiting = not votes or (bool(leads) and leads[0] < 0)
        if is_waiting and elapsed < self.length:
            return None
        return self._begin(self.round + 1, votes, now)

    def _begin(self, number: int, votes: Mapping[str, int], now: float) -> Mapping[str, int]:
        self.round = number % ROUNDS
        self._began = now
        return votes

    def _expire(self, oldest: float) -> None:
        self._plain = {k: v for k, v in self._plain.items() if v[1] >= oldest}
        self._round_votes = {k: v for k, v in self._round_votes.items() if v[1] >= oldest}

    def _votes(self) -> Mapping[str, int]:
        votes = {sender: opinion for sender, (opinion, _) in self._plain.items()}
        for sender, (vote, _) in self._round_votes.items():
            lead = _lead(vote.round, self.round)
            if lead in (0, 1):
                votes[sender] = vote.opinion if lead == 0 else vote.previous
        return votes


def tally(opinions: Iterable[int]) -> Mapping[int, int]:
    """The count of each opinion, most frequent first, equal counts by opinion."""
    counts = Counter(opinions)
    return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def majority(opinions: Iterable[int], current: int, *, ties: Ties, rng: Generator) -> int:
    """The most frequent opinion among the votes; `current` without votes.

    Between equally frequent opinions `ties` decides: "random" draws one of them, "keep" returns
    `current` (even if it is none of them), "lowest" returns the lowest.
    """
    counts = tally(opinions)
    if not counts:
        return current
    most = max(counts.values())
    leaders = [opinion for opinion, count in counts.items() if count == most]
    if len(leaders) == 1 or ties == "lowest":  # `tally` orders equal counts by opinion
        return leaders[0]
    return current if ties == "keep" else int(rng.choice(leaders))


def read_opinion(value: object, count: int) -> int | None:
    """The opinion in a message; None unless it is an integer in [0, count)."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < count:
        return None
    return value


def read_round_vote(value: object, count: int) -> RoundVote | None:
    """The round vote in a message, [round, opinion, previous]; None for anything else."""
    if not isinstance(value, list) or len(value) != len(RoundVote._fields):
        return None
    number = read_opinion(value[0], ROUNDS)
    opinion, previous = (read_opinion(part, count) for part in value[1:])
    if number is None or opinion is None or previous is None:
        return None
    return RoundVote(number, opinion, previous)


def _lead(number: int, other: int) -> int:
    """How many rounds `number` is ahead of `other`; negative if behind."""
    return (number - other + ROUNDS // 2) % ROUNDS - ROUNDS // 2
