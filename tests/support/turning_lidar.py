"""A robot that turns on the spot in a room with a lidar whose rays are measured one by one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from swarmd.core.values import Array, Odometry, Pose, Scan, ScanSpec, Twist
from swarmd.sensing.measured_sweep import Order
from swarmd.sensing.scan_pipeline import Deskewer, OdometryHistory, ScanDelay

STEP = 0.01  # s
ODOMETRY_PERIOD = 0.05


@dataclass(frozen=True)
class Lidar:
    """`rays` of `rate` scans a second, measured in an order of the message.

    `claim` in s: the duration that the driver tells, in rising order whatever is true; 0: nothing.
    `delay`: s by which scans are later than the platform's latency, up to `jitter` more at random;
    `scan_clock` s: of its stamps.
    """

    order: Order
    rate: float = 5.0
    rays: int = 360
    claim: float = 0.0
    step: float = 1.0
    first: float = 0.0
    noise: float = 0.01
    dropouts: float = 0.0
    delay: float = 0.0
    jitter: float = 0.0
    scan_clock: float = 0.0
    odometry_scale: float = 1.0
    are_wheels_in_the_air: bool = False

    def spec(self, *, measures_sweep: bool = True) -> ScanSpec:
        """Its platform, which does not tell the sweep."""
        step = math.copysign(2.0 * math.pi / self.rays, self.step)
        bearings: Array = self.first + step * np.arange(self.rays, dtype=np.float64)
        bearings = (bearings + math.pi) % (2.0 * math.pi) - math.pi
        bearings.flags.writeable = False
        return ScanSpec(
            bearings,
            self.rate,
            0.12,
            8.0,
            offset=(-0.04, 0.0),
            latency=0.5 / self.rate,
            measures_sweep=measures_sweep,
        )


class Room:
    """A rectangle with posts that stand still and neighbours that walk around the robot."""

    def __init__(self, rng: np.random.Generator, *, most_neighbors: int = 4) -> None:
        width, depth = rng.uniform(1.5, 6.0, 2)
        across, along = rng.uniform(0.2, 0.8, 2)
        self._walls = -across * width, (1.0 - across) * width, -along * depth, (1.0 - along) * depth
        posts, neighbors = int(rng.integers(0, 7)), int(rng.integers(0, most_neighbors + 1))
        angles = rng.uniform(0.0, 2.0 * math.pi, posts + neighbors)
        distances = rng.uniform(0.5, 2.0, posts + neighbors)
        radii = np.append(rng.uniform(0.05, 0.25, posts), np.full(neighbors, 0.1))
        rates = np.append(np.zeros(posts), rng.uniform(-0.5, 0.5, neighbors))
        self._discs = list(zip(angles, distances, radii, rates, strict=True))

    def ranges(self, x: Array, y: Array, angles: Array, times: Array) -> Array:
        """The exact ranges of rays, each from its own place at its own time."""
        cos, sin = np.cos(angles + 1e-9), np.sin(angles + 1e-9)  # along no wall
        left, right, low, high = self._walls
        to_x = np.where(cos > 0.0, right - x, left - x) / cos
        ranges = np.minimum(to_x, np.where(sin > 0.0, high - y, low - y) / sin)
        for angle, distance, radius, rate in self._discs:
            ahead = distance * np.cos(angle + rate * times) - x
            aside = distance * np.sin(angle + rate * times) - y
            along = ahead * cos + aside * sin
            half = radius**2 - (ahead**2 + aside**2 - along**2)
            hit = along - np.sqrt(np.maximum(half, 0.0))
            ranges = np.where((half >= 0.0) & (hit > 0.0), np.minimum(ranges, hit), ranges)
        return np.asarray(ranges, np.float64)


def swinging(rate: float, period: float, seconds: float) -> Array:
    """Headings each STEP, at a rate of turn up to `rate` rad/s to both sides."""
    time = np.arange(0.0, seconds, STEP)
    yaws: Array = rate * period / (2.0 * math.pi) * (1.0 - np.cos(2.0 * math.pi * time / period))
    return yaws


def wandering(rng: np.random.Generator, seconds: float, *, fastest: float = 2.0) -> Array:
    """Headings, each STEP, of a robot that stands and turns to random sides for random times."""
    rates = np.zeros(round(seconds / STEP))
    begin = 0
    while begin < len(rates):
        begin += round(rng.uniform(0.3, 2.0) / STEP)
        end = begin + round(rng.uniform(0.5, 2.5) / STEP)
        rates[begin:end] = rng.uniform(0.5, fastest) * rng.choice((-1.0, 1.0))
        begin = end
    smooth = np.convolve(rates, np.full(30, 1.0 / 30.0), mode="same")  # accelerates for 0.3 s
    yaws: Array = np.cumsum(smooth) * STEP
    return yaws


class TurningLidar:
    """Runs a lidar on a robot with headings each STEP through delay, order and de-skew.

    `error`: the largest error in rad of a return's bearing in the last scan, against its place at
    the time that the scan counts as of. `raw` and `seen`: the last scan, before and after.
    """

    def __init__(
        self, lidar: Lidar, yaws: Array, rng: np.random.Generator, room: Room | None = None
    ) -> None:
        self.lidar, self.yaws, self._rng = lidar, yaws, rng
        self.room = Room(rng) if room is None else room
        self.spec = lidar.spec()
        self.delays = ScanDelay(self.spec)
        self._history = OdometryHistory(self.delays)
        self._deskewer = Deskewer(self.spec, self._history, self.delays.sweep)
        self._ages = lidar.order.ages(lidar.rays)
        self._claim = Order(1.0, lidar.claim).ages(lidar.rays) if lidar.claim else None
        self._times = STEP * np.arange(len(yaws))
        self._told = 0  # readings of odometry so far
        self._seq = round(1.2 * lidar.rate)
        self.raw = self.seen = Scan(0, 0.0, np.empty(0), np.empty(0), 0.0, 0.0)
        self.time, self.error = 0.0, 0.0

    @property
    def order(self) -> Order | None:
        """The order that is known."""
        assert self.delays.sweep is not None
        order: Order | None = self.delays.sweep.order
        return order

    def turned(self) -> float:
        """rad turned so far, to both sides."""
        return float(np.abs(np.diff(self.yaws[: round(self.time / STEP)])).sum())

    def next_scan(self) -> bool:
        """Measure a scan and let it arrive; False after the last heading."""
        lidar = self.lidar
        self._seq += 1
        newest = self._seq / lidar.rate
        arrival = newest - float(self._ages.mean()) + self.spec.latency + lidar.delay
        arrival += float(self._rng.uniform(0.0, lidar.jitter))
        if arrival + STEP > self._times[-1]:
            return False
        while self._told * ODOMETRY_PERIOD <= arrival:
            self._tell_odometry(self._told * ODOMETRY_PERIOD)
            self._told += 1
        self.time = arrival
        self.raw, x, y = self._measure(newest)
        self.delays.on_scan(self.raw, arrival)
        age = arrival - (self._told - 1) * ODOMETRY_PERIOD
        self.seen = self._deskewer.deskew(self.raw, arrival, age, self.delays.added)
        middle = newest if self.order is not None else newest - float(self._ages.mean())
        self.error = self._error(x, y, middle)
        return True

    def _tell_odometry(self, at: float) -> None:
        scale = self.lidar.odometry_scale
        yaw, before = scale * self._yaw(at), scale * self._yaw(at - ODOMETRY_PERIOD)
        rate = float(yaw - before) / ODOMETRY_PERIOD
        pose = Pose(0.0, 0.0, math.remainder(float(yaw), 2.0 * math.pi))
        odometry = Odometry(at, pose, Twist(0.0, rate))
        self._history.take(odometry, at)

    def _yaw(self, at: Array | float) -> Array:
        return np.asarray(np.interp(at, self._times, self.yaws), np.float64)

    def _sensor(self, at: Array | float) -> tuple[Array, Array, Array]:
        yaw = np.asarray(self._yaw(at) * (not self.lidar.are_wheels_in_the_air))
        return self.spec.offset[0] * np.cos(yaw), self.spec.offset[0] * np.sin(yaw), yaw

    def _measure(self, newest: float) -> tuple[Scan, Array, Array]:
        """The raw scan, and the places (n,) of its returns."""
        lidar, spec, times = self.lidar, self.spec, newest - self._ages
        x, y, yaw = self._sensor(times)
        angles = yaw + spec.bearings
        ranges = self.room.ranges(x, y, angles, times)
        place = x + ranges * np.cos(angles), y + ranges * np.sin(angles)
        ranges = ranges + self._rng.normal(0.0, lidar.noise, lidar.rays)
        ranges[self._rng.random(lidar.rays) < lidar.dropouts] = math.nan
        stamp = newest - float(self._ages.max()) + lidar.scan_clock
        limits = spec.range_min, spec.range_max
        return Scan(self._seq, stamp, ranges, spec.bearings, *limits, self._claim), *place

    def _error(self, x: Array, y: Array, at: float) -> float:
        own_x, own_y, yaw = self._sensor(np.array(at))
        off: Array = self.seen.bearings[-self.lidar.rays :] - np.arctan2(y - own_y, x - own_x) + yaw
        return float(np.abs((off + math.pi) % (2.0 * math.pi) - math.pi).max())
