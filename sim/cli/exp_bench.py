"""`swarmctl exp bench`: patterns in the tasks of the public suite, in one table."""

from __future__ import annotations

import math
import shlex
import time
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from itertools import count
from pathlib import Path
from signal import SIGTERM
from typing import TYPE_CHECKING, Any

import click

from swarmd.cli import completion
from swarmd.cli.output import print_json, print_table, signals_end, warn
from swarmd.core.errors import ConfigError
from swarmd.sim.cli.options import need, new_folder, out_option, output_option, warn_of_few
from swarmd.sim.experiments.cores import MAX_PROCESSES, usable_cores

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from swarmd.sim.experiments.benchmark import Task, TaskEntry

FAILED, PARTIAL = 1, 3  # exit codes if all runs failed, or some
_LIST = "list"


def _tasks(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    from swarmd.sim.experiments.benchmark import task_names

    return completion.names_or_files((_LIST, *task_names()), incomplete)


@click.command()
@click.argument("tasks", metavar="[TASK..|list]", nargs=-1, shell_complete=_tasks)
@click.option(
    "--pattern",
    "--mission",
    "patterns",
    multiple=True,
    metavar="PATTERN|FILE",
    help="A pattern or mission by name, or its file (.py, .yaml); may be repeated [the candidates"
    " of each task].",
)
@click.option(
    "--seeds",
    metavar="SEEDS",
    help="Number of seeds from 0 on, or the seeds: 500-519, or 3,5,9 [as each task says: 20].",
)
@click.option(
    "-j",
    "--jobs",
    type=click.IntRange(1, MAX_PROCESSES),
    help="Runs at a time, each in a process of its own; results do not depend on it [all cores].",
)
@click.option(
    "--with",
    "others",
    multiple=True,
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE.csv",
    help="Results of another program beside ours: columns task, seed, value, and name if wanted.",
)
@out_option("Folder of the results; interrupted runs in it resume [runs/bench-N].")
@click.option("--traces", is_flag=True, help="Keep traces, for `exp view` and `exp plot`.")
@output_option
@click.pass_context
def bench(
    ctx: click.Context,
    tasks: tuple[str, ...],
    patterns: tuple[str, ...],
    seeds: str | None,
    jobs: int | None,
    others: tuple[Path, ...],
    out: Path | None,
    traces: bool,
    is_json: bool,
) -> None:
    """Run patterns in the tasks of the benchmark suite, and print one table of all.

    TASK is a name of `exp bench list`, or a file of that format; without one, all ten are run. A
    cell has the median of the seeds, its 95 % interval, and the rank within the task where that
    interval overlaps no other. A pattern whose needs the robots of a task do not meet is not run
    there; a line names the missing needs. The first line estimates the time.

    Exit code 0 if every run finished, 3 if some failed, 1 if all failed.
    """
    need("mujoco")
    from swarmd.sim.cli.progress import progress, time_span
    from swarmd.sim.experiments import benchmark
    from swarmd.sim.experiments.plan import parse_seeds
    from swarmd.sim.experiments.pool import run_jobs

    if tasks[:1] == (_LIST,):
        if len(tasks) > 1:
            raise ConfigError(f"list stands alone; leave out {tasks[1]}, or list")
        _print_tasks([benchmark.load_task(name) for name in benchmark.task_names()], is_json)
        return
    loaded = [benchmark.load_task(name) for name in tasks or benchmark.task_names()]
    known = [task.name for task in loaded]
    if len(set(known)) < len(known):
        raise ConfigError("a task is given twice, or two files have one name; keep one")
    names, plugin_dir = _named(patterns)
    entries, misfits = benchmark.entries_of(loaded, names, plugin_dir)
    values = _of_others(others, loaded, {entry.pattern for entry in entries})
    given = None if seeds is None else parse_seeds(seeds)
    for one in misfits:
        warn(f"{one.pattern} does not fit {one.task}: {one.why}")
    if not entries:
        raise ConfigError(f"{', '.join(names)}: fits none of the tasks; see exp bench list")
    folder = out or new_folder(Path("runs"), (f"bench-{n}" for n in count(1)))
    command = ["swarmctl", "exp", "bench", *tasks]
    command += [word for one in patterns for word in ("--pattern", one)]
    command += ["--seeds", seeds] if seeds else []
    command += [word for one in others for word in ("--with", str(one))]
    command += ["--out", str(folder), *(["--traces"] * traces)]
    _tell_the_time(entries, given, jobs or usable_cores())
    begin, planned, finished = time.monotonic(), 0, 0
    try:
        for number, entry in enumerate(entries, start=1):
            warn(f"{number} of {len(entries)}: {entry.task.name}, {entry.pattern}")
            with ExitStack() as stack:
                stack.enter_context(signals_end(SIGTERM))
                results = benchmark.run_entry(
                    entry,
                    given,
                    folder,
                    partial(run_jobs, processes=jobs or usable_cores()),
                    traces=traces,
                    command=command,
                    on_progress=stack.enter_context(progress()),
                )
            found = benchmark.values_by_seed(entry, results)
            values[entry.pattern, entry.task.name] = found
            planned, finished = planned + len(found), finished + len(results.runs)
            for run, reason in list(results.failures.items())[:1]:
                warn(f"failed: {len(results.failures)} runs; the first, {run}: {reason}")
    except (KeyboardInterrupt, SystemExit):
        warn(f"finished runs are kept in {folder}/; to go on: {shlex.join(command)}")
        raise
    better = {task.name: task.file.metric.better for task in loaded}
    table = benchmark.table_of(values, better)
    if is_json:
        told = benchmark.document(loaded, table, misfits)
        print_json("BenchmarkTable", {**told, "folder": str(folder)})
    else:
        shown = [name for name in known if any(name in cells for cells in table.values())]
        print_table(
            ("PATTERN", *(name.upper() for name in shown)),
            [
                (row, *(benchmark.cell_text(cells.get(name)) for name in shown))
                for row, cells in table.items()
            ],
        )
    warn_of_few(
        sum(math.isfinite(value) for value in by_seed.values()) for by_seed in values.values()
    )
    took = time_span(time.monotonic() - begin)
    warn(f"{finished} of {planned} runs are there after {took}; results: {folder}/TASK/PATTERN/")
    ctx.exit(0 if finished == planned else PARTIAL if finished else FAILED)


def _tell_the_time(
    entries: Sequence[TaskEntry], seeds: Sequence[int] | None, processes: int
) -> None:
    """Print how many runs there are, and an estimate of the time that all of them take."""
    from swarmd.sim.cli.progress import time_span
    from swarmd.sim.experiments.cost import measured_cost

    cost = measured_cost(Path("experiments"))
    seconds, runs = 0.0, 0
    for entry in entries:
        number = entry.task.file.seeds if seeds is None else len(seeds)
        duration = entry.task.file.scenario["duration"]
        of_a_run = cost.run_seconds(entry.task.name, entry.task.robots, duration)
        seconds += of_a_run * math.ceil(number / processes)
        runs += number
    text = f"{runs} runs, about {time_span(seconds)} with {processes} at a time"
    warn(f"{text}; an estimate, from {cost.basis}")


def _named(patterns: Sequence[str]) -> tuple[list[str], Path | None]:
    """Names of patterns, and the folder of those that are given by file; ConfigError for two."""
    files = [Path(one) for one in patterns if one.endswith((".py", ".yaml"))]
    for file in files:
        if not file.is_file():
            raise ConfigError(f"--pattern {file}: there is no such file; expected a pattern's file")
    folders = {file.resolve().parent for file in files}
    if len(folders) > 1:
        raise ConfigError("--pattern: the files lie in several folders; put them into one")
    names = [Path(one).stem if one.endswith((".py", ".yaml")) else one for one in patterns]
    return list(dict.fromkeys(names)), folders.pop() if folders else None


def _of_others(
    files: Sequence[Path], loaded: Sequence[Task], taken: set[str]
) -> dict[tuple[str, str], dict[int, float]]:
    """The values of CSV files by (row, task), of these tasks; ConfigError for a name twice."""
    from swarmd.sim.experiments.benchmark import read_results, task_names

    found: dict[tuple[str, str], dict[int, float]] = {}
    tasks = {task.name: task.file.metric.bounds for task in loaded}
    for file in files:
        theirs = read_results(file, {*tasks, *task_names()}, tasks)
        if not any(task in tasks for _, task in theirs):
            warn(f"{file} has no run of {', '.join(tasks)}, and no row in the table")
        for row, task in theirs:
            if row in taken or (row, task) in found:
                text = f"{file}: {row} is the name of another row of {task}"
                raise ConfigError(f"{text}; give it another one in the column name")
        found |= {key: values for key, values in theirs.items() if key[1] in tasks}
    return found


def _print_tasks(tasks: Sequence[Task], is_json: bool) -> None:
    from swarmd.sim.experiments.benchmark import SUITE

    listed: list[dict[str, Any]] = [
        {
            "name": task.name,
            "robots": task.robots,
            "duration": task.file.scenario["duration"],
            "metric": task.file.metric.name,
            "better": task.file.metric.better,
            "candidates": [one.pattern for one in task.file.candidates],
            "task": " ".join(task.file.task.split()),
        }
        for task in tasks
    ]
    if is_json:
        print_json("BenchmarkTasks", {"suite": SUITE, "tasks": listed})
        return
    rows = [
        (
            one["name"],
            str(one["robots"]),
            f"{one['duration']:g} s",
            one["metric"],
            one["better"],
            ", ".join(one["candidates"]),
        )
        for one in listed
    ]
    print_table(("TASK", "ROBOTS", "BUDGET", "METRIC", "BETTER", "CANDIDATES"), rows)
