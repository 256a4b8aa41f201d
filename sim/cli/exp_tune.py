"""`swarmctl exp tune`: search values of parameters, with races over seeds."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
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
    workers,
)
from swarmd.sim.experiments.cores import MAX_PROCESSES

if TYPE_CHECKING:
    from rich.live import Live
    from rich.table import Table

    from swarmd.sim.experiments.simulate import OnProgress, Progress
    from swarmd.sim.experiments.tune import Candidate, Look, OnLook

_MAX_ROWS = 8  # candidates in the live table
_MAX_METRIC, _BORDERS = 16, 13  # characters of a metric's name, and around four columns
_MIN_VALUES = 8  # characters of the values of a candidate in one column


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
@output_option
def tune(
    scenario: str,
    metric: str,
    budget: int,
    seeds: str,
    params: tuple[str, ...],
    sets: tuple[str, ...],
    held_out: str,
    pseudo_reality: bool,
    candidates: int,
    jobs: int | None,
    timeout: float | None,
    out: Path | None,
    is_json: bool,
) -> None:
    """Search values of parameters of SCENARIO with the best mean of a metric.

    All candidates run with the same seeds. A candidate that is significantly worse gets no further
    runs. Then the best candidate is compared with the present values on held-out seeds, which the
    search has not used. The result is a scenario file with the values and their evidence, on stdout
    and in DIR/tuned.yaml.
    """
    need("mujoco", "optuna", extra="sim,plot,tune")
    from swarmd.sim.experiments import tune as tuning
    from swarmd.sim.experiments.plan import parse_seeds, parse_sets

    tuning.split_metric(metric)  # a fault of the metric must not leave an empty folder
    names = (f"{Path(scenario).stem}-tune-{n}" for n in itertools.count(1))
    folder = out or new_folder(Path("experiments"), names)

    # The search, with its progress on stderr. `on_look`: called with an interim result (a look).
    # `on_step`: called with a line before each race and each set of held-out runs.
    try:
        with signals_end(SIGTERM), live_table() as (on_look, on_step, on_progress):
            tuned = tuning.tune(
                scenario,
                metric,
                budget=budget,
                seeds=parse_seeds(seeds),
                param=params,
                set=parse_sets(sets),
                # An int is a number of seeds.
                held_out=int(held_out) if held_out.isdecimal() else parse_seeds(held_out),
                pseudo_reality=pseudo_reality,
                candidates=candidates,
                out=folder,
                runner=workers(jobs, timeout),
                on_note=lambda note: warn(f"note: {note}"),
                on_look=on_look,
                on_step=on_step,
                on_progress=on_progress,
            )
    except (KeyboardInterrupt, SystemExit):
        warn(f"finished runs are kept; to go on, give the same command with --out {folder}")
        raise

    # The result, and its pictures if matplotlib is installed.
    if is_json:
        print_json("Tuning", tuning.plain_tuning(tuned))
    else:
        click.echo(tuned.document, nl=False)
    if find_spec("matplotlib") is not None:
        from swarmd.sim.plots.tuning import draw_tuning

        draw_tuning(tuned, folder / "plots")
    warn(f"results: {folder}/ (the file: {folder / tuning.RESULT})")


@contextmanager
def live_table() -> Iterator[tuple[OnLook, Callable[[str], None], OnProgress]]:
    """Yield the callbacks `on_look`, `on_step` and `on_progress` of `tune`: progress on stderr.

    A terminal shows a table of the best candidates. Any other output gets a line for each interim
    result (`Look`), and a line for each step: a race, or a set of held-out runs.
    """
    if not sys.stderr.isatty():
        yield (
            lambda look: warn(f"{look.headline}; best: {look.leader_text}"),
            warn,
            lambda now: None,
        )
        return
    from rich.console import Console
    from rich.live import Live

    console = Console(stderr=True, no_color=not has_colour(True))
    with Live(console=console, transient=True, auto_refresh=False) as live:
        shown = _LiveTable(live)
        yield shown.show_look, shown.show_step, shown.show_progress


class _LiveTable:
    """The newest interim result on a terminal, above a line on the present step."""

    def __init__(self, live: Live) -> None:
        self._live = live
        self._newest_look: Look | None = None
        self._step_text = self._runs_text = ""

    def show_look(self, look: Look) -> None:
        self._newest_look = look
        self._draw()

    def show_step(self, text: str) -> None:
        self._step_text, self._runs_text = text, ""
        self._draw()

    def show_progress(self, now: Progress) -> None:
        # `total` counts the runs up to the next interim result.
        text = f"{now.total - now.done} runs to come"
        if text != self._runs_text:
            self._runs_text = text
            self._draw()

    def _draw(self) -> None:
        from rich.text import Text

        note = f"{self._step_text}: {self._runs_text}" if self._runs_text else self._step_text
        look, width = self._newest_look, self._live.console.width
        self._live.update(Text(note) if look is None else table(look, note, width), refresh=True)


def table(look: Look, note: str, width: int) -> Table:
    """A table of the best candidates: their values, the mean over their runs, the number of runs.

    `look`: an interim result of a tuning. `note`: text below the table. The table is at most
    `width` characters wide: a wide table if it fits, else a narrow table.
    """
    from rich.console import Console

    wide = _wide_table(look, note)
    # No line breaks in 10 000 characters, so `maximum` is the width of the whole table.
    wide_width = Console(width=10_000).measure(wide).maximum
    return wide if wide_width <= width else _narrow_table(look, note, width)


def _wide_table(look: Look, note: str) -> Table:
    """The table with a column for each parameter."""
    from rich.table import Table

    labels = _labels(look)
    wide = Table(title=look.headline, caption=note, title_justify="left", caption_justify="left")
    for head in ("candidate", *labels.values(), look.metric, "seeds"):
        wide.add_column(head, justify="right")
    for candidate in look.candidates[:_MAX_ROWS]:
        _add_row(wide, look, candidate, _cells(candidate, labels))
    return wide


def _narrow_table(look: Look, note: str, width: int) -> Table:
    """The table with one column for all values of a candidate, which are cut to fit into `width`.

    The values of the best candidate stand in full below the table.
    """
    from rich.table import Table

    labels = _labels(look)
    metric_width = min(len(look.metric), _MAX_METRIC)
    free_width = width - len("candidate") - metric_width - len("seeds") - _BORDERS
    values_width = max(free_width, _MIN_VALUES)
    caption = f"{note}\nbest: {look.leader_text}"
    narrow = Table(
        title=look.headline, caption=caption, title_justify="left", caption_justify="left"
    )
    narrow.add_column("candidate", justify="right")
    narrow.add_column("values", justify="left")
    narrow.add_column(look.metric, justify="right", width=metric_width)
    narrow.add_column("seeds", justify="right")
    for candidate in look.candidates[:_MAX_ROWS]:
        pairs = zip(labels.values(), _cells(candidate, labels), strict=True)
        text = " ".join(f"{label}={value}" for label, value in pairs if value)
        cut_text = text if len(text) <= values_width else f"{text[: values_width - 1]}…"
        _add_row(narrow, look, candidate, [cut_text])
    return narrow


def _labels(look: Look) -> dict[str, str]:
    """A short name of each parameter of the shown candidates, by its dotted key."""
    shown = look.candidates[:_MAX_ROWS]
    return short_names(list(dict.fromkeys(key for candidate in shown for key in candidate.values)))


def _cells(candidate: Candidate, keys: Iterable[str]) -> list[str]:
    """The value of each key as text; empty for a key that the candidate lacks."""
    return [_value_text(candidate.values.get(key)) for key in keys]


def _add_row(table: Table, look: Look, candidate: Candidate, values: Sequence[str]) -> None:
    """Add the row of a candidate; pale if the candidate was worse, and gets no further runs."""
    from swarmd.sim.experiments.statistics import number

    name = "present" if candidate.number == 0 else str(candidate.number)
    mean, runs = number(look.value(candidate)), str(len(candidate.losses))
    table.add_row(name, *values, mean, runs, style="dim" if candidate.is_out else "")


def short_names(keys: Sequence[str]) -> dict[str, str]:
    """A short name of each dotted key: its last words, as few as no other key ends with."""
    short = {}
    for key in keys:
        words = key.split(".")
        suffixes = (".".join(words[start:]) for start in range(len(words) - 1, -1, -1))
        other_keys = [f".{other}" for other in keys if other != key]
        short[key] = next(
            (s for s in suffixes if not any(other.endswith(f".{s}") for other in other_keys)), key
        )
    return short


def _value_text(value: object) -> str:
    """A value of a parameter as text; empty for None."""
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
