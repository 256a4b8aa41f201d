"""Which robots are neighbors: all, those within a range, or those with a good link. Pure.

A robot takes messages of its neighbors only. The settings mean the same as those of the simulated
radio (`radio.neighborhood` and `radio.range` of a scenario), so that a pattern meets the same
neighborhood in simulation and in the field. Each limit has a hysteresis: noise does not turn a
robot at the limit into a neighbor and back with each measurement.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple

from msgspec import structs

from swarmd.core.values import Neighbor
from swarmd.link.members.neighbor_settings import NeighborSettings

# Hysteresis: a neighbor stays a neighbor up to RANGE_MARGIN times the range, and down to these
# margins below the limits of quality (share of beacons) and of signal (dB).
RANGE_MARGIN = 1.1
QUALITY_MARGIN = 0.2
SIGNAL_MARGIN = 6.0


class Link(NamedTuple):
    """The link from a robot: the share of its beacons that arrived, and its signal in dBm."""

    quality: float
    signal: float | None = None


PlaceNeighbors = Callable[[tuple[Neighbor, ...], float], tuple[Neighbor, ...]]


class Neighborhood:
    """The neighbors of one robot. All times are in s on its monotonic clock.

    `place` gives robots the distances that follow from poses in a shared frame, at a time.
    """

    def __init__(self, settings: NeighborSettings, place: PlaceNeighbors) -> None:
        self.settings = settings
        self._place = place
        self._ids: frozenset[str] = frozenset()

    def select(
        self,
        candidates: Collection[Neighbor],
        now: float,
        links: Mapping[str, Link] | None = None,
    ) -> tuple[Neighbor, ...]:
        """Set `in_reach` of each candidate: True if it is a neighbor now.

        `candidates`: the other robots. `now` in s. `links`: the measured links by robot.

        - neighborhood `range`: the distance that the base measures counts, else the distance to the
          place that the robot reported. A robot of unknown distance is not in reach.
        - neighborhood `link`: a robot without a measured link is not in reach.
        """
        if self.settings.neighborhood == "all":
            return tuple(candidates)
        placed = self._place(tuple(candidates), now)
        is_near = [self._is_near(candidate, links or {}) for candidate in placed]
        marked = [
            candidate if near else structs.replace(candidate, in_reach=False)
            for candidate, near in zip(candidates, is_near, strict=True)
        ]
        self._ids = frozenset(neighbor.id for neighbor in marked if neighbor.in_reach)
        return tuple(marked)

    def _is_near(self, candidate: Neighbor, links: Mapping[str, Link]) -> bool:
        was_near = candidate.id in self._ids
        if self.settings.neighborhood == "range":
            distance = candidate.distance
            limit = self.settings.range or 0.0
            return distance is not None and distance <= limit * (RANGE_MARGIN if was_near else 1.0)
        link = links.get(candidate.id)
        signal = self.settings.signal
        if link is None:
            return False
        is_strong = (
            signal is None
            or link.signal is None
            or (link.signal >= signal - (SIGNAL_MARGIN if was_near else 0.0))
        )
        least = self.settings.quality - (QUALITY_MARGIN if was_near else 0.0)
        return is_strong and link.quality >= least
