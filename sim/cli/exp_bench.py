"""`swarmctl exp bench`: patterns in the tasks of the public suite, in one table."""

from __future__ import annotations

import math
import shlex
import time
from collections.abc import Sequence
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
from swarmd.texts.values import counted

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from swarmd.sim.experiments.benchmark import Table, Task, TaskEntry
    from swarmd.sim.experiments.results import Results

FAILED, PARTIAL = 1, 3  # exit codes if all runs failed, or some
_LIST = "list"


def _tasks(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    from swarmd.sim.experiments.benchmark import task_names

    return completion.names_or_files((_LIST, *task_names()), incomplete)


@click.command(epilog="Example: swarmctl exp bench doorway --seeds 20")
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
    """Run patterns in the tasks of the benchmark suite, and print one table of the results.

    TASK is a name of `exp bench list`, or a file in the format of these tasks. Without TASK all ten
    tasks are run. A cell of the table has the median over the seeds and its 95 % interval. A cell
    has a rank within its task only if its interval overlaps no other interval of the task. A
    pattern is not run in a task whose robots lack an input that the pattern needs; a line on stderr
    names the pattern. Before the runs, a line estimates the time.

    Exit code 0 if every run finished, 3 if some failed, 1 if all failed.
    """
    # 1. The tasks, the patterns, and results of other programs.
    need("mujoco")
    from swarmd.sim.cli.progress import time_span
    from swarmd.sim.experiments import benchmark
    from swarmd.sim.experiments.plan import parse_seeds

    if tasks[:1] == (_LIST,):  # the words `exp bench list`
        if len(tasks) > 1:
            raise ConfigError(f"list stands alone; leave out {tasks[1]}, or list")
        _print_tasks([benchmark.load_task(name) for name in benchmark.task_names()], is_json)
        return
    loaded = [benchmark.load_task(name) for name in tasks or benchmark.task_names()]
    task_names = [task.name for task in loaded]
    if len(set(task_names)) < len(task_names):
        raise ConfigError("a task is given twice, or two files have one name; keep one")
    pattern_names, plugin_dir = _pattern_names(patterns)
    entries, misfits = benchmark.entries_of(loaded, pattern_names, plugin_dir)
    # The values of the table, by (name of table row, task) and by seed.
    values = _values_of_files(others, loaded, {entry.pattern for entry in entries})
    chosen_seeds = None if seeds is None else parse_seeds(seeds)
    for misfit in misfits:
        warn(f"{misfit.pattern} does not fit {misfit.task}: {misfit.why}")
    if not entries:
        raise ConfigError(f"{', '.join(pattern_names)}: fits none of the tasks; see exp bench list")

    # 2. The runs: an entry is one pattern in one task. `command` resumes them in `folder`.
    folder = out or new_folder(Path("runs"), (f"bench-{n}" for n in count(1)))
    command = _command(tasks, patterns, seeds, others, folder, traces=traces)
    processes = jobs or usable_cores()
    start_time = time.monotonic()
    planned = finished = 0
    try:
        for number, entry in enumerate(entries, start=1):
            warn(f"{number} of {len(entries)}: {entry.task.name}, {entry.pattern}")
            results = _run_entry(entry, chosen_seeds, folder, processes, command, traces=traces)
            by_seed = benchmark.values_by_seed(entry, results)
            values[entry.pattern, entry.task.name] = by_seed
            planned += len(by_seed)
            finished += len(results.runs)
    except (KeyboardInterrupt, SystemExit):
        warn(f"finished runs are kept in {folder}/; to go on: {shlex.join(command)}")
        raise

    # 3. The table, the number of runs, and the exit code.
    better = {task.name: task.file.metric.better for task in loaded}
    table = benchmark.table_of(values, better)
    if is_json:
        document = benchmark.document(loaded, table, misfits)
        print_json("BenchmarkTable", {**document, "folder": str(folder)})
    else:
        _print_results(table, task_names)
    # The runs with a value, for each row and task: a failed run has NaN, and so has a run in which
    # the metric has no value.
    warn_of_few(
        sum(math.isfinite(value) for value in by_seed.values()) for by_seed in values.values()
    )
    duration = time_span(time.monotonic() - start_time)
    warn(
        f"{finished} of {counted(planned, 'run')} done after {duration};"
        f" results: {folder}/TASK/PATTERN/"
    )
    if finished < planned:
        ctx.exit(PARTIAL if finished else FAILED)


def _command(
    tasks: Sequence[str],
    patterns: Sequence[str],
    seeds: str | None,
    others: Sequence[Path],
    folder: Path,
    *,
    traces: bool,
) -> list[str]:
    """The words of the command line that resumes a benchmark in `folder`."""
    command = ["swarmctl", "exp", "bench", *tasks]
    command += [word for pattern in patterns for word in ("--pattern", pattern)]
    command += ["--seeds", seeds] if seeds else []
    command += [word for file in others for word in ("--with", str(file))]
    command += ["--out", str(folder)]
    command += ["--traces"] if traces else []
    return command


def _run_entry(
    entry: TaskEntry,
    seeds: Sequence[int] | None,
    folder: Path,
    processes: int,
    command: Sequence[str],
    *,
    traces: bool,
) -> Results:
    """Do the missing runs of an entry, a pattern in a task of the benchmark.

    Progress and the first failure are printed on stderr. `seeds` None: those of the task.
    `processes`: runs at a time. `command`: the command line that resumes the runs. `traces`: also
    keep traces.
    """
    from swarmd.sim.cli.progress import progress
    from swarmd.sim.experiments.benchmark import run_entry
    from swarmd.sim.experiments.pool import run_jobs

    runner = partial(run_jobs, processes=processes)
    with signals_end(SIGTERM), progress() as on_progress:
        results = run_entry(
            entry, seeds, folder, runner, traces=traces, command=command, on_progress=on_progress
        )
    if results.failures:
        run, reason = next(iter(results.failures.items()))
        warn(f"failed: {len(results.failures)} runs; the first, {run}: {reason}")
    return results


def _print_results(table: Table, task_names: Sequence[str]) -> None:
    """Print the cells of the table by pattern, with a column for each task that has a value."""
    from swarmd.sim.experiments.benchmark import cell_text

    columns = [name for name in task_names if any(name in cells for cells in table.values())]
    rows = [
        (row_name, *(cell_text(cells.get(name)) for name in columns))
        for row_name, cells in table.items()
    ]
    print_table(("PATTERN", *(name.upper() for name in columns)), rows)


def _pattern_names(patterns: Sequence[str]) -> tuple[list[str], Path | None]:
    """The names of patterns, and the folder of their files; None if no pattern is a file.

    `patterns`: names, or paths of .py and .yaml files. ConfigError if a file does not exist, or if
    the files lie in several folders.
    """
    files = [Path(pattern) for pattern in patterns if pattern.endswith((".py", ".yaml"))]
    for file in files:
        if not file.is_file():
            raise ConfigError(f"--pattern {file}: there is no such file; expected a pattern's file")
    folders = {file.resolve().parent for file in files}
    if len(folders) > 1:
        raise ConfigError("--pattern: the files lie in several folders; put them into one")
    names = [
        Path(pattern).stem if pattern.endswith((".py", ".yaml")) else pattern
        for pattern in patterns
    ]
    return list(dict.fromkeys(names)), folders.pop() if folders else None


def _values_of_files(
    files: Sequence[Path], loaded: Sequence[Task], patterns: set[str]
) -> dict[tuple[str, str], dict[int, float]]:
    """The results of other programs, from CSV files.

    Returns for each pair (row of the table, task) the values by seed. The column `name` of a file
    names the rows. Values of tasks that are not in `loaded` are left out. ConfigError if a row has
    the name of a pattern in `patterns`, or if two files give values for the same row and task.
    """
    from swarmd.sim.experiments.benchmark import read_results, task_names

    merged: dict[tuple[str, str], dict[int, float]] = {}
    bounds_by_task = {task.name: task.file.metric.bounds for task in loaded}
    for file in files:
        of_file = read_results(file, {*bounds_by_task, *task_names()}, bounds_by_task)
        of_tasks = {key: by_seed for key, by_seed in of_file.items() if key[1] in bounds_by_task}
        if not of_tasks:
            warn(f"{file} has no run of {', '.join(bounds_by_task)}, and no row in the table")
        for row_name, task in of_file:
            if row_name in patterns or (row_name, task) in merged:
                text = f"{file}: {row_name} is the name of another row of {task}"
                raise ConfigError(f"{text}; give it another one in the column name")
        merged |= of_tasks
    return merged


def _print_tasks(tasks: Sequence[Task], is_json: bool) -> None:
    """Print tasks of the benchmark suite, as a table or as JSON.

    The candidates of a task are the patterns that run if the user names none. The budget is the
    duration of a run.
    """
    from swarmd.sim.experiments.benchmark import SUITE

    listed: list[dict[str, Any]] = [
        {
            "name": task.name,
            "robots": task.robots,
            "duration": task.file.scenario["duration"],
            "metric": task.file.metric.name,
            "better": task.file.metric.better,
            "candidates": [candidate.pattern for candidate in task.file.candidates],
            "task": " ".join(task.file.task.split()),
        }
        for task in tasks
    ]
    if is_json:
        print_json("BenchmarkTasks", {"suite": SUITE, "tasks": listed})
        return
    rows = [
        (
            entry["name"],
            str(entry["robots"]),
            f"{entry['duration']:g} s",
            entry["metric"],
            entry["better"],
            ", ".join(entry["candidates"]),
        )
        for entry in listed
    ]
    print_table(("TASK", "ROBOTS", "BUDGET", "METRIC", "BETTER", "CANDIDATES"), rows)
