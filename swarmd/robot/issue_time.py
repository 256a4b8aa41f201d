"""Which of two orders was issued first, a start or a stop, without a common clock. Pure.

An order counts from the moment at which its user typed, clicked or called it. One rule decides
between a start (of a run) and a stop:

1. Both orders come from one machine: the time on the clock of that machine decides.
2. Otherwise the time on the robot's own clock decides. A start counts as issued at the earliest
   possible time, and a stop at the latest possible time. So in doubt the robot stands.
"""

from __future__ import annotations

from typing import NamedTuple

from swarmd.core.verbs import AnyRequest

MAX_CLOCKS = 64


class IssueTime(NamedTuple):
    """When an order was issued."""

    at: float  # s, own clock: of a start the earliest possible time, of a stop the latest
    clock: str = ""  # the clock of the machine that issued the order; empty if it is unknown
    issued: float = 0.0  # s on that clock

    @classmethod
    def of(cls, request: AnyRequest, at: float) -> IssueTime:
        """The time of a request that was issued at `at` on the own clock."""
        return cls(at, request.clock, request.issued)

    def is_before(self, other: IssueTime) -> bool:
        """True if this order was issued before `other`; False at equal times."""
        if self.clock and self.clock == other.clock:
            return self.issued < other.issued
        return self.at < other.at


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
        by = issuer if stop.is_before(newest) else by
        latest = IssueTime(max(stop.at, newest.at), stop.clock, max(stop.issued, newest.issued))
        self._newest[stop.clock] = latest, by

    def later_than(self, start: IssueTime) -> str:
        """Who issued a stop after this start; empty if nobody did."""
        issuers = (by for stop, by in self._newest.values() if start.is_before(stop))
        return next(issuers, "")
