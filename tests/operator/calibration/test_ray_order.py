"""In which order a lidar measures its rays: measured while the robot turns."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
import yaml

from swarmd.core.values import Array, Scan
from swarmd.operator.calibration.figures import SweepFigure
from swarmd.operator.calibration.ray_order import RayOrder

STEP = 0.01  # s
SECONDS = 9.0  # of the swings of a calibration
OFFSET = -0.04, 0.0


@dataclass(frozen=True)
class Lidar:
    """A lidar of `rate` scans a second, each measured in `duration` s.

    `direction`: of time in the message: 1.0 from the first ray to the last, -1.0 backwards, 0.0 all
    at once. `start`: share of the message before the ray that is measured first. `step`: the sign
    of the angle from ray to ray. `cover`: the share of a turn with rays.
    """

    direction: float
    duration: float = 0.2
    rate: float = 5.0
    rays: int = 360
    start: float = 0.0
    step: float = 1.0
    first: float = 0.0
    cover: float = 1.0
    noise: float = 0.01
    dropouts: float = 0.0

    @property
    def bearings(self) -> Array:
        step = math.copysign(2.0 * math.pi * self.cover / self.rays, self.step)
        bearings: Array = self.first + step * np.arange(self.rays, dtype=np.float64)
        return np.asarray((bearings + math.pi) % (2.0 * math.pi) - math.pi)

    @property
    def ages(self) -> Array:
        """(n,) s by which each ray is older than the newest."""
        place = np.arange(self.rays)
        if self.direction < 0.0:
            place = place[::-1]
        since = (place - round(self.start * self.rays)) % self.rays
        return np.asarray(abs(self.direction) * self.duration * (1.0 - (since + 1) / self.rays))


class Room:
    """A rectangle with posts that stand still and neighbours that walk around the robot."""

    def __init__(self, rng: np.random.Generator, *, most_neighbors: int = 0) -> None:
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


@dataclass
class Turns:
    """A robot that swings on the spot by up to `rate` rad/s to both sides, as in a calibration.

    `late`: s by which the delay is wrong. `scale`: of odometry. `is_in_the_air`: the wheels turn,
    the robot does not.
    """

    lidar: Lidar
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))
    rate: float = 1.2
    is_to_one_side: bool = False
    late: float = 0.0
    scale: float = 1.0
    is_in_the_air: bool = False
    neighbors: int = 0

    def figure(self) -> SweepFigure:
        lidar, times = self.lidar, np.arange(-1.0, SECONDS + 1.0, STEP)
        room = Room(self.rng, most_neighbors=self.neighbors)
        rates = self.rate * np.sin(2.0 * math.pi * times / 3.0) * (times > 0.0) * (times < SECONDS)
        if self.is_to_one_side:
            rates = np.abs(rates)
        yaws = np.cumsum(rates) * STEP
        true = np.zeros_like(yaws) if self.is_in_the_air else yaws

        def scan(newest: float, *, at_rest: bool = False) -> Scan:
            at = newest - lidar.ages
            yaw = np.interp(at, times, true) * (not at_rest)
            x, y = OFFSET[0] * np.cos(yaw), OFFSET[0] * np.sin(yaw)
            ranges = room.ranges(x, y, yaw + lidar.bearings, at)
            ranges = ranges + self.rng.normal(0.0, lidar.noise, lidar.rays)
            ranges[self.rng.random(lidar.rays) < lidar.dropouts] = math.nan
            return Scan(0, newest, ranges, lidar.bearings, 0.12, 8.0)

        looks = [scan(-1.0 - k / lidar.rate, at_rest=True) for k in range(6)]
        headings = np.column_stack((times, self.scale * yaws))
        order = RayOrder(looks, OFFSET, 1.0 / lidar.rate, headings)
        for k in range(1, round(SECONDS * lidar.rate)):
            newest = k / lidar.rate
            order.add(scan(newest), newest - float(lidar.ages.mean()) - self.late)
        return order.figure()


REVERSED = Lidar(-1.0)  # as by a driver that reverses the rays of an RPLIDAR


@pytest.mark.parametrize(
    ("lidar", "start_deg", "direction"),
    [
        (Lidar(1.0), 0.0, "ccw"),
        (REVERSED, -1.0, "cw"),
        (Lidar(1.0, step=-1.0, first=0.5 * math.pi), 90.0, "cw"),
        (Lidar(-1.0, step=-1.0), 1.0, "ccw"),
        (Lidar(1.0, 0.1, 10.0, rays=720, dropouts=0.1), 0.0, "ccw"),
        (Lidar(1.0, 0.075, 10.0, rays=270, cover=0.75, first=-2.36), -135.2, "ccw"),
    ],
)
def test_order_and_duration_are_found(lidar: Lidar, start_deg: float, direction: str) -> None:
    found = Turns(lidar).figure()
    assert yaml.safe_load(found.value) == {
        "start_deg": pytest.approx(start_deg),
        "direction": direction,
        "duration": pytest.approx(lidar.duration / lidar.cover),
    }
    assert found.samples >= 8


def test_duration_that_is_not_the_period_is_found() -> None:
    found = Turns(replace(REVERSED, duration=0.1)).figure()
    assert yaml.safe_load(found.value)["duration"] == pytest.approx(0.1, abs=0.02)


def test_rays_of_one_time_are_found() -> None:
    found = Turns(Lidar(0.0)).figure()
    assert found.value == "null"


@pytest.mark.parametrize(
    "turns",
    [
        Turns(replace(REVERSED, start=0.1)),
        Turns(replace(REVERSED, start=0.5)),
        Turns(REVERSED, is_to_one_side=True),
        Turns(REVERSED, is_in_the_air=True),
        Turns(REVERSED, rate=0.0),
        Turns(replace(REVERSED, rays=7)),
        Turns(replace(REVERSED, rays=1)),
    ],
    ids=["starts at 0.1", "starts at 0.5", "one side", "in the air", "at rest", "few", "one ray"],
)
def test_what_the_turns_do_not_show_is_not_measured_and_says_why(turns: Turns) -> None:
    found = turns.figure()
    assert found.value == ""
    assert found.why


@pytest.mark.short_rows(3)
@pytest.mark.parametrize("seed", range(16))
def test_random_lidars_never_get_another_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rate, direction = float(rng.choice((5.0, 10.0))), float(rng.choice((1.0, -1.0, 0.0)))
    lidar = Lidar(
        direction,
        float(rng.uniform(0.9, 1.0)) / rate,
        rate,
        rays=int(rng.choice((360, 720))),
        step=float(rng.choice((1.0, -1.0))),
        first=float(rng.uniform(-3.0, 3.0)),
        noise=float(rng.choice((0.005, 0.02))),
        dropouts=float(rng.choice((0.0, 0.1))),
    )
    found = Turns(
        lidar,
        rng,
        rate=float(rng.uniform(0.8, 2.0)),
        late=float(rng.uniform(-0.02, 0.02)),
        scale=float(rng.uniform(0.97, 1.03)),
        neighbors=4,
    ).figure()
    value = yaml.safe_load(found.value or "none")
    turn = "ccw" if direction * lidar.step > 0.0 else "cw"
    wanted = (None, "none") if direction == 0.0 else (turn, "none")
    assert (value["direction"] if isinstance(value, dict) else value) in wanted


@pytest.mark.parametrize(
    "figure", [SweepFigure("null", 20), SweepFigure("{a: 1}", 9), SweepFigure(why="a round room")]
)
def test_a_figure_survives_the_report(figure: SweepFigure) -> None:
    assert SweepFigure.parse(figure.text) == figure
