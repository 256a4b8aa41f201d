"""A ring of range sensors beside the lidar: its scan, its age, and its returns as obstacles."""

from __future__ import annotations

import numpy as np

from swarmd.core.messages import Reason
from swarmd.core.values import Odometry, Platform, Scan, ScanSpec
from swarmd.protection.compatibility import barrier_settings, fastest_corner
from swarmd.protection.decision import ToldObstacle
from swarmd.protection.footprint import Footprint
from swarmd.sensing.conditioning import ScanConditioner
from swarmd.sensing.rays import unit_vectors


class RangeRing:
    """The section `ranges` of a platform. Times are in s on the robot's clock.

    It is conditioned apart from the lidar, which does not see what the ring is for: a ring without
    fresh values holds the robot. `scan`: the last one, conditioned; None before the first.
    """

    def __init__(self, platform: Platform, spec: ScanSpec) -> None:
        """No scan yet."""
        self._spec, self._outline = spec, Footprint(platform.footprint)
        self._conditioner = ScanConditioner(spec)
        barrier = barrier_settings(platform)
        self._extent = 0.0 if barrier is None else barrier.unseen_extent
        self._speed = fastest_corner(platform)
        self._known_at: float | None = None
        self._problem: Reason | None = None
        self._places: list[tuple[float, float]] = []  # m in the base frame, of the returns
        self._radius = 0.0
        self.scan: Scan | None = None

    def on_scan(self, scan: Scan, odometry: Odometry | None, now: float) -> None:
        """Take in a scan of the ring; an invalid scan does not count."""
        conditioned = self._conditioner.take(scan, odometry, now)
        if isinstance(conditioned, Reason):
            self._problem = conditioned
            return
        self._known_at = known_at = self._conditioner.known_at
        self._problem = None if known_at == now else Reason.INVALID_SCAN
        # Remembered values are where the robot was when they were measured.
        self._radius = self._extent + (now - known_at) * self._speed
        self.scan, directions = conditioned, unit_vectors(conditioned.bearings)
        outline = self._outline.along_rays(self._spec.offset, directions)
        # A return within the outline, or too close to measure, lies on the outline.
        distances = np.maximum(np.maximum(conditioned.ranges, conditioned.range_min), outline)
        is_seen = distances < np.inf
        points = self._spec.offset + distances[is_seen, None] * directions[is_seen]
        self._places = [(x, y) for x, y in points.tolist()]

    def hold(self, now: float) -> Reason | None:
        """The reason why the ring forbids motion; None if it does not."""
        stale_at = self.stale_at
        if stale_at is None:
            return self._problem or Reason.NO_SCAN
        return (self._problem or Reason.STALE_SCAN) if now > stale_at else None

    @property
    def stale_at(self) -> float | None:
        """The time at which the last scan becomes too old; None before the first."""
        return None if self._known_at is None else self._known_at + self._spec.stale_after

    def obstacles(self, now: float) -> tuple[ToldObstacle, ...]:
        """The returns as discs: unseen parts extend beyond each by the barrier's `unseen_extent`.

        The sensors measure one after the other, so the oldest value is half a period older than
        the mean.
        """
        if self._known_at is None:
            return ()
        age, radius = now - self._known_at + self._spec.latency, self._radius
        age += 0.5 / self._spec.rate
        return tuple(ToldObstacle(x, y, radius, age) for x, y in self._places)
