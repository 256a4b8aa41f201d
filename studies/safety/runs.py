"""Runs of scenes in worker processes, each kept as a line of a file, so that work can continue."""

from __future__ import annotations

import hashlib
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from datetime import date
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from msgspec import Struct, structs

import swarmd
import swarmd.config
from studies.safety.judgement import Judgement, judge
from studies.safety.scenes import ATTACKERS, Scene, scenario
from swarmd.core.errors import ConfigError
from swarmd.protection.walls.walls_settings import MOVING_WALL
from swarmd.sim.experiments.provenance import digest_of_code, git_state
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.trace import Trace


class Task(Struct, frozen=True, order=True):
    """A run to do."""

    scene: Scene
    seed: int


class Kept(Struct, frozen=True, kw_only=True):
    """A finished run: `code` is the digest of the sources, `cpu` the processor time in s."""

    task: Any
    code: str
    cpu: float


class Record(Kept, frozen=True, kw_only=True):
    """A judged run of a scene.

    `commit`: the checkout's, with `(changed)` if tracked files differ from it.
    """

    task: Task
    date: str
    commit: str
    found: Judgement

    def __str__(self) -> str:
        found = self.found
        return (
            f"{self.task.scene.name} seed {self.task.seed}: {found.collisions} collisions,"
            f" {found.faults} at fault, {found.touch_faults} with the arena,"
            f" {found.pushed} pushed, {self.cpu:.0f} s"
        )


Line = TypeVar("Line", bound=Kept)


def fingerprint() -> str:
    """A digest of everything that decides a run's result: sources, platforms and scenes."""
    digest = hashlib.sha256(digest_of_code(Path(swarmd.__file__).parent).encode())
    digest.update(digest_of_code(Path(__file__).parent).encode())
    for path in sorted((Path(swarmd.config.__path__[0]) / "platforms").glob("*.yaml")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def commit() -> str:
    """The commit of the sources, such as `1a2b3c4 (changed)`; `unknown` without a checkout."""
    state = git_state(Path(__file__).parent)
    return "unknown" if state is None else state.commit[:7] + " (changed)" * state.is_dirty


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


def perform(task: Task, code: str, *, at: str) -> Record:
    """Simulate and evaluate, in this process; `at` is the commit."""
    begin = time.process_time()
    made = scenario(task.scene)
    trace, told = simulate(made, task.seed)
    cpu = time.process_time() - begin
    found = judge(trace, attackers(trace), made.realism.actuation)
    found = structs.replace(found, told=len(told))
    today = str(date.today())
    return Record(task=task, code=code, cpu=cpu, date=today, commit=at, found=found)


def carry_out(tasks: Sequence[Task], file: Path, jobs: int) -> list[Record]:
    """The records of all tasks, in their order, as `carry_out_missing` does."""
    for scene in dict.fromkeys(task.scene for task in tasks):
        scenario(scene)  # so that errors appear before the first run
    return carry_out_missing(tasks, partial(perform, at=commit()), Record, file, jobs)


def carry_out_missing(
    tasks: Sequence[Any],
    perform: Callable[[Any, str], Line],
    kind: type[Line],
    file: Path,
    jobs: int,
) -> list[Line]:
    """The records of all tasks, in their order; tasks with a record in `file` are not repeated.

    Only records of the same sources count. `perform(task, code)` makes the record of a task, a
    `kind`, in one of `jobs` processes. Each is written when it is finished, with a line on stderr.
    """
    code = fingerprint()
    known = {one.task: one for one in read(file, kind) if one.code == code}
    missing = [task for task in tasks if task not in known]
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("ab") as out:
        out.truncate(file.read_bytes().rfind(b"\n") + 1)  # the line that `read` leaves out
        for record in _done(missing, perform, code, jobs):
            known[record.task] = record
            out.write(msgspec.json.encode(record) + b"\n")
            out.flush()
            done = sum(task in known for task in tasks)
            print(f"{done}/{len(tasks)} {record}", file=sys.stderr, flush=True)
    return [known[task] for task in tasks]


def read(file: Path, kind: type[Line]) -> list[Line]:
    """What a file holds; ConfigError for a line that is no record.

    A last line without its end is left out: power was cut while it was written.
    """
    lines = file.read_bytes().split(b"\n")[:-1] if file.exists() else ()
    try:
        return [msgspec.json.decode(line, type=kind) for line in lines]
    except msgspec.DecodeError as error:
        raise ConfigError(f"{file}: {error}; take the line out, or remove the file") from error


def total(found: Iterable[Judgement]) -> Judgement:
    """The numbers of several runs together: sums, the worst speeds and the smallest gap."""
    some = [structs.asdict(one) for one in found]

    def merge(name: str) -> Callable[[Iterable[Any]], Any]:
        return max if name.startswith("worst") else min if name == "min_gap" else sum

    return Judgement(**{name: merge(name)(one[name] for one in some) for name in some[0]})


def _done(
    tasks: Sequence[Any], perform: Callable[[Any, str], Line], code: str, jobs: int
) -> Iterator[Line]:
    if jobs == 1:
        yield from (perform(task, code) for task in tasks)
        return
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # else two processes would want four processors
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        try:
            for future in as_completed([pool.submit(perform, task, code) for task in tasks]):
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)
