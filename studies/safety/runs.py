"""Judged runs of scenes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from msgspec import Struct, structs

from studies import keeper
from studies.keeper import Traced, traced
from studies.safety.judgement import Judgement, judge
from studies.safety.scenes import ATTACKERS, Scene, scenario
from swarmd.robot.protection.walls.walls_settings import MOVING_WALL
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.trace import Trace


class Task(Struct, frozen=True, order=True):
    """A run to do."""

    scene: Scene
    seed: int


Record: TypeAlias = keeper.Record[Task, Judgement]
"""A judged run of a scene."""


def attackers(trace: Trace) -> frozenset[str]:
    """The ids of the attacking robots."""
    groups = trace.meta["groups"].items()
    return frozenset(robot for name, ids in groups if name.startswith(ATTACKERS) for robot in ids)


def simulate(made: Scenario, seed: int) -> tuple[Trace, list[str]]:
    """A run in this process: its trace, and the events of robots that name a wall that moved."""
    run = Lockstep(made, seed)
    run.advance(made.duration)
    told = [
        f"{event.at:8.2f} s  {run.world.ids[shell.row]}: {event.text}"
        for shell in run.shells
        if shell is not None
        for event in shell.robot.status(run.world.time).events
        if MOVING_WALL in event.text
    ]
    return run.trace(), sorted(told)


def perform(task: Task) -> Traced[Judgement]:
    """Simulate and evaluate a run, in this process."""
    made = scenario(task.scene)
    trace, told = simulate(made, task.seed)
    found = judge(trace, attackers(trace), made.realism.actuation)
    return traced(structs.replace(found, told=len(told)), trace)


def carry_out(tasks: Sequence[Task], file: Path, jobs: int) -> list[Record]:
    """The records of all tasks, in their order; those in `file` are not done again."""
    for scene in dict.fromkeys(task.scene for task in tasks):
        scenario(scene)  # so that errors appear before the first run
    return keeper.records(perform, tasks, file, jobs=jobs, told=_told)


def total(found: Iterable[Judgement]) -> Judgement:
    """The numbers of several runs together: sums, the worst speeds and the smallest gap.

    What is not known of one run is not known of all together.
    """
    some = [structs.asdict(one) for one in found]

    def merged(name: str) -> Any:
        merge: Callable[[Iterable[Any]], Any] = sum
        if name.startswith("worst"):
            merge = max
        elif name == "min_gap":
            merge = min
        values = [one[name] for one in some]
        return None if None in values else merge(values)

    return Judgement(**{name: merged(name) for name in some[0]})


def _told(record: Record) -> str:
    found = record.found
    return (
        f"{record.task.scene.name} seed {record.task.seed}: {found.collisions} collisions,"
        f" {found.faults} at fault, {found.touch_faults} with the arena,"
        f" {found.pushed} pushed, {record.cpu:.0f} s"
    )
