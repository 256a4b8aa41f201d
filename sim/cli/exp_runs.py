"""The runs of a plan, for `exp run` and `exp bench`: options, doing the runs, exit code."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from signal import SIGTERM
from typing import TYPE_CHECKING

import click

from swarmd.core.errors import SwarmError
from swarmd.operator.cli.output import signals_end, warn
from swarmd.operator.texts.values import counted
from swarmd.sim.experiments.cores import MAX_PROCESSES

if TYPE_CHECKING:
    from swarmd.sim.experiments.plan import Plan
    from swarmd.sim.experiments.results import Results
    from swarmd.sim.experiments.sequential import SequentialTest
    from swarmd.sim.experiments.simulate import Runner
    from swarmd.sim.metrics.metric import Metric

# exit codes if all runs failed, or some
FAILED = 1
PARTIAL = 3

seeds_option = click.option(
    "--seeds",
    default="20",
    show_default=True,
    metavar="SEEDS",
    help="Number of seeds from 0 on, or the seeds: 500-519, or 3,5,9.",
)
jobs_option = click.option(
    "-j",
    "--jobs",
    type=click.IntRange(1, MAX_PROCESSES),
    help="Runs at a time, each in a process of its own; results do not depend on it [all cores].",
)


def do_runs(
    plan: Plan,
    folder: Path,
    runner: Runner,
    *,
    traces: bool,
    command: list[str],
    metrics: Sequence[Metric],
    test: SequentialTest | None = None,
    is_fresh: bool = False,
) -> Results:
    """Do the runs of a plan that `folder` lacks, with progress on stderr.

    `command`: the command line that resumes them, printed after a signal. `metrics`: those to show.
    `test`: ends the runs when it is decided; None: all runs are done. `is_fresh`: no run is taken
    from the store of runs; else lines on stderr say how many were.
    Before several runs with a pattern of a file, the first second of the first run is tried.
    """
    from swarmd.sim.cli.progress import progress
    from swarmd.sim.experiments.known_runs import known_runs
    from swarmd.sim.experiments.manifest import manifest_of, plugin_folders
    from swarmd.sim.experiments.sequential import run_until
    from swarmd.sim.experiments.simulate import check_first_second, run_experiment
    from swarmd.sim.metrics.catalog import beyond_catalog

    manifest = manifest_of(
        plan,
        traces=traces,
        command=command,
        metrics=beyond_catalog(metrics),
        shown=[metric.name for metric in metrics],
    )
    known = known_runs(manifest.made_with, is_fresh=is_fresh)
    does_runs = runner if known is None else known.runner(runner)
    try:
        with signals_end(SIGTERM), progress() as on_progress:
            if plan.runs[1:] and plugin_folders(plan):
                # With known runs of its own: the trial is no run of the experiment.
                trial = known_runs(manifest.made_with, is_fresh=is_fresh)
                check_first_second(plan, runner if trial is None else trial.runner(runner))
            if test is not None:
                results = run_until(test, manifest, folder, does_runs, on_progress=on_progress)
            else:
                results = run_experiment(manifest, folder, does_runs, on_progress=on_progress)
    except (KeyboardInterrupt, SystemExit):
        _tell_how_to_resume(folder, plan, command)
        raise
    for line in [] if known is None else known.lines():
        warn(line)
    return results


def _tell_how_to_resume(folder: Path, plan: Plan, command: Sequence[str]) -> None:
    """Print how many runs are kept, and `command`; nothing if `folder` has no results so far."""
    from swarmd.sim.experiments.results import load_results

    with suppress(SwarmError):  # no results
        done = f"{len(load_results(folder).rows)} of {counted(len(plan.runs), 'run')} kept"
        warn(f"{done}; to go on: {shlex.join(command)}")


def command_line(verb: Sequence[str], options: Mapping[str, object]) -> list[str]:
    """The words of a command line of `exp`: a verb with its arguments, and options.

    `options`: the values of the options in their order: a tuple for an option that may be repeated,
    a bool for a flag, None for an option that the command line does not need.
    """
    words = ["swarmctl", "exp", *verb]
    for option, value in options.items():
        if isinstance(value, tuple):
            words += [word for part in value for word in (option, part)]
        elif isinstance(value, bool):
            words += [option] if value else []
        elif value is not None:
            words += [option, str(value)]
    return words


def exit_code(finished: int, *, is_complete: bool) -> int:
    """0 if all runs finished (`is_complete`), PARTIAL if some did, FAILED if none did."""
    return 0 if is_complete else PARTIAL if finished else FAILED
