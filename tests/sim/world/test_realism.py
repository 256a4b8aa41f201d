"""Presets of realism and values above them."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec import to_builtins
from msgspec.structs import replace

from swarmd.core.errors import ConfigError
from swarmd.sim.world.realism import IDEAL, REALISMS, REALISTIC, realism_of


@pytest.mark.parametrize("preset", REALISMS.values())
def test_plain_values_are_the_same_realism_again(preset: Any) -> None:
    assert realism_of(to_builtins(preset)) == preset
    assert realism_of({"preset": "ideal", **to_builtins(preset)}) == preset


def test_single_values_stand_over_the_preset() -> None:
    changed = realism_of({"preset": "ideal", "odometry": {"slip": 0.1}})
    assert changed.odometry.slip == 0.1
    assert (changed.lidar, changed.actuation) == (IDEAL.lidar, IDEAL.actuation)


def test_single_values_stand_over_realistic_if_no_preset_is_named() -> None:
    changed = realism_of({"lidar": {"dropout": 0.0}})
    assert changed == replace(REALISTIC, lidar=replace(REALISTIC.lidar, dropout=0.0))


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("ideel", "no preset 'ideel'; did you mean 'ideal'?"),
        ({"preset": "x"}, "no preset 'x'; there are: ideal, realistic"),
        ({"lidr": {}}, "no key 'lidr'; did you mean 'lidar'?"),
        ({"lidar": {"dropuot": 0.1}}, "lidar has no key 'dropuot'; did you mean 'dropout'?"),
        (
            {"lidar": {"dropout": 2}},
            "lidar.dropout is 2; expected a number of at least 0 and up to 1",
        ),
        (
            {"actuation": {"delay": float("nan")}},
            "actuation.delay is nan; expected a number of at least 0 and up to 1",
        ),
        (7, "is 7; expected ideal or realistic, or keys and values"),
    ],
)
def test_a_mistake_is_one_line_with_place_and_remedy(value: Any, text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        realism_of(value, "my.yaml: realism")
    assert str(caught.value) == f"my.yaml: realism: {text}"
