"""Touches counted as people count them: once each, however many steps they last."""

from __future__ import annotations

EPISODE_GAP = 0.5
"""Seconds apart after which the same two touch anew."""


class Episodes:
    """Counts the touches of pairs. Feed it in order of time."""

    def __init__(self) -> None:
        self._last: dict[tuple[str, str], float] = {}
        self._counts: dict[tuple[str, str], int] = {}

    @property
    def counts(self) -> dict[tuple[str, str], int]:
        """How often each pair (in order of name) has touched."""
        return dict(self._counts)

    def add(self, time: float, a: str, b: str) -> bool:
        """Note that two touch now; true if this begins a new touch."""
        pair = (a, b) if a <= b else (b, a)
        last = self._last.get(pair)
        self._last[pair] = time
        if last is not None and time - last <= EPISODE_GAP:
            return False
        self._counts[pair] = self._counts.get(pair, 0) + 1
        return True
