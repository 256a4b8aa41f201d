"""Start poses of groups: by layout, repeatable for a seed, without overlap."""

from __future__ import annotations

import math
from copy import deepcopy
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from swarmd.core.errors import ConfigError
from swarmd.sim.world.geometry import gaps, transform
from tests.support.examples import examples

if TYPE_CHECKING:
    from tests.sim.scenarios.conftest import Load

RED, BLUE = "groups.red.start", "groups.blue.start"


def test_every_group_has_its_own_layout(load: Load) -> None:
    poses = load({BLUE: {"layout": "ring", "radius": 1.5, "heading_deg": 90}}).starts(0)
    np.testing.assert_allclose(poses[:2], [[0, -0.5, 0], [0, 0.5, 0]])
    np.testing.assert_allclose(poses[2:, :2], [[0, 1.5], [0, -1.5]], atol=1e-12)


def test_a_row_turns_and_moves_as_a_whole(load: Load) -> None:
    start = {"layout": "row", "spacing": 2, "center": [1, -1], "heading_deg": 90}
    poses = load({RED: start, BLUE: {"poses": [[-2, 0, 90], [-2, 1, -45]]}}).starts(0)
    np.testing.assert_allclose(poses[:2], [[2, -1, math.pi / 2], [0, -1, math.pi / 2]], atol=1e-12)
    np.testing.assert_allclose(poses[2:], [[-2, 0, math.pi / 2], [-2, 1, -math.pi / 4]])


def test_groups_without_a_start_share_one(load: Load) -> None:
    changes = {RED: None, BLUE: None, "start": {"layout": "paper", "spacing": 0.6}}
    np.testing.assert_allclose(load(changes).starts(0)[:, 1], [0, 0.6, 1.2, 1.8])


def test_the_default_layout_is_a_grid_of_1_m(load: Load) -> None:
    poses = load({RED: None, BLUE: None}).starts(0)
    np.testing.assert_allclose(poses[:, :2], [[-0.5, -0.5], [-0.5, 0.5], [0.5, -0.5], [0.5, 0.5]])


@pytest.mark.parametrize(
    "start", [{"layout": "random"}, {"layout": "chain", "near": 0.62, "far": 0.8}]
)
def test_a_seed_is_one_start_and_another_seed_another(load: Load, start: dict[str, Any]) -> None:
    starts = load({RED: start}).starts
    again = load({RED: start}).starts
    np.testing.assert_array_equal(starts(7), again(7))
    assert np.abs(starts(7)[:2] - starts(8)[:2]).max() > 0.01
    np.testing.assert_array_equal(starts(7)[2:], starts(8)[2:])


def test_two_random_groups_do_not_throw_the_same_dice(load: Load) -> None:
    left = {"layout": "random", "size": [2, 2], "center": [-1, 0]}
    right = {"layout": "random", "size": [2, 2], "center": [1, 0]}
    starts = load({RED: left, BLUE: right}).starts
    apart = starts(3)[2:, :2] - starts(3)[:2, :2]
    assert np.abs(apart - [2, 0]).max() > 0.01


@settings(
    max_examples=examples(25),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(seed=st.integers(0, 2**40), clearance=st.floats(0.0, 0.3))
def test_random_robots_stand_apart_within_their_region(
    load: Load, seed: int, clearance: float
) -> None:
    region = {"layout": "random", "clearance": clearance, "size": [4, 2], "center": [0.5, 1]}
    scenario = load({"groups.red.count": 8, RED: region})
    poses = scenario.starts(seed)
    assert np.all(np.abs(poses[:8, :2] - [0.5, 1]) <= [2, 1])
    shapes = [
        transform(platform.footprint, pose)
        for platform, pose in zip(scenario.robots.values(), poses, strict=True)
    ]
    movable_boxes = [scenario.arena.boxes[0].corners, *(p.corners for p in scenario.arena.poles)]
    assert min(float(gaps(a, b)) for a, b in combinations(shapes, 2)) > 0.0
    assert min(float(gaps(a, b)) for a, b in combinations(shapes[:8], 2)) > clearance
    assert min(float(gaps(a, b)) for a in shapes[:8] for b in movable_boxes) > clearance


@settings(
    max_examples=examples(25),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(seed=st.integers(0, 2**40))
def test_each_robot_of_a_chain_has_a_neighbor_between_near_and_far(load: Load, seed: int) -> None:
    chain = {"layout": "chain", "near": 0.62, "far": 0.8, "center": [-1.5, 0], "heading_deg": 30}
    poses = load({"groups.red.count": 6, RED: chain}).starts(seed)[:6]
    np.testing.assert_allclose(poses[:, 2], math.radians(30))
    apart = np.hypot(*np.moveaxis(poses[:, None, :2] - poses[None, :, :2], -1, 0))
    assert apart[~np.eye(6, dtype=bool)].min() >= 0.62
    reached = np.hypot(*(poses[:, :2] - [-1.5, 0]).T) < 1e-9
    assert reached.sum() == 1
    for _ in range(5):
        reached |= (apart[reached] <= 0.8).any(axis=0)
    assert reached.all()


@pytest.mark.parametrize(
    ("count", "start"),
    [
        (2, {"layout": "random", "clearance": 0.34, "size": [1.0, 0.01]}),
        (6, {"layout": "chain", "near": 0.4, "far": 0.8}),
    ],
)
def test_no_robot_has_a_better_place_by_its_name(
    load: Load, count: int, start: dict[str, Any]
) -> None:
    """Each is nearest to the middle equally often, though the second finds the first in its way."""
    from scipy.stats import chisquare

    own = {**start, "center": [-1.5, 0.0]}
    starts = load(
        {"groups.red.count": count, RED: own, BLUE: {"poses": [[3, 0, 0], [3, 1, 0]]}}
    ).starts
    places = [starts(seed)[:count, :2] for seed in range(100)]
    middle = [int(np.hypot(*(place - own["center"]).T).argmin()) for place in places]
    assert chisquare(np.bincount(middle, minlength=count)).pvalue > 1e-4


def test_the_order_of_groups_and_robots_in_a_file_moves_no_random_start(load: Load) -> None:
    own: dict[str, Any] = {"platform": "burger", "start": {"layout": "random"}}
    shared: dict[str, Any] = {"platform": "waffle_pi"}
    groups: list[tuple[str, dict[str, Any], list[str]]] = [
        ("red", own, ["r-1", "r-2"]),
        ("blue", own, ["s-1", "s-2"]),
        ("some", {**shared, "platform": "burger"}, ["t-1", "t-2"]),
        ("rest", shared, ["u-1"]),
    ]
    turned = [(name, group, robots[::-1]) for name, group, robots in reversed(groups)]
    both = []
    for some in (groups, turned):
        named = {name: {**deepcopy(group), "robots": robots} for name, group, robots in some}
        changes = {"groups": named, "events": [], "start": {"layout": "random"}}
        both.append(load(changes).starts(5))
    np.testing.assert_array_equal(both[0], both[1])


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({RED: {"layout": "row", "spacing": 0.1}}, f"{RED}: red-02 .*red-01"),
        ({RED: {"layout": "row", "spacing": 9}}, "red-01 .*walls"),
        ({RED: {"poses": [[3, 2, 0], [0, 0, 0]]}}, "red-01 .*box"),
        ({RED: {"poses": [[3, -2, 0], [0, 0, 0]]}}, "red-01 .*pole"),
        ({RED: {"poses": [[-2.5, -2, 0], [0, 0, 0]]}}, "red-01 .*segment"),
        ({BLUE: {"layout": "row"}}, f"{BLUE}: s-one .*red-01"),
        ({RED: {"poses": [[0, 0, 0]]}}, RED),
        ({RED: {"layout": "list"}}, RED),
        ({RED: {"layout": "chain"}}, f"{RED} .*near and far"),
        ({RED: {"layout": "chain", "near": 2, "far": 1}}, f"{RED} .*near 2.*far 1"),
        ({RED: {"layout": "random", "center": [1, 1]}}, f"{RED} .*center"),
        ({RED: {"layout": "ring", "spacing": 1}}, f"{RED}.spacing .*radius"),
        (
            {RED: {"layout": "row", "spacing": 0.1}, BLUE: {"layout": "random"}},
            "red-02 .*red-01",
        ),
    ],
)
def test_a_robot_without_room_is_named(load: Load, changes: dict[str, Any], fault: str) -> None:
    with pytest.raises(ConfigError, match=rf"^here\.yaml: .*{fault}"):
        load(changes)


def test_a_seed_without_room_is_refused(load: Load) -> None:
    crowd = load({"groups.red.count": 9, RED: {"layout": "random", "clearance": 3.0}})
    with pytest.raises(ConfigError, match=r"groups\.red\.start: .*red-\d\d"):
        crowd.starts(0)


def test_a_file_that_changes_the_layout_need_not_take_the_old_one_back(load: Load) -> None:
    poses = load({}, {f"{RED}.layout": "ring", f"{RED}.radius": 2}).starts(0)
    np.testing.assert_allclose(np.hypot(*poses[:2, :2].T), 2.0)
    poses = load({}, {f"{RED}.poses": [[0, 0, 0], [0, 1, 0]]}).starts(0)
    np.testing.assert_allclose(poses[:2, 1], [0, 1])
