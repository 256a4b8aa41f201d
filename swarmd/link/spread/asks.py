"""Limits the questions that a robot sends to peers for their records. Pure.

A robot asks a peer for a record, such as its goal or roster, if the peer's datagrams show that the
record differs. `Asks` keeps forged datagrams from making a robot send many questions.
"""

from __future__ import annotations

import math
from collections.abc import Hashable

from swarmd.core.bounds import keep_newest

MAX_KNOWN = 1024


class Asks:
    """Decides when a peer may be asked.

    1. `take` permits one question to a peer in `period` s.
    2. `take` permits questions to at most `at_once` peers of a group in `window` s (default:
       `period`). The caller chooses the groups, such as all peers that show the same digest.
    3. `knows`: a peer that has answered for a digest need not be asked for this digest again.

    Each of the three rules remembers the newest MAX_KNOWN peers or groups.
    """

    def __init__(self, period: float, at_once: int = 1, window: float | None = None) -> None:
        self._period = period
        self._at_once = at_once
        self._window = period if window is None else window
        self._known: dict[Hashable, bytes] = {}
        self._asked_until: dict[Hashable, float] = {}
        # By group, the times in s of the last questions to its peers.
        self._asked_at: dict[Hashable, list[float]] = {}

    def knows(self, peer: Hashable, digest: bytes) -> bool:
        """True if the peer has answered for this digest."""
        return self._known.get(peer) == digest

    def answered(self, peer: Hashable, digest: bytes) -> None:
        """Note that the peer has answered for this digest."""
        keep_newest(self._known, peer, digest, MAX_KNOWN)

    def forget(self, peer: Hashable) -> None:
        """Forget the answer of the peer, which could not be used, so that it is asked again."""
        self._known.pop(peer, None)

    def may(self, peer: Hashable, now: float) -> bool:
        """True if the peer may be asked now; the limit of its group is not tested."""
        return now >= self._asked_until.get(peer, -math.inf)

    def wait(self, peer: Hashable, until: float) -> None:
        """Do not ask the peer before this time."""
        keep_newest(self._asked_until, peer, until, MAX_KNOWN)

    def take(self, peer: Hashable, now: float, group: Hashable = None) -> bool:
        """True if the peer may be asked now; it then counts as asked. `group` None: no group."""
        if not self.may(peer, now):
            return False
        if group is not None:
            recent = [at for at in self._asked_at.get(group, ()) if now - at < self._window]
            is_full = len(recent) >= self._at_once
            keep_newest(self._asked_at, group, recent if is_full else [*recent, now], MAX_KNOWN)
            if is_full:
                return False
        self.wait(peer, now + self._period)
        return True
