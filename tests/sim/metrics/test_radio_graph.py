"""The radio graph, against graphs whose numbers are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swarmd.sim.metrics import pairs, radio_graph
from swarmd.sim.world.arena import parse_arena
from swarmd.sim.world.radio import Radio, RadioSettings
from tests.sim.metrics.runs import line, run


def radio(reach: float | None = None, **more: Any) -> dict[str, Any]:
    kind = {} if reach is None else {"neighborhood": "range", "range": reach}
    return {"meta": {"radio": {**kind, **more}}}


def test_components_by_range() -> None:
    pose = line(0.0, 1.0, 2.0, 5.0)
    assert radio_graph.radio_components(run(pose, **radio(1.0))).tolist() == [2.0]
    assert radio_graph.radio_components(run(pose, **radio(0.9))).tolist() == [4.0]
    assert radio_graph.radio_components(run(pose, **radio(3.0))).tolist() == [1.0]


@pytest.mark.parametrize("meta", [{}, {"radio": {}}, {"radio": {"neighborhood": "all"}}])
def test_without_a_range_everyone_hears_everyone(meta: dict[str, Any]) -> None:
    trace = run(line(0.0, 1e6, -1e6), meta=meta)
    assert radio_graph.radio_components(trace).tolist() == [1.0]
    assert radio_graph.radio_connected(trace) == 1.0


def test_connected_is_a_share_of_time() -> None:
    pose = np.zeros((4, 2, 3))
    pose[:, 1, 0] = (0.5, 1.0, 1.5, 2.0)
    trace = run(pose, **radio(1.2))
    assert radio_graph.is_radio_connected(trace).tolist() == [1.0, 1.0, 0.0, 0.0]
    assert radio_graph.radio_connected(trace) == 0.5


def test_absent_robots_pass_nothing_on() -> None:
    present = np.array([[True, False, True]])
    trace = run(line(0.0, 1.0, 2.0), present=present, **radio(1.0))
    assert radio_graph.radio_components(trace).tolist() == [2.0]
    two = run(line(0.0, 9.0, 1.0), present=present, **radio(1.0))
    assert radio_graph.radio_components(two).tolist() == [1.0]
    nobody = run(line(0.0, 1.0), present=np.zeros((1, 2), dtype=bool), **radio(1.0))
    assert np.isnan(radio_graph.radio_components(nobody)).all()
    assert radio_graph.radio_connected(nobody) is None


def test_walls_cut_links_where_the_radio_wants_sight() -> None:
    pose = line(-1.0, 1.0, 1.5)
    walled = {"arena": "6x6,segment:0:-1:0:1"}
    blind = run(pose, meta={**walled, **radio(9.0, line_of_sight=True)["meta"]})
    assert radio_graph.radio_components(blind).tolist() == [2.0]
    heard = run(pose, meta={**walled, **radio(9.0)["meta"]})
    assert radio_graph.radio_components(heard).tolist() == [1.0]
    anywhere = run(pose, meta={**walled, **radio(line_of_sight=True)["meta"]})
    assert radio_graph.radio_components(anywhere).tolist() == [2.0]


def test_boxes_cut_links_while_they_stand_between() -> None:
    pose = np.zeros((3, 2, 3))
    pose[:, 0, 0], pose[:, 1, 0] = -1.0, 1.0
    box_pose = np.array([[[0.0, 0.0, 0.0]], [[0.0, 2.0, 0.0]], [[np.nan] * 3]])
    trace = run(
        pose,
        meta={"arena": "6x6", **radio(9.0, line_of_sight=True)["meta"]},
        movable_boxes=("crate",),
        box_pose=box_pose,
        box_shapes=np.array([[[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]]]),
    )
    assert radio_graph.radio_components(trace).tolist() == [2.0, 1.0, 1.0]


@pytest.mark.parametrize("n", [6, 50])
def test_links_are_those_of_the_radio(n: int) -> None:
    pose = np.random.default_rng(1).uniform(-3.0, 3.0, (5, n, 3))
    arena = "6x6,segment:0:-1:0:1,pole:1:1:0.3,box:-1:1:0.5:0.5"
    told = {"neighborhood": "range", "range": 1.5, "line_of_sight": True}
    trace = run(pose, meta={"arena": arena, "radio": told})
    air = Radio(
        RadioSettings(neighborhood="range", range=1.5, line_of_sight=True),
        trace.ids,
        parse_arena(arena),
        seed=0,
    )
    for instant in range(5):
        (links,) = [one for one in radio_graph.radio_links(trace) if (one.instant >= 0).all()]
        here = links.instant == instant
        mine = sorted(zip(links.a[here].tolist(), links.b[here].tolist(), strict=True))
        heard = [(a, b) for a in range(n) for b in air.hearers(a, pose[instant]).tolist() if a < b]
        assert mine == heard


def test_components_of_more_than_is_worked_on_at_once() -> None:
    n = pairs.MAX_POINTS // 10
    pose = np.zeros((25, n, 3))
    pose[:, :, 0] = np.arange(n)
    pose[20:, n // 2 :, 0] += 5.0
    counts = radio_graph.radio_components(run(pose, **radio(1.1)))
    assert counts.tolist() == [1.0] * 20 + [2.0] * 5
