"""How much of their time robots of ordinary runs stand that nothing but protection holds.

A window of WINDOW s of a robot counts as held if the robot asks for motion all the time, does not
move, touches nothing, and has free floor: its outline could move WAY m straight ahead or straight
back without touching anything, by the true poses.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from benchmarks.table import markdown
from studies import keeper
from studies.keeper import Traced, traced
from studies.safety.driven import faults
from studies.safety.judge import collisions
from swarmd.core.values import Array
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.metrics.window import arena_of, tall_boxes
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.trace import Trace
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.geometry import gaps, transform

FIRST_SEED = 14_000
WINDOW = 10.0
STANDS = 0.02
"""m: a robot that stays within this distance of its place in a window stands."""
WAY = 0.3
"""m of free floor ahead or back."""
ASKS = 0.95
"""The share of the instants of a window in which a robot must ask for motion."""
MODES = ("platform", "off", "still")
"""Protection as in the platform's file; the controls: protection `off`, and robots that ask for no
motion."""

_STEPS = 3  # places along WAY that must be free
_ROUNDING = 1e-6


class Swarm(Struct, frozen=True):
    """A swarm of one platform: what it runs, where, and for how many s."""

    platform: str
    count: int
    pattern: str
    side: float
    duration: float
    visibility: str
    start: dict[str, Any]


_ANYWHERE = {"layout": "random", "clearance": 0.3}
SWARMS: Mapping[str, Swarm] = {
    "nine TurtleBots 4, 5 x 5 m": Swarm(
        "turtlebot4", 9, "random_walk", 5.0, 240.0, "real", _ANYWHERE
    ),
    "ten Waffle Pis, 5 x 5 m": Swarm("waffle_pi", 10, "random_walk", 5.0, 240.0, "real", _ANYWHERE),
    "`swarmctl demo`: seven Waffle Pis gather": Swarm(
        "waffle_pi", 7, "attraction", 6.3, 60.0, "body", {"layout": "random", "clearance": 0.3}
    ),
}


class Run(Struct, frozen=True, order=True):
    """A run to do: one of SWARMS in one of MODES."""

    swarm: str
    mode: str
    seed: int


class Found(Struct, frozen=True, kw_only=True):
    """What a run gave: windows of all robots, how many were held, and the longest in a row in s."""

    windows: int
    held: int
    longest: float
    touches: int
    faults: int


Record: TypeAlias = keeper.Record[Run, Found]
"""A finished run."""


def scenario_for(run: Run) -> Scenario:
    """The scenario of a run."""
    swarm = SWARMS[run.swarm]
    platforms = {}
    if run.mode == "off":
        platforms = {
            swarm.platform: {"extends": swarm.platform, "protection": {"mode": "off"}},
        }
    runs: dict[str, Any] = {"pattern": swarm.pattern}
    if run.mode == "still":
        runs = {"pattern": "drive", "parameters": {"speed": 0.0}}
    return scenario_of(
        {
            "name": "held",
            "duration": swarm.duration,
            "trace_rate": 20.0,
            "lidar_visibility": swarm.visibility,
            "realism": "realistic",
            "arena": {"size": [swarm.side, swarm.side]},
            "platforms": platforms,
            "groups": {"robots": {"platform": swarm.platform, "count": swarm.count, **runs}},
            "start": swarm.start,
        }
    )


def measure(trace: Trace) -> Found:
    """The windows of a trace."""
    held = held_windows(trace)
    longest = run = np.zeros(held.shape[1])
    for row in held:
        run = np.where(row, run + WINDOW, 0.0)
        longest = np.maximum(longest, run)
    return Found(
        windows=held.size,
        held=int(held.sum()),
        longest=float(longest.max(initial=0.0)),
        touches=len(collisions(trace)),
        faults=len(list(faults(trace))),
    )


def held_windows(trace: Trace) -> NDArray[np.bool_]:
    """(windows, robots) whether each robot is held in each window.

    ValueError for a trace without the requested commands or the arena.
    """
    rows = list(_held(trace))
    return np.array(rows, dtype=np.bool_).reshape(-1, len(trace.ids))


def _held(trace: Trace) -> Iterator[list[bool]]:
    """Of each window: whether each robot is held in it."""
    arena = arena_of(trace)
    if trace.requested is None or arena is None:
        raise ValueError("a trace without requested commands or arena; wanted: one of lockstep")
    room = 0.5 * np.array((arena.length, arena.width))
    asks = np.abs(trace.requested).max(axis=2) > 0.0
    starts = np.arange(trace.t[0], trace.t[-1] - WINDOW + _ROUNDING, WINDOW)
    for start in starts.tolist():
        is_in = (trace.t >= start - _ROUNDING) & (trace.t <= start + WINDOW + _ROUNDING)
        touching = (trace.contact_t >= start) & (trace.contact_t <= start + WINDOW)
        touched = set(trace.contact_pair[touching].ravel().tolist())
        pose = trace.pose[is_in]
        off = np.hypot(*np.moveaxis(pose[:, :, :2] - pose[0, :, :2], -1, 0)).max(axis=0)
        wants = asks[is_in].mean(axis=0) >= ASKS
        outlines = [transform(trace.footprint(row), pose[0, row]) for row in range(len(trace.ids))]
        outlines += _obstacles(trace, arena, int(np.argmax(is_in)))
        yield [
            bool(off[row] < STANDS)
            and bool(wants[row])
            and row not in touched
            and _has_floor(pose[0], row, outlines, room)
            for row in range(len(trace.ids))
        ]


def _obstacles(trace: Trace, arena: Arena, instant: int) -> list[Array]:
    """The outlines of boxes, inner walls and poles that are in the arena at an instant."""
    found = [box.corners for _, box in arena.fixed] + [pole.corners for pole in arena.poles]
    movable = tall_boxes(trace)
    if movable is not None:
        poses = movable[1][instant]
        found += [transform(shape, pose) for shape, pose in zip(movable[0], poses, strict=True)]
    return [outline for outline in found if np.isfinite(outline).all()]


def _has_floor(pose: Array, row: int, outlines: Sequence[Array], room: Array) -> bool:
    """Whether robot `row` of the poses (n, 3) could move WAY m ahead or back.

    `outlines`: of all robots, then of obstacles. `room`: (2,) m, half of the sides of the arena.
    """
    own = outlines[row]
    others = [outline for number, outline in enumerate(outlines) if number != row]
    ahead = np.array((math.cos(pose[row, 2]), math.sin(pose[row, 2])))

    def is_free(way: float) -> bool:
        outline = own + way * ahead
        is_inside = bool((np.abs(outline).max(axis=0) < room).all())
        return is_inside and all(float(gaps(outline, other)) > 0.0 for other in others)

    parts = np.linspace(1.0 / _STEPS, 1.0, _STEPS).tolist()
    return any(all(is_free(way * part) for part in parts) for way in (WAY, -WAY))


def perform(run: Run) -> Traced[Found]:
    """Simulate and measure a run, in this process."""
    trace = simulate_run(scenario_for(run), run.seed)
    return traced(measure(trace), trace)


def carry_out(modes: Sequence[str], seeds: int, jobs: int, file: Path) -> list[Record]:
    """The runs of all swarms that are not in `file` yet; a control has one seed."""
    runs = [
        Run(swarm, mode, FIRST_SEED + number)
        for swarm in SWARMS
        for mode in modes
        for number in range(seeds if mode == "platform" else 1)
    ]
    return keeper.records(perform, runs, file, jobs=jobs, told=_told)


def _told(record: Record) -> str:
    task = record.task
    return f"{task.swarm} {task.mode} {task.seed}: {record.found.held} held"


def table(records: Sequence[Record]) -> str:
    """Markdown: a row for each swarm and mode."""
    groups: dict[tuple[str, str], list[Found]] = {}
    for one in records:
        groups.setdefault((one.task.swarm, one.task.mode), []).append(one.found)
    rows = [
        ["robots", "protection", "runs", "robot-hours", "held", "longest", "touches", "at fault"]
    ]
    words = {"platform": "as the platform says", "off": "**off**", "still": "asks for no motion"}
    for (swarm, mode), some in groups.items():
        windows = sum(one.windows for one in some)
        share = sum(one.held for one in some) / windows
        rows.append(
            [
                *(swarm, words[mode], str(len(some)), f"{windows * WINDOW / 3600.0:.2f}"),
                *(f"{share:.1%}", f"{max(one.longest for one in some):.0f} s"),
                *(str(sum(one.touches for one in some)), str(sum(one.faults for one in some))),
            ]
        )
    return markdown(rows)
