"""The latches of a robot (emergency stops that wait for a reset), and the ids of reset latches."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

import msgspec
from msgspec import Struct

from swarmd.core.bounds import Name
from swarmd.core.messages import Latch

MAX_CLEARED = 256  # ids of reset latches that are remembered
MAX_HELD = 32  # latches held by id
OVERFLOW = "more"  # the id for all latches beyond MAX_HELD: a flood must not fill the disk


class LatchRecord(Struct, frozen=True, kw_only=True):
    """The content of the latch file, written before an emergency stop is acknowledged."""

    held: dict[Name, Latch] = {}
    cleared: tuple[Name, ...] = ()
    folded: tuple[Name, ...] = ()


class Latches:
    """The held latches (emergency stops that hold the robot) by id, and the ids that were reset.

    A peer that missed a reset may still report the latch: a latch whose id was reset here is not
    adopted from a peer. But an estop request of an operator latches even with the id of a reset
    latch, since a stop is always obeyed.
    """

    def __init__(self, record: LatchRecord | None = None) -> None:
        record = record or LatchRecord()
        self._held = dict(record.held)
        self._cleared = dict.fromkeys(record.cleared)
        # The ids of the latches that OVERFLOW stands for: a repeat of such a latch is not new.
        self._folded = dict.fromkeys(record.folded)

    @property
    def held(self) -> Mapping[str, Latch]:
        """The latches that hold the robot now."""
        return self._held

    @property
    def text(self) -> str:
        """The issuers and reasons of the held latches, in one line."""
        texts = (
            f"by {latch.issuer}" + (f": {latch.reason}" if latch.reason else "")
            for latch in self._held.values()
        )
        return ", ".join(dict.fromkeys(texts))

    def add(self, latch_id: str, latch: Latch) -> bool:
        """Hold a latch; True if it is new."""
        if latch_id not in self._held and len(self._held) >= MAX_HELD:
            is_new = latch_id not in self._folded
            self._folded[latch_id] = None
            while len(self._folded) > MAX_CLEARED // 2:
                del self._folded[next(iter(self._folded))]
            self._held[OVERFLOW] = msgspec.structs.replace(latch, scope="robots")
            return is_new
        is_new = latch_id not in self._held
        self._held[latch_id] = latch
        return is_new

    def adopt(self, latches: Mapping[str, Latch]) -> tuple[str, ...]:
        """Hold the swarm-wide latches of a peer except those reset here; returns the new ids."""
        wanted = [
            latch_id
            for latch_id, latch in latches.items()
            if latch.scope == "swarm" and latch_id not in self._cleared
        ]
        if OVERFLOW in self._held:  # which may stand for any latch that is not held by its own id
            wanted = [latch_id for latch_id in wanted if latch_id in self._held]
        return tuple(latch_id for latch_id in wanted if self.add(latch_id, latches[latch_id]))

    @property
    def cleared(self) -> Collection[str]:
        """The ids of latches that were reset."""
        return self._cleared.keys()

    def is_cleared(self, latch_id: str) -> bool:
        """True if a latch with this id was reset and is not held again."""
        return latch_id in self._cleared and latch_id not in self._held

    def clear(self, latch_ids: Iterable[str]) -> None:
        """Reset the latches with these ids; an id that was never held is remembered as cleared."""
        named = list(latch_ids)
        if OVERFLOW in named and OVERFLOW in self._held:
            named += self._folded
            self._folded.clear()
        for latch_id in named:
            self._held.pop(latch_id, None)
            self._cleared.pop(latch_id, None)
            self._cleared[latch_id] = None
        while len(self._cleared) > MAX_CLEARED:
            del self._cleared[next(iter(self._cleared))]

    def record(self) -> LatchRecord:
        """The record for the latch file."""
        return LatchRecord(
            held=dict(self._held), cleared=tuple(self._cleared), folded=tuple(self._folded)
        )
