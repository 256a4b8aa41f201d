"""Builders of scans, for tests of patterns and other code that reads scans."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.random import Generator

from swarmd.core.values import Array, Platform, Pose, Scan

ORIGIN = Pose()


class Disc(NamedTuple):
    """A round obstacle: centre x, y and radius, in m."""

    x: float
    y: float
    radius: float = 0.1


def trembling(ranges: Array, seq: int) -> Array:
    """The ranges (n,) plus some micrometres, since two identical scans mean a frozen lidar."""
    return ranges + 1e-6 * (seq % 100)


def empty_scan(platform: Platform, seq: int, stamp: float, distance: float = np.inf) -> Scan:
    """A scan in which every ray returns `distance` m (+inf: no return), plus some micrometres."""
    spec = platform.scan
    ranges = trembling(np.full(len(spec.bearings), distance), seq)
    return replace(scan_from(platform, ranges, spec.bearings, seq=seq), stamp=stamp)


def scan_of(
    platform: Platform,
    discs: Sequence[Disc] = (),
    *,
    room: float | None = None,
    pose: Pose = ORIGIN,
    seq: int = 0,
    noise: float = 0.0,
    rng: Generator | None = None,
) -> Scan:
    """The scan of the platform's lidar at `pose` among discs, in a square room.

    `room`: the side of the room in m, whose center is the origin; None without walls. Discs and
    `pose` are in the frame of the room. `noise`: the standard deviation of ranges in m. `rng`: of
    the noise; by default a generator with the seed `seq`. A range above range_max becomes +inf
    (nothing in reach), a range below range_min -inf (too close).
    """
    spec = platform.scan
    # 1. The sensor in the frame of the room, and the direction of each ray.
    cos = np.cos(spec.bearings + pose.yaw)
    sin = np.sin(spec.bearings + pose.yaw)
    x = pose.x + spec.offset[0] * math.cos(pose.yaw) - spec.offset[1] * math.sin(pose.yaw)
    y = pose.y + spec.offset[0] * math.sin(pose.yaw) + spec.offset[1] * math.cos(pose.yaw)
    # 2. The nearest hit of each ray on the walls and the discs.
    ranges = np.full(len(spec.bearings), math.inf)
    if room is not None:
        ranges = np.minimum(_to_wall(0.5 * room, x, cos), _to_wall(0.5 * room, y, sin))
    for disc in discs:
        # The ray passes the center nearest at `along` m, and enters the disc half a chord before.
        along = (disc.x - x) * cos + (disc.y - y) * sin
        half_chord_squared = disc.radius**2 - ((disc.x - x) ** 2 + (disc.y - y) ** 2 - along**2)
        hit = along - np.sqrt(np.maximum(half_chord_squared, 0.0))
        is_hit = (half_chord_squared >= 0.0) & (along > 0.0)
        ranges = np.where(is_hit, np.minimum(ranges, hit), ranges)
    # 3. Noise, and the limits of the sensor.
    if noise > 0.0:
        ranges = ranges + (rng or np.random.default_rng(seq)).normal(0.0, noise, len(ranges))
    ranges = np.where(ranges > spec.range_max, math.inf, ranges)
    ranges = np.where(ranges < spec.range_min, -math.inf, ranges)
    return scan_from(platform, ranges, spec.bearings, seq=seq)


def scan_from(platform: Platform, ranges: Array, bearings: Array, *, seq: int = 0) -> Scan:
    """A scan of these rays with the platform's range limits, all measured at once."""
    spec = platform.scan
    at_once = np.zeros(len(ranges))
    return Scan(seq, seq / spec.rate, ranges, bearings, spec.range_min, spec.range_max, at_once)


def odd_scans(platform: Platform) -> Mapping[str, Scan]:
    """Unusual scans that every pattern must handle, by the name of what is unusual.

    Random ranges come from a generator with a fixed seed, so the scans are always the same.
    """
    bearings = platform.scan.bearings
    n = len(bearings)
    rng = np.random.default_rng(0)
    reach = platform.scan.range_max
    min_range = min(0.2, 0.5 * reach)  # m: the lower bound of random ranges
    seven_bearings = np.linspace(-math.pi, math.pi, 7, endpoint=False)
    double_bearings = np.linspace(0.0, 2.0 * math.pi, 2 * n, endpoint=False)
    with_holes = np.where(rng.random(n) < 0.2, math.nan, rng.uniform(min_range, reach, n))
    rays: dict[str, tuple[Array, Array]] = {  # (ranges in m, bearings in rad)
        "no rays": (np.empty(0), np.empty(0)),
        "one ray": (np.array([1.0]), np.array([0.3])),
        "two rays": (np.array([0.4, math.inf]), np.array([3.0, -3.0])),
        "nothing seen": (np.full(n, math.inf), bearings),
        "all unknown": (np.full(n, math.nan), bearings),
        "all too near": (np.full(n, -math.inf), bearings),
        "all zero": (np.zeros(n), bearings),
        "all below range_min": (np.full(n, 0.5 * platform.scan.range_min), bearings),
        "all at range_max": (np.full(n, reach), bearings),
        "all equal": (np.full(n, 0.5 * reach), bearings),
        "noise": (rng.uniform(-1.0, 2.0 * reach, n), bearings),
        "holes": (with_holes, bearings),
        "seven rays": (
            np.array([0.3, 1.0, math.nan, math.inf, 0.5, -math.inf, 2.0]),
            seven_bearings,
        ),
        "more rays": (rng.uniform(min_range, reach, 2 * n), double_bearings),
        "unsorted": (rng.uniform(min_range, reach, n), rng.permutation(bearings)),
    }
    return {name: scan_from(platform, *pair) for name, pair in rays.items()}


def busy_scans(platform: Platform, count: int, *, seed: int = 0) -> list[Scan]:
    """Scans with three to six discs at random places in a room, sensor noise included."""
    rng = np.random.default_rng(seed)
    threshold = float(platform.protection["threshold"])
    near = 1.2 * threshold
    far = 0.9 * platform.scan.range_max
    scans = []
    for seq in range(count):
        discs = []
        for _ in range(int(rng.integers(3, 7))):
            distance = rng.uniform(near, far)
            bearing = rng.uniform(-math.pi, math.pi)
            radius = float(rng.uniform(0.1, 0.2)) * threshold / 0.5
            discs.append(Disc(distance * math.cos(bearing), distance * math.sin(bearing), radius))
        room = float(rng.uniform(2.2, 3.0)) * platform.scan.range_max
        scans.append(scan_of(platform, discs, room=room, seq=seq, noise=0.01, rng=rng))
    return scans


def mirrored(scan: Scan) -> Scan:
    """The scan with left and right exchanged."""
    ranges = scan.ranges[::-1].copy()
    bearings = -scan.bearings[::-1]
    return Scan(scan.seq, scan.stamp, ranges, bearings, scan.range_min, scan.range_max)


def reordered(scan: Scan, rng: Generator) -> Scan:
    """The same rays in another order, their bearings counted from another start."""
    order = rng.permutation(len(scan.ranges))
    bearings = (scan.bearings[order] + math.pi) % (2.0 * math.pi) - math.pi
    ranges = scan.ranges[order]
    return Scan(scan.seq, scan.stamp, ranges, bearings, scan.range_min, scan.range_max)


def read_only(scan: Scan) -> Scan:
    """A copy whose arrays raise ValueError when they are written to."""
    ranges = scan.ranges.copy()
    bearings = scan.bearings.copy()
    ranges.flags.writeable = False
    bearings.flags.writeable = False
    ages = None if scan.ages is None else scan.ages.copy()
    if ages is not None:
        ages.flags.writeable = False
    filled = None if scan.filled is None else scan.filled.copy()
    if filled is not None:
        filled.flags.writeable = False
    return Scan(
        scan.seq,
        scan.stamp,
        ranges,
        bearings,
        scan.range_min,
        scan.range_max,
        ages,
        scan.newest_age,
        filled,
        scan.borrowed,
    )


def _to_wall(half: float, start: float, direction: Array) -> Array:
    """Range to the two walls at -half and half across one axis; inf along them."""
    wall = np.where(direction > 0.0, half - start, -half - start)
    result = np.full(len(direction), math.inf)
    np.divide(wall, direction, out=result, where=np.abs(direction) > 1e-12)
    return result
