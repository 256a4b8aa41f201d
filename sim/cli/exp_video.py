"""`swarmctl exp video`: a film of one run."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.cli.output import warn
from swarmd.core.errors import ConfigError
from swarmd.sim.cli.options import need, out_option
from swarmd.texts.values import megabytes

if TYPE_CHECKING:
    from swarmd.sim.film.film import FilmSettings
    from swarmd.sim.view.trace_source import RecordedRun

_SIZE = re.compile(r"([0-9]+)x([0-9]+)")
_SMALLEST, _LARGEST = 160, 4096


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
    "--camera",
    type=click.Choice(["top", "perspective"]),
    default="top",
    show_default=True,
    help="From above without perspective, or from the side.",
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
    metavar="WxH",
    help="Pixels [as many as 1280x720, of .gif and .webp 480x360, in the shape of the arena].",
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
    camera: str,
    colour: str,
    speed: float,
    size: str | None,
    start: float,
    stop: float | None,
    trail: float,
) -> None:
    """Film one run of DIR: an experiment, the folder of a demo, or a trace.

    A film is made without a display. The program ffmpeg, Mesa and the extra `film` are necessary.
    """
    need_film()
    from swarmd.sim.film.film import FilmSettings, title_of
    from swarmd.sim.view.trace_source import runs_of

    settings = FilmSettings(
        camera="perspective" if camera == "perspective" else "top",  # for the type: str to Literal
        colour=colour,
        speed=speed,
        size=None if size is None else _size_of(size),
        start=start,
        stop=stop,
        trail=trail,
    )
    runs = runs_of(place, seed, variant)
    run = runs.load(runs.first)  # the run of `seed` and `variant`
    of_variant = f", {variant}" if variant else ""
    film(run, out, f"{title_of(run.trace)}{of_variant}", settings)


def need_film() -> None:
    """PluginError for the first library of the extra `film` that is missing."""
    need("mujoco", "OpenGL", "PIL", extra="sim,film")


def film(
    run: RecordedRun, out: Path, title: str, settings: FilmSettings, *, is_quiet: bool = False
) -> None:
    """Write a film of `run` to `out`, with progress on stderr, and print its name and size.

    `is_quiet`: name and size are printed on stderr, not on stdout.
    """
    from swarmd.sim.film.film import make_film

    printed_quarters = -1

    def on_progress(done: int, total: int) -> None:
        nonlocal printed_quarters
        quarters = 4 * done // total
        if quarters > printed_quarters:
            printed_quarters = quarters
            warn(f"{done} of {total} frames")

    for note in make_film(run, out, title, settings, on_progress):
        warn(f"note: {note}")
    click.echo(f"{out}: {megabytes(out.stat().st_size, 2)}", err=is_quiet)


def _size_of(text: str) -> tuple[int, int]:
    match = _SIZE.fullmatch(text)
    width, height = (int(part) for part in match.groups()) if match else (0, 0)
    is_valid = all(_SMALLEST <= side <= _LARGEST and side % 2 == 0 for side in (width, height))
    if not is_valid:
        wanted = f"even numbers from {_SMALLEST} to {_LARGEST}, such as 1280x720"
        raise ConfigError(f"--size {text}: expected {wanted}")
    return width, height
