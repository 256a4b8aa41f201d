"""A platform with a ring of range sensors beside its lidar, and scans of the ring."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from swarmd.core.values import Platform, Scan, ScanSpec
from swarmd.settings.platforms import load_platform

RING_DEG = (-60.0, -30.0, 0.0, 30.0, 60.0, 180.0)


def ring_spec(offset: tuple[float, float] = (0.0, 0.0)) -> ScanSpec:
    """Five sensors ahead and one behind, by their distances from `offset`."""
    bearings = np.radians(RING_DEG)
    return ScanSpec(bearings, 20.0, 0.05, 1.0, offset, zero="unknown", latency=0.02, is_noisy=False)


def with_ring(platform: Platform | str, spec: ScanSpec | None = None) -> Platform:
    """The platform with that ring."""
    known = load_platform(platform) if isinstance(platform, str) else platform
    return replace(known, ranges=spec or ring_spec())


def ring_scan(
    seq: int, stamp: float, returns: Mapping[float, float], spec: ScanSpec | None = None
) -> Scan:
    """A scan with ranges in m by the bearing of a sensor in degrees; the others see nothing."""
    own = spec or ring_spec()
    ranges = np.array([returns.get(deg, math.inf) for deg in RING_DEG])
    return Scan(seq, stamp, ranges, own.bearings, own.range_min, own.range_max)
