"""The latches of a robot (emergency stops that wait for a reset), and the ids of reset latches."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from msgspec import Struct
from msgspec.structs import replace

from swarmd.core.bounds import MAX_SECONDS, Name, Stamp, Word
from swarmd.core.messages import Latch

MAX_CLEARED = 256  # ids of reset latches that are remembered
MAX_HELD = 32  # latches held by id
OVERFLOW = "more"  # the id for all latches beyond MAX_HELD: a flood must not fill the disk


class LatchRecord(Struct, frozen=True, kw_only=True):
    """The content of the latch file, written before an emergency stop is acknowledged.

    - `held`: the latches by id. Their ages hold when the record is handed to a robot, and are None
      in the file.
    - `since`: by id, when the emergency stop was issued, in s on the clock `clock` (the `clock_id`
      of the machine). Without an entry it is not known, as after a restart of the machine.
    """

    held: dict[Name, Latch] = {}
    cleared: tuple[Name, ...] = ()
    folded: tuple[Name, ...] = ()
    since: dict[Name, Stamp] = {}
    clock: Word = ""


class Latches:
    """The held latches (emergency stops that hold the robot) by id, and the ids that were reset.

    A peer that missed a reset may still report the latch: a latch whose id was reset here is not
    adopted from a peer. But an estop request of an operator latches even with the id of a reset
    latch, since a stop is always obeyed.

    A copy of a held latch changes nothing: no later copy rewrites who stopped the robot, or why.
    """

    def __init__(self, record: LatchRecord | None = None, now: float = 0.0) -> None:
        """`record`: of an earlier process; `now`: s on the own clock."""
        record = record or LatchRecord()
        held = record.held.items()
        self._held = {i: replace(latch, age=None) for i, latch in held}
        # When the latches were issued, in s on the own clock; without an entry it is not known.
        self._since = {i: now - latch.age for i, latch in held if latch.age is not None}
        self._since |= record.since
        self._cleared = dict.fromkeys(record.cleared)
        # The ids of the latches that OVERFLOW stands for: a repeat of such a latch is not new.
        self._folded = dict.fromkeys(record.folded)

    @property
    def held(self) -> Mapping[str, Latch]:
        """The latches that hold the robot now, without their ages."""
        return self._held

    def aged(self, now: float) -> dict[str, Latch]:
        """The latches that hold the robot, each with its age at `now`."""
        ages = {i: min(max(now - since, 0.0), MAX_SECONDS) for i, since in self._since.items()}
        return {i: replace(latch, age=ages.get(i)) for i, latch in self._held.items()}

    @property
    def text(self) -> str:
        """The issuers and reasons of the held latches, in one line."""
        texts = (
            f"by {latch.issuer}" + (f": {latch.reason}" if latch.reason else "")
            for latch in self._held.values()
        )
        return ", ".join(dict.fromkeys(texts))

    def add(self, latch_id: str, latch: Latch, now: float) -> bool:
        """Hold a latch, whose age holds at `now`; True if it is new."""
        is_full = len(self._held) >= MAX_HELD
        if latch_id in self._held or (is_full and latch_id in self._folded):
            return False
        if is_full:
            self._folded[latch_id] = None
            while len(self._folded) > MAX_CLEARED // 2:
                del self._folded[next(iter(self._folded))]
            latch_id = OVERFLOW
            latch = replace(latch, scope="robots")
            self._since.pop(latch_id, None)
        self._held[latch_id] = replace(latch, age=None)
        if latch.age is not None:
            self._since[latch_id] = now - latch.age
        return True

    def adopt(self, latches: Mapping[str, Latch], now: float) -> tuple[str, ...]:
        """Hold the swarm-wide latches of a peer except those reset here; returns the new ids."""
        if OVERFLOW in self._held:  # which may stand for any latch that is not held by its own id
            return ()
        return tuple(
            latch_id
            for latch_id, latch in latches.items()
            if latch.scope == "swarm"
            and latch_id not in self._cleared
            and self.add(latch_id, latch, now)
        )

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
            self._since.pop(latch_id, None)
            self._cleared.pop(latch_id, None)
            self._cleared[latch_id] = None
        while len(self._cleared) > MAX_CLEARED:
            del self._cleared[next(iter(self._cleared))]

    def record(self) -> LatchRecord:
        """The record for the latch file."""
        return LatchRecord(
            held=dict(self._held),
            cleared=tuple(self._cleared),
            folded=tuple(self._folded),
            since=dict(self._since),
        )
