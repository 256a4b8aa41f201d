"""A film of one run from above: frames by matplotlib, in the style of the other figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError
from swarmd.sim.film.colours import Colouring, colouring_of
from swarmd.sim.film.encode import check_output, encoder
from swarmd.sim.metrics.window import cut
from swarmd.sim.plots import scene
from swarmd.sim.plots.theme import new_figure
from swarmd.sim.trace import Trace, faults_at, poses_at
from swarmd.sim.view.trace_source import RecordedRun
from swarmd.sim.world.geometry import radius
from swarmd.sim.world.scalar_fields import Field

RATES = {".mp4": 25, ".gif": 12, ".webp": 12}
"""Frames per s by suffix."""
SIZES = {".mp4": 1080, ".gif": 480, ".webp": 480}
"""The longer side of frames in pixels by suffix; the arena gives the aspect."""
_HOLD = 1.0  # s for which the last frame stays
# width by height of a frame
_NARROWEST = 0.8
_WIDEST = 2.2
# small frames are lower than _INCHES, for legible text
_LEAST_DPI = 90.0
_INCHES = 4.5
_MAX_NAMES = 20  # robots with names
# of the key: columns, and entries
_COLUMNS = 6
_MAX_KEY = 18
_MIN_PIXELS = 20.0  # the least length of a robot
_MOST = 2.0  # the largest enlargement of a robot
_NOTED = 1.05  # the least enlargement that a note tells


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmSettings:
    """The colours, the size and the part of the run that a film shows."""

    colour: str = "state"  # the value that gives the colour of robots, see `colouring_of`
    speed: float = 4.0  # times real time
    size: int | None = None  # pixels of the longer side; None: by the file's suffix
    start: float = 0.0  # s from the beginning of the run
    stop: float | None = None  # s from the beginning of the run; None: its end
    trail: float = 5.0  # s of the path that is drawn behind each robot


def title_of(trace: Trace) -> str:
    """The title of a film: scenario and seed, or pattern, number of robots and platforms."""
    meta = trace.meta
    if meta.get("scenario"):  # a demo of a pattern has none
        return f"{meta['scenario']}, seed {meta.get('seed', 0)}"
    kinds = ", ".join(dict.fromkeys(trace.platforms))
    return f"{meta.get('pattern', '')} {len(trace.ids)} {kinds}".strip()


def make_film(
    run: RecordedRun,
    path: Path,
    title: str,
    settings: FilmSettings,
    on_progress: Callable[[int, int], None] = lambda done, of: None,
) -> None:
    """Write the film of a run to `path`.

    `on_progress` is called with the numbers of written and of all frames. The file appears whole or
    not at all. ConfigError for wrong settings, PluginError if ffmpeg is missing, SwarmError if the
    trace is empty or the film cannot be written.
    """
    check_output(path)
    # rate: frames per s
    trace = run.trace
    rate = RATES[path.suffix]
    scene.check_drawable(trace)
    extent = scene.extent_of(trace)
    size = frame_size(extent, settings.size or SIZES[path.suffix])
    stop = trace.duration if settings.stop is None else min(settings.stop, trace.duration)
    seconds = stop - settings.start
    if seconds <= 0.0:
        raise ConfigError(
            f"a film from {settings.start:g} s to {stop:g} s of a run of {trace.duration:g} s has"
            " no frame; choose an earlier start"
        )
    notes = f"x and y in m; {settings.speed:.3g}x real time"
    colouring = colouring_of(trace, settings.colour)
    drawing = Drawing(trace, colouring, size, extent, run.fields, title, notes)
    count = max(round(seconds * rate / settings.speed), 1)
    with encoder(path, size, rate) as write:
        for number in range(1, count + 1):  # the last frame shows the time `stop`
            frame = drawing.at(settings.start + number * seconds / count, settings.trail).tobytes()
            write(frame)
            on_progress(number, count)
        for _ in range(round(_HOLD * rate)):
            write(frame)


def frame_size(extent: scene.Extent, longer: int) -> tuple[int, int]:
    """The even size (width, height) of frames with about the aspect of `extent`, in pixels.

    `longer`: the longer side.
    """
    aspect = min(max(extent.width / extent.height, _NARROWEST), _WIDEST)
    width = longer * min(aspect, 1.0)
    height = longer * min(1.0 / aspect, 1.0)
    return 2 * round(width / 2.0), 2 * round(height / 2.0)


class Drawing:
    """Draws a run from above, at any time, into arrays (height, width, 3) of uint8."""

    def __init__(
        self,
        trace: Trace,
        colouring: Colouring,
        size: tuple[int, int],
        extent: scene.Extent,
        fields: Sequence[Field] = (),
        title: str | None = None,
        notes: str = "",
    ) -> None:
        """`size`: width and height in pixels. SwarmError if matplotlib is missing.

        `title` and the time stand above the map, `notes` and the key to the colours below; without
        a title, the map alone fills the picture. Robots shorter than _MIN_PIXELS are enlarged.
        """
        # 1. The map with what stays. Half a pixel more prevents that a size is rounded down.
        dpi = max(_LEAST_DPI, size[1] / _INCHES)
        self.figure = new_figure((size[0] + 0.5) / dpi, (size[1] + 0.5) / dpi, is_map=True)
        self.figure.set_dpi(dpi)
        self._canvas: Any = self.figure.canvas  # Agg's, whose methods have no types
        self._axes = axes = self.figure.add_subplot()
        scene.prepare(axes, extent)
        scene.paint_fields(axes, trace, extent, fields, is_small=True)
        scene.paint_arena(axes, trace)

        # 2. The texts around the map, and the layout, which is made once.
        self._title = title
        self._names: Sequence[str] = ()
        if title is None:
            axes.set_position((0.0, 0.0, 1.0, 1.0))
            axes.set_axis_off()
        else:
            if len(trace.ids) <= _MAX_NAMES:
                heads = {name.rpartition("-")[0] for name in trace.ids}
                self._names = [
                    name.rpartition("-")[2] if len(heads) == 1 else name for name in trace.ids
                ]
            axes.tick_params(labelsize=8)
            axes.set_title(title, loc="left", fontsize=10)  # for the layout
            axes.set_xlabel(notes, fontsize=8)
            if colouring.key:
                self._add_key(colouring.key)
        self.figure.draw_without_rendering()
        self.figure.set_layout_engine("none")

        # 3. The enlargement of robots, which follows from the scale.
        diameter = 2.0 * min(map(radius, trace.footprints.values()))
        pixels = diameter * axes.bbox.width / extent.width
        self._factor = min(max(_MIN_PIXELS / pixels, 1.0), _MOST)
        if self._factor >= _NOTED:
            axes.set_xlabel(f"{notes}; robots enlarged {self._factor:.1f}x")
        self._kept = {*axes.get_children()}
        self.show(trace, colouring)

    def _add_key(self, key: Sequence[tuple[str, str]]) -> None:
        from matplotlib.lines import Line2D

        style: dict[str, Any] = {"linestyle": "none", "marker": "o", "markeredgecolor": "0.1"}
        handles = [Line2D([], [], color=colour, label=word, **style) for colour, word in key]
        self.figure.legend(handles=handles[:_MAX_KEY], loc="outside lower center", ncols=_COLUMNS,
                            frameon=False, fontsize=8)  # fmt: skip

    def show(self, trace: Trace, colouring: Colouring) -> None:
        """Draw this trace from now on: other instants of the same robots in the same arena."""
        shapes = {name: self._factor * shape for name, shape in trace.footprints.items()}
        self._trace = replace(trace, footprints=shapes)
        self._colouring = colouring

    def at(self, time: float, trail: float = 0.0) -> NDArray[np.uint8]:
        """The pixels (height, width, 3) of the run at `time` in s from its start.

        `trail`: s of the path that is drawn behind each robot.
        """
        from matplotlib.collections import LineCollection

        axes = self._axes
        trace = self._trace
        for artist in {*axes.get_children()} - self._kept:
            artist.remove()
        t = trace.t - trace.t[0]
        instant = max(int(np.searchsorted(t, time + 1e-9, side="right")) - 1, 0)
        boxes = None if trace.box_pose is None else poses_at(t, trace.box_pose, time)[None]
        present = cut(trace, instant, instant + 1)
        present = replace(present, pose=poses_at(t, trace.pose, time)[None], box_pose=boxes)
        colours = self._colouring.colours[instant].tolist()

        past = trace.pose[int(np.searchsorted(t, time - trail)) : instant + 1]
        paths = np.concatenate((past, present.pose))[..., :2].swapaxes(0, 1)
        trails = LineCollection(list(paths), colors=colours, linewidths=2.0, alpha=0.5, zorder=2.0)
        axes.add_collection(trails, autolim=False)
        scene.paint_movable_boxes(axes, present)
        scene.paint_bodies(axes, present, -1, colours, is_filled=True)
        reach = max(map(radius, trace.footprints.values()))
        faults = faults_at(trace, time)
        for row, (name, (x, y, _)) in enumerate(
            zip(self._names, present.pose[0].tolist(), strict=False)
        ):
            if math.isfinite(x + y):
                label = ": ".join(filter(None, (name, faults.get(trace.ids[row]))))
                axes.text(x, y + reach, label, ha="center", va="bottom", fontsize=8, clip_on=True)
        # The time comes first: a title that is too long is cut at its end.
        axes.set_title(f"{time:.1f} s: {self._title}", loc="left", fontsize=10)
        self._canvas.draw()
        return np.asarray(self._canvas.buffer_rgba())[..., :3]
