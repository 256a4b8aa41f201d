"""The holds that follow from hazards of the base, and the end of each hold. Pure.

A hold is a reason for which protection sends zero. `InputAges.hold` (input_ages.py) has the holds
that follow from scans, odometry and peers.

| kind of hazard                | while reported          | the hold ends                        |
|-------------------------------|-------------------------|--------------------------------------|
| bump, cliff, stall, not_heard | holds the robot         | CLEAR_TIME after the last report     |
| wheel_drop, lifted            | holds and ends the run  | CLEAR_TIME after the last report;    |
|                               |                         | motion needs a new run               |

Any hold that lasts for MAX_HOLD_TIME ends the run.
"""

from __future__ import annotations

import math

from swarmd.core.hazard import ENDS_RUN, Hazard

CLEAR_TIME = 0.5
"""Seconds for which a hazard must be gone: a robot must not push again with each tick."""
MAX_HAZARDS = 16
"""Hazards that count at once; of more, those that end the run come first."""
MAX_TEXT = 64  # characters of one hazard


class HazardHolds:
    """The hazards of one base with their ages; times in s on the robot's clock."""

    def __init__(self) -> None:
        self.present: tuple[Hazard, ...] = ()
        self._since: dict[Hazard, float] = {}
        self._until: dict[Hazard, float] = {}

    def take(self, hazards: tuple[Hazard, ...], now: float) -> None:
        """Replace the present hazards; the hold of each earlier hazard ends after CLEAR_TIME."""
        self._forget(now)
        for gone in self.present:
            self._until[gone] = now + CLEAR_TIME
        ending_first = sorted(hazards, key=lambda hazard: hazard.kind not in ENDS_RUN)
        self.present = tuple(ending_first[:MAX_HAZARDS])
        for hazard in self.present:
            self._since.setdefault(hazard, now)
            self._until[hazard] = math.inf

    @property
    def until(self) -> float:
        """When the last hold ends, in s; -inf without a hold, inf while a hazard is reported."""
        return max(self._until.values(), default=-math.inf)

    def holds(self, now: float) -> bool:
        """True while a hazard is reported, and for CLEAR_TIME after the last report."""
        return now < self.until

    @property
    def ends_run(self) -> bool:
        """True while a reported hazard forbids a run (wheel drop or lift)."""
        return any(hazard.kind in ENDS_RUN for hazard in self.present)

    def text(self, now: float) -> str:
        """Each hazard that holds, with its age: `bump front left, 0.4 s; cliff, 1.2 s`."""
        return "; ".join(
            f"{hazard.text[:MAX_TEXT]}, {now - self._since[hazard]:.1f} s"
            for hazard, until in self._until.items()
            if now < until
        )

    def _forget(self, now: float) -> None:
        for hazard in [ended for ended, until in self._until.items() if now >= until]:
            del self._until[hazard], self._since[hazard]
