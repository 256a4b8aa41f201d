"""Tracks beside the truth: their errors, and avoidance with true tracks in their place.

`errors` compares the tracks of ten Burgers that drive to goals in 4 x 4 m with their true places
and velocities, for several lidars.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from msgspec import Struct, structs

from benchmarks.table import markdown
from studies import keeper
from studies.keeper import Traced, traced
from studies.safety.scenes import Scene, scenario
from swarmd.core.values import Array, Odometry, Platform, Scan
from swarmd.robot.protection.decision import DecisionContext
from swarmd.robot.steering.tracks import Surroundings, Track
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.world.world import World

REACH = 2.5  # m, of true tracks
COMPARED = 1.5  # m within which tracks are compared
FALSE = 0.2  # m: a track that is farther from each robot is false
SETTLED = 3.0  # s from which tracks are compared


class Lidar(Struct, frozen=True):
    """A lidar of `rate` Hz, with so many times the noise and a share of lost rays."""

    rate: float = 5.0
    noise: float = 1.0
    dropout: float = 0.0


LIDARS: Mapping[str, Lidar] = {
    "5 Hz": Lidar(),
    "10 Hz": Lidar(10.0),
    "5 Hz, twice the noise": Lidar(noise=2.0),
    "5 Hz, 30 % of the rays lost": Lidar(dropout=0.3),
}


def true_tracks(world: World, row: int, reach: float) -> tuple[Track, ...]:
    """The other robots within `reach` m of one, in its base frame; their radius is that of scans.

    Scans measure nearly half of the diagonal of an outline.
    """
    poses, twists = world.poses(), world.twists()
    x, y, yaw = poses[row]
    cos, sin = math.cos(yaw), math.sin(yaw)
    found = []
    for other, platform in enumerate(world.platforms):
        ahead, aside = math.cos(poses[other, 2]), math.sin(poses[other, 2])
        along, left = 0.5 * (platform.footprint.min(axis=0) + platform.footprint.max(axis=0))
        to_x, to_y = ahead * along - aside * left, aside * along + ahead * left  # to the middle
        dx, dy = poses[other, 0] + to_x - x, poses[other, 1] + to_y - y
        if other == row or not math.hypot(dx, dy) <= reach:
            continue
        linear, turn, lateral = twists[other]
        vx = ahead * linear - aside * lateral - turn * to_y
        vy = aside * linear + ahead * lateral + turn * to_x
        radius = 0.5 * math.hypot(*np.ptp(platform.footprint, axis=0).tolist())
        place = cos * dx + sin * dy, cos * dy - sin * dx
        found.append(Track(other, *place, cos * vx + sin * vy, cos * vy - sin * vx, radius))
    return tuple(found)


class TrueTracker:
    """The tracker of one robot, with true tracks of robots; walls are those of its scans."""

    def __init__(self, tracker: Any, world: World, row: int) -> None:
        self._tracker, self._world, self._row = tracker, world, row
        self.reset, self.on_odometry, self.observe = (
            tracker.reset,
            tracker.on_odometry,
            tracker.observe,
        )

    def surroundings(self, context: DecisionContext) -> Surroundings:
        """The true tracks now."""
        walls = self._tracker.surroundings(context).walls
        return Surroundings(true_tracks(self._world, self._row, REACH), walls)


class ComparedTracker:
    """A tracker whose tracks are compared with the truth after each scan.

    `errors` (k, 3): m, m/s, and the true speed in m/s. `false` of `tracks`; `found` of `robots`.
    """

    def __init__(self, tracker: Any, world: World, row: int) -> None:
        self._tracker, self._world, self._row = tracker, world, row
        self.reset, self.surroundings = tracker.reset, tracker.surroundings
        self.errors: list[tuple[float, float, float]] = []
        self.tracks = self.false = self.robots = self.found = 0

    def on_odometry(self, odometry: Odometry) -> None:
        """Pass a reading on."""
        self._tracker.on_odometry(odometry)

    def observe(self, scan: Scan, context: DecisionContext) -> None:
        """Pass a scan on, and compare."""
        self._tracker.observe(scan, context)
        if self._world.time < SETTLED:
            return
        truth = true_tracks(self._world, self._row, COMPARED + FALSE)
        seen = set()
        for track in self._tracker.surroundings(context).tracks:
            if math.hypot(track.x, track.y) > COMPARED:
                continue
            self.tracks += 1
            offs = [math.hypot(track.x - one.x, track.y - one.y) for one in truth]
            if min(offs, default=math.inf) > FALSE:
                self.false += 1
                continue
            one = truth[int(np.argmin(offs))]
            seen.add(one.id)
            off = math.hypot(track.vx - one.vx, track.vy - one.vy)
            self.errors.append((min(offs), off, math.hypot(one.vx, one.vy)))
        near = {one.id for one in truth if math.hypot(one.x, one.y) <= COMPARED}
        self.robots += len(near)
        self.found += len(near & seen)


def replace_trackers(run: Lockstep, kind: Any) -> list[Any]:
    """Give each robot that avoids a tracker of another kind."""
    made = []
    for row, shell in enumerate(run.shells):
        assert shell is not None
        steering: Any = shell.robot._steering
        if steering._tracker is not None:
            steering._tracker = kind(steering._tracker, run.world, row)
            made.append(steering._tracker)
    return made


def with_lidar(made: Scenario, lidar: Lidar) -> Scenario:
    """The scenario with another lidar of all robots."""
    noise = made.realism.lidar
    changed = structs.replace(
        noise,
        near_sd=lidar.noise * noise.near_sd,
        far_sd=lidar.noise * noise.far_sd,
        dropout=lidar.dropout or noise.dropout,
    )
    robots = {name: _with_rate(one, lidar.rate) for name, one in made.robots.items()}
    return replace(made, robots=robots, realism=structs.replace(made.realism, lidar=changed))


def _with_rate(platform: Platform, rate: float) -> Platform:
    scan = platform.scan
    sweep = None if scan.sweep is None else replace(scan.sweep, duration=1.0 / rate)
    return replace(platform, scan=replace(scan, rate=rate, latency=0.5 / rate, sweep=sweep))


class Run(Struct, frozen=True):
    """A run to do, with one of LIDARS, of `duration` s."""

    lidar: str
    seed: int
    duration: float


class Found(Struct, frozen=True):
    """The sums of the compared trackers of a run, as in `ComparedTracker`."""

    errors: Array
    tracks: int
    false: int
    robots: int
    found: int


Record: TypeAlias = keeper.Record[Run, Found]
"""A finished run."""


def perform(run: Run) -> Traced[Found]:
    """One run among dense goals."""
    made = scenario(Scene("goals", "burger", "body", "orca", duration=run.duration))
    lockstep = Lockstep(with_lidar(made, LIDARS[run.lidar]), run.seed)
    trackers = replace_trackers(lockstep, ComparedTracker)
    lockstep.advance(run.duration)
    errors = np.array([row for one in trackers for row in one.errors]).reshape(-1, 3)
    found = Found(
        errors,
        tracks=sum(one.tracks for one in trackers),
        false=sum(one.false for one in trackers),
        robots=sum(one.robots for one in trackers),
        found=sum(one.found for one in trackers),
    )
    return traced(found, lockstep.trace())


def carry_out(seeds: Sequence[int], duration: float, jobs: int, file: Path) -> list[Record]:
    """The runs of all lidars; those in `file` are not done again."""
    runs = [Run(lidar, seed, duration) for lidar in LIDARS for seed in seeds]
    return keeper.records(perform, runs, file, jobs=jobs)


def table(records: Sequence[Record]) -> str:
    """Markdown, a row for each lidar."""
    rows = [["lidar", "place, r.m.s., 95 % [cm]", "velocity, r.m.s., 95 % [m/s]"]]
    rows[0] += ["true speed, r.m.s. [m/s]", "false tracks", "robots with a track"]
    for name in LIDARS:
        done = [record.found for record in records if record.task.lidar == name]
        errors: Array = np.concatenate([one.errors for one in done])
        place, velocity, speed = np.sqrt(np.mean(errors**2, axis=0))
        worst = np.percentile(errors, 95.0, axis=0)
        rows.append(
            [
                name,
                f"{100.0 * place:.1f}, {100.0 * worst[0]:.1f}",
                f"{velocity:.2f}, {worst[1]:.2f}",
                f"{speed:.2f}",
                f"{sum(one.false for one in done) / sum(one.tracks for one in done):.1%}",
                f"{sum(one.found for one in done) / sum(one.robots for one in done):.0%}",
            ]
        )
    return markdown(rows)
