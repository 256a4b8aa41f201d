"""The distance from what is no robot: exact, for all that may stand in an arena."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.values import Array
from swarmd.settings.platforms import load_platform
from swarmd.sim.metrics import clearance
from swarmd.sim.world.arena import parse_arena
from swarmd.sim.world.geometry import gaps, transform
from tests.sim.metrics.runs import run
from tests.support.examples import examples

HALF, SIDE = 0.254, 0.215  # of a Jackal


def at(x: float, y: float, yaw: float = 0.0) -> Array:
    return np.array([[[x, y, yaw]]])


@pytest.mark.parametrize(
    ("arena", "pose", "gap"),
    [
        ("6x4", at(2.0, 0.0), 3.0 - 2.0 - HALF),
        ("6x4", at(2.0, 0.0, math.pi / 2.0), 3.0 - 2.0 - SIDE),
        ("6x4", at(0.0, -1.7), 2.0 - 1.7 - SIDE),
        ("6x4", at(2.9, 0.0), 0.0),  # within the wall
        ("20x20,box:2:0:0.5:0.5", at(0.0, 0.0), 2.0 - 0.25 - HALF),
        ("20x20,box:2:0:0.5:0.5:45", at(0.0, 0.0), 2.0 - 0.5 * math.sqrt(0.5) - HALF),
        ("20x20,pole:2:0:0.1", at(0.0, 0.0), 2.0 - 0.1 - HALF),
        ("20x20,pole:1:1:0.1", at(0.0, 0.0), math.hypot(1.0 - HALF, 1.0 - SIDE) - 0.1),
        ("20x20,pole:0.3:0:0.1", at(0.0, 0.0), 0.0),
        ("20x20,pole:0:0:0.1", at(0.0, 0.0), 0.0),
        ("20x20,segment:-2:1:2:1", at(0.0, 0.0), 1.0 - 0.005 - SIDE),
    ],
)
def test_is_between_the_outline_and_what_is_nearest(arena: str, pose: Array, gap: float) -> None:
    trace = run(pose, meta={"arena": arena})
    assert clearance.clearance(trace) == pytest.approx(gap, abs=1e-12)


def test_a_movable_box_counts_where_it_is_and_while_it_is_there() -> None:
    box = parse_arena("9x9,box/crate:0:0:0.2:0.2:0:5").movable_boxes[0][1]
    box_pose = np.array([[[2.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]], [[np.nan] * 3]])
    trace = run(
        np.zeros((3, 1, 3)),
        meta={"arena": "9x9,box/crate:0:0:0.2:0.2:0:5"},
        movable_boxes=("crate",),
        box_pose=box_pose,
        box_shapes=box.shape[None],
    )
    wanted = [2.0 - 0.1 - HALF, 1.0 - 0.1 - SIDE, 4.5 - HALF]
    found = clearance.clearances(trace)
    assert found is not None
    np.testing.assert_allclose(found, wanted)
    assert clearance.clearance(trace) == pytest.approx(wanted[1])


@given(seed=st.integers(0, 10_000))
@settings(deadline=None, max_examples=examples(25))
def test_is_that_of_looking_at_every_robot_and_obstacle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    words = [
        f"box:{x:.2f}:{y:.2f}:{a:.2f}:{b:.2f}:30" for x, y, a, b in rng.uniform(0.1, 3, (4, 4))
    ]
    arena = parse_arena(",".join(["12x12", *words]))
    pose = rng.uniform(-3.0, 3.0, (5, 6, 3))
    names = ("burger", "jackal", "waffle_pi") * 2
    trace = run(pose, meta={"arena": arena.text}, platforms=names)
    each = [
        gaps(transform(load_platform(name).footprint, pose[:, i]), box.corners)
        for i, name in enumerate(names)
        for box in arena.boxes
    ]
    found = clearance.clearances(trace)
    assert found is not None
    np.testing.assert_allclose(found, np.min(each, axis=0), atol=1e-12)


def test_there_is_none_without_an_arena_or_a_robot() -> None:
    assert clearance.clearance(run(at(0.0, 0.0))) is None
    assert clearance.clearances(run(at(0.0, 0.0), meta={"arena": "?"})) is None
    empty = run(np.zeros((0, 1, 3)), meta={"arena": "6x6"})
    assert clearance.clearance(empty) == math.inf


def test_a_body_that_is_not_in_the_arena_is_near_nothing() -> None:
    pose = np.zeros((1, 2, 3))
    pose[0, 1] = np.nan
    there, alone = (
        clearance.clearances(run(p, meta={"arena": "6x6"})) for p in (pose, pose[:, :1])
    )
    assert there is not None
    assert alone is not None
    np.testing.assert_array_equal(there, alone)
