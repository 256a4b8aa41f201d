"""`swarmctl exp report`: one HTML file of an experiment."""

from __future__ import annotations

from pathlib import Path

import click

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.cli.options import chosen_metrics, need


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="The report [DIR/report.html].",
)
@click.option("--metrics", metavar="A,B,..", help="Show these metrics first, and draw them.")
@click.option("--seed", type=click.IntRange(min=0), help="The run to play [a typical one].")
@click.option("--variant", metavar="NAME", help="Of a sweep, the variant of the run to play.")
def report(
    folder: Path, out: Path | None, metrics: str | None, seed: int | None, variant: str | None
) -> None:
    """Write the experiment in DIR as one HTML file: results, figures, a run to play, the manifest.

    The file needs no network and no other file, and prints well.
    """
    need("mujoco", "matplotlib")
    from swarmd.sim.experiments.manifest import write_whole
    from swarmd.sim.experiments.results import load_results
    from swarmd.sim.report.html import report_of

    path = folder / "report.html" if out is None else out
    if path.suffix != ".html" or not path.parent.is_dir():
        raise ConfigError(f"{path}: expected a name that ends in .html, in a folder that exists")
    chosen = chosen_metrics(metrics, load_results(folder).asked)
    text = report_of(folder, chosen, seed, variant)
    try:
        write_whole(path, text)
    except OSError as error:
        raise SwarmError(f"{path}: cannot be written: {error.strerror or error}") from error
    click.echo(f"{path}: {path.stat().st_size / 1e6:.2f} MB")
