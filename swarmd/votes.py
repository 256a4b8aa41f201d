"""Counting votes: windows of time, majorities, ties. Pure; the time is handed in.

Source: Kaiser et al., ICRA 2022 (tumbling windows: of fixed length, one after the other); a vote
that counts is the latest of its sender, the voter's own is not among them, as in ROS2swarm.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Literal, TypeAlias

from numpy.random import Generator

Ties: TypeAlias = Literal["random", "keep", "lowest"]


class VoteWindow:
    """A tumbling window of `length` s that opens at `now` and reopens whenever it is closed.

    At its end a vote older than `expiry` s no longer counts.
    """

    def __init__(self, length: float, *, now: float, expiry: float = math.inf) -> None:
        self.length = length
        self.expiry = expiry
        self._end = now + length
        self._votes: dict[str, tuple[int, float]] = {}

    def add(self, sender: str, opinion: int, heard_at: float) -> None:
        """Count a vote; an older one of the same sender is replaced."""
        known = self._votes.get(sender)
        if known is None or heard_at >= known[1]:
            self._votes[sender] = (opinion, heard_at)

    def close(self, now: float) -> Mapping[str, int] | None:
        """The votes by sender if the window has ended, and a new one opens; else None.

        The windows stay in step with the first: several that ended unseen are closed as one.
        """
        if now < self._end:
            return None
        self._end += self.length * (math.floor((now - self._end) / self.length) + 1)
        votes = {
            sender: opinion
            for sender, (opinion, heard_at) in self._votes.items()
            if now - heard_at <= self.expiry
        }
        self._votes.clear()
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
