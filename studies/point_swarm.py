"""A simulation of hundreds of point robots that run one pattern, with exact motion and radio.

Each robot's pattern runs in a `PatternExecutor` as on a robot, at a rate and phase of its own. The
robots are unicycles without bodies. Commands take effect at once, without protection. The odometry
of a robot is its true pose. A run in lockstep, with bodies, lidars and protection, costs about ten
times as much.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from swarmd.core.angles import wrap
from swarmd.core.errors import ConfigError
from swarmd.core.host_messages import Load, Loaded, LoadRefused, Step, Stepped
from swarmd.core.values import (
    PLACES_BY_POSE,
    Array,
    Inputs,
    Message,
    Neighbor,
    Odometry,
    Platform,
    Pose,
    Scalar,
    Scan,
    Twist,
    Value,
)
from swarmd.pattern_host.executor import PatternExecutor
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import pattern_names
from swarmd.settings.settings import load_platform
from tests.support.voting_sim import Air

Sense = Callable[[float, int, Array], Mapping[str, float]]
"""Readings from the time in s, the robot's row and the poses (n, 3)."""

See = Callable[[int, Array], Scan]
"""A scan from the robot's row and the poses (n, 3)."""

Until = Callable[[Sequence[Mapping[str, Scalar]]], bool]
"""Whether the run ends, from the reports of all robots."""

CLEAR = Air()
"""The default radio: a delay of 20 ms, without loss."""

_PROVIDES = PLACES_BY_POSE | {"neighbors"}


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """The samples of a run of n robots at T instants."""

    t: Array  # (T,) s
    pose: Array  # (T, n, 3)
    stepped: Array  # (T, n) s of the step that made the report; NaN before the first step
    reports: Sequence[Sequence[Mapping[str, Scalar]]]  # by instant, then by robot
    sent: int  # messages of all robots

    def reported(self, name: str, missing: float = math.nan) -> Array:
        """One reported number (T, n); `missing` where a robot is absent or does not report it."""
        rows = [[float(report.get(name, missing)) for report in now] for now in self.reports]
        return np.array(rows)


@dataclass(slots=True, eq=False)
class _Point:
    """A robot and its pattern."""

    name: str
    executor: PatternExecutor
    period: float
    inbox: list[tuple[float, Message]] = field(default_factory=list)
    stepped_at: float = math.nan
    report: Mapping[str, Scalar] = field(default_factory=dict)


class PointSwarm:
    """Point robots that run one pattern and start at `poses` (n, 3); equal seeds give equal runs.

    - `params`: parameters of all robots; `own`: further parameters by row.
    - `links` (n, n): the robots that hear and sense each other; None: all within `reach` m.
    - `torus`: the side in m of a square with periodic boundaries; None: an unbounded plane.
    - `hearers`: the number of linked robots, drawn at random, that receive a message, as in a well
      mixed swarm; None: all linked robots.
    - `ends`: by row the time in s at which a robot leaves.
    - `air`: delay, jitter, loss and duplication of messages.
    - `sense`, `see`: give the readings and the scan of a robot; None: the robots have none.
    """

    def __init__(
        self,
        pattern: str,
        poses: Array,
        *,
        seed: int,
        params: Mapping[str, Value] | None = None,
        own: Mapping[int, Mapping[str, Value]] | None = None,
        links: NDArray[np.bool_] | None = None,
        reach: float = math.inf,
        torus: float | None = None,
        hearers: int | None = None,
        ends: Mapping[int, float] | None = None,
        air: Air = CLEAR,
        sense: Sense | None = None,
        see: See | None = None,
    ) -> None:
        self._pattern = pattern
        self._rng = np.random.default_rng([seed, 0x706F696E])
        self._links, self._reach, self._torus, self._hearers = links, reach, torus, hearers
        self._ends, self._air, self._sense, self._see = ends or {}, air, sense, see
        count = len(poses)
        self._points = [
            _load(pattern, f"robot-{row:03}", {**(params or {}), **(own or {}).get(row, {})}, seed)
            for row in range(count)
        ]
        loader, platform = _loader_and_platform()
        self._has_bearings = any(need in _PROVIDES for need in loader(pattern).needs)
        self._linked: dict[int, list[int]] = {}  # linked rows by row, if they do not change
        limits = platform.limits
        self._limits = limits.linear, limits.angular
        self._base, self._since = np.array(poses, float), np.zeros(count)
        self._twist = np.zeros((count, 2))
        self._sent = self._scans = 0
        phases = [float(self._rng.uniform(0.0, point.period)) for point in self._points]
        self._queue = [(phase, row) for row, phase in enumerate(phases)]
        heapq.heapify(self._queue)

    def run(self, seconds: float, every: float = 0.1, until: Until | None = None) -> Track:
        """Run for `seconds`, or until `until` is true; a sample each `every` s."""
        times = np.array([every * k for k in range(round(seconds / every) + 1)])
        poses, reports, stepped = [], [], []
        for now in times.tolist():
            while self._queue[0][0] <= now:
                at, row = heapq.heappop(self._queue)
                if at >= self._ends.get(row, math.inf):
                    self._leave(row, at)
                    continue
                self._step(row, at)
                heapq.heappush(self._queue, (at + self._points[row].period, row))
            poses.append(self._poses(now))
            reports.append([point.report for point in self._points])
            stepped.append([point.stepped_at for point in self._points])
            if until is not None and until(reports[-1]):
                break
        return Track(times[: len(poses)], np.array(poses), np.array(stepped), reports, self._sent)

    def _leave(self, row: int, now: float) -> None:
        self._base[row], self._since[row] = self._poses(now)[row], now
        self._twist[row], self._points[row].report = 0.0, {}
        heapq.heappush(self._queue, (math.inf, row))

    def _poses(self, now: float) -> Array:
        """The poses (n, 3) at `now` s: each robot follows an arc since its last command."""
        if not self._twist.any():
            return self._base + 0.0  # as the sum below: no -0.0
        linear, angular = self._twist.T
        dt = now - self._since
        half = 0.5 * angular * dt
        way = linear * dt * np.sinc(half / math.pi)
        x, y, yaw = self._base.T
        x, y = x + way * np.cos(yaw + half), y + way * np.sin(yaw + half)
        return np.stack([x, y, yaw + angular * dt], axis=1)

    def _step(self, row: int, now: float) -> None:
        point, poses = self._points[row], self._poses(now)
        near = self._near(row, now, poses)
        arrived = sorted((sent for sent in point.inbox if sent[0] <= now), key=lambda sent: sent[0])
        point.inbox = [sent for sent in point.inbox if sent[0] > now]
        scan = None if self._see is None else self._see(row, poses)
        inputs = Inputs(
            now,
            0.0 if math.isnan(point.stepped_at) else now - point.stepped_at,
            scan=scan,
            is_new_scan=scan is not None,
            odometry=Odometry(now, Pose(*poses[row].tolist()), Twist(*self._twist[row].tolist())),
            neighbors=self._sensed(row, near, poses) if self._has_bearings else (),
            messages=tuple(Message(m.sender, m.channel, m.value, now - at) for at, m in arrived),
            pose=Pose(*poses[row].tolist()),
            readings={} if self._sense is None else self._sense(now, row, poses),
        )
        point.stepped_at = now
        stepped = point.executor.handle(Step(1, inputs))
        assert isinstance(stepped, Stepped), stepped
        point.report = stepped.outputs.report
        twist = stepped.outputs.twist
        self._base[row], self._since[row] = poses[row], now
        self._twist[row] = obeyed(self._pattern, twist, self._limits)
        for channel, value in stepped.outputs.messages.items():
            self._sent += 1
            self._send(Message(point.name, channel, value, 0.0), near, now)

    def _near(self, row: int, now: float, poses: Array) -> list[int]:
        """The rows of the present robots that are linked to robot `row`."""
        if row not in self._linked:
            if self._links is None:
                is_near = np.hypot(*self._off(row, poses).T) <= self._reach
            else:
                is_near = self._links[row].copy()
            is_near[row] = False
            near = np.flatnonzero(is_near).tolist()
            if self._links is None and math.isfinite(self._reach):
                return [n for n in near if now < self._ends.get(n, math.inf)]
            self._linked[row] = near
        return [n for n in self._linked[row] if now < self._ends.get(n, math.inf)]

    def _off(self, row: int, poses: Array) -> Array:
        """The positions (n, 2) of all robots relative to robot `row`, in m along x and y."""
        off = poses[:, :2] - poses[row, :2]
        if self._torus is not None:
            off -= self._torus * np.round(off / self._torus)
        return off

    def _sensed(self, row: int, near: list[int], poses: Array) -> tuple[Neighbor, ...]:
        """The robots `near` as neighbors of robot `row`, with range, bearing and heading."""
        off, yaw = self._off(row, poses)[near], poses[row, 2]
        values = zip(
            near,
            np.hypot(*off.T).tolist(),
            (np.arctan2(off[:, 1], off[:, 0]) - yaw).tolist(),
            (poses[near, 2] - yaw).tolist(),
            strict=True,
        )
        return tuple(
            Neighbor(self._points[n].name, 0.0, distance, wrap(bearing), wrap(heading))
            for n, distance, bearing, heading in values
        )

    def _send(self, message: Message, near: list[int], now: float) -> None:
        air, rng = self._air, self._rng
        if self._hearers is not None and len(near) > self._hearers:
            near = [near[i] for i in rng.choice(len(near), self._hearers, replace=False)]
        for hearer in near:
            if air.loss > 0.0 and rng.random() < air.loss:
                continue
            for _ in range(2 if air.twice > 0.0 and rng.random() < air.twice else 1):
                due = now + air.delay + air.jitter * (2.0 * rng.random() - 1.0)
                self._points[hearer].inbox.append((due, message))


def at_places(places: Sequence[tuple[float, float]] | Array) -> Array:
    """Poses (n, 3) at places (n, 2), all with yaw 0."""
    return np.column_stack([np.asarray(places, float), np.zeros(len(places))])


def obeyed(pattern: str, twist: Twist | None, limits: tuple[float, float]) -> tuple[float, float]:
    """The speed in m/s and the turn rate in rad/s that a base takes from a robot of any `pattern`.

    `studies/outcomes/still.py` replaces it for robots that never move.
    """
    linear, angular = limits
    if twist is None:
        return 0.0, 0.0
    return max(-linear, min(twist.linear, linear)), max(-angular, min(twist.angular, angular))


def _load(pattern: str, name: str, params: Mapping[str, Value], seed: int) -> _Point:
    loader, platform = _loader_and_platform()
    needs = loader(pattern).needs
    platform = replace(platform, provides=platform.provides | needs | _PROVIDES)
    executor = PatternExecutor(loader)
    loaded = executor.handle(Load(1, pattern, (("study", params),), name, platform, seed))
    if isinstance(loaded, LoadRefused):
        raise ConfigError(loaded.text)
    assert isinstance(loaded, Loaded)
    return _Point(name, executor, 1.0 / loaded.rate)


@lru_cache(maxsize=1)
def _loader_and_platform() -> tuple[PatternLoader, Platform]:
    """The patterns and the platform of all runs, cached: reading them takes longer than a run."""
    origins = pattern_names(None)
    loader = PatternLoader({name: (o.value, o.is_file) for name, o in origins.items()})
    return loader, load_platform("burger")
