"""Which of two orders was issued first, a start or a stop, without a common clock. Pure.

An order counts from the moment at which its user typed, clicked or called it. The robot has two
readings of this moment: one on its own clock, and one on the clock of the machine that issued the
order. On the own clock a start counts as issued at the earliest possible time, and a stop at the
latest possible time.

1. Clocks of one id may still be of two machines: a virtual machine that was set back to a snapshot,
   two clones of a suspended image, or a forged time. `at - issued` shows it: for orders of one
   clock the stop has a greater difference than the start, by the time of both on their ways.
2. A start is refused if it was issued before a stop: by the clock of the machine, if both
   differences agree to MAX_WAY; else by the own clock.
3. A stop is refused if it was issued before a run: by the own clock, and also by the clock of the
   machine if both differences agree to MAX_FREEZE.

So in doubt the robot stands, and no time that a machine states holds for longer than these bounds.
"""

from __future__ import annotations

from typing import NamedTuple

from swarmd.core.verbs import AnyRequest

MAX_CLOCKS = 64
MAX_WAY = 2.0
"""Seconds of two ways, with relays. Measured: at most 1.2 s at a delay of 0.5 s. A longer way lets
the robot refuse a start that followed a stop within the time of this way."""
MAX_FREEZE = 60.0
"""Seconds for which a frozen computer or a relay may hide a stop, so that it seems to be later."""


class IssueTime(NamedTuple):
    """When an order was issued."""

    at: float  # s, own clock: of a start the earliest possible time, of a stop the latest
    clock: str = ""  # the clock of the machine that issued the order; empty if it is unknown
    issued: float = 0.0  # s on that clock

    @classmethod
    def of(cls, request: AnyRequest, at: float) -> IssueTime:
        """The time of a request that was issued at `at` on the own clock."""
        return cls(at, request.clock, request.issued)

    def is_before(self, stop: IssueTime) -> bool:
        """True if this start was issued before `stop`, in doubt; False at equal times."""
        if self._is_on_clock_of(stop, MAX_WAY):
            return self.issued < stop.issued
        return self.at < stop.at

    def is_surely_before(self, start: IssueTime) -> bool:
        """True if this stop was issued before `start`, without a doubt; False at equal times."""
        is_on_clock = self._is_on_clock_of(start, MAX_FREEZE)
        return self.at < start.at and not (is_on_clock and self.issued >= start.issued)

    def _is_on_clock_of(self, other: IssueTime, most: float) -> bool:
        """True if one clock has issued both: the differences of both readings agree to `most` s."""
        shift = (self.at - self.issued) - (other.at - other.issued)
        return self.clock != "" and self.clock == other.clock and abs(shift) <= most


class KnownStops:
    """The newest stops that a robot knows: its own, relayed ones, and those of the goals of peers.

    A robot refuses a start that was issued before one of them.
    """

    def __init__(self) -> None:
        # By clock, the newest stop that was issued on this clock, and who issued it. All stops
        # without a clock share an entry, and so do those of further clocks beyond MAX_CLOCKS.
        self._newest: dict[str, tuple[IssueTime, str]] = {}

    def note(self, stop: IssueTime, by: str) -> None:
        """Note that `by` issued a stop; an older stop than the newest one changes nothing."""
        if stop.clock not in self._newest and len(self._newest) >= MAX_CLOCKS:
            stop = stop._replace(clock="")
        newest, issuer = self._newest.get(stop.clock, (stop, by))
        if stop.clock and not stop._is_on_clock_of(newest, MAX_WAY):
            # Two machines have this clock id: the earlier stop counts by the own clock alone.
            # Of two stops of one instant, the first that was noted does.
            if stop.at < newest.at:
                stop, by, newest, issuer = newest, issuer, stop, by
            self._newest[stop.clock] = stop, by
            stop = newest._replace(clock="")
            by = issuer
            newest, issuer = self._newest.get("", (stop, by))
        by = issuer if stop.is_before(newest) else by
        latest = IssueTime(max(stop.at, newest.at), stop.clock, max(stop.issued, newest.issued))
        self._newest[stop.clock] = latest, by

    def later_than(self, start: IssueTime) -> str:
        """Who issued a stop after this start; empty if nobody did."""
        issuers = (by for stop, by in self._newest.values() if start.is_before(stop))
        return next(issuers, "")
