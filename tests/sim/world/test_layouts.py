"""Start layouts: expected poses, no overlap, repeatable for a seed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array
from swarmd.settings.platforms import load_platform
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.layouts import parse_layout

BURGER = load_platform("burger").footprint
WAFFLE = load_platform("waffle_pi").footprint
ARENA = Arena(8.0, 8.0)


def place(text: str, n: int = 3, arena: Arena = ARENA, seed: int = 0) -> Array:
    return parse_layout(text, [BURGER] * n, arena, seed=seed)


def test_paper_begins_in_the_middle_as_experiment_1_does() -> None:
    poses = place("paper", n=7, arena=Arena(18.0, 18.0))
    np.testing.assert_array_equal(poses[:, 1], np.arange(7.0))
    away = np.hypot(*(poses[:, :2] - poses[:, :2].mean(axis=0)).T)
    assert away.mean() == pytest.approx(1.714, abs=1e-3)


def test_grid_is_as_square_as_can_be() -> None:
    poses = place("grid:0.5", n=5)
    assert len(np.unique(poses[:, 0])) == 2
    assert len(np.unique(poses[:, 1])) == 3
    assert np.diff(np.unique(poses[:, 1])) == pytest.approx([0.5, 0.5])


def test_ring_looks_inwards() -> None:
    poses = place("ring:2", n=6)
    np.testing.assert_allclose(np.hypot(poses[:, 0], poses[:, 1]), 2.0)
    ahead = poses[:, :2] + 2.0 * np.stack((np.cos(poses[:, 2]), np.sin(poses[:, 2])), axis=-1)
    np.testing.assert_allclose(ahead, 0.0, atol=1e-12)


def test_a_list_gives_all_poses() -> None:
    poses = place("list:0:0:90,1:-1:0,-1:2.5:-45")
    np.testing.assert_allclose(poses[:, 2], [math.pi / 2.0, 0.0, -math.pi / 4.0])
    np.testing.assert_array_equal(poses[2, :2], [-1.0, 2.5])


def test_random_is_its_seed() -> None:
    np.testing.assert_array_equal(place("random", seed=4), place("random", seed=4))
    assert np.abs(place("random", seed=4) - place("random", seed=5)).max() > 0.1


@pytest.mark.parametrize(
    ("text", "n", "complaint"),
    [
        ("gird", 3, "grid"),
        ("row:wide", 3, "wide"),
        ("row:0.1", 3, "robot 1.*robot 0"),
        ("paper:2", 3, "robot 2.*walls"),
        ("list:0:0:0", 3, "3"),
        ("list:0:0,1:1,2:2", 3, "x:y:degrees"),
        ("list:0:0:nan", 1, "nan"),
        ("random:2", 30, "room"),
    ],
)
def test_an_invalid_layout_is_refused(text: str, n: int, complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        place(text, n)
