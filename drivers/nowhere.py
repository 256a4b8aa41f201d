"""A sink for who only looks."""

from __future__ import annotations

from collections.abc import Mapping

from swarmd.values import Neighbor, Odometry, Scan


class Nowhere:
    """Takes everything and keeps nothing."""

    def scan(self, scan: Scan) -> None:
        pass

    def odometry(self, odometry: Odometry) -> None:
        pass

    def neighbors(self, neighbors: tuple[Neighbor, ...]) -> None:
        pass

    def readings(self, values: Mapping[str, float]) -> None:
        pass

    def state(self, is_up: bool, text: str) -> None:
        pass

    def dropped(self, what: str) -> None:
        pass
