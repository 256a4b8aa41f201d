"""`swarmctl exp tune`: search values of parameters over seeds."""

from __future__ import annotations

import itertools
import sys
from contextlib import nullcontext
from importlib.util import find_spec
from pathlib import Path
from signal import SIGTERM

import click

from swarmd.operator.cli.options import plugin_dir_option
from swarmd.operator.cli.output import print_json, signals_end, warn
from swarmd.operator.texts.values import printable
from swarmd.sim.cli.options import (
    engine,
    engine_options,
    fresh_option,
    need,
    new_folder,
    out_option,
    output_option,
    pattern_option,
    scenarios,
    set_option,
    with_pattern,
)
from swarmd.sim.cli.progress import progress
from swarmd.sim.experiments.cores import MAX_PROCESSES


@click.command(
    epilog="\b\nExample:\n"
    "  swarmctl exp tune aggregation --metric gather_time:min --param range=2..7"
)
@click.argument("scenario", shell_complete=scenarios)
@click.option(
    "--metric",
    required=True,
    metavar="M[:min|max]",
    help="What is best; a direction is needed where neither is better as such.",
)
@click.option(
    "--budget",
    type=click.IntRange(min=2),
    default=500,
    show_default=True,
    help="Runs of all batches together, at least two for each seed: 40 for 20 seeds; held-out runs"
    " are besides.",
)
@click.option(
    "--seeds", default="20", show_default=True, metavar="SEEDS", help="Seeds of the search."
)
@click.option(
    "--param",
    "params",
    multiple=True,
    metavar="KEY=LO..HI",
    help="A parameter of the scenario's pattern or a dotted key of the scenario, with its range or"
    " its values KEY=A,B,..; KEY alone takes the declared bounds. May be repeated [all parameters"
    " of the scenario's patterns].",
)
@pattern_option
@plugin_dir_option
@set_option
@click.option(
    "--held-out",
    default="50",
    show_default=True,
    metavar="SEEDS",
    help="For the claim: this number of seeds after those of the search, or the seeds: 900-949.",
)
@click.option(
    "--pseudo-reality",
    is_flag=True,
    help="Also do the held-out runs with noise, delays and losses drawn for each seed, and tell"
    " what they change.",
)
@click.option(
    "--candidates",
    type=click.IntRange(min=1),
    default=8,
    show_default=True,
    help="Candidates of a batch, at most.",
)
@click.option(
    "-j",
    "--jobs",
    type=click.IntRange(1, MAX_PROCESSES),
    help="Runs at a time; the result does not depend on it [all cores].",
)
@engine_options
@fresh_option
@click.option(
    "--timeout",
    type=click.FloatRange(min=1.0),
    metavar="SECONDS",
    help="A run without progress for this time has failed [60].",
)
@out_option("Folder of the tuning; an interrupted one in it resumes [experiments/SCENARIO-tune-N].")
@output_option
def tune(
    scenario: str,
    metric: str,
    budget: int,
    seeds: str,
    params: tuple[str, ...],
    pattern: str | None,
    plugin_dir: Path | None,
    sets: tuple[str, ...],
    held_out: str,
    pseudo_reality: bool,
    candidates: int,
    jobs: int | None,
    on: str | None,
    scheduler_file: Path | None,
    is_fresh: bool,
    timeout: float | None,
    out: Path | None,
    is_json: bool,
) -> None:
    """Search values of parameters of SCENARIO with the best mean of a metric.

    All candidates run with the same seeds. A candidate that is significantly worse than the best of
    earlier batches gets no further runs. Then the best candidate is compared with the present
    values on held-out seeds, which the search has not used. The result is a scenario file with the
    values and their evidence, on stdout and in DIR/tuned.yaml.
    """
    need("mujoco", "optuna", extra="sim,plot,tune")
    from swarmd.sim.experiments import tune as tuning
    from swarmd.sim.experiments.known_runs import known_runs
    from swarmd.sim.experiments.plan import parse_seeds, parse_sets

    tuning.split_metric(metric)  # a fault of the metric must not leave an empty folder
    values = with_pattern(scenario, parse_sets(sets), pattern=pattern, plugin_dir=plugin_dir)
    folder = out or new_folder(
        Path("experiments"), (f"{Path(scenario).stem}-tune-{n}" for n in itertools.count(1))
    )

    # The search, with its progress on stderr.
    known = known_runs(is_fresh=is_fresh)
    bar = progress() if sys.stderr.isatty() else nullcontext()
    try:
        with (
            engine(jobs, timeout, on=on, scheduler_file=scheduler_file) as runner,
            signals_end(SIGTERM),
            bar as on_progress,
        ):
            tuned = tuning.tune(
                scenario,
                metric,
                budget=budget,
                seeds=parse_seeds(seeds),
                param=params,
                set=values,
                # An int is a number of seeds.
                held_out=int(held_out) if held_out.isdecimal() else parse_seeds(held_out),
                pseudo_reality=pseudo_reality,
                candidates=candidates,
                out=folder,
                runner=runner if known is None else known.runner(runner),
                on_note=lambda note: warn(f"note: {note}"),
                # Not by click, which writes behind the bar; rich prints lines of sys.stderr above.
                on_step=lambda line: print(printable(line), file=sys.stderr),
                on_progress=on_progress,
            )
    except (KeyboardInterrupt, SystemExit):
        warn(f"finished runs are kept; to go on, give the same command with --out {folder}")
        raise

    for line in [] if known is None else known.lines():
        warn(line)

    # The result, and its picture if matplotlib is installed.
    if is_json:
        print_json("Tuning", tuning.plain_tuning(tuned))
    else:
        click.echo(tuned.document, nl=False)
    if find_spec("matplotlib") is not None:
        from swarmd.sim.plots.tuning import draw_landscape

        need("matplotlib")
        draw_landscape(tuned, folder / "plots" / "landscape.png")
    warn(f"results: {folder}/ (the file: {folder / tuning.RESULT})")
