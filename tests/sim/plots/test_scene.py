"""What is shown of a run seen from above."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from swarmd.sim.plots.scene import (
    Extent,
    cut_note,
    extent_of,
    paint_arena,
    paint_bodies,
    paint_movable_boxes,
    paint_paths,
    paint_paths_by_time,
    robot_colour,
    robot_style,
)
from swarmd.sim.plots.theme import new_figure
from tests.sim.plots.runs import full, walk

if TYPE_CHECKING:
    from matplotlib.axes import Axes

pytest.importorskip("matplotlib")


@pytest.fixture
def axes() -> Axes:
    return new_figure(4.0, 4.0).add_subplot()


def test_shows_the_whole_arena_that_robots_use() -> None:
    extent = extent_of(walk(9, arena="6x4"))
    assert extent.left < -3.0 < 3.0 < extent.right
    assert extent.bottom < -2.0 < 2.0 < extent.top
    assert cut_note(walk(9, arena="6x4")) == ""


def test_shows_and_names_the_used_part_of_a_large_arena() -> None:
    trace = walk(4, arena="40x30")
    extent = extent_of(trace)
    assert extent.width < 6.0
    assert extent.left < trace.pose[..., 0].min() < trace.pose[..., 0].max() < extent.right
    assert cut_note(trace) == "part of an arena of 40 m x 30 m"


def test_a_box_far_from_the_robots_is_shown() -> None:
    trace = full(4)
    trace = replace(trace, meta={"arena": "80x80"})
    assert trace.box_pose is not None
    trace.box_pose[:, 0, 0] = 15.0
    assert extent_of(trace).right > 15.0


def test_without_a_known_arena_the_robots_alone_are_shown() -> None:
    trace = walk(4, arena="nowhere")
    assert 1.0 < extent_of(trace).width < 4.0
    assert cut_note(trace) == ""


def test_the_longer_side_has_the_length_asked_for() -> None:
    assert Extent(0.0, 4.0, 0.0, 2.0).panel(6.0) == (6.0, 3.0)
    assert Extent(0.0, 1.0, 0.0, 20.0).panel(6.0) == (1.2, 6.0)


def test_every_part_of_the_arena_is_painted_and_movable_boxes_are_not(
    axes: Axes,
) -> None:
    paint_arena(axes, full(2))
    walls, boxes = axes.collections
    assert len(axes.lines) == 1  # the outer walls
    assert len(walls.get_paths()) == 1
    assert len(boxes.get_paths()) == 1
    assert len(axes.patches) == 1  # the pole


def test_a_box_that_is_pushed_is_hollow_at_first_and_filled_at_last(axes: Axes) -> None:
    from matplotlib.colors import to_rgba

    paint_movable_boxes(axes, full(2))
    faces = [to_rgba(patch.get_facecolor())[3] for patch in axes.patches]
    assert faces == [0.0, 1.0, 0.0]  # the crate twice; the door, gone at the end, once
    assert len(axes.lines) == 1
    outline = np.asarray(axes.patches[1].get_path().vertices)[:4]
    assert outline.mean(axis=0) == pytest.approx([2.4, 0.3])


def test_the_path_of_a_robot_is_dotted_while_it_is_absent(axes: Axes) -> None:
    paint_paths(axes, full(3))
    styles = [line.get_linestyle() for line in axes.lines]
    assert styles == ["-", ":", "-", ":", "-"]
    there, away = (np.asarray(line.get_xdata()) for line in axes.lines[:2])
    assert np.isnan(there[:10]).all()
    assert np.isnan(away[10:]).all()


def test_twenty_robots_look_different() -> None:
    assert len({(robot_colour(robot), robot_style(robot)) for robot in range(20)}) == 20


def test_paths_of_many_robots_are_coloured_by_time(axes: Axes) -> None:
    trace = walk(30, 101)
    ways = paint_paths_by_time(axes, trace)
    assert len(ways.get_paths()) == 100 * 30
    assert ways.get_clim() == (0.0, 10.0)
    first, last = ways.get_paths()[0].vertices, ways.get_paths()[-1].vertices
    assert np.asarray(first)[0] == pytest.approx(trace.pose[0, 0, :2])
    assert np.asarray(last)[-1] == pytest.approx(trace.pose[-1, -1, :2])


def test_paths_of_a_thousand_robots_are_thinned(axes: Axes) -> None:
    ways = paint_paths_by_time(axes, walk(1000, 3000))
    assert sum(len(np.asarray(path.vertices)) for path in ways.get_paths()) < 250_000


def test_absent_robots_are_dotted_and_pale(axes: Axes) -> None:
    paint_bodies(axes, full(3), 0, ["red", "green", "blue"], is_filled=True)
    there, noses, away, _ = axes.collections
    assert len(there.get_paths()) == len(noses.get_paths()) == 2
    assert len(away.get_paths()) == 1
    assert there.get_alpha() == 1.0
    assert away.get_alpha() == 0.45
    assert away.get_linestyle() != there.get_linestyle()


def test_noses_are_seen_on_dark_and_on_light_robots(axes: Axes) -> None:
    paint_bodies(axes, walk(2), 0, ["#332288", "#DDCC77"], is_filled=True)
    inks = np.asarray(axes.collections[1].get_edgecolor())
    assert inks[:, 0].tolist() == [1.0, pytest.approx(0.1)]


def test_a_hundred_and_one_robots_have_no_noses(axes: Axes) -> None:
    paint_bodies(axes, walk(101), -1, ["red"] * 101, is_filled=True)
    assert [len(bodies.get_paths()) for bodies in axes.collections] == [101, 0]
