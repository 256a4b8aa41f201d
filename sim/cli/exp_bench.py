"""`swarmctl exp bench`: patterns in the tasks of the benchmark suite, in one table."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.core.errors import ConfigError
from swarmd.operator.cli import completion
from swarmd.operator.cli.options import plugin_dir_option
from swarmd.operator.cli.output import print_json, print_table, warn
from swarmd.operator.texts.values import counted
from swarmd.plugins import is_pattern_path, pattern_at, place_of_pattern
from swarmd.sim.cli.exp_runs import command_line, do_runs, exit_code, jobs_option, seeds_option
from swarmd.sim.cli.options import (
    engine,
    engine_options,
    fresh_option,
    need,
    new_folder,
    out_option,
    output_option,
    set_option,
    warn_of_few,
)

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem


def _tasks(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    from swarmd.sim.scenarios.scenariofile import task_names

    return completion.names_or_files([Path(name).name for name in task_names()], incomplete)


@click.command(epilog="Example: swarmctl exp bench doorway --seeds 20")
@click.argument("tasks", metavar="[TASK..]", nargs=-1, shell_complete=_tasks)
@click.option(
    "--pattern",
    "--mission",
    "patterns",
    multiple=True,
    metavar="NAME|FILE",
    help="A pattern or mission: a name, or your file or folder; may be repeated [the patterns of"
    " each task].",
)
@plugin_dir_option
@set_option
@seeds_option
@jobs_option
@engine_options
@fresh_option
@out_option("Folder of the results; interrupted runs in it resume [runs/bench-N].")
@click.option("--traces", is_flag=True, help="Keep traces, for `exp view` and `exp plot`.")
@output_option
@click.pass_context
def bench(
    ctx: click.Context,
    tasks: tuple[str, ...],
    patterns: tuple[str, ...],
    plugin_dir: Path | None,
    sets: tuple[str, ...],
    seeds: str,
    jobs: int | None,
    on: str | None,
    scheduler_file: Path | None,
    is_fresh: bool,
    out: Path | None,
    traces: bool,
    is_json: bool,
) -> None:
    """Run patterns in the tasks of the benchmark suite, and print one table of the results.

    TASK is a scenario benchmark/TASK of `exp list`, or the file of a scenario with the keys
    `metric` and `patterns`. Without TASK all tasks of the suite are run. The table has the median
    over the seeds and its 95 % interval. A pattern has a rank within its task only if its interval
    overlaps no other interval of the task. A pattern is not run in a task whose robots lack an
    input that the pattern needs; a line on stderr names the pattern. Before the runs, a line
    estimates the time.

    Exit code 0 if every run finished, 3 if some failed, 1 if all failed. A run in which a pattern
    raised an error counts as failed here, and its results are kept.
    """
    # 1. The plans: a sweep of the pattern for each task.
    need("mujoco")
    from swarmd.sim.cli.progress import time_span
    from swarmd.sim.experiments.benchmark import (
        HEADER,
        plan_of_task,
        row,
        standings,
        task_of,
    )
    from swarmd.sim.experiments.plan import parse_seeds, parse_sets
    from swarmd.sim.scenarios.scenariofile import TASKS, task_names

    scenarios = [t if t.endswith(".yaml") else f"{TASKS}/{t}" for t in tasks] or task_names()
    if len({Path(scenario).stem for scenario in scenarios}) < len(scenarios):
        raise ConfigError("a task is given twice, or two files have one name; keep one")
    chosen, folder_of_patterns = _patterns_and_folder(patterns, plugin_dir)
    values = parse_sets(sets)
    found = [
        plan_of_task(scenario, parse_seeds(seeds), chosen, folder_of_patterns, warn, values)
        for scenario in scenarios
    ]
    planned = [one for one in found if one is not None]
    if not planned:
        raise ConfigError("no task has a pattern to run; give --pattern NAME")

    # 2. The runs: an experiment for each task.
    folder = out or new_folder(Path("runs"), (f"bench-{n}" for n in count(1)))
    options = {
        "--pattern": patterns,
        "--plugin-dir": plugin_dir,
        "--set": sets,
        "--seeds": seeds,
        "--on": on,
        "--scheduler-file": scheduler_file,
        "--fresh": is_fresh,
        "--out": folder,
        "--traces": traces,
    }
    command = command_line(("bench", *tasks), options)
    start_time = time.monotonic()
    done = []
    with engine(jobs, None, on=on, scheduler_file=scheduler_file) as runner:
        for number, (plan, metric) in enumerate(planned, start=1):
            task = task_of(plan)
            warn(f"{number} of {len(planned)}: {task}, {counted(len(plan.variants), 'pattern')}")
            results = do_runs(
                plan,
                folder / task,
                runner,
                traces=traces,
                command=command,
                metrics=[metric],
                is_fresh=is_fresh,
            )
            done.append(results)
            for run, reason in list(results.failures.items())[:1]:
                failed = counted(len(results.failures), "run")
                warn(f"failed: {failed}; the first, {run}: {reason}")
            for run, fault in list(results.pattern_faults.items())[:1]:
                failed = counted(len(results.pattern_faults), "run")
                warn(f"{fault} of run {run}: a pattern failed in {failed} of {task}")

    # 3. The table, the number of runs, and the exit code.
    listed = [standing for results in done for standing in standings(results)]
    if is_json:
        content = {"results": [asdict(standing) for standing in listed], "folder": str(folder)}
        print_json("BenchmarkTable", content)
    else:
        print_table(HEADER, [row(standing, ".3g") for standing in listed])
    warn_of_few(standing.summary.n for standing in listed)
    runs = sum(len(plan.runs) for plan, _ in planned)
    finished = sum(len(results.runs) for results in done)
    faultless = finished - sum(len(results.pattern_faults) for results in done)
    duration = time_span(time.monotonic() - start_time)
    warn(f"{finished} of {counted(runs, 'run')} done after {duration}; results: {folder}/TASK/")
    ctx.exit(exit_code(faultless, is_complete=faultless == runs))


def _patterns_and_folder(
    patterns: Sequence[str], plugin_dir: Path | None
) -> tuple[list[str], Path | None]:
    """The patterns to run, and the folder of patterns of one's own; None without one.

    `patterns`: names, or paths. If all paths lie in one folder, it is this folder, and the patterns
    have names alone: further names may be those of files in it. `plugin_dir`: of the option, or of
    its variable, which is weaker than a path. ConfigError if there is no pattern at a path.
    """
    places = {text: pattern_at(text) for text in patterns if is_pattern_path(text)}
    folders = dict.fromkeys(place.folder for place in places.values())
    source = click.get_current_context().get_parameter_source("plugin_dir")
    if folders and source is click.core.ParameterSource.ENVIRONMENT:
        plugin_dir = None
    if plugin_dir is not None:
        for text in places:
            place_of_pattern(text, plugin_dir)  # ConfigError if it lies elsewhere
    if len(folders) > 1:  # each variant takes the folder of its own file
        return list(dict.fromkeys(patterns)), plugin_dir
    names = [places[text].name if text in places else text for text in patterns]
    return list(dict.fromkeys(names)), next(iter(folders), plugin_dir)
