"""A sink for who only looks."""

from __future__ import annotations

from collections.abc import Mapping

from swarmd.values import Neighbor, Odometry, Scan


class Nowhere:
    """Takes everything and keeps nothing."""

    def scan(self, scan: Scan) -> None:
        """It is not kept."""

    def odometry(self, odometry: Odometry) -> None:
        """It is not kept."""

    def neighbors(self, neighbors: tuple[Neighbor, ...]) -> None:
        """They are not kept."""

    def readings(self, values: Mapping[str, float]) -> None:
        """They are not kept."""

    def state(self, is_up: bool, text: str) -> None:
        """It is not kept."""

    def dropped(self, what: str) -> None:
        """It is not counted."""
