"""A film of one run, with a caption below each frame: title, time, key to the colours, notes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from swarmd.core.errors import ConfigError
from swarmd.sim.film.colours import Rgb, colouring_of
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
_BACK = (255, 255, 255)  # colours
_TEXT = (22, 25, 29)
_DIM = (90, 101, 114)
_LINES_A_FRAME = 32  # the height of a frame in lines of text
_SMALLEST = 13  # pixels of text


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmSettings:
    """The settings of a film.

    `speed` times real time; `size` in pixels (None: by the file's suffix). `start` and `stop` in s
    from the begin of the run (None: its end). `trail`: the path of each robot in the last s.
    """

    camera: Camera = "top"
    colour: str = "state"
    speed: float = 4.0
    size: tuple[int, int] | None = None
    start: float = 0.0
    stop: float | None = None
    trail: float = 5.0


def title_of(trace: Trace) -> str:
    """A title for a run: scenario and seed, or pattern, number and platforms of the robots."""
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
    """Write the film of a run to `path` atomically.

    Returns notes on what the film cannot show as in the run: platforms whose heights are assumed.
    ConfigError for wrong settings, PluginError if ffmpeg or OpenGL is missing, SwarmError if the
    trace is empty or the film cannot be written.
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
    stage = stage_of(trace, (width, height - bare.height), run.platforms, run.fields)
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


class Caption:
    """Draws the caption of one film."""

    def __init__(
        self,
        size: tuple[int, int],
        title: str,
        key: Sequence[tuple[Rgb, str]],
        notes: Sequence[str] = (),
    ) -> None:
        """`size` in pixels of the whole frame. A title or key that does not fit its line is cut."""
        self.width, height = size
        text = max(_SMALLEST, round(height / _LINES_A_FRAME))
        self._line = round(1.45 * text)
        self.height = 2 * (self._line + round(0.2 * text))
        self.height += (height - self.height) % 2  # the picture above needs an even height
        self._pad = round(0.6 * text)
        self._font = ImageFont.load_default(text)
        self._image = Image.new("RGB", (self.width, self.height), _BACK)
        self._draw = ImageDraw.Draw(self._image)
        self._top = round(0.2 * text)
        self._draw.text((self._pad, self._top), self._fitted(title), _TEXT, self._font)
        self._paint_key(key, notes)
        self._blank = np.asarray(self._image).copy()

    def below(self, picture: NDArray[np.uint8], time: str) -> NDArray[np.uint8]:
        """The picture with the caption and this time below it."""
        image = Image.fromarray(self._blank)
        width = self._length(time)
        place = (self.width - self._pad - width, self._top)
        ImageDraw.Draw(image).text(place, time, _TEXT, self._font)
        return np.concatenate((picture, np.asarray(image)))

    def _paint_key(self, key: Sequence[tuple[Rgb, str]], notes: Sequence[str]) -> None:
        side, gap = round(0.55 * self._line), self._pad
        text = "; ".join(notes)
        # Notes come before the key.
        room = self.width - 2 * self._pad - self._length(text) - self._length("...") - gap
        at, top = self._pad, self._top + self._line
        for colour, word in key:
            end = at + side + gap // 2 + self._length(word)
            if end > room:
                self._draw.text((at, top), "...", _TEXT, self._font)
                break
            high = top + (self._line - side) // 3
            self._draw.ellipse((at, high, at + side, high + side), fill=colour, outline=_DIM)
            self._draw.text((at + side + gap // 2, top), word, _TEXT, self._font)
            at = end + 2 * gap
        place = (self.width - self._pad - self._length(text), top)
        self._draw.text(place, text, _DIM, self._font)

    def _fitted(self, title: str) -> str:
        room = self.width - 2 * self._pad - self._length("  0000.0 s")
        kept = len(title)
        while kept and self._length(title[:kept]) > room:
            kept -= 1
        return title[:kept]

    def _length(self, text: str) -> int:
        return round(self._font.getlength(text))
