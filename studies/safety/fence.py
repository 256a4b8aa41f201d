"""`python -m studies.safety.fence --robot-hours 50`: crossings of the fence by MuJoCo's poses.

Each run has robots of one platform and mode within random polygons, convex or not, with and
without areas to keep out of. Robots drive random commands. The pose in the shared frame has random
errors up to the told bound, comes up to 0.1 s late, is lost for up to 1.2 s, and sometimes jumps by
metres. A crossing: a place of the true outline is outside. In one run of four the robots start
outside, wholly or across the fence; a crossing is then a distance to the fence that grows by more
than twice the told error and GROWTH, or a robot that leaves after it was inside by as much. With
`--exact` poses have no errors. Runs that build/safety has from the same sources are not repeated.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from msgspec import Struct

from studies import keeper
from studies.keeper import Traced, traced
from studies.safety.scenes import PLUGINS
from swarmd.core.pin import restart_pinned
from swarmd.core.values import Array, Pose, SharedPose
from swarmd.robot.protection.fence.fence import Fence
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.world.world import World

PLATFORMS = ("burger", "waffle_pi", "turtlebot4", "jackal")
MODES = ("barrier", "stop_zone", "off")
ROBOTS = {"barrier": 4, "stop_zone": 1, "off": 1}
"""Robots of a run by mode: without the barrier other robots push a robot across its fence."""
ERROR, YAW_ERROR = 0.03, 0.03  # m and rad: the told bounds of the errors
GROWTH = 0.005
"""m that the distance of a robot outside may grow, beside twice the told error of a pose."""
LATE, LOST, JUMPED = 0.2, 0.02, 0.01  # shares of poses that are late, begin a loss, or jump
_PARTS = np.linspace(0.0, 1.0, 5)[:, None, None]  # of an edge of the outline


class Run(Struct, frozen=True):
    """A run to do; `duration` in s. `is_outside`: the robots start outside.

    `is_exact`: poses have no error, and are told so.
    """

    platform: str
    mode: str
    seed: int
    duration: float
    is_outside: bool
    is_exact: bool = False


class Found(Struct, frozen=True, kw_only=True):
    """What a run gave: robot-seconds, those in motion, crossings, and distances in m.

    `worst`: m that a place was outside at most; for a start outside: by how much the distance grew.
    `nearest`: the least distance of the outline from the fence, of robots inside; None without.
    `entered`: robots that started outside and came inside.
    """

    seconds: float
    moving: float
    crossings: int
    worst: float
    nearest: float | None
    entered: int


Record: TypeAlias = keeper.Record[Run, Found]
"""A finished run."""


class Judge:
    """Distances of the outlines of robots to their fence, by true poses."""

    def __init__(self, fence: Fence, outlines: Sequence[Array]) -> None:
        self._fence, self._radius = fence, fence.radius
        self._points = [
            (one + _PARTS * (np.roll(one, -1, axis=0) - one)).reshape(-1, 2) for one in outlines
        ]

    def clearances(self, poses: Array) -> Array:
        """(n,) m from each outline to the fence; minus the m by which a place is outside."""
        circles = self._fence.clearances(poses[:, :2])
        for row in np.flatnonzero(circles < self._radius):
            x, y, yaw = poses[row]
            cos, sin = math.cos(yaw), math.sin(yaw)
            placed = self._points[row] @ np.array([[cos, sin], [-sin, cos]]) + (x, y)
            circles[row] = self._fence.clearances(placed).min() + self._radius
        return circles


class Localisation:
    """Poses with errors, delays, losses and jumps, in place of those of the world."""

    def __init__(self, world: World, seed: int, *, is_exact: bool) -> None:
        self._true, self._rng = world.shared_pose, np.random.default_rng(seed)
        self._is_exact = is_exact
        self._last: dict[int, SharedPose] = {}
        self._lost_until: dict[int, float] = {}

    def shared_pose(self, robot: int, stamp: float) -> SharedPose:
        """The pose of a robot; a stamp that does not advance while the pose is lost."""
        rng, known = self._rng, self._last.get(robot)
        pose = self._true(robot, stamp)
        self._last[robot] = pose
        if known is not None and rng.random() < LATE:  # that of the reading before
            pose = known
        if rng.random() < LOST and stamp > self._lost_until.get(robot, 1.0):
            self._lost_until[robot] = stamp + rng.uniform(0.0, 1.2)
        at = 0.0 if stamp < self._lost_until.get(robot, 0.0) else pose.stamp
        if self._is_exact:
            return SharedPose(at, pose.pose, 0.0, 0.0, "world")
        way, far = rng.uniform(-math.pi, math.pi), rng.uniform(0.0, ERROR)
        if rng.random() < JUMPED:
            far = rng.uniform(0.0, 5.0)
        x, y = pose.pose.x + far * math.cos(way), pose.pose.y + far * math.sin(way)
        yaw = pose.pose.yaw + rng.uniform(-YAW_ERROR, YAW_ERROR)
        return SharedPose(at, Pose(x, y, yaw), ERROR, YAW_ERROR, "world")


def scene(platform: str, mode: str, seed: int, duration: float, *, is_outside: bool) -> Scenario:
    """Robots and a random fence of about 6 m."""
    rng = np.random.default_rng(seed)
    for _ in count():
        n = int(rng.integers(3, 10))
        angles = 2.0 * math.pi * (np.arange(n) + rng.uniform(-0.3, 0.3, n)) / n
        radii = rng.uniform(1.5, 4.0, n) if rng.random() < 0.7 else np.full(n, 3.5)
        corners = np.stack((radii * np.cos(angles), radii * np.sin(angles)), axis=1).tolist()
        keep_out = []
        if rng.random() < 0.5:
            at, side = rng.uniform(-1.5, 1.5, 2), rng.uniform(0.02, 1.0)
            shape = np.array([[0.0, 0.0], [1.0, 0.1], [0.9, 1.0], [0.4, 0.3]])
            keep_out = [(at + side * shape).tolist()]
        data: dict[str, Any] = {
            "name": f"fence-{platform}-{mode}-{seed}",
            "duration": duration,
            "arena": {"size": [16.0, 16.0]},
            "plugin_dir": str(PLUGINS),
            "platforms": {platform: {"protection": {"mode": mode}}},
            "fence": {"frame": "world", "polygon": corners, "keep_out": keep_out},
        }
        # A hold of 2 s ends a run: each robot begins anew every 10 s.
        data["events"] = [
            {"at": at, "run": "random_twists"} for at in np.arange(10.0, duration, 10.0).tolist()
        ]
        group = {"platform": platform, "count": ROBOTS[mode], "pattern": "random_twists"}
        places = _starts(data, group, rng, is_outside=is_outside)
        if places is not None:
            start = {"layout": "list", "poses": places}
            return scenario_of({**data, "groups": {"all": {**group, "start": start}}})
    raise AssertionError


def _starts(
    data: dict[str, Any], group: dict[str, Any], rng: np.random.Generator, *, is_outside: bool
) -> list[list[float]] | None:
    """Start poses inside (or outside) that keep 1 m from each other; None without room."""
    made = scenario_of({**data, "groups": {"all": group}})
    settings = next(iter(made.settings.values())).fence
    assert settings is not None
    fence = Fence(settings, next(iter(made.robots.values())))
    places: list[list[float]] = []
    for place in rng.uniform(-6.0, 6.0, (2000, 2)):
        clearance = float(fence.clearances(place[None])[0])
        is_good = clearance < 0.0 if is_outside else clearance > 0.15
        if is_good and all(math.dist(place, other[:2]) > 1.0 for other in places):
            places.append([*place.tolist(), float(rng.uniform(-180.0, 180.0))])
        if len(places) == group["count"]:
            return places
    return None


def perform(run: Run) -> Traced[Found]:
    """Simulate one run and judge it at each step of the world."""
    made = scene(run.platform, run.mode, run.seed, run.duration, is_outside=run.is_outside)
    lockstep = Lockstep(made, run.seed)
    world = lockstep.world
    poses_told = Localisation(world, run.seed, is_exact=run.is_exact)
    world.shared_pose = poses_told.shared_pose  # type: ignore[method-assign]
    growth = GROWTH if run.is_exact else GROWTH + 2.0 * ERROR
    settings = made.settings[world.ids[0]].fence
    assert settings is not None
    fence = Fence(settings, world.platforms[0])
    judge = Judge(fence, [one.footprint for one in world.platforms])
    n = len(world.ids)
    is_inside = np.full(n, not run.is_outside)  # the outline is, or was, wholly inside
    was_bad = np.zeros(n, dtype=bool)
    least = np.full(n, np.inf)  # m by which the circle was outside so far
    crossings, worst, nearest, moving = 0, 0.0, math.inf, 0.0

    def look(_: float) -> None:
        nonlocal crossings, worst, nearest, moving, was_bad, least, is_inside
        poses = world.poses()
        moving += world.dt * float((np.abs(world.twists()[:, :2]) > 0.01).any(axis=1).sum())
        circles = fence.clearances(poses[:, :2])
        least = np.minimum(least, np.maximum(-circles, 0.0))
        grown = -circles - least
        clearance = judge.clearances(poses)
        is_inside |= circles >= growth
        # Of a robot outside, the circle around the axle counts, as in the fence; of a robot inside,
        # the outline.
        off = np.where(is_inside, -clearance, grown)
        is_bad = off > np.where(is_inside, 0.0, growth)
        crossings += int((is_bad & ~was_bad).sum())
        was_bad, worst = is_bad, max(worst, float(off.max()))
        nearest = min(nearest, float(clearance[is_inside].min(initial=math.inf)))

    lockstep.advance(run.duration, look)
    found = Found(
        seconds=n * run.duration,
        moving=moving,
        crossings=crossings,
        worst=worst,
        nearest=None if nearest == math.inf else nearest,
        entered=int(is_inside.sum()) if run.is_outside else 0,
    )
    return traced(found, lockstep.trace())


def plan(
    robot_hours: float, duration: float, first_seed: int, *, is_exact: bool = False
) -> Iterator[Run]:
    """Runs of all platforms and modes in turn, one of four with a start outside."""
    left = 3600.0 * robot_hours
    for number in count():
        if left <= 0.0:
            return
        platform = PLATFORMS[number % len(PLATFORMS)]
        mode = MODES[number // len(PLATFORMS) % len(MODES)]
        left -= ROBOTS[mode] * duration
        is_outside = number // (len(PLATFORMS) * len(MODES)) % 4 == 3
        yield Run(platform, mode, first_seed + number, duration, is_outside, is_exact)


def table(results: Sequence[Record]) -> str:
    """The sum of each platform, mode and start, as lines of a table."""
    cells: dict[tuple[str, str, bool], list[Found]] = {}
    for one in results:
        run = one.task
        cells.setdefault((run.platform, run.mode, run.is_outside), []).append(one.found)
    heads = "platform", "mode", "start", "robot-hours", "in motion", "crossings", "worst", "nearest"
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for (platform, mode, is_outside), cell in sorted(cells.items()):
        seconds = sum(one.seconds for one in cell)
        nearest = min((one.nearest for one in cell if one.nearest is not None), default=None)
        words = (
            platform,
            mode,
            f"outside, {sum(one.entered for one in cell)} came in" if is_outside else "inside",
            f"{seconds / 3600.0:.2f}",
            f"{sum(one.moving for one in cell) / seconds:.0%}",
            str(sum(one.crossings for one in cell)),
            f"{1000.0 * max(one.worst for one in cell):.1f} mm",
            "-" if nearest is None else f"{100.0 * nearest:.1f} cm",
        )
        lines.append(f"| {' | '.join(words)} |")
    return "\n".join(lines)


def main(arguments: Sequence[str]) -> int:
    """Carry out the runs and print the table; 1 if there was a crossing."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot-hours", type=float, default=50.0)
    parser.add_argument("--duration", type=float, default=120.0, help="s of each run")
    parser.add_argument("--seed", type=int, default=1, help="of the first run")
    parser.add_argument("--exact", action="store_true", help="poses without errors")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--out", type=Path, default=Path("build/safety"))
    options = parser.parse_args(arguments)
    limits = options.robot_hours, options.duration, options.seed
    runs = list(plan(*limits, is_exact=options.exact))
    file = options.out / "fence.jsonl"
    results = keeper.records(perform, runs, file, jobs=options.jobs)
    hours = sum(one.found.seconds for one in results) / 3600.0
    cpu = sum(one.cpu for one in results)
    crossings = sum(one.found.crossings for one in results)
    print(f"{table(results)}\n\n{hours:.2f} robot-hours, {crossings} crossings")
    if hours:
        print(f"{cpu / hours:.0f} CPU-s a robot-hour")
    return 1 if crossings else 0


if __name__ == "__main__":
    restart_pinned()  # as in a night, so that runs have its bits
    sys.exit(main(sys.argv[1:]))
