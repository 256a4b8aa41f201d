"""`swarmctl exp tune`: search values of parameters, with races over seeds."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from signal import SIGTERM
from typing import TYPE_CHECKING

import click

from swarmd.cli.output import has_colour, print_json, signals_end, warn
from swarmd.sim.cli.options import (
    need,
    new_folder,
    out_option,
    output_option,
    scenarios,
    set_option,
)
from swarmd.sim.experiments.cores import MAX_PROCESSES, usable_cores

if TYPE_CHECKING:
    from rich.table import Table

    from swarmd.sim.experiments.manifest import Manifest
    from swarmd.sim.experiments.simulate import OnProgress, Progress, Runner
    from swarmd.sim.experiments.tune import Look, OnLook

_SHOWN = 8  # candidates in the live table
_MAX_METRIC, _BORDERS = 16, 13  # characters of a metric's name, and around four columns


@click.command()
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
    help="Runs of all races together, at least two for each seed of the races: 40 for 20 seeds;"
    " held-out runs are besides.",
)
@click.option(
    "--seeds", default="20", show_default=True, metavar="SEEDS", help="Seeds of the races."
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
@set_option
@click.option(
    "--mission",
    "modules",
    metavar="PATTERN,..|FILE",
    help="Search missions of these patterns instead; --param then has the bounds of conditions:"
    " timeout=5..60, nearer=0.3..1, probability=0.01..1, neighbors=1..6, reading:NAME=LO..HI. With"
    " a mission's file (.yaml), this mission with other values; --param then has dotted keys of the"
    " file [all its probabilities].",
)
@click.option(
    "--held-out",
    default="50",
    show_default=True,
    metavar="SEEDS",
    help="For the claim: this number of seeds after those of the races, or the seeds: 900-949.",
)
@click.option(
    "--pseudo-reality",
    is_flag=True,
    help="Also do the held-out runs with noise, delays and losses drawn for each seed, and tell"
    " what they change.",
)
@click.option(
    "--candidates",
    type=click.IntRange(min=2),
    default=8,
    show_default=True,
    help="New candidates of a race, at most.",
)
@click.option(
    "-j",
    "--jobs",
    type=click.IntRange(1, MAX_PROCESSES),
    help="Runs at a time; the result does not depend on it [all cores].",
)
@click.option(
    "--timeout",
    type=click.FloatRange(min=1.0),
    metavar="SECONDS",
    help="A run without progress for this time has failed [60].",
)
@out_option("Folder of the tuning; an interrupted one in it resumes [experiments/SCENARIO-tune-N].")
@click.option(
    "--scheduler", metavar="ADDRESS", help="Run on the workers of a Dask cluster: tcp://HOST:8786."
)
@output_option
def tune(
    scenario: str,
    metric: str,
    budget: int,
    seeds: str,
    params: tuple[str, ...],
    sets: tuple[str, ...],
    modules: str | None,
    held_out: str,
    pseudo_reality: bool,
    candidates: int,
    jobs: int | None,
    timeout: float | None,
    out: Path | None,
    scheduler: str | None,
    is_json: bool,
) -> None:
    """Search values of parameters of SCENARIO with the best mean of a metric.

    All candidates meet the same seeds; a candidate that is worse with confidence ends early. The
    best one is held against the present values on seeds that no race has used. Prints a scenario's
    file with the values and their evidence, which is also in DIR/tuned.yaml.
    """
    need("mujoco", "optuna", extra="sim,plot,tune")
    from swarmd.sim.experiments import tune as tuning
    from swarmd.sim.experiments.plan import parse_seeds, parse_sets
    from swarmd.sim.experiments.pool import STEP_TIMEOUT, run_jobs

    if scheduler is not None:
        need("distributed", extra="sim,plot,cluster")
    tuning.split_metric(metric)  # before there is a folder
    names = (f"{Path(scenario).stem}-tune-{n}" for n in itertools.count(1))
    folder = out or new_folder(Path("experiments"), names)
    limit = STEP_TIMEOUT if timeout is None else timeout

    @contextmanager
    def workers(manifest: Manifest) -> Iterator[tuple[Runner, Manifest]]:
        if scheduler is None:
            yield partial(run_jobs, processes=jobs or usable_cores(), timeout=limit), manifest
            return
        from swarmd.sim.experiments.cluster import connect

        with connect(scheduler, manifest, limit, warn, jobs) as cluster:
            yield cluster.run_jobs, cluster.manifest

    try:
        with signals_end(SIGTERM), live_table() as (on_look, on_step, on_progress):
            found = tuning.tune(
                scenario,
                metric,
                budget=budget,
                seeds=parse_seeds(seeds),
                param=params,
                set=parse_sets(sets),
                mission=modules.split(",") if modules else (),
                held_out=int(held_out) if held_out.isdecimal() else parse_seeds(held_out),
                pseudo_reality=pseudo_reality,
                candidates=candidates,
                out=folder,
                workers=workers,
                on_note=lambda note: warn(f"note: {note}"),
                on_look=on_look,
                on_step=on_step,
                on_progress=on_progress,
            )
    except (KeyboardInterrupt, SystemExit):
        warn(f"finished runs are kept; to go on, give the same command with --out {folder}")
        raise
    if is_json:
        print_json("Tuning", tuning.plain_tuning(found))
    else:
        click.echo(found.document, nl=False)
    if find_spec("matplotlib") is not None:
        from swarmd.sim.plots.tuning import draw_tuning

        draw_tuning(found, folder / "plots")
    warn(f"results: {folder}/ (the file: {folder / tuning.RESULT})")


@contextmanager
def live_table() -> Iterator[tuple[OnLook, Callable[[str], None], OnProgress]]:
    """The callbacks `on_look`, `on_step` and `on_progress` of `tune`, which show the progress.

    A terminal shows a table of the best candidates. Any other output gets a line for each look and
    for each step.
    """
    if not sys.stderr.isatty():

        def show_line(look: Look) -> None:
            warn(f"{look.headline}; best: {look.leader_text}")

        yield show_line, warn, lambda now: None
        return
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    console = Console(stderr=True, no_color=not has_colour(True))
    shown: list[Look] = []
    step = note = ""
    with Live(console=console, transient=True, auto_refresh=False) as live:

        def draw() -> None:
            text = f"{step}: {note}" if note else step
            found = table(shown[0], text, console.width) if shown else Text(text)
            live.update(found, refresh=True)

        def show(look: Look) -> None:
            shown[:] = [look]
            draw()

        def show_step(text: str) -> None:
            nonlocal step, note
            step, note = text, ""
            draw()

        def show_progress(now: Progress) -> None:
            nonlocal note
            # Of the runs that are there and those up to the next look.
            if (text := f"{now.total - now.done} runs to come") != note:
                note = text
                draw()

        yield show, show_step, show_progress


def table(look: Look, note: str, width: int) -> Table:
    """The best candidates: their values, the mean over their runs, and the number of runs.

    Each value has a column if all columns fit into `width` characters. Else one column has all
    values, shortened, and the values of the best candidate are below the table in full.
    """
    from rich.console import Console
    from rich.table import Table

    from swarmd.sim.experiments.statistics import number

    best = look.candidates[:_SHOWN]
    names = list(dict.fromkeys(name for one in best for name in one.values))
    labels = short_names(names)

    metric_width = min(len(look.metric), _MAX_METRIC)
    room = max(width - len("candidate") - metric_width - len("seeds") - _BORDERS, 8)

    def made(*, is_wide: bool) -> Table:
        caption = note if is_wide else f"{note}\nbest: {look.leader_text}"
        found = Table(title=look.headline, caption=caption)
        found.title_justify = found.caption_justify = "left"
        found.add_column("candidate", justify="right")
        for label in labels.values() if is_wide else ["values"]:
            found.add_column(label, justify="right" if is_wide else "left")
        found.add_column(look.metric, justify="right", width=None if is_wide else metric_width)
        found.add_column("seeds", justify="right")
        for one in best:
            state = "present" if one.number == 0 else str(one.number)
            values = [_shown(one.values.get(name)) for name in names]
            if not is_wide:
                given = zip(labels.values(), values, strict=True)
                text = " ".join(f"{label}={value}" for label, value in given if value)
                values = [text if len(text) <= room else f"{text[: room - 1]}…"]
            mean, count = number(look.value(one)), str(len(one.losses))
            found.add_row(state, *values, mean, count, style="dim" * one.is_out)
        return found

    wide = made(is_wide=True)
    needed = Console(width=10_000).measure(wide).maximum
    return wide if needed <= width else made(is_wide=False)


def short_names(keys: Sequence[str]) -> dict[str, str]:
    """Each key by its shortest end of whole words that no other key ends with."""
    found = {}
    for key in keys:
        words = key.split(".")
        ends = (".".join(words[start:]) for start in range(len(words) - 1, -1, -1))
        others = [other for other in keys if other != key]
        found[key] = next(
            (end for end in ends if not any(f".{o}".endswith(f".{end}") for o in others)), key
        )
    return found


def _shown(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else "" if value is None else str(value)
