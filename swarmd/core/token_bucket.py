"""A token bucket: limits a rate and lets short bursts pass."""

from __future__ import annotations


class TokenBucket:
    """Passes `rate` units a second on average, and up to `burst` units at once. Begins full. Pure.

    Times are in s on one monotonic clock and come with each call.
    """

    def __init__(self, rate: float, burst: float) -> None:
        self._rate = rate
        self._burst = burst
        self._tokens = burst
        self._at = 0.0

    def holds(self, amount: float, now: float) -> bool:
        """True if `amount` units may pass at `now`."""
        self._tokens = min(self._tokens + max(now - self._at, 0.0) * self._rate, self._burst)
        self._at = now
        return self._tokens >= amount

    def take(self, amount: float, now: float) -> bool:
        """Take `amount` units at `now`; False, and takes nothing, if too few are left."""
        is_allowed = self.holds(amount, now)
        if is_allowed:
            self._tokens -= amount
        return is_allowed
