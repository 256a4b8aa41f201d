"""`swarmctl exp report`: one HTML file of an experiment or a recording."""

from __future__ import annotations

from pathlib import Path

import click

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.cli.options import chosen_metrics, need
from swarmd.texts.values import megabytes


@click.command()
@click.argument("place", metavar="DIR|FILE.mcap", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="The report [DIR/report.html, or FILE.html].",
)
@click.option("--metrics", metavar="A,B,..", help="Show these metrics first, and draw them.")
@click.option("--seed", type=click.IntRange(min=0), help="The run to play [a typical one].")
@click.option("--variant", metavar="NAME", help="Of a sweep, the variant of the run to play.")
def report(
    place: Path, out: Path | None, metrics: str | None, seed: int | None, variant: str | None
) -> None:
    """Write the experiment in DIR as one HTML file: results, figures, a run to play, the manifest.

    Of a recording, one robot's or that of `record merge`: states, gaps, stops, paths by odometry.
    The file needs no network and no other file, and prints well.
    """
    need("mujoco", "matplotlib")
    from swarmd.sim.experiments.manifest import NAME, write_whole

    is_recording = place.suffix == ".mcap"
    path = out or (place.with_suffix(".html") if is_recording else place / "report.html")
    if path.suffix != ".html" or not path.parent.is_dir():
        raise ConfigError(f"{path}: expected a name that ends in .html, in a folder that exists")
    if is_recording:
        if any(one is not None for one in (metrics, seed, variant)):
            raise ConfigError(f"{place}: --metrics, --seed and --variant are for experiments")
        need("mcap", "rosbags", extra="sim,plot,record")
        from swarmd.sim.report.recording_report import recording_report

        text = recording_report(place)
    else:
        if place.is_dir() and next(place.rglob("*.mcap"), None) and not (place / NAME).exists():
            raise ConfigError(
                f"{place}: a folder of recordings; expected an experiment or one file, such as"
                f" that of: swarmctl record merge {place} -o {place.name}.mcap"
            )
        from swarmd.sim.experiments.results import load_results
        from swarmd.sim.report.html import report_of

        text = report_of(place, chosen_metrics(metrics, load_results(place).asked), seed, variant)
    try:
        write_whole(path, text)
    except OSError as error:
        raise SwarmError(f"{path}: cannot be written: {error.strerror or error}") from error
    click.echo(f"{path}: {megabytes(path.stat().st_size, 2)}")
