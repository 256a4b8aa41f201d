"""A rate limit for repeated events, so that `describe` keeps room for other events. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from swarmd.core.token_bucket import TokenBucket

BURST = 3
"""Events of one kind that pass at once."""
PERIOD = 60.0
"""Seconds after which one more passes."""


class EventLimit:
    """Hands events to `log(text, now)`; of those beyond the limit of their kind, their number."""

    def __init__(self, log: Callable[[str, float], None]) -> None:
        self._log = log
        self._budgets: dict[str, TokenBucket] = {}
        self._left_out: Counter[str] = Counter()

    def log(self, kind: str, text: str, now: float) -> None:
        """Log an event, or count it."""
        if self._passes(kind, now):
            self._log(text, now)
        else:
            self._left_out[kind] += 1

    def advance(self, now: float) -> None:
        """Log how many events were left out, of each kind of which one more passes."""
        for kind, count in list(self._left_out.items()):
            if self._passes(kind, now):
                del self._left_out[kind]
                self._log(f"{kind}: {count} more events", now)

    def _passes(self, kind: str, now: float) -> bool:
        budget = self._budgets.get(kind)
        if budget is None:
            budget = self._budgets[kind] = TokenBucket(1.0 / PERIOD, BURST)
        return budget.take(1.0, now)
