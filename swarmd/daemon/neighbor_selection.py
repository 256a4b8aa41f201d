"""Which robots are in reach of this one: the settings of neighbors, applied to what is known."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Iterable

from swarmd.core.values import Neighbor, PeerPlace, SharedPose
from swarmd.daemon.radio_signal import RadioSignal
from swarmd.network.neighbor_settings import NeighborSettings
from swarmd.network.neighborhood import Link, Neighborhood


class NeighborSelection:
    """Selects neighbors. `heard` gives each robot with its host and the share of its beacons."""

    def __init__(
        self,
        settings: NeighborSettings,
        heard: Callable[[], Iterable[tuple[str, str, float]]],
        interface: str,
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self._neighborhood = Neighborhood(settings)
        self._heard = heard
        self._needs_links = settings.neighborhood == "link"
        self._signal = None if settings.signal is None else RadioSignal(loop, interface)

    def on_pose(self, pose: SharedPose) -> None:
        """Take in the own pose in a shared frame."""
        self._neighborhood.on_pose(pose)

    def on_place(self, place: PeerPlace, now: float) -> None:
        """Take in where a peer is by its own word."""
        self._neighborhood.on_place(place, now)

    def select(self, candidates: Collection[Neighbor], now: float) -> tuple[Neighbor, ...]:
        """The candidates, each marked as in reach or not."""
        links = self._links() if self._needs_links else None
        return self._neighborhood.select(candidates, now, links)

    def close(self) -> None:
        """End the reading of signals."""
        if self._signal is not None:
            self._signal.close()

    def _links(self) -> dict[str, Link]:
        signal = self._signal
        return {
            robot: Link(quality, None if signal is None else signal.of(host))
            for robot, host, quality in self._heard()
        }
