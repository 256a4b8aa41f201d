"""The emergency stops that hold a robot, and those that were reset: the latch set."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import msgspec
from msgspec import Struct

from swarmd.core.messages import Latch, Name

REMEMBERED = 256
HELD = 32
OVERFLOW = "more"  # stands for all beyond HELD: a flood must not fill the disk or the status


class LatchRecord(Struct, frozen=True, kw_only=True):
    """What is written to the state directory before an emergency stop is acknowledged."""

    held: dict[Name, Latch] = {}
    cleared: tuple[Name, ...] = ()


class Latches:
    """Held latches by id. A cleared id is remembered, so that a peer's older view cannot return it.

    An explicit estop with a cleared id latches again: stopping is always taken.
    """

    def __init__(self, record: LatchRecord | None = None) -> None:
        record = record or LatchRecord()
        self._held = dict(record.held)
        self._cleared = dict.fromkeys(record.cleared)
        self._last_folded = ""  # the id that `more` stands for most recently: repeats are no news

    @property
    def held(self) -> Mapping[str, Latch]:
        """The latches that hold the robot now."""
        return self._held

    def add(self, latch_id: str, latch: Latch) -> bool:
        """Latch; True if it was not held yet."""
        if latch_id not in self._held and len(self._held) >= HELD:
            is_new, self._last_folded = latch_id != self._last_folded, latch_id
            self._held[OVERFLOW] = msgspec.structs.replace(latch, scope="robots")
            return is_new
        is_new = latch_id not in self._held
        self._held[latch_id] = latch
        return is_new

    def take_over(self, latches: Mapping[str, Latch]) -> tuple[str, ...]:
        """Latch the swarm-wide ones of a peer that were not reset here; the ids that are new."""
        wanted = [
            latch_id
            for latch_id, latch in latches.items()
            if latch.scope == "swarm" and latch_id not in self._cleared
        ]
        if OVERFLOW in self._held:  # which may stand for those not held by name
            wanted = [latch_id for latch_id in wanted if latch_id in self._held]
        return tuple(latch_id for latch_id in wanted if self.add(latch_id, latches[latch_id]))

    def clear(self, latch_ids: Iterable[str]) -> None:
        """Reset the named ids; others stay. Ids never held are remembered all the same."""
        for latch_id in latch_ids:
            self._held.pop(latch_id, None)
            self._cleared.pop(latch_id, None)
            self._cleared[latch_id] = None
        while len(self._cleared) > REMEMBERED:
            del self._cleared[next(iter(self._cleared))]

    def record(self) -> LatchRecord:
        """What is to be written down."""
        return LatchRecord(held=dict(self._held), cleared=tuple(self._cleared))
