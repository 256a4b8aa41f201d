"""The figures of a report, drawn as by `swarmctl exp plot`, as data URLs."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, TYPE_CHECKING

from swarmd.sim.metrics.metric import Metric
from swarmd.sim.plots.figures import KINDS, Look, draw_experiment
from swarmd.sim.plots.theme import DPI

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

MAX_FIGURES = 24
"""Pictures in a report; a sweep of many variants has more."""

_CAPTIONS = (
    ("intervals", "Mean, 95 % interval and spread of the runs, by variant."),
    ("differences", "Differences of means from the first variant, with 95 % intervals."),
    ("survival_", "{Name}: share of runs that have not had it yet (Kaplan-Meier)."),
    ("over_time_", "{Name} over time: median over the seeds, and bands around it."),
    ("runs", "All runs, seen from above."),
    ("trajectories", "Paths of the {name} run: hollow at the start, filled at the end."),
)
_COLOURS = 160  # of a picture: a quarter of its bytes, and no difference to the eye


@dataclass(frozen=True, slots=True)
class Figure:
    """A picture: `kind` is a part of its file's name, `source` a data URL."""

    kind: str
    caption: str
    source: str


def figures_of(folder: Path, metrics: Sequence[Metric] | None = None) -> list[Figure]:
    """The figures of an experiment; errors as of `draw_experiment`."""
    with TemporaryDirectory(prefix="swarmd-report-") as place:
        made = draw_experiment(folder, Path(place), metrics=metrics, look=Look(only=KINDS))
        return [_figure(path) for path in made]


def _figure(path: Path) -> Figure:
    kind, caption = next(
        ((kind, text) for kind, text in _CAPTIONS if kind in path.stem), ("", path.stem)
    )
    name = (
        path.stem.replace("over_time_", "")
        .replace("survival_", "")
        .replace(f"_{kind}", "")
        .replace("_", " ")
    )
    text = caption.format(name=name, Name=name.capitalize())
    return Figure(kind, text, _data_url(path))


def drawn(drawing: Drawing, caption: str) -> Figure:
    """A figure of matplotlib for a report."""
    file = io.BytesIO()
    drawing.savefig(file, format="png", dpi=DPI)
    return Figure("", caption, _data_url(file))


def figures_html(figures: Sequence[Figure]) -> str:
    """The first figures side by side, with their captions."""
    parts = [
        f'<figure class="{figure.kind}"><img src="{figure.source}" alt="{escape(figure.caption)}">'
        f"<figcaption>{escape(figure.caption)}</figcaption></figure>"
        for figure in figures[:MAX_FIGURES]
    ]
    if len(figures) > len(parts):
        parts.append(
            f"<p>{len(parts)} of {len(figures)} figures; `swarmctl exp plot` draws all.</p>"
        )
    return f'<div class="pair">{"".join(parts)}</div>' if parts else ""


def _data_url(picture: Path | IO[bytes]) -> str:
    """The picture with fewer colours, as a data URL."""
    from PIL import Image

    file = io.BytesIO()
    with Image.open(picture) as image:
        image.convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE).save(
            file, "png", optimize=True
        )
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"
