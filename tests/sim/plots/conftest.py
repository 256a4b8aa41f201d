"""Traces made by hand, the folder of a real experiment, and a check of layouts."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from swarmd.settings.platforms import load_platform
from swarmd.sim.trace import Trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GATHERING = """\
duration: 3
arena: {size: [5, 5]}
groups:
  all: {platform: burger, count: 3, prefix: r, pattern: attraction, start: {layout: random}}
"""

Walk = Callable[..., Trace]
Overlaps = Callable[["Figure"], list[tuple[str, str]]]


@pytest.fixture
def walk() -> Walk:
    """Makes a run of robots that walk at random, from a grid 1 m apart, at 10 Hz."""

    def make(n: int, instants: int = 20, *, arena: str = "6x6", **parts: Any) -> Trace:
        rng = np.random.default_rng([5, n])
        side = int(np.ceil(np.sqrt(n)))
        grid = np.stack(np.divmod(np.arange(n), side), axis=-1) - (side - 1) / 2.0
        pose = np.empty((instants, n, 3))
        pose[..., :2] = grid + 0.05 * np.cumsum(rng.normal(size=(instants, n, 2)), axis=0)
        pose[..., 2] = rng.uniform(-3.0, 3.0, n)
        burger = load_platform("burger")
        trace = Trace(
            ids=tuple(f"tb3-{robot:02d}" for robot in range(n)),
            t=np.arange(instants) / 10.0,
            pose=pose,
            safe=np.zeros_like(pose),
            contact_t=np.zeros(0),
            contact_pair=np.zeros((0, 2), dtype=np.int64),
            contact_speed=np.zeros((0, 2)),
            platforms=(burger.name,) * n,
            footprints={burger.name: burger.footprint},
            meta={"arena": arena, "thresholds": {burger.name: 0.4}},
        )
        return replace(trace, **parts)

    return make


@pytest.fixture
def full(walk: Walk) -> Callable[[int], Trace]:
    """Makes a run that holds all that a picture can show: two robots at least."""

    def make(n: int) -> Trace:
        arena = (
            "6x6,box:2:2:0.5:0.5:20,pole:-2:2:0.2,segment:-2:-2.5:2:-2.5,box/crate:2:0:0.4:0.4:0:2"
        )
        trace = walk(n, arena=arena)
        present = np.ones((20, n), dtype=bool)
        present[:10, 0] = present[15:, 1] = False
        movable_boxes = np.full((20, 2, 3), np.nan)
        movable_boxes[:, 0] = np.linspace((2.0, 0.0, 0.0), (2.4, 0.3, 1.0), 20)
        movable_boxes[5:10, 1] = -2.0, 0.0, 0.5
        square = np.array([[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]])
        return replace(
            trace,
            contact_t=np.array([0.2, 0.3, 1.2, 1.9]),
            contact_pair=np.array([[0, 1], [0, 1], [1, 0], [1, -1]]),
            contact_speed=np.array([[0.1, 0.1], [0.1, 0.1], [0.1, 0.0], [0.1, 0.0]]),
            present=present,
            movable_boxes=("crate", "door"),
            box_pose=movable_boxes,
            box_shapes=np.stack((square, square)),
        )

    return make


@pytest.fixture(scope="session")
def conducted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an experiment of two variants and three seeds, for reading alone."""
    pytest.importorskip("mujoco")
    from swarmd.sim.experiments.simulate import simulate

    folder = tmp_path_factory.mktemp("conducted")
    (folder / "gathering.yaml").write_text(GATHERING)
    laws = {"groups.all.parameters.law": ["settling", "paper"]}
    simulate(folder / "gathering.yaml", 3, sweep=laws, out=folder / "x")
    return folder / "x"


@pytest.fixture
def experiment(conducted: Path, tmp_path: Path) -> Path:
    """The same for a test's own use."""
    return Path(shutil.copytree(conducted, tmp_path / "x"))


@pytest.fixture
def overlaps() -> Overlaps:
    """Finds the pairs of texts of a figure that overlap by more than two pixels."""

    def find(figure: Figure) -> list[tuple[str, str]]:
        from matplotlib.text import Text

        figure.draw_without_rendering()
        hidden = {
            label
            for axes in figure.axes
            for axis in (axes.xaxis, axes.yaxis)
            for tick in axis.get_major_ticks()
            for label in (tick.label1, tick.label2)
            if not min(axis.get_view_interval()) <= tick.get_loc() <= max(axis.get_view_interval())
        }
        boxes = [
            (text.get_text(), text.get_window_extent().padded(-1.0))
            for text in figure.findobj(Text)
            if text.get_visible() and text.get_text() and text not in hidden
        ]
        return [
            (one, other)
            for (one, box), (other, box2) in itertools.combinations(boxes, 2)
            if box.overlaps(box2)
        ]

    return find
