"""How late stamped messages arrive from another clock, without a common time. Pure."""

from __future__ import annotations

import math

# Beyond what quartz (100 ppm) and a clock that is slewed (500 ppm) drift apart; so fast, too, is a
# delay that all messages share forgotten.
_MAX_DRIFT = 1e-3
_MIN_COUNT = 5  # messages before the fastest of them tells anything
_SET_BACK = 1.0  # s; a stamp that is older than the last by more has a clock that was set


class ArrivalDelay:
    """How much later each message of one stream arrives than its fastest message.

    The delay of the fastest message itself is not seen: the caller adds a bound for it. A stamp
    that is set back by more than 1 s starts the measurement anew.
    """

    def __init__(self) -> None:
        self._count = 0
        self._stamp = self._arrival = -math.inf
        self._lag = math.inf  # the lowest difference of arrival and stamp

    def take(self, stamp: float, now: float) -> float | None:
        """How much later than the fastest, in s, a message with `stamp` arrived at `now`.

        None: too few have arrived, or its stamp is not newer than that of the last one.
        """
        if not math.isfinite(stamp):
            return None
        if stamp < self._stamp - _SET_BACK:
            self._count, self._lag = 0, math.inf
        elif stamp <= self._stamp:
            return None
        lag = now - stamp
        drifted = (
            self._lag if math.isinf(self._lag) else self._lag + _MAX_DRIFT * (now - self._arrival)
        )
        self._lag = min(drifted, lag)
        self._stamp, self._arrival = stamp, now
        self._count += 1
        return lag - self._lag if self._count >= _MIN_COUNT else None
