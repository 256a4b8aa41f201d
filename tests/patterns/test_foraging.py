"""Foraging: searches, drives to an item, closes the gripper, homes to the lamp, opens it there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from swarmd.core.values import Inputs, Outputs
from swarmd.patterns.foraging.pattern import Foraging
from swarmd.settings.platforms import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import scan_of

BURGER = load_platform("burger")
PLATFORM = replace(BURGER, provides=BURGER.provides | Foraging.needs)
FREE = scan_of(PLATFORM)
NOTHING = {
    "food": 0.0, "food_distance": 0.0, "food_bearing": 0.0, "held": 0.0, "ground": 1.0,
    "light_1": 0.5, "light_2": 0.5,
}  # fmt: skip


class TestForaging(PatternContract):
    pattern = Foraging


def run(*readings: Mapping[str, float], **params: float) -> list[Outputs]:
    """The outputs at 10 Hz for these readings beside those of an empty floor."""
    pattern: Any = Subject(Foraging, PLATFORM, params).make()
    return [
        pattern.step(
            Inputs(now=0.1 * i, dt=0.1 if i else 0.0, scan=FREE, readings={**NOTHING, **one})
        )
        for i, one in enumerate(readings)
    ]


def at(distance: float, bearing: float = 0.0) -> dict[str, float]:
    return {"food": 2.0, "food_distance": distance, "food_bearing": bearing}


def test_without_an_item_it_walks_with_an_open_gripper() -> None:
    found = run({}, {}, {})
    assert [one.grip for one in found] == [False] * 3
    assert found[-1].twist is not None
    assert found[-1].twist.linear > 0.0
    assert found[-1].report == {"state": "search"}


@pytest.mark.parametrize("bearing", [1.0, -1.0, 3.0])
def test_it_turns_to_an_item_on_the_spot(bearing: float) -> None:
    (one,) = run(at(0.5, bearing))
    assert one.twist is not None
    assert one.twist.linear == 0.0
    assert one.twist.angular * bearing > 0.0
    assert one.grip is False


def test_it_drives_to_an_item_ahead_and_closes_the_gripper_in_reach() -> None:
    far, near = run(at(0.5, 0.1), at(0.07))
    assert far.twist is not None
    assert far.twist.linear > 0.0
    assert (far.grip, near.grip) == (False, True)


def test_an_item_in_the_nest_is_left_there() -> None:
    (one,) = run({**at(0.07), "ground": 0.6})
    assert one.report == {"state": "search"}
    assert one.grip is False


def test_it_steers_to_the_lamp_with_an_item_and_keeps_hold_of_it() -> None:
    (one,) = run({"held": 1.0, "light_1": 0.8, "light_2": 0.2})
    assert one.twist is not None
    assert one.twist.angular > 0.0
    assert one.grip is True


def test_it_drops_the_item_after_the_time_inside_the_nest() -> None:
    home = {"held": 1.0, "ground": 0.6}
    grips = [one.grip for one in run({"held": 1.0}, *[home] * 4, inside=0.25)]
    assert grips == [True, True, True, False, False]


def test_the_time_inside_begins_again_when_it_leaves_the_nest() -> None:
    home = {"held": 1.0, "ground": 0.6}
    grips = [one.grip for one in run(home, home, home, {"held": 1.0}, home, home, inside=0.25)]
    assert all(grips)


def test_without_its_readings_it_stands() -> None:
    pattern: Any = Subject(Foraging, PLATFORM, {}).make()
    outputs = pattern.step(Inputs(now=0.0, dt=0.0, scan=FREE, readings={"held": 0.0}))
    assert (outputs.twist, outputs.grip) == (None, None)
