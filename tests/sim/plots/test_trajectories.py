"""The picture of one run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from swarmd.core.errors import SwarmError
from swarmd.sim.plots.theme import save
from swarmd.sim.plots.trajectories import trajectories_figure
from swarmd.sim.trace import Trace
from tests.sim.plots.runs import full, overlaps, walk

if TYPE_CHECKING:
    from matplotlib.figure import Figure

pytest.importorskip("matplotlib")


def labels(figure: Figure) -> list[str]:
    return [
        text.get_text() for text in (figure.axes[0].get_legend() or figure.legends[0]).get_texts()
    ]


def test_each_robot_has_its_line_in_the_legend() -> None:
    figure = trajectories_figure(walk(3))
    assert labels(figure) == ["tb3-00", "tb3-01", "tb3-02", "start", "end"]
    assert figure.axes[0].get_aspect() == 1.0


def test_the_legend_names_each_kind_of_mark() -> None:
    assert labels(trajectories_figure(full(3))) == [
        *("tb3-00", "tb3-01", "tb3-02", "start", "end", "joins", "leaves", "movable box"),
        *("contact, both moving: 1", "contact, one moving: 1", "contact with wall or box: 1"),
    ]


def test_many_robots_are_coloured_by_time_and_not_named() -> None:
    figure = trajectories_figure(full(30))
    assert labels(figure) == [
        *("start", "end", "joins", "leaves", "movable box"),
        *("contact, both moving: 1", "contact, one moving: 1", "contact with wall or box: 1"),
    ]
    assert [axes.get_ylabel() for axes in figure.axes] == ["y [m]", "time [s]"]
