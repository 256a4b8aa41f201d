"""The summary of a demo: numbers of the run, and its problems."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from swarmd.core.messages import State, Status
from swarmd.sim.metrics.catalog import metric_of
from swarmd.sim.trace import Trace

METRICS = (
    *("mean_distance_to_centroid_start", "mean_distance_to_centroid_end", "clusters_end"),
    *("largest_cluster", "robot_contacts", "arena_contacts", "minimum_gap", "path_length"),
    *("mean_speed", "protection_duty"),
)
"""What a summary tells of each run, by the names of the catalog."""
MIN_MOVE = 1e-3  # m or rad


@dataclass(frozen=True, slots=True)
class DoneEvent:
    """An event that was due at `at` s and done at `done_at` s; `problem` is "" without an error."""

    at: float
    done_at: float
    action: str
    robots: tuple[str, ...]
    problem: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoSummary:
    """A finished demo."""

    pattern: str
    platform: str
    robots: tuple[str, ...]
    arena: str
    layout: str
    seed: int
    # From the start of the command until all robots moved; None if some robot did not move.
    seconds_to_moving: float | None
    kernels: str  # the code that decided, as the robots reported it
    seconds: float  # simulated
    real_time_factor: float
    metrics: Mapping[str, float | None]  # by name; None without a value
    problems: tuple[str, ...]  # empty if all robots ran to the end and no two touched
    signal: int = 0  # the number of the signal that ended the run early; 0: none
    scenario: str = ""
    events: tuple[DoneEvent, ...] = ()  # those after the start

    @property
    def is_good(self) -> bool:
        """True without problems."""
        return not self.problems

    def as_json(self) -> dict[str, Any]:
        """The content of summary.json and of `-o json`."""
        return {**asdict(self), "is_good": self.is_good}

    def lines(self) -> list[tuple[str, str]]:
        """(name, value) pairs to print."""
        moving = self.seconds_to_moving
        arena = self.arena.partition(",item/")[0]  # of hundreds of items none is listed
        return [
            ("robots", f"{len(self.robots)} {self.platform}, {self.pattern}, {arena} m"),
            (
                "simulated time",
                f"{self.seconds:.1f} s, {self.real_time_factor:.2f} times real time",
            ),
            ("all moving after", "not all moved" if moving is None else f"{moving:.1f} s"),
            *(
                (name, f"{value:.3g} {metric_of(name).unit}".rstrip())
                for name, value in self.metrics.items()
                if value is not None
            ),
            ("kernels", self.kernels),
        ]


def all_moved_after(trace: Trace) -> float | None:
    """When the last robot made its first move, in s from the start; None if some did not move."""
    has_moved = (np.abs(trace.pose - trace.pose[0]) > MIN_MOVE).any(axis=2)
    if not has_moved.any(axis=0).all():
        return None
    return float(trace.t[has_moved.argmax(axis=0).max()] - trace.t[0])


def problems_of(
    robots: Iterable[str],
    idle: Mapping[str, Status],
    before: Mapping[str, Status],
    after: Mapping[str, Status],
    contacts: int,
) -> tuple[str, ...]:
    """A line for each robot that did not run to the end, and a line if robots touched each other.

    `idle`: the statuses before the request `run`, by robot. `before`: those after the request; a
    pattern may have failed until then. `after`: those at the end.
    """
    problems = [line for robot in robots if (line := _problem(robot, idle, before, after))]
    if contacts:
        problems.append(f"robots touched each other {contacts} times")
    return tuple(problems)


def _problem(
    robot: str,
    idle: Mapping[str, Status],
    before: Mapping[str, Status],
    after: Mapping[str, Status],
) -> str:
    start = before.get(robot)
    end = after.get(robot)
    if start is None or end is None:
        return f"{robot} did not answer at the {'start' if start is None else 'end'}"
    if end.instance != start.instance:
        return f"{robot} was restarted"
    has_finished = end.state is State.IDLE and end.reason == "finished"
    if end.state is not State.RUNNING and not has_finished:
        why = f" ({end.reason})" if end.reason else ""
        return f"{robot} ended {end.state}{why}{': ' + end.detail if end.detail else ''}"
    if end.health.host_restarts > idle.get(robot, start).health.host_restarts:
        return f"{robot}: its pattern failed and was started again"
    if end.generation != start.generation:
        return f"{robot} was given another request"
    return ""
