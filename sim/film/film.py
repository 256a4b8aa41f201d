"""A film of one run, with a caption below each frame: title, time, key to the colours, notes."""

from __future__ import annotations

import math
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
from swarmd.sim.plots.scene import check_drawable, extent_of
from swarmd.sim.trace import Trace
from swarmd.sim.view.trace_source import RecordedRun

RATES = {".mp4": 25, ".gif": 12, ".webp": 12}
"""Frames per s by suffix."""
SIZES = {".mp4": (1280, 720), ".gif": (480, 360), ".webp": (480, 360)}
"""Width and height in pixels by suffix, in perspective; from above the arena gives the aspect."""
_HOLD = 1.0  # s for which the last frame stays
_BACK = (255, 255, 255)  # colours
_TEXT = (22, 25, 29)
_DIM = (90, 101, 114)
_LINES_A_FRAME = 32  # the height of a frame in lines of text
_SMALLEST = 13  # pixels of text
_NARROWEST, _WIDEST = 0.8, 2.2  # width by height of a picture that is as wide as its arena
_LONGEST_BAR = 0.2  # of the width of a frame
_MAX_NAMES = 20  # robots with names
_NOTED_ENLARGEMENT = 1.05  # of robots; a note tells a larger enlargement


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmSettings:
    """The camera, the colours, the size and the part of the run that a film shows."""

    camera: Camera = "top"
    colour: str = "state"  # the value that gives the colour of robots, see `colouring_of`
    speed: float = 4.0  # times real time
    size: tuple[int, int] | None = None  # pixels; None: by the file's suffix and the arena
    start: float = 0.0  # s from the beginning of the run
    stop: float | None = None  # s from the beginning of the run; None: its end
    trail: float = 5.0  # s of the path that is drawn behind each robot


def title_of(trace: Trace) -> str:
    """The title of a film: scenario and seed, or pattern, number of robots and platforms."""
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
    """Write the film of a run to `path`; returns a line for each platform that is unknown here.

    Robots of an unknown platform are drawn with assumed heights. `on_progress` is called with the
    numbers of written and of all frames. The file appears whole or not at all. ConfigError for
    wrong settings, PluginError if ffmpeg or OpenGL is missing, SwarmError if the trace is empty or
    the film cannot be written.
    """
    # 1. Size of frames, part of the run, colours.
    check_output(path)
    trace = run.trace
    check_drawable(trace)
    rate = RATES[path.suffix]  # frames per s
    size = settings.size or frame_size(trace, SIZES[path.suffix], settings.camera)
    stop = trace.duration if settings.stop is None else min(settings.stop, trace.duration)
    if stop <= settings.start:
        raise ConfigError(
            f"a film from {settings.start:g} s to {stop:g} s of a run of {trace.duration:g} s has"
            " no frame; choose an earlier start"
        )
    colouring = colouring_of(trace, settings.colour)

    # 2. The renderer, and the marks and the caption that are drawn onto its pictures. A frame is a
    #    picture with the caption below.
    width, height = size
    picture_size = width, height - caption_height(height)
    stage = stage_of(trace, picture_size, run.platforms, run.fields)
    caption_notes = [f"{settings.speed:.3g}x real time"]
    with Renderer(trace, stage, colouring, settings.camera) as renderer:
        if stage.factor > _NOTED_ENLARGEMENT:
            caption_notes.append(f"robots enlarged {stage.factor:.1f}x")
        marks = Marks(renderer, trace.ids)
        if marks.prefix:  # robots are shown with shorter names, without the common prefix
            caption_notes.append(f"names begin with {marks.prefix}")
        caption = Caption(size, title, colouring.key, caption_notes)

        # 3. The frames. The last frame shows the time `stop`, and stays for _HOLD s.
        seconds = stop - settings.start
        count = max(round(seconds * rate / settings.speed), 1)
        with Encoder(path, size, rate) as encoder:
            for number in range(1, count + 1):
                time = settings.start + number * seconds / count
                picture = marks.onto(renderer.frame(time, settings.trail), time)
                frame = caption.below(picture, f"{time:.1f} s")
                encoder.write(frame)
                on_progress(number, count)
            for _ in range(round(_HOLD * rate)):
                encoder.write(frame)
    return [
        f"the heights of {name} are assumed: there is no such platform" for name in stage.assumed
    ]


def frame_size(trace: Trace, size: tuple[int, int], camera: Camera) -> tuple[int, int]:
    """The size (width, height) in pixels of frames in the shape of the run's arena.

    The frame has about as many pixels as `size`. With a camera from the side it is `size`.
    """
    if camera != "top":
        return size
    extent, (width, height) = extent_of(trace), size
    aspect = min(max(extent.width / extent.height, _NARROWEST), _WIDEST)
    caption = caption_height(size[1])
    across = math.sqrt(width * (height - caption) * aspect)
    return 2 * round(across / 2.0), 2 * round((across / aspect + caption) / 2.0)


class Marks:
    """Draws a scale bar and the names of the robots onto frames from above; else nothing."""

    def __init__(self, renderer: Renderer, ids: Sequence[str]) -> None:
        """`ids`: the names of the robots; of many robots there are none."""
        self._renderer = renderer
        self.prefix = ""
        """What all names begin with, and is not drawn."""
        self._names: Sequence[str] = ()
        if renderer.scale is not None and len(ids) <= _MAX_NAMES:
            heads = {name[: name.rfind("-") + 1] for name in ids}
            self.prefix = heads.pop() if len(heads) == 1 else ""
            self._names = [name.removeprefix(self.prefix) for name in ids]
        self._text = max(_SMALLEST - 2, round(renderer.height / _LINES_A_FRAME))
        self._font = ImageFont.load_default(self._text)

    def onto(self, picture: NDArray[np.uint8], time: float) -> NDArray[np.uint8]:
        """The picture of `time` in s with its marks."""
        scale = self._renderer.scale
        if scale is None:
            return picture
        image = Image.fromarray(picture)
        draw = ImageDraw.Draw(image)
        above = self._renderer.stage.reach * scale
        for name, (x, y) in zip(self._names, self._renderer.pixels(time).tolist(), strict=False):
            if math.isfinite(x + y):
                draw.text((x, y - above), name, _TEXT, self._font, anchor="mb", stroke_width=2,
                          stroke_fill=_BACK)  # fmt: skip
        length = bar_length(_LONGEST_BAR * image.width / scale)
        left, level = 2 * self._text, image.height - 2 * self._text  # within the walls
        ends = (left, level, left + round(length * scale), level)
        draw.line(ends, _BACK, 6)
        draw.line(ends, _TEXT, 2)
        draw.text((left, level - 3), f"{length:g} m", _TEXT, self._font, anchor="lb",
                  stroke_width=2, stroke_fill=_BACK)  # fmt: skip
        return np.asarray(image)


def bar_length(most: float) -> float:
    """The longest of 1, 2 and 5 times a power of ten that is not above `most`, all in m."""
    power = 10.0 ** math.floor(math.log10(most))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= most)


def _text_height(frame_height: int) -> int:
    """The height of the text of a caption in pixels."""
    return max(_SMALLEST, round(frame_height / _LINES_A_FRAME))


def caption_height(frame_height: int) -> int:
    """The height in pixels of the caption in a frame, which includes the caption."""
    text = _text_height(frame_height)
    height = 2 * (round(1.45 * text) + round(0.2 * text))
    return height + (frame_height - height) % 2  # the picture above needs an even height


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
        text = _text_height(height)
        self._line = round(1.45 * text)
        self.height = caption_height(height)
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
        length = len(title)
        while length and self._length(title[:length]) > room:
            length -= 1
        return title[:length]

    def _length(self, text: str) -> int:
        return round(self._font.getlength(text))
