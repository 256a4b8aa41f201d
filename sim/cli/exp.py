"""`swarmctl exp`: run scenarios over many seeds, repeat, compare and plot them."""

from __future__ import annotations

import itertools
import shlex
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from signal import SIGTERM
from typing import TYPE_CHECKING, Any

import click

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.operator.cli.options import VerbGroup, plugin_dir_option
from swarmd.operator.cli.output import print_json, print_table, signals_end, warn
from swarmd.operator.cli.patterns import report_mission
from swarmd.operator.texts.values import counted
from swarmd.sim.cli.exp_bench import bench
from swarmd.sim.cli.exp_outcomes import RunOptions, run_outcomes
from swarmd.sim.cli.exp_referee import referee
from swarmd.sim.cli.exp_results import (
    MISSED,
    check,
    exit_if_incomplete,
    export,
    metrics_of,
    plot,
    report,
    view,
)
from swarmd.sim.cli.exp_runs import (
    PARTIAL,
    command_line,
    do_runs,
    exit_code,
    jobs_option,
    seeds_option,
)
from swarmd.sim.cli.exp_tune import tune
from swarmd.sim.cli.exp_video import video
from swarmd.sim.cli.options import (
    chosen_metrics,
    engine,
    engine_options,
    folder_argument,
    fresh_option,
    need,
    new_folder,
    out_option,
    output_option,
    pattern_option,
    scenarios,
    set_option,
    trust_option,
    warn_of_few,
    with_pattern,
)
from swarmd.sim.cli.progress import progress, time_span
from swarmd.sim.experiments.cores import MAX_PROCESSES, cores_of_a_run, usable_cores

if TYPE_CHECKING:
    from swarmd.sim.experiments.compare import Difference, Side
    from swarmd.sim.experiments.plan import Plan
    from swarmd.sim.experiments.results import Results
    from swarmd.sim.experiments.sequential import SequentialTest
    from swarmd.sim.metrics.metric import Metric

_FAILURES_SHOWN = 5


_metrics = click.option(
    "--metrics",
    metavar="A,B,..",
    help="Show only these metrics; see `swarmctl exp metrics`. Also report:KEY, what patterns"
    " report, reading:KEY, what sensors read, and FILE.py:NAME, one of your own.",
)
_timeout = click.option(
    "--timeout",
    type=click.FloatRange(min=1.0),
    metavar="SECONDS",
    help="A run without progress for this time fails, and the others continue [60].",
)


@click.group(cls=VerbGroup, epilog="Example: swarmctl exp run aggregation --seeds 10")
def exp() -> None:
    """Run scenarios over many seeds; statistics, comparisons and plots."""


@exp.command(epilog="Example: swarmctl exp run aggregation --seeds 20 --out runs/gather")
@click.argument("scenario", shell_complete=scenarios)
@seeds_option
@pattern_option
@plugin_dir_option
@set_option
@click.option(
    "--sweep",
    "sweeps",
    multiple=True,
    metavar="KEY=A,B,..",
    help="Values to run in turn; repeated, every combination of values is run.",
)
@jobs_option
@click.option(
    "--cores",
    type=click.IntRange(1, MAX_PROCESSES),
    help="Processes that share the robots of each run; results do not depend on it [1; from 100"
    " robots on, those that no other run uses].",
)
@_timeout
@out_option(
    "Folder of the results; an interrupted experiment in it resumes [experiments/SCENARIO-N]."
)
@click.option(
    "--shard", metavar="K/N", help="Run only the K-th of N parts; `exp merge` joins their folders."
)
@engine_options
@click.option("--scheduler", metavar="ADDRESS", hidden=True)  # the name of --on in 0.2.0
@fresh_option
@click.option("--no-traces", is_flag=True, help="Keep only metrics; fewer plots are possible.")
@click.option(
    "--until",
    metavar="REQUIREMENT",
    help="Run seeds in their order until it is sure whether 'METRIC >= VALUE' holds for the mean of"
    " a metric with a known range, such as 'one_cluster_at_end >= 0.9'.",
)
@click.option(
    "--alpha",
    type=click.FloatRange(0.0, 0.5, min_open=True),
    help="With --until: the probability of a wrong answer, at most [0.05].",
)
@click.option(
    "--most",
    type=click.IntRange(min=1),
    help="With --until: the number of seeds after which it stays undecided [500, or --seeds].",
)
@_metrics
@output_option
@click.pass_context
def run(
    ctx: click.Context,
    scenario: str,
    seeds: str,
    pattern: str | None,
    plugin_dir: Path | None,
    sets: tuple[str, ...],
    sweeps: tuple[str, ...],
    jobs: int | None,
    cores: int | None,
    timeout: float | None,
    out: Path | None,
    shard: str | None,
    on: str | None,
    scheduler_file: Path | None,
    scheduler: str | None,
    is_fresh: bool,
    no_traces: bool,
    until: str | None,
    alpha: float | None,
    most: int | None,
    metrics: str | None,
    is_json: bool,
) -> None:
    """Run SCENARIO, a name of `exp list` or a YAML file, once for each seed.

    With PATTERN/outcomes.yaml, or an outcomes.yaml of your own, all runs that its rows of outcomes
    need are done, and `exp check` judges the folder.

    Exit code 0 if every run finished, 3 if some failed, 1 if all failed. A run in which a pattern
    raised an error counts as failed here, and its results are kept. Before several runs with a
    pattern of a file, the first second of the first run is tried.

    With --until the exit code is also 1 if the requirement is not met. The folder then holds the
    runs up to the seed that decided, the same with any --jobs.
    """
    # 1. Libraries.
    need("mujoco")
    from swarmd.sim.experiments.outcomes import is_outcomes

    if scheduler is not None:
        warn(f"--scheduler is deprecated: give --on {scheduler}; 0.4.0 takes --scheduler away")
        if on is not None:
            raise ConfigError("--on and --scheduler both name a cluster; leave out --scheduler")
        on = scheduler

    if is_outcomes(scenario):
        options = RunOptions(
            out=out,
            jobs=jobs,
            cores=cores,
            timeout=timeout,
            on=on,
            scheduler_file=scheduler_file,
            is_fresh=is_fresh,
            no_traces=no_traces,
            is_json=is_json,
        )
        ctx.exit(run_outcomes(ctx, scenario, seeds, options))
    from swarmd.sim.experiments.plan import parse_seeds, parse_sets, parse_shard, parse_sweeps
    from swarmd.sim.experiments.requirements import Verdict
    from swarmd.sim.experiments.sequential import SequentialTest
    from swarmd.sim.experiments.simulate import plan_of
    from swarmd.sim.metrics.catalog import metric_of

    # 2. The metrics to show (None: a default choice), and the plan of all runs.
    chosen = chosen_metrics(metrics)
    test = None
    if until is not None:
        test = SequentialTest(until, alpha or 0.05, metric_of)
        if sweeps or shard is not None:
            raise ConfigError(
                "--until decides one variant in one folder: no --sweep and no --shard"
            )
        chosen = (test.metric, *(one for one in chosen or () if one.name != test.metric.name))
        if ctx.get_parameter_source("seeds") is click.core.ParameterSource.DEFAULT:
            seeds = str(most or 500)
    elif alpha is not None or most is not None:
        raise ConfigError("--alpha and --most need --until REQUIREMENT")
    swept = parse_sweeps(sweeps)
    values = with_pattern(
        scenario, parse_sets(sets), pattern=pattern, plugin_dir=plugin_dir, swept=swept
    )
    plan = plan_of(
        scenario,
        parse_seeds(seeds)[:most],
        values,
        swept,
        on_note=lambda note: warn(f"note: {note}"),
    )
    if shard is not None:
        plan = replace(plan, shard=parse_shard(shard))
        if out is None:
            raise ConfigError("--shard needs --out DIR, so that the same command resumes the part")
    is_here = on is None and scheduler_file is None
    if cores is None and plan.runs and is_here:
        cores = _spare_cores(plan, jobs)

    # 3. The command line that resumes the experiment in its folder.
    stem = Path(scenario).stem
    folder = out or new_folder(Path("experiments"), (f"{stem}-{n}" for n in itertools.count(1)))
    command = command_line(
        ("run", scenario),
        {
            "--seeds": seeds,
            "--pattern": pattern,
            "--plugin-dir": plugin_dir if values.get("plugin_dir") == str(plugin_dir) else None,
            "--set": sets,
            "--sweep": sweeps,
            "--jobs": jobs,
            "--cores": cores,
            "--shard": shard,
            "--on": on,
            "--scheduler-file": scheduler_file,
            "--fresh": is_fresh,
            "--out": folder,
            "--no-traces": no_traces,
            "--until": until,
            "--alpha": alpha,
            "--most": most,
            "--metrics": ",".join(metric.origin or metric.name for metric in chosen or ()) or None,
            "--timeout": None if timeout is None else f"{timeout:g}",
        },
    )

    # 4. The runs.
    start_time = time.monotonic()
    with engine(jobs, timeout, cores, on=on, scheduler_file=scheduler_file) as runner:
        results = do_runs(
            plan,
            folder,
            runner,
            traces=not no_traces,
            command=command,
            metrics=chosen or (),
            test=test,
            is_fresh=is_fresh,
        )

    # 5. The statistics and the exit code.
    measured = None if chosen is None else [results.about(metric.name) for metric in chosen]
    _print_results(results, measured, is_json, test)
    duration = time_span(time.monotonic() - start_time)
    warn(f"{len(results.runs)} of {counted(len(results.plan.runs), 'run')} done after {duration}")
    warn(f"results: {folder}/ (to see them: swarmctl exp plot {shlex.quote(str(folder))})")
    faultless = len(results.runs) - len(results.pattern_faults)
    if test is not None:
        warn(f"{until}: {test.verdict} after {counted(test.runs, 'run')}, alpha {test.alpha:g}")
        if test.verdict is Verdict.NOT_MET:
            ctx.exit(MISSED)
    ctx.exit(exit_code(faultless, is_complete=faultless == len(results.plan.runs)))


def _spare_cores(plan: Plan, jobs: int | None) -> int | None:
    """How many cores each run gets, so that no core is idle; None if each run gets one.

    `jobs`: the most runs at a time; None: no limit.
    """
    parallel_runs = min(len(plan.runs), jobs or MAX_PROCESSES)
    most_robots = max(run.robots for run in plan.runs)
    cores_per_run = cores_of_a_run(usable_cores(), parallel_runs, most_robots)
    return cores_per_run if cores_per_run > 1 else None


@exp.command(epilog="Example: swarmctl exp rerun runs/gather")
@folder_argument
@out_option("Folder of the new results; without it they are compared and discarded.")
@jobs_option
@engine_options
@_timeout
@trust_option
@output_option
@click.pass_context
def rerun(
    ctx: click.Context,
    folder: Path,
    out: Path | None,
    jobs: int | None,
    on: str | None,
    scheduler_file: Path | None,
    timeout: float | None,
    is_trusted: bool,
    is_json: bool,
) -> None:
    """Repeat the experiment in DIR from its manifest, and list which runs are identical.

    The results may come from another person. So a Python file of a pattern or metric runs only if
    you have run the same code before. A new file, and a file that has changed since the runs, is
    refused without --trust.

    Exit code 0 if all runs are identical to the last bit, 3 if some are, 1 if none is.
    """
    need("mujoco")
    from swarmd.sim.experiments import rerun as rerunning

    known_differences = rerunning.warnings(folder, is_trusted=is_trusted)
    for line in known_differences:
        warn(f"warning: {line}; results may differ")
    with (
        engine(jobs, timeout, on=on, scheduler_file=scheduler_file) as runner,
        signals_end(SIGTERM),
        progress() as on_progress,
    ):
        # The first difference of each run by the run's name; "" for an identical run.
        difference_by_run = rerunning.rerun(
            folder, out, on_progress=on_progress, is_trusted=is_trusted, runner=runner
        )
    if is_json:
        listed = [
            {"run": run, "identical": not difference, "why": difference}
            for run, difference in difference_by_run.items()
        ]
        print_json(
            "Rerun", {"folder": str(folder), "differences": known_differences, "runs": listed}
        )
    else:
        rows = [
            (run, f"differs: {difference}" if difference else "identical")
            for run, difference in difference_by_run.items()
        ]
        print_table(("RUN", "RESULT"), rows)
    identical_runs = [run for run, difference in difference_by_run.items() if not difference]
    is_complete = len(identical_runs) == len(difference_by_run)
    warn(f"{len(identical_runs)} of {counted(len(difference_by_run), 'run')} identical")
    if not is_complete:
        nothing = "nothing that the manifest names has changed, so something else has"
        warn(f"likely cause: {next(iter(known_differences), nothing)}")
    ctx.exit(exit_code(len(identical_runs), is_complete=is_complete))


@exp.command(epilog="Example: swarmctl exp merge runs/part-1 runs/part-2 --out runs/gather")
@click.argument(
    "folders", metavar="DIR..", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@out_option("Folder of all runs; it may hold parts that were merged before.", required=True)
@_metrics
@trust_option
@output_option
@click.pass_context
def merge(
    ctx: click.Context,
    folders: tuple[Path, ...],
    out: Path,
    metrics: str | None,
    is_trusted: bool,
    is_json: bool,
) -> None:
    """Join the folders of `exp run --shard` into one folder, as a single machine would make it.

    Missing runs are listed. Exit code 0 if no run is missing, else 3.
    """
    need("mujoco")
    from swarmd.sim.experiments import merge as merging

    results, lacking = merging.merge(folders, out, is_trusted=is_trusted)
    _print_results(results, chosen_metrics(metrics, results.asked), is_json)
    for line in lacking:
        warn(f"missing: {line}")
    warn(f"results: {out}/")
    ctx.exit(PARTIAL if lacking else 0)


@exp.command(epilog="Example: swarmctl exp compare runs/wait:wait=0 runs/wait:wait=120")
@click.argument("a")
@click.argument("b", required=False)
@_metrics
@trust_option
@output_option
def compare(a: str, b: str | None, metrics: str | None, is_trusted: bool, is_json: bool) -> None:
    """Show which metrics differ between experiments A and B: DIR, or DIR:VARIANT of a sweep.

    A metric differs if the 95 % interval of the difference of means excludes 0. The p-values are
    corrected for the number of metrics (Holm). If some runs never reach an event, such as
    gathering, the times to this event are compared by the log-rank test. Their mean is then the
    restricted mean: a run without the event within the shorter duration of A and B counts as that
    duration.

    If A is the folder of a sweep and B is left out, one table shows all variants of A. For two
    swept keys a second table shows the mean for each value and the interaction of the keys.

    Without --metrics, the metrics that were given to `exp run` are compared, if any.

    Exit code 1 if planned runs of A or B are missing.
    """
    from swarmd.sim.experiments import compare as comparing

    if b is None:
        _compare_variants(a, metrics, is_trusted=is_trusted, is_json=is_json)
        return
    side_pairs = comparing.sides(a, b, is_trusted=is_trusted)  # a side: a variant of A or of B
    # Each side holds the results of its whole experiment, so the first pair has all results.
    results_a, results_b = (side.results for side in side_pairs[0])
    chosen = metrics_of(results_a, metrics) or metrics_of(results_b, metrics)
    comparisons = [
        (left, right, comparing.compare(left, right, chosen)) for left, right in side_pairs
    ]
    if is_json:
        documents = [comparing.document(*comparison) for comparison in comparisons]
        print_json("Comparison", {"comparisons": documents})
    else:
        for left, right, differences in comparisons:
            _print_differences(left, right, differences)
    exit_if_incomplete(results_a, results_b)


@exp.command(epilog="Example: swarmctl exp show runs/spacing")
@folder_argument
@_metrics
@trust_option
@output_option
def show(folder: Path, metrics: str | None, is_trusted: bool, is_json: bool) -> None:
    """Show the statistics of the experiment in DIR, also if it is not finished."""
    from swarmd.sim.experiments.results import load_results

    results = load_results(folder, is_trusted=is_trusted)
    _print_results(results, chosen_metrics(metrics, results.asked), is_json)


@exp.command("list", epilog="Example: swarmctl exp list")
@output_option
def list_scenarios(is_json: bool) -> None:
    """List the scenarios that come with swarmd, with the tasks of the benchmark suite."""
    need("mujoco")
    from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_names, task_names

    names = (*scenario_names(), *task_names())
    listed: list[dict[str, Any]] = [
        {
            "name": name,
            "robots": len(scenario.robots),
            "duration": scenario.duration,
            "description": " ".join(scenario.description.split()),
        }
        for name, scenario in ((name, load_scenario(name)) for name in names)
    ]
    if is_json:
        print_json("Scenarios", {"scenarios": listed})
        return
    rows = [
        (entry["name"], str(entry["robots"]), f"{entry['duration']:g} s", entry["description"])
        for entry in listed
    ]
    print_table(("NAME", "ROBOTS", "DURATION", "DESCRIPTION"), rows)


@exp.command(
    "check-mission", epilog="Example: swarmctl exp check-mission survey.yaml shelter_choice"
)
@click.argument("file", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("scenario", shell_complete=scenarios)
@plugin_dir_option
@set_option
@output_option
def check_mission(
    file: Path, scenario: str, plugin_dir: Path | None, sets: tuple[str, ...], is_json: bool
) -> None:
    """Check the mission in FILE for the robots of SCENARIO: their platforms, fields and radio.

    `swarmctl mission check` does the same for one platform without a scenario. The mission may name
    installed patterns and the patterns in the scenario's plugin_dir. Exit code 2 if there is a
    fault.
    """
    need("mujoco")
    from swarmd.pattern_host.plugin_inspector import check_mission as faults_of
    from swarmd.sim.experiments.plan import parse_sets
    from swarmd.sim.scenarios.scenariofile import load_scenario

    values = with_pattern(scenario, parse_sets(sets), pattern=None, plugin_dir=plugin_dir)
    loaded = load_scenario(scenario, values, source="--set")
    # Robots with equal platform and equal equipment need one check.
    platforms = {
        (platform.name, frozenset(platform.provides)): platform
        for platform in loaded.robots.values()
    }
    faults = dict.fromkeys(
        line
        for platform in platforms.values()
        for line in faults_of(file, platform, loaded.plugin_dir)
    )
    names = ", ".join(dict.fromkeys(name for name, _ in platforms))
    report_mission(file, faults, f"{names} of {loaded.name}", is_json=is_json)


@exp.command("metrics", epilog="Example: swarmctl exp metrics")
@output_option
def list_metrics(is_json: bool) -> None:
    """List the metrics of every run, those of installed packages, and those with places."""
    from swarmd.sim.metrics.catalog import METRICS
    from swarmd.sim.metrics.own import installed_metrics
    from swarmd.sim.metrics.placed import KINDS

    keys = ("name", "unit", "better", "meaning", "source")
    known = (*METRICS.values(), *installed_metrics().values())
    listed = [{key: getattr(m, key) for key in keys} for m in known]
    listed += [
        {"name": m.usage, **{key: getattr(m, key) for key in keys[1:]}} for m in KINDS.values()
    ]
    if is_json:
        print_json("Metrics", {"metrics": listed})
        return
    print_table([*map(str.upper, keys)], [[*(v or "-" for v in m.values())] for m in listed])


@exp.command(epilog="Example: swarmctl exp measure runs/20260301-101500/run.npz")
@click.argument(
    "files", metavar="TRACE.npz..", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@_metrics
@output_option
def measure(files: tuple[Path, ...], metrics: str | None, is_json: bool) -> None:
    """Compute metrics of traces: of experiments, and of simulations in real time (`swarmctl demo`).

    A trace of a run in real time has no requested commands. Metrics that need requested commands
    have no value there.
    """
    from swarmd.sim.experiments.statistics import number
    from swarmd.sim.metrics import catalog

    chosen = chosen_metrics(metrics) or tuple(catalog.METRICS.values())
    measured = {str(file): _measured(file, chosen) for file in files}
    if is_json:
        print_json("Measurements", {"traces": measured})
        return
    rows = [
        (metric.name, metric.unit or "-", *(number(v[metric.name]) for v in measured.values()))
        for metric in chosen
    ]
    stems = [Path(file).stem.upper() for file in measured]
    heads = stems if len(set(stems)) == len(stems) else list(measured)
    print_table(("METRIC", "UNIT", *heads), rows)


def _measured(file: Path, metrics: Sequence[Metric]) -> dict[str, float | None]:
    """The value of each metric of a trace by the metric's name; None if a metric has no value.

    ConfigError if the trace lacks a report or reading that a metric needs. SwarmError if a custom
    metric fails.
    """
    from swarmd.sim.metrics import catalog
    from swarmd.sim.metrics.own import MetricError
    from swarmd.sim.trace import load_trace

    trace = load_trace(file)
    values = dict[str, float | None]()
    for metric in metrics:
        try:
            values |= catalog.measure(trace, [metric])
        except MetricError as error:
            raise SwarmError(f"{file}: metric {metric.name}: {error}") from error
        if not values[metric.name]:
            catalog.check_has_value(metric, trace)
    return values


def _print_results(
    results: Results,
    names: Sequence[Metric] | None,
    is_json: bool,
    test: SequentialTest | None = None,
) -> None:
    for run, fault in list(results.pattern_faults.items())[:1]:
        warn(
            f"{fault} of run {run}: a pattern failed in {len(results.pattern_faults)} of"
            f" {len(results.runs)} runs, see failures.json"
        )
    if is_json:
        print_json(
            "ExperimentSummary",
            {
                **results.document(names),
                "folder": str(results.folder),
                "until": test and test.document(),
            },
        )
    else:
        click.echo(results.text(names))
    warn_of_few(len(results.seeds(variant)) for variant in results.variants)
    for name, reason in list(results.failures.items())[:_FAILURES_SHOWN]:
        warn(f"failed: {name}: {reason}")
    if len(results.failures) > _FAILURES_SHOWN:
        warn(f"and others; see {results.folder}/failures.json")
    _warn_of_metrics(results, results.metrics if names is None else [m.name for m in names])


def _warn_of_metrics(results: Results, names: Sequence[str]) -> None:
    """Warn of each metric that failed in runs, with the first fault, or that no robot reports."""
    from swarmd.sim.metrics.protection import FAILED_PATTERNS

    runs = len(results.runs)
    for name in names:
        if name == FAILED_PATTERNS:  # counts what `_print_results` tells
            continue
        faults = {run: errors[name] for run, errors in results.errors.items() if name in errors}
        for run, fault in list(faults.items())[:1]:
            warn(f"metric {name} failed in {len(faults)} of {runs} runs; {run}: {fault}")
    for name, fault in results.unreported().items():
        if name in names:
            warn(fault)


def _print_differences(a: Side, b: Side, differences: Sequence[Difference]) -> None:
    from swarmd.sim.experiments.compare import DIFFERENCE_HEADER, difference_row

    is_paired = any(difference.is_paired for difference in differences)
    click.echo(f"A: {a.label}\nB: {b.label}")
    click.echo(f"{'paired by seed' if is_paired else 'independent samples'}, 95 % bootstrap;")
    click.echo("p of permutations, or of the log-rank test, with Holm's correction\n")
    print_table(DIFFERENCE_HEADER, [difference_row(difference) for difference in differences])
    differing = sum(d.differs for d in differences)
    verb = "differs" if len(differences) == 1 else "differ"
    click.echo(f"\n{differing} of {counted(len(differences), 'metric')} {verb}", nl=False)
    # Intervals of 95 %: of metrics without a true difference, 5 % still differ.
    by_chance = 0.05 * sum(d.interval is not None for d in differences)
    click.echo(f"; {by_chance:.2g} would by chance if nothing did", nl=False)
    click.echo(f"; {sum(d.holds for d in differences)} with Holm's correction\n")
    warn_of_few(max(counts) for counts in zip(*((d.n_a, d.n_b) for d in differences), strict=True))


def _compare_variants(folder: str, metrics: str | None, *, is_trusted: bool, is_json: bool) -> None:
    """Print the variants of the sweep in `folder` as one table, or as JSON.

    For two swept keys, also the mean for each value and the interaction of the keys are printed.
    ConfigError if the experiment has only one variant.
    """
    from swarmd.sim.experiments import sweep
    from swarmd.sim.experiments.results import load_results
    from swarmd.sim.report.tables import shown_metrics

    results = load_results(folder, is_trusted=is_trusted)
    if len(results.variants) < 2:
        raise ConfigError(
            f"{folder}: nothing was swept; name a second experiment, or run a --sweep"
        )
    chosen = metrics_of(results, metrics)
    listed_metrics, _ = shown_metrics(results, chosen)
    # For each metric: the mean for each value of both keys, and the interaction of the keys. Empty
    # unless exactly two keys were swept.
    factors = sweep.factors(results, listed_metrics)
    if is_json:
        document = {"variants": sweep.variants_document(results, listed_metrics)}
        print_json("Variants", {**document, "factors": [asdict(factor) for factor in factors]})
        exit_if_incomplete(results)
        return
    print_table(*sweep.variants_table(results, listed_metrics))
    click.echo(f"\n{sweep.READING}\n")
    if factors:
        print_table(
            sweep.MARGINAL_HEADER,
            [row for factor in factors for row in sweep.marginal_rows(factor)],
        )
        click.echo()
        print_table(sweep.INTERACTION_HEADER, [sweep.interaction_row(f) for f in factors])
    warn_of_few(len(results.seeds(variant)) for variant in results.variants)
    exit_if_incomplete(results)


exp.add_command(bench)
exp.add_command(check)
exp.add_command(export)
exp.add_command(referee)
exp.add_command(report)
exp.add_command(plot)
exp.add_command(tune)
exp.add_command(video)
exp.add_command(view)
