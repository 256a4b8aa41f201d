"""A film of one run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from swarmd.core.errors import ConfigError
from swarmd.sim.film.caption import Caption
from swarmd.sim.film.colours import colouring_of
from swarmd.sim.film.encode import Encoder, check_output
from swarmd.sim.film.renderer import Camera, Renderer
from swarmd.sim.film.stage import stage_of
from swarmd.sim.plots.scene import check_drawable
from swarmd.sim.trace import Trace
from swarmd.sim.view.trace_source import RecordedRun

RATES = {".mp4": 25, ".gif": 12, ".webp": 12}
"""Frames per s by suffix."""
SIZES = {".mp4": (1280, 720), ".gif": (480, 360), ".webp": (480, 360)}
"""Width and height in pixels by suffix."""
_HOLD = 1.0  # s for which the last frame stays


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmSettings:
    """`speed` times real time; `size` in pixels (None: by the file's suffix).

    `start` and `stop` in s from the begin of the run (None: its end). `trail`: s of the path behind
    each robot.
    """

    camera: Camera = "top"
    colour: str = "state"
    speed: float = 4.0
    size: tuple[int, int] | None = None
    start: float = 0.0
    stop: float | None = None
    trail: float = 5.0


def title_of(trace: Trace) -> str:
    """What a run was, in a few words."""
    meta = trace.meta
    if "scenario" in meta:
        return f"{meta['scenario']}, seed {meta.get('seed', 0)}"
    kinds = ", ".join(dict.fromkeys(trace.platforms))
    return f"{meta.get('pattern', '')} {len(trace.ids)} {kinds}".strip()


def make_film(
    run: RecordedRun,
    path: Path,
    title: str,
    settings: FilmSettings,
    on_progress: Callable[[int, int], None] = lambda done, of: None,
) -> list[str]:
    """Write the film of a run to `path`; notes on what is not as it was.

    The file appears whole or not at all. ConfigError for wrong settings, PluginError if ffmpeg or
    OpenGL is missing, SwarmError if the trace is empty or the film cannot be written.
    """
    check_output(path)
    trace = run.trace
    check_drawable(trace)
    size, rate = settings.size or SIZES[path.suffix], RATES[path.suffix]
    stop = trace.duration if settings.stop is None else min(settings.stop, trace.duration)
    if stop <= settings.start:
        text = f"from {settings.start:g} s to {stop:g} s of a run of {trace.duration:g} s"
        raise ConfigError(f"a film {text} has no frame; choose an earlier start")
    colouring = colouring_of(trace, settings.colour)
    notes = [f"{settings.speed:.3g}x real time"]
    width, height = size
    bare = Caption(size, title, colouring.key)  # for its height
    stage = stage_of(trace, (width, height - bare.height), run.platforms)
    with Renderer(trace, stage, colouring, settings.camera) as renderer:
        if stage.factor > 1.05:
            notes.append(f"robots enlarged {stage.factor:.1f}x")
        caption = Caption(size, title, colouring.key, notes)
        count = max(round((stop - settings.start) * rate / settings.speed), 1)
        with Encoder(path, size, rate) as encoder:
            for number in range(count):
                time = settings.start + (number + 1) * (stop - settings.start) / count
                picture = renderer.frame(time, settings.trail)
                frame = caption.below(picture, f"{time:.1f} s")
                encoder.write(frame)
                on_progress(number + 1, count)
            for _ in range(round(_HOLD * rate)):
                encoder.write(frame)
    assumed = stage.assumed
    return [f"the heights of {name} are assumed: there is no such platform" for name in assumed]
