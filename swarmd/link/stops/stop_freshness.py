"""Detection of replayed stops without a shared clock. Pure.

A stop carries the `origin` of its operator's installation (4 random bytes) and a `counter`: ms of
the operator's clock, and at least the counter of the last stop plus 1. A file in the folder of the
operator's identity keeps both. A robot accepts

- a copy of a stop whose id the robot knows. The age of the copy counts as at least the time since
  the robot first heard the stop. So a copy ends no run that began later, and does not renew an
  emergency stop that was reset since.
- a stop with a new id, if its counter is less than SLACK behind the greatest counter that the robot
  has heard of its origin. SLACK covers stops that operators issue at the same time, and that robots
  relay in another order.

Any other stop is refused as replayed.

An emergency stop must never be refused wrongly. So a robot that refuses a stop answers `REPLAYED`,
with a proof for the operator. The operator then repeats the stop with an origin that was never
used. An attacker can only replay datagrams, and cannot make a new origin. The cases, and what
becomes of the operator's stop:

===============================  ===================================================================
two machines of one operator     each has an origin of its own
a copied folder, clock behind    refused, and accepted with the next repeat (0.1 s), under a new
                                 origin
the operator's clock is set back the file keeps the counter, which goes on from the last
the file is lost or damaged      a new origin
the file cannot be written       a random origin for each command
the file is a restored backup    accepted, since the clock has passed all earlier counters; with a
                                 clock that is behind: as for a copied folder
several commands at one time     the file is locked, and robots accept any order of counters within
                                 SLACK
a robot restarts                 it keeps the greatest counters on disk, and a stop that is still
                                 repeated gets a new origin. Without its file the robot takes
                                 replayed stops
relayed copies                   are known by their ids, or come within SLACK. Robots relay for a
                                 minute, and take over the origin of the operator's newest copy
a stolen robot forges counters   as for a copied folder
===============================  ===================================================================

Not covered: a robot that has heard neither the stop nor a later stop of its origin accepts a
replayed copy. The robot then stops without need, which is safe, and logs the operator's name.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct
from msgspec.structs import replace

from swarmd.core.bounds import keep_newest
from swarmd.link.datagram import Stop

REPLAYED = "replayed"
"""The refusal of a stop that counts as replayed."""
SLACK = 300_000  # ms of the operator's clock
MAX_ORIGINS = 64
MAX_IDS = 1024


class TakenStop(Struct, frozen=True):
    """A stop that is accepted."""

    stop: Stop  # with an age of at least the time since its first copy
    is_repeated: bool  # a copy was heard before


class StopFreshness:
    """The stops that a robot has heard, by which it refuses replayed stops.

    `floors`: by origin, the greatest counter that the robot heard in its earlier life. The robot no
    longer knows the ids of the stops of that life. So a stop of such an origin must have a greater
    counter, without SLACK.
    """

    def __init__(self, floors: Mapping[bytes, int] | None = None) -> None:
        self._floors = dict(floors or {})
        self._greatest = dict(self._floors)
        self._first: dict[str, float] = {}  # id -> when it was first heard

    @property
    def counters(self) -> Mapping[bytes, int]:
        """The greatest counter of each origin, to be kept on disk for the robot's next life."""
        return self._greatest

    def take(self, stop: Stop, now: float) -> TakenStop | None:
        """Take a stop; None if it is refused as replayed."""
        first_heard_at = self._first.get(stop.id)
        greatest = self._greatest.get(stop.origin)
        if first_heard_at is not None:
            age = max(stop.age, round(1000.0 * (now - first_heard_at)))
            self._note(stop)
            return TakenStop(replace(stop, age=age), True)
        if greatest is not None:
            floor = max(greatest - SLACK, self._floors.get(stop.origin, -1))
            if stop.counter <= floor:
                return None
        keep_newest(self._first, stop.id, now, MAX_IDS)
        self._note(stop)
        return TakenStop(stop, False)

    def _note(self, stop: Stop) -> None:
        if not stop.origin:
            return
        greatest = max(stop.counter, self._greatest.pop(stop.origin, 0))
        self._greatest[stop.origin] = greatest
        if len(self._greatest) > MAX_ORIGINS:
            oldest = next(iter(self._greatest))
            del self._greatest[oldest]
            self._floors.pop(oldest, None)
