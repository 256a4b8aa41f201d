"""`swarmctl exp video`: a film of one run."""

from __future__ import annotations

from pathlib import Path

import click

from swarmd.operator.cli.output import warn
from swarmd.operator.texts.values import megabytes
from swarmd.sim.cli.options import need, out_option


@click.command(
    "video",
    epilog="Example: swarmctl exp video runs/patrol --colour report:phase",
)
@click.argument("place", metavar="DIR", type=click.Path(exists=True, path_type=Path))
@click.option("--seed", type=click.IntRange(min=0), help="The seed of the run [the first run].")
@click.option("--variant", metavar="NAME", help="The variant of a sweep [the first].")
@out_option(
    "The film: .mp4, .gif or .webp.", "-o", is_file=True, default="run.mp4", show_default=True
)
@click.option(
    "--colour",
    default="state",
    show_default=True,
    metavar="VALUE",
    help="Colour of robots: state, pattern, platform, robot, or a value that they report;"
    " report:state where it is named as one of these.",
)
@click.option(
    "--speed",
    type=click.FloatRange(0.0, 1000.0, min_open=True),
    default=4.0,
    show_default=True,
    help="Times real time.",
)
@click.option(
    "--size",
    type=click.IntRange(160, 4096),
    help="Pixels of the longer side [1080, of .gif and .webp 480]; the arena gives the shape.",
)
@click.option("--from", "start", type=click.FloatRange(min=0.0), default=0.0, help="First s [0].")
@click.option("--to", "stop", type=click.FloatRange(min=0.0), help="Last s [the end].")
@click.option(
    "--trail",
    type=click.FloatRange(min=0.0),
    default=5.0,
    show_default=True,
    help="Seconds of the path behind each robot.",
)
def video(
    place: Path,
    seed: int | None,
    variant: str | None,
    out: Path,
    colour: str,
    speed: float,
    size: int | None,
    start: float,
    stop: float | None,
    trail: float,
) -> None:
    """Film one run of DIR: an experiment, the folder of a demo, or a trace.

    The program ffmpeg and the extra `plot` are necessary.
    """
    need("mujoco", "matplotlib")
    from swarmd.sim.film.film import FilmSettings, make_film, title_of
    from swarmd.sim.view.trace_source import runs_of

    settings = FilmSettings(
        colour=colour,
        speed=speed,
        size=size,
        start=start,
        stop=stop,
        trail=trail,
    )
    runs = runs_of(place, seed, variant)
    run = runs.load(runs.first)  # the run of `seed` and `variant`

    def on_progress(done: int, total: int) -> None:
        if 4 * done % total < 4:  # once a quarter
            warn(f"{done} of {total} frames")

    of_variant = f", {variant}" if variant else ""
    make_film(run, out, f"{title_of(run.trace)}{of_variant}", settings, on_progress)
    click.echo(f"{out}: {megabytes(out.stat().st_size, 2)}")
