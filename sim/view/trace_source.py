"""A recorded run on the page: the trace plays, and may be paused and set to any time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array
from swarmd.sim.trace import Trace
from swarmd.sim.world.arena import parse_arena
from swarmd.view.source import ShownArena, ShownRobot


class TraceSource:
    """See `swarmd.view.source.Source`."""

    kind = "run"

    def __init__(
        self, trace: Trace, title: str, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.swarm = title
        self.patterns: Sequence[str] = ()
        self.duration = trace.duration
        self._trace, self._clock = trace, clock
        self.robots = [
            ShownRobot(name, i, trace.platforms[i], trace.footprint(i))
            for i, name in enumerate(trace.ids)
        ]
        self.arena = shown_arena(str(trace.meta.get("arena", "")))
        self._t = trace.t - (trace.t[0] if len(trace.t) else 0.0)
        self._limits = _largest(trace)
        self._offset, self._since, self._speed = 0.0, clock(), 1.0

    @property
    def time(self) -> float:
        """Seconds into the run; it begins again after its end."""
        at = self._offset + self._speed * (self._clock() - self._since)
        return at % self.duration if self.duration and self._speed else min(at, self.duration)

    def frame(self) -> tuple[float, Array]:
        """Poses at the present time, interpolated."""
        now = self.time
        if not len(self._t):
            return now, np.zeros((0, 4))
        last = min(int(np.searchsorted(self._t, now)), len(self._t) - 1)
        first = max(last - 1, 0)
        span = self._t[last] - self._t[first]
        share = (now - self._t[first]) / span if span > 0.0 else 0.0
        poses = (1.0 - share) * self._trace.pose[first] + share * self._trace.pose[last]
        known = np.flatnonzero(np.isfinite(poses).all(axis=1))
        return now, np.column_stack((known, poses[known]))

    def rows(self) -> Mapping[str, Mapping[str, Any]]:
        """What each robot reported at the present time."""
        at, trace = self._index(), self._trace
        return {robot.name: self._row(at, i) for i, robot in enumerate(self.robots) if trace.ids}

    def scan(self, name: str) -> Array | None:
        """Traces have no scans."""
        return None

    def boxes(self) -> Sequence[tuple[Array, Sequence[float]]]:
        """The movable boxes that are in the arena."""
        trace = self._trace
        if trace.box_pose is None or trace.box_shapes is None:
            return ()
        poses = trace.box_pose[self._index()]
        shapes = zip(trace.box_shapes, poses, strict=True)
        return [(shape, pose.tolist()) for shape, pose in shapes if np.isfinite(pose).all()]

    def links(self) -> Sequence[tuple[int, int]]:
        """Traces do not tell who hears whom."""
        return ()

    def detail(self, name: str) -> Mapping[str, Any] | None:
        """The values of one robot, and its contacts until now."""
        index = self._trace.ids.index(name)
        row = self._row(self._index(), index)
        values = [["Platform", self._trace.platforms[index]]]
        values += [[key, _short(value)] for key, value in row["report"].items()]
        return {"values": values, "events": self._contacts(index)}

    def select(self, names: Sequence[str]) -> None:
        """All is known of each robot already."""

    def play(self, *, is_playing: bool, speed: float) -> None:
        """Play or pause."""
        self._offset, self._since = self.time, self._clock()
        self._speed = speed if is_playing else 0.0

    def seek(self, time: float) -> None:
        """Go to a time in s."""
        self._offset, self._since = min(max(time, 0.0), self.duration), self._clock()

    def _index(self) -> int:
        return min(int(np.searchsorted(self._t, self.time)), max(len(self._t) - 1, 0))

    def _row(self, at: int, i: int) -> dict[str, Any]:
        trace = self._trace
        report: dict[str, Any] = {
            name: float(values[at, i])
            for name, values in trace.report.items()
            if np.isfinite(values[at, i])
        }
        report |= {name: str(values[at, i]) for name, values in trace.words.items()}
        state = "running" if trace.state is None else str(trace.state[at, i])
        reason = "" if trace.reason is None else str(trace.reason[at, i])
        row: dict[str, Any] = {
            "presence": "alive",
            "state": state,
            "why": reason.replace("_", " "),
            "pattern": str(trace.meta.get("pattern", "")),
            "report": report,
            "limits": self._limits,
            "safe": trace.safe[at, i].tolist(),
            "protection": "",
            "rows": [],
        }
        if trace.requested is not None and np.isfinite(trace.requested[at, i]).all():
            row["requested"] = trace.requested[at, i].tolist()
        if trace.active is not None and state == "running":
            row["protection"] = "limits" if trace.active[at, i] else "passes"
        if trace.recovering is not None and trace.recovering[at, i]:
            row["protection"] = "recovers"
        if trace.gap is not None and np.isfinite(trace.gap[at, i]):
            row["near"] = float(trace.gap[at, i])
        if trace.bound is not None and np.isfinite(trace.bound[at, i]).all():
            row["rows"] = [trace.bound[at, i].tolist()]
        return row

    def _contacts(self, index: int) -> list[list[str]]:
        trace, now = self._trace, self.time
        found: list[list[str]] = []
        last = -1.0
        for at, (a, b) in zip(trace.contact_t, trace.contact_pair, strict=True):
            time = float(at - trace.t[0])
            if time > now or index not in (a, b):
                continue
            if time - last > 0.5:
                other = b if index == a else a
                name = trace.ids[other] if other >= 0 else "the arena"
                found.append([f"{time:.1f} s", f"touches {name}"])
            last = time
        return found[::-1][:20]


def shown_arena(text: str) -> ShownArena | None:
    """The arena of a text as `parse_arena` reads it; None if it has none."""
    try:
        arena = parse_arena(text)
    except ConfigError:
        return None
    shapes = [box.corners for _, box in arena.fixed]
    poles = [(pole.x, pole.y, pole.radius) for pole in arena.poles]
    return ShownArena((arena.length, arena.width), shapes, poles)


def _largest(trace: Trace) -> list[float]:
    """The highest commands of the run, to scale the dial."""
    both = [trace.safe] if trace.requested is None else [trace.safe, trace.requested]
    values = np.concatenate([one.reshape(-1, 3) for one in both])
    values = np.abs(values[np.isfinite(values).all(axis=1)])
    largest = np.maximum(values.max(axis=0) if len(values) else np.ones(3), 0.01)
    return [float(value) for value in largest]


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
