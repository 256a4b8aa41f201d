"""The ideal search: how soon seven points that search at full speed are together.

The points start as the robots of scenario `paper_exp1_hardware_free`, and move in its arena. A
group moves as one, in a straight line, and turns to a random direction at a wall. Two groups merge
at once when a point of one is in sight of a point of the other. The points of a group then lie on a
hexagon around their mean place. No group loses a point, and a merger takes no time. The model is no
upper bound: a group in a long chain would see farther than a hexagon.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from msgspec import Struct

from studies.keeper import each
from swarmd.core.values import Array
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import load_scenario

SCENARIO = "paper_exp1_hardware_free"
RULES: Mapping[str, int] = {"all groups move": 7, "groups of up to 3": 3, "single robots": 1}
"""The most points of a group that moves, by rule; larger groups wait."""
ENOUGH = 6
"""Points in one group that end the search."""
SIGHT = 0.8
"""m."""
STEP = 0.1
"""s."""
MARGIN = 0.25
"""The least distance of a point from a wall in m: the rear corner of a Waffle Pi from its axle."""
SPACING = 0.65
"""m, in a group: of Waffle Pis with visibility `real`."""
PLACES = SPACING * np.array(
    [(0.0, 0.0), *((math.cos(k * math.pi / 3), math.sin(k * math.pi / 3)) for k in range(6))]
)
"""The places (7, 2) of the points of a group, taken in this order, from its centre."""


class Search(Struct, frozen=True):
    """A search to do; groups of more than `most_moving` points wait."""

    seed: int
    most_moving: int


def search_times(seeds: Sequence[int], most_moving: int) -> Array:
    """(seeds,) s until six points are in one group, as `search_time`."""
    return np.array(each(search_time, [Search(seed, most_moving) for seed in seeds]))


def search_time(search: Search) -> float:
    """s until six points are in one group; inf: not within the scenario's duration."""
    scenario = _scenario()
    speed = min(platform.limits.linear for platform in scenario.robots.values())
    half = np.array((scenario.arena.length, scenario.arena.width)) / 2.0 - MARGIN
    rng = np.random.default_rng(search.seed)
    groups = Groups(scenario.starts(search.seed)[:, :2], half, rng)
    way = speed * STEP
    for step in range(1, round(scenario.duration / STEP) + 1):
        if groups.move(way, search.most_moving):
            return STEP * step
    return math.inf


@cache
def _scenario() -> Scenario:
    """The scenario, cached: reading it takes longer than a search."""
    return load_scenario(SCENARIO)


class Groups:
    """Groups of points in a rectangle of half size `half` (2,) around the origin."""

    def __init__(self, points: Array, half: Array, rng: np.random.Generator) -> None:
        """Each of the `points` (n, 2) is a group; `sizes` are the numbers of points of groups."""
        self._half = half
        self._rng = rng
        self._centers = points.copy()
        self.sizes = [1] * len(points)
        self._headings = rng.uniform(0.0, math.tau, len(points))

    @property
    def points(self) -> Array:
        """The points (n, 2), ordered by their groups."""
        by_group = zip(self._centers, self.sizes, strict=True)
        return np.concatenate([center + PLACES[:size] for center, size in by_group])

    def move(self, way: float, most_moving: int) -> bool:
        """Move all groups of up to `most_moving` points by `way`, and merge those in sight.

        True if a group has ENOUGH points.
        """
        ahead = way * np.column_stack((np.cos(self._headings), np.sin(self._headings)))
        for group, size in enumerate(self.sizes):
            place = self._centers[group] + ahead[group]
            if size > most_moving:
                continue
            if np.array_equal(place, self._inside(place, size)):
                self._centers[group] = place
            else:
                self._headings[group] = self._rng.uniform(0.0, math.tau)
        while (pair := self._pair_in_sight()) is not None:
            self._merge(*pair)
        return max(self.sizes) >= ENOUGH

    def _inside(self, center: Array, size: int) -> Array:
        """The nearest centre at which a group of that size is in the rectangle."""
        places = PLACES[:size]
        inside: Array = np.clip(
            center, -self._half - places.min(axis=0), self._half - places.max(axis=0)
        )
        return inside

    def _pair_in_sight(self) -> tuple[int, int] | None:
        """The first two groups of which two points are within SIGHT."""
        points = self.points
        owner = np.repeat(np.arange(len(self.sizes)), self.sizes)
        away = points[:, None] - points
        is_seen = (away**2).sum(axis=2) < SIGHT**2
        pairs = np.argwhere(is_seen & (owner[:, None] < owner))
        return None if len(pairs) == 0 else (int(owner[pairs[0, 0]]), int(owner[pairs[0, 1]]))

    def _merge(self, one: int, other: int) -> None:
        """Make one group of two, around their mean place, with a new heading."""
        sizes = self.sizes[one], self.sizes[other]
        total = sum(sizes)
        center = (self._centers[one] * sizes[0] + self._centers[other] * sizes[1]) / total
        self._centers[one] = self._inside(center, total)
        self.sizes[one] = total
        self._headings[one] = self._rng.uniform(0.0, math.tau)
        self._centers = np.delete(self._centers, other, axis=0)
        self._headings = np.delete(self._headings, other)
        del self.sizes[other]
