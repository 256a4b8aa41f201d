"""`swarmctl exp plot`: the pictures of an experiment, for the screen or for a paper."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import click

from swarmd.core.errors import ConfigError
from swarmd.sim.cli.options import chosen_metrics, folder_argument, need, out_option

_INCHES = {"in": 1.0, "cm": 1.0 / 2.54, "mm": 0.1 / 2.54, "pt": 1.0 / 72.27}
_NARROWEST, _WIDEST = 2.0, 20.0


@click.command("plot")
@folder_argument
@out_option("Folder of the pictures [DIR/plots; with --seeds DIR/plots/seeds-SEEDS].", "-o")
@click.option(
    "--metrics", metavar="A,B,..", help="Draw these metrics; also report:KEY and FILE.py:NAME."
)
@click.option(
    "--seeds", metavar="SEEDS", help="Draw only the runs of these seeds: 7, 500-519, or 3,5,9."
)
@click.option("--facet", metavar="KEY", help="A panel for each value of this swept key.")
@click.option(
    "--target",
    "targets",
    multiple=True,
    metavar="METRIC=VALUE",
    help="Draw a line at this value of a metric; may be repeated.",
)
@click.option(
    "--format",
    "form",
    type=click.Choice(["png", "svg", "pdf"]),
    default="png",
    show_default=True,
    help="Form of the files.",
)
@click.option(
    "--width",
    metavar="LENGTH",
    help="For a paper: pictures of this width, such as 3.5in, 89mm or 252pt, with texts of 6 to 8"
    " points and without titles.",
)
def plot(
    folder: Path,
    out: Path | None,
    metrics: str | None,
    seeds: str | None,
    facet: str | None,
    targets: tuple[str, ...],
    form: str,
    width: str | None,
) -> None:
    """Draw the experiment in DIR: trajectories, metrics by run and over time, differences."""
    need("matplotlib")
    from swarmd.sim.experiments.plan import parse_seeds
    from swarmd.sim.experiments.results import load_results
    from swarmd.sim.plots.figures import Look, draw_experiment

    if seeds and out is None:  # the pictures of all runs stay
        out = folder / "plots" / f"seeds-{seeds}"
    one_or_more = f"{seeds}-{seeds}" if seeds and seeds.isdecimal() else seeds
    chosen = None if one_or_more is None else parse_seeds(one_or_more)
    inches = None if width is None else parse_width(width)
    about = load_results(folder).asked
    names = chosen_metrics(metrics, about)
    bounds = {about(name).name: value for name, value in parse_targets(targets).items()}
    look = Look(suffix=f".{form}", width=inches, facet=facet, targets=bounds)
    for path in draw_experiment(folder, out, metrics=names, seeds=chosen, look=look):
        click.echo(str(path))


def parse_width(text: str) -> float:
    """Inches of a width such as `3.5in`, `89mm` or `252pt`; ConfigError for another text."""
    found = re.fullmatch(r"\s*([0-9]+(?:\.[0-9]+)?)\s*(in|cm|mm|pt)\s*", text)
    inches = float(found[1]) * _INCHES[found[2]] if found else 0.0
    if not _NARROWEST <= inches <= _WIDEST:
        raise ConfigError(f"--width {text!r}: expected 2in to 20in, such as 3.5in, 89mm or 252pt")
    return inches


def parse_targets(words: Sequence[str]) -> Mapping[str, float]:
    """The values of `--target METRIC=VALUE`; ConfigError for another text."""
    found = {}
    for word in words:
        name, _, value = word.rpartition("=")
        try:
            found[name] = float(value)
        except ValueError:
            name = ""
        if not name:
            raise ConfigError(f"--target {word!r}: expected such as gather_time=60")
    return found
