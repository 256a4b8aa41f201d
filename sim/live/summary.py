"""The summary of a demo: numbers of the run, and its problems."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from swarmd.core.messages import State, Status
from swarmd.core.values import Platform, Scalar
from swarmd.sim.metrics.aggregation import cluster_counts, distance_to_centroid, largest_cluster
from swarmd.sim.metrics.contacts import count_of
from swarmd.sim.metrics.gap import minimum_gap
from swarmd.sim.metrics.kinematics import mean_speed
from swarmd.sim.trace import Trace

LATE_SHARE = 0.2  # the last share of a run, over which the mean speed is taken


@dataclass(frozen=True, slots=True, kw_only=True)
class Numbers:
    """Numbers of a run, in m, m/s and s; `before` is the start and `after` the end of the run."""

    seconds: float  # simulated
    real_time_factor: float
    centroid_before: float  # mean distance of the robots from their centroid
    centroid_after: float
    link: float
    """Robots within this distance belong to one cluster: twice the protection threshold."""
    clusters_before: int
    clusters_after: int
    largest_cluster: int  # robots, at the end
    contacts: int  # contact episodes between robots
    arena_contacts: int  # contact episodes with walls and obstacles
    minimum_gap: float | None  # None for a single robot
    mean_speed_late: float
    protection_duty: float | None
    """The share of decisions in which protection changed the requested command; None if unknown."""


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
    late: tuple[str, ...] = ()  # robots that started only when they were asked again
    arena: str
    layout: str
    seed: int
    # From the start of the command until all robots moved; None if some robot did not move.
    seconds_to_moving: float | None
    kernels: str  # the code that decided, as the robots reported it
    numbers: Numbers
    problems: tuple[str, ...]  # empty if all robots ran to the end and no two touched
    signal: int = 0  # the number of the signal that ended the run early; 0: none
    scenario: str = ""
    events: tuple[DoneEvent, ...] = ()  # those after the start
    reports: Mapping[str, Mapping[str, Scalar]] = field(default_factory=dict)  # the last, by robot
    readings: Mapping[str, Mapping[str, Scalar]] = field(default_factory=dict)  # the last, by robot

    @property
    def is_good(self) -> bool:
        """True without problems."""
        return not self.problems

    def as_json(self) -> dict[str, Any]:
        """The content of summary.json and of `-o json`."""
        return {**asdict(self), "is_good": self.is_good}

    def lines(self) -> list[tuple[str, str]]:
        """(name, value) pairs to print."""
        n = self.numbers
        moving, duty = self.seconds_to_moving, n.protection_duty
        arena = self.arena.partition(",item/")[0]  # of hundreds of items none is listed
        return [
            ("robots", f"{len(self.robots)} {self.platform}, {self.pattern}, {arena} m"),
            ("simulated time", f"{n.seconds:.1f} s, {n.real_time_factor:.2f} times real time"),
            ("all moving after", "not all moved" if moving is None else f"{moving:.1f} s"),
            *([("started late", ", ".join(self.late))] if self.late else []),
            ("distance to centroid", f"{n.centroid_before:.2f} m -> {n.centroid_after:.2f} m"),
            ("clusters", f"{n.clusters_before} -> {n.clusters_after}"),
            ("largest cluster", f"{n.largest_cluster} of {len(self.robots)}"),
            ("contacts", f"{n.contacts} between robots, {n.arena_contacts} with walls"),
            ("minimum gap", "-" if n.minimum_gap is None else f"{n.minimum_gap:.2f} m"),
            ("speed at the end", f"{n.mean_speed_late:.3f} m/s"),
            *_spread("reported", self.reports),
            *_spread("reading", self.readings),
            ("kernels", self.kernels),
            ("protection active", "-" if duty is None else f"{100 * duty:.0f} % of decisions"),
        ]


def _spread(what: str, values: Mapping[str, Mapping[str, Scalar]]) -> list[tuple[str, str]]:
    """A line for each name: the mean and the range of the numbers of all robots."""
    numbers: dict[str, list[float]] = {}
    for of_robot in values.values():
        for name, value in of_robot.items():
            if isinstance(value, int | float):
                numbers.setdefault(name, []).append(float(value))
    return [
        (
            f"{what} {name}",
            f"{sum(of_all) / len(of_all):.3g} ({min(of_all):.3g} to {max(of_all):.3g})",
        )
        for name, of_all in sorted(numbers.items())
    ]


def numbers_of(
    trace: Trace, platforms: Mapping[str, Platform], duty: float | None, real_time_factor: float
) -> Numbers:
    """The numbers of a trace; `platforms` by name, `duty` as the robots reported it."""
    kinds = (platforms[name] for name in set(trace.platforms))
    link = 2.0 * max(float(kind.protection.get("threshold", 0.5)) for kind in kinds)
    away = distance_to_centroid(trace)
    counts = cluster_counts(trace, link)
    gap = minimum_gap(trace)
    return Numbers(
        seconds=trace.duration,
        real_time_factor=real_time_factor,
        centroid_before=float(away[0]),
        centroid_after=float(away[-1]),
        link=link,
        clusters_before=int(counts[0]),
        clusters_after=int(counts[-1]),
        largest_cluster=int(largest_cluster(trace, link)[-1]),
        contacts=count_of(trace, "robot"),
        arena_contacts=count_of(trace, "arena"),
        minimum_gap=gap if math.isfinite(gap) else None,
        mean_speed_late=mean_speed(trace, (1.0 - LATE_SHARE) * trace.duration) or 0.0,
        protection_duty=duty,
    )


def mean_duty(statuses: Mapping[str, Status]) -> float | None:
    """The share of all decisions since `run` in which protection was active; None without any."""
    decisions = sum(s.decision.decisions for s in statuses.values())
    if not decisions:
        return None
    return sum(s.decision.duty * s.decision.decisions for s in statuses.values()) / decisions


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
    start, end = before.get(robot), after.get(robot)
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
