"""How the hazards of a base hold a robot, and how each hold ends. Pure.

The holds of scans, odometry and peers are in `InputAges.hold` (input_ages.py).

| kind                          | while it is reported | ends                              |
|-------------------------------|----------------------|-----------------------------------|
| bump, cliff, stall, not_heard | holds                | CLEAR_TIME after its last report  |
| wheel_drop, lifted            | holds, ends the run  | the same; motion needs a new run  |

The robot ends a run under any hold that lasts (`MAX_HOLD_TIME`).
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
        """Take in all present hazards; those of before that are not among them have gone."""
        self._forget(now)
        for gone in self.present:
            self._until[gone] = now + CLEAR_TIME
        ending_first = sorted(hazards, key=lambda one: one.kind not in ENDS_RUN)
        self.present = tuple(ending_first[:MAX_HAZARDS])
        for hazard in self.present:
            self._since.setdefault(hazard, now)
            self._until[hazard] = math.inf

    @property
    def until(self) -> float:
        """When the last hold ends; -inf without one, inf while a hazard is reported."""
        return max(self._until.values(), default=-math.inf)

    def holds(self, now: float) -> bool:
        """True while a hazard is reported, or was less than CLEAR_TIME ago."""
        return now < self.until

    @property
    def ends_run(self) -> bool:
        """True while a hazard is reported with which no run may go on or begin."""
        return any(one.kind in ENDS_RUN for one in self.present)

    def text(self, now: float) -> str:
        """Each hazard that holds, with its age: `bump front left, 0.4 s; cliff, 1.2 s`."""
        return "; ".join(
            f"{one.text[:MAX_TEXT]}, {now - self._since[one]:.1f} s"
            for one, until in self._until.items()
            if now < until
        )

    def _forget(self, now: float) -> None:
        for hazard in [one for one, until in self._until.items() if now >= until]:
            del self._until[hazard], self._since[hazard]
