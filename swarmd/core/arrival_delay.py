"""Measures the arrival delay of messages that another clock stamped, without a common time. Pure.

Each difference of arrival time and stamp is an unknown clock offset plus the delay of the message.
The least difference so far belongs to the fastest message. The extra delay of a message is its
difference less the least difference. The clocks drift apart, and the least difference drifts with
them. So the estimate of the least difference rises at the rate of the greatest drift, until a fast
message lowers the estimate again.
"""

from __future__ import annotations

import math

# Above the drift of quartz (100 ppm) and of a slewed clock (500 ppm). A delay that all messages
# share is forgotten at this rate, too.
_MAX_DRIFT = 1e-3
_MIN_COUNT = 5  # messages before the estimate is used
_SET_BACK = 1.0  # s; a stamp this much older than the last stamp shows that the clock was set


class ArrivalDelay:
    """Measures the extra delay of each message of a stream over the fastest message.

    The delay of the fastest message itself cannot be measured: the caller adds a bound for it. A
    stamp that is set back by more than 1 s restarts the measurement.
    """

    def __init__(self) -> None:
        self._count = 0
        self._stamp = -math.inf
        self._arrival = -math.inf
        self._lag = math.inf  # the lowest difference of arrival and stamp

    def take(self, stamp: float, now: float) -> float | None:
        """The extra delay in s, over the fastest message, of a message that arrived at `now`.

        None if fewer than 5 messages have arrived, or if `stamp` is not newer than the last stamp.
        """
        if not math.isfinite(stamp):
            return None
        if stamp < self._stamp - _SET_BACK:
            self._count = 0
            self._lag = math.inf
        elif stamp <= self._stamp:
            return None
        lag = now - stamp
        drifted = (
            self._lag if math.isinf(self._lag) else self._lag + _MAX_DRIFT * (now - self._arrival)
        )
        self._lag = min(drifted, lag)
        self._stamp = stamp
        self._arrival = now
        self._count += 1
        return lag - self._lag if self._count >= _MIN_COUNT else None
