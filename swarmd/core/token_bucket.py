"""A limit on a rate that lets short bursts pass."""

from __future__ import annotations


class TokenBucket:
    """Passes `rate` units a second in the long run and `burst` units at once. Pure; it begins full.

    Times are in s on one monotonic clock, handed in.
    """

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._tokens, self._at = burst, 0.0

    def holds(self, amount: float, now: float) -> bool:
        """True if `amount` units may pass at `now`."""
        self._tokens = min(self._tokens + max(now - self._at, 0.0) * self._rate, self._burst)
        self._at = now
        return self._tokens >= amount

    def take(self, amount: float, now: float) -> bool:
        """Let `amount` units pass at `now`; False, and nothing is taken, if they do not fit."""
        is_allowed = self.holds(amount, now)
        if is_allowed:
            self._tokens -= amount
        return is_allowed
