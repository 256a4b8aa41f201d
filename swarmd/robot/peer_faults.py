"""The faults of robots that only peers can tell, as one robot knows them. Pure.

`link/members/hearing.py` finds them. They are words of status and log: no motion depends on them.
"""

from __future__ import annotations

from msgspec.structs import replace

from swarmd.core.messages import UNHEARD, PeerFault


class PeerFaults:
    """The present faults. Times are in s on the robot's clock."""

    def __init__(self) -> None:
        self._faults: tuple[PeerFault, ...] = ()
        self._at = 0.0

    def take(self, faults: tuple[PeerFault, ...], now: float) -> tuple[PeerFault, ...]:
        """Take all present faults; returns those that are new, and for the log.

        What this robot alone misses is a suspicion and no fault of the other: it is not logged.
        """
        known = {(fault.robot, fault.kind) for fault in self._faults}
        self._faults = faults
        self._at = now
        return tuple(
            fault
            for fault in faults
            if fault.kind != UNHEARD and (fault.robot, fault.kind) not in known
        )

    def at(self, now: float) -> tuple[PeerFault, ...]:
        """The present faults, with their times at `now`."""
        aged = max(now - self._at, 0.0)
        return tuple(replace(fault, since=fault.since + aged) for fault in self._faults)
