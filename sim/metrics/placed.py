"""Metrics whose name holds a place or a number, such as `share_in:disc:1.5:0:0.7`.

An area is `disc:x:y:radius` or `box:x:y:length:width` in m. A name may have several areas, which
count as their union. The name holds all numbers that another program needs to compute the metric.
Only present robots count, by the position of their axle centres.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError
from swarmd.core.numbers import finite_number
from swarmd.core.values import Array
from swarmd.sim.metrics import pairs
from swarmd.sim.metrics.metric import (
    SHARE,
    Better,
    Metric,
    Series,
    Value,
    at_end,
    late_mean,
    over_time,
)
from swarmd.sim.metrics.window import arena_of, presence, row_means
from swarmd.sim.trace import Trace
from swarmd.sim.world.arena import Arena

CELL = 0.1
"""Side in m of the squares in which floor is counted."""
_SIZES = {"disc": 3, "box": 4}


@dataclass(frozen=True, slots=True)
class Area:
    """A disc x, y, radius or an upright box x, y, length, width, in m."""

    kind: str
    numbers: tuple[float, ...]

    def holds(self, places: Array) -> NDArray[np.bool_]:
        """(...) whether each of `places` (..., 2) is in the area."""
        x, y, *size = self.numbers
        dx = places[..., 0] - x
        dy = places[..., 1] - y
        if self.kind == "disc":
            return np.asarray(np.hypot(dx, dy) <= size[0])
        return np.asarray((np.abs(dx) <= size[0] / 2.0) & (np.abs(dy) <= size[1] / 2.0))


def share_in(trace: Trace, areas: Sequence[Area]) -> Array:
    """(T,) the share of the present robots that are in the areas; NaN without a robot."""
    return row_means(_in_any(trace.pose[..., :2], areas).astype(np.float64), presence(trace))


def share_reached(trace: Trace, areas: Sequence[Area]) -> Array:
    """(T,) the share of all robots that have been in the areas up to each instant."""
    return _share_until(_in_any(trace.pose[..., :2], areas) & presence(trace))


def share_swapped(trace: Trace, reach: float) -> Array:
    """(T,) the share of all robots that have been at their goals up to each instant.

    The goal of a robot is its start position mirrored at the origin, as in the position swap of van
    den Berg et al. 2011. A robot is at the goal within `reach` m.
    """
    goals = -trace.pose[:1, :, :2]
    away = trace.pose[..., :2] - goals
    return _share_until((np.hypot(away[..., 0], away[..., 1]) <= reach) & presence(trace))


def share_caught(trace: Trace, group: str, reach: float) -> Array | None:
    """(T,) the share of a group's robots that have been caught up to each instant.

    A robot is caught once a robot of another group is within `reach` m, from axle to axle. None if
    the trace has no such group, or no robot outside the group.
    """
    members = trace.meta.get("groups", {}).get(group, ())
    is_prey = np.array([robot in members for robot in trace.ids], dtype=bool)
    if not is_prey.any() or is_prey.all():
        return None
    place = trace.pose[..., :2]
    is_here = presence(trace)
    away = place[:, is_prey, None] - place[:, None, ~is_prey]
    near = np.hypot(away[..., 0], away[..., 1]) <= reach
    near &= is_here[:, is_prey, None] & is_here[:, None, ~is_prey]
    return _share_until(np.asarray(near.any(axis=2)))


def share_reporting(trace: Trace, key: str, number: float) -> Array | None:
    """(T,) the share of the present robots whose pattern reports `number` as `key`.

    A robot without a report of `key` does not report `number`. None if no robot ever reports `key`.
    """
    said = trace.report.get(key)
    if said is None:
        return None
    return row_means((said == number).astype(np.float64), presence(trace))


def box_progress(trace: Trace, x: float, y: float) -> Array | None:
    """(T,) 1 - d / d0, where d is the distance of the first movable box from x, y in m.

    d0 is the distance at the start. None without a movable box, or if the box starts at the place.
    """
    if trace.box_pose is None or not trace.box_pose.shape[1]:
        return None
    off = trace.box_pose[:, 0, :2] - (x, y)
    away = np.hypot(off[:, 0], off[:, 1])
    first = float(away[0]) if len(away) else 0.0
    return np.asarray(1.0 - away / first) if first > 0.0 else None


def coverage_distance(trace: Trace, areas: Sequence[Area]) -> Array | None:
    """(T,) the mean distance in m from the floor outside `areas` to the nearest robot there.

    The floor is a grid of squares of CELL m. Squares in the areas and robots in the areas do not
    count. The distance of a square is measured from its middle. While no robot counts, the mean is
    the arena's diagonal. None if the trace names no arena.
    """
    arena = arena_of(trace)
    if arena is None:
        return None
    floor = _squares(arena.length, arena.width)
    floor = floor[~_in_any(floor, areas)]
    is_counted = presence(trace) & ~_in_any(trace.pose[..., :2], areas)
    distances = np.full(len(trace.t), math.hypot(arena.length, arena.width))
    for at in np.flatnonzero(is_counted.any(axis=1)):
        place = trace.pose[at, is_counted[at], :2]
        away = floor[:, None] - place[None]
        distances[at] = np.sqrt((away**2).sum(axis=2).min(axis=1)).mean()
    return distances


def network_area(trace: Trace, link: float, radius: float) -> Array:
    """(T,) the floor in m2 within `radius` m of a robot of the largest network.

    Robots within `link` m of each other are linked, also through walls. The largest network is the
    connected component with the most robots; among components with equally many robots the greatest
    area counts. The floor is a grid of squares of CELL m. If the trace names an arena, floor
    outside the arena does not count.
    """
    is_here = presence(trace)
    arena = arena_of(trace)
    n = is_here.shape[1]
    areas = np.zeros(len(trace.t))
    for at in range(len(trace.t)):
        place = trace.pose[at, :, :2]
        links = pairs.near(place[None], is_here[at : at + 1], link)
        label = pairs.components(n, links.a, links.b)
        label[~is_here[at]] = -1
        names, sizes = np.unique(label[label >= 0], return_counts=True)
        largest = names[sizes == sizes.max()] if len(sizes) else ()
        covered = [_disc_area(place[label == name], radius, arena) for name in largest]
        areas[at] = max(covered, default=0.0)
    return areas


def _disc_area(place: Array, radius: float, arena: Arena | None) -> float:
    """The area in m2 of the union of discs around `place` (k, 2), within the walls."""
    low = np.floor((place.min(axis=0) - radius) / CELL) * CELL
    count = np.ceil((place.max(axis=0) + radius - low) / CELL).astype(int)
    x, y = (low[axis] + (np.arange(count[axis]) + 0.5) * CELL for axis in (0, 1))
    is_covered = np.zeros((len(x), len(y)), dtype=bool)
    for px, py in place:
        is_covered |= np.hypot((x - px)[:, None], (y - py)[None]) <= radius
    if arena is not None:
        is_covered &= (np.abs(x) <= arena.length / 2.0)[:, None]
        is_covered &= (np.abs(y) <= arena.width / 2.0)[None]
    return float(is_covered.sum()) * CELL**2


def _squares(length: float, width: float) -> Array:
    """The middles (k, 2) of the squares of a floor, in m."""
    x, y = (
        (np.arange(math.ceil(side / CELL)) + 0.5) * CELL - side / 2.0 for side in (length, width)
    )
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


def _in_any(places: Array, areas: Sequence[Area]) -> NDArray[np.bool_]:
    is_in = np.zeros(places.shape[:-1], dtype=bool)
    for area in areas:
        is_in |= area.holds(places)
    return is_in


def _share_until(is_so: NDArray[np.bool_]) -> Array:
    """(T,) the share of the columns of `is_so` (T, n) that have been true up to each instant."""
    return np.asarray(np.logical_or.accumulate(is_so, axis=0).mean(axis=1))


def _whole(series: Series, word: str) -> Value:
    """The statistic `word` (of TIMES) of a series, which is computed for the whole run.

    It is for series whose values depend on the start of the run.
    """

    def value(trace: Trace) -> float | None:
        values = series(trace)
        return None if values is None else over_time(values, trace.t, word)

    return value


_mean = partial(_whole, word="mean")
_end = partial(_whole, word="end")


@dataclass(frozen=True, slots=True, kw_only=True)
class Placed:
    """A kind of metric with values in its name."""

    usage: str
    """The name with placeholders."""
    unit: str
    better: Better
    meaning: str
    source: str
    read: Callable[[Sequence[str]], Series]
    """The series for the words of the name after the first; ValueError for wrong words."""
    over: Callable[[Series], Value]
    """Makes the number of a run from the series."""


def is_placed(name: str) -> bool:
    """Whether the name is that of one of KINDS."""
    return name.partition(":")[0] in KINDS


def placed_metric(name: str) -> Metric:
    """The metric of a name such as `share_in:disc:1.5:0:0.7`; ConfigError for wrong values."""
    kind, *words = name.split(":")
    placed = KINDS[kind]
    try:
        series = placed.read(words)
    except ValueError as error:
        raise ConfigError(f"metric {name!r}: {error}; expected {placed.usage}") from None
    return Metric(
        name=name,
        unit=placed.unit,
        meaning=placed.meaning,
        source=placed.source,
        value=placed.over(series),
        series=series,
        better=placed.better,
        bounds=SHARE if kind.startswith("share_") else None,
    )


def _numbers(words: Sequence[str], count: int) -> tuple[float, ...]:
    if len(words) != count:
        raise ValueError(f"there are {len(words)} values, not {count}")
    numbers = tuple(map(finite_number, words))
    for word, number in zip(words, numbers, strict=True):
        if math.isnan(number):
            raise ValueError(f"{word!r} is no number")
    return numbers


def _areas(words: Sequence[str]) -> tuple[Area, ...]:
    return tuple(_each_area(words))


def _each_area(words: Sequence[str]) -> Iterator[Area]:
    while words:
        kind = words[0]
        count = _SIZES.get(words[0], 0)
        if not count:
            raise ValueError(f"{kind!r} is no area")
        numbers = _numbers(words[1 : count + 1], count)
        if min(numbers[2:]) <= 0.0:
            raise ValueError(f"the {kind} has a size that is not positive")
        yield Area(kind, numbers)
        words = words[count + 1 :]


def _some_areas(words: Sequence[str]) -> tuple[Area, ...]:
    if not words:
        raise ValueError("there is no area")
    return _areas(words)


def _group_and_reach(words: Sequence[str]) -> Series:
    if not words or not words[0]:
        raise ValueError("there is no group")
    (reach,) = _numbers(words[1:], 1)
    return partial(share_caught, group=words[0], reach=reach)


def _key_and_number(words: Sequence[str]) -> Series:
    if not words or not words[0]:
        raise ValueError("there is no key of a report")
    (number,) = _numbers(words[1:], 1)
    return partial(share_reporting, key=words[0], number=number)


def _read_box(words: Sequence[str]) -> Series:
    x, y = _numbers(words, 2)
    return partial(box_progress, x=x, y=y)


def _read_network(words: Sequence[str]) -> Series:
    link, radius = _numbers(words, 2)
    if not radius > 0.0:
        raise ValueError("the radius is not positive")
    return partial(network_area, link=link, radius=radius)


_CHOCOLATE = "Francesca et al. 2015, Swarm Intell. 9"

KINDS: Mapping[str, Placed] = MappingProxyType({
    "share_in": Placed(
        usage="share_in:AREA", unit="share", better="more", source=_CHOCOLATE,
        meaning="share of the robots that are in the area, mean of the last 60 s",
        read=lambda words: partial(share_in, areas=_some_areas(words)), over=late_mean),
    "share_reached": Placed(
        usage="share_reached:AREA", unit="share", better="more", source="ours",
        meaning="share of the robots that have been in the area so far, mean over the run: half if"
        " all arrive after half of the time",
        read=lambda words: partial(share_reached, areas=_some_areas(words)), over=_mean),
    "share_swapped": Placed(
        usage="share_swapped:DISTANCE", unit="share", better="more",
        source="the swap: van den Berg et al. 2011, ISRR; the number: ours",
        meaning="share of the robots that have been within the distance of the place opposite"
        " their start so far, mean over the run",
        read=lambda words: partial(share_swapped, reach=_numbers(words, 1)[0]), over=_mean),
    "share_caught": Placed(
        usage="share_caught:GROUP:DISTANCE", unit="share", better="more", source="ours",
        meaning="share of the group's robots that another robot has been within the distance of so"
        " far, mean over the run: 1 less the mean time of capture as a share of the run",
        read=_group_and_reach, over=_mean),
    "share_reporting": Placed(
        usage="share_reporting:KEY:NUMBER", unit="share", better="more", source="ours",
        meaning="share of the robots whose pattern reports the number as KEY at the end",
        read=_key_and_number, over=at_end),
    "box_progress": Placed(
        usage="box_progress:X:Y", unit="share", better="more", source="ours",
        meaning="share of the way to the place that the first movable box has made at the end",
        read=_read_box, over=_end),
    "coverage_distance": Placed(
        usage="coverage_distance[:AREA]", unit="m", better="less", source=_CHOCOLATE,
        meaning="mean distance from the floor outside the area to the nearest robot outside it,"
        " mean of the last 60 s",
        read=lambda words: partial(coverage_distance, areas=_areas(words)), over=late_mean),
    "network_area": Placed(
        usage="network_area:LINK:RADIUS", unit="m2", better="more", source=_CHOCOLATE,
        meaning="floor within the radius of a robot of the largest network at the end; robots"
        " within the link of each other are linked",
        read=_read_network, over=at_end),
})  # fmt: skip
"""By the first word of the name."""
