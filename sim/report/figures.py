"""The figures of a report: those of `swarmctl exp plot`, as data URLs."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from swarmd.sim.metrics.metric import Metric
from swarmd.sim.plots.figures import draw_experiment

_CAPTIONS = (
    ("intervals", "Values of every run by variant, with mean and 95 % interval."),
    ("differences", "Differences of means from the first variant, with 95 % intervals."),
    ("survival_", "{Name}: share of runs that have not had it yet (Kaplan-Meier)."),
    ("over_time_", "{Name} over time: median over the seeds, and bands around it."),
    ("runs", "All runs, seen from above."),
    ("trajectories", "Paths of the {name} run: hollow at the start, filled at the end."),
    ("start_and_end", "Start and end of the {name} run."),
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
        return [_figure(path) for path in draw_experiment(folder, Path(place), metrics=metrics)]


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
    return Figure(kind, text, f"data:image/png;base64,{_small(path)}")


def _small(path: Path) -> str:
    """The picture with fewer colours, as base64."""
    from PIL import Image

    file = io.BytesIO()
    with Image.open(path) as picture:
        picture.convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE).save(
            file, "png", optimize=True
        )
    return base64.b64encode(file.getvalue()).decode()
