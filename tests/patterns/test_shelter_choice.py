"""Shelter choice: one robot, the floor, and those that tell it that they rest."""

from __future__ import annotations

from typing import Any

import pytest

from swarmd.core.values import Inputs, Message, Neighbor, Outputs, Twist, Value
from swarmd.kit.behavior import Pattern
from swarmd.patterns.shelter_choice.pattern import ShelterChoice
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import empty_scan


class TestShelterChoice(PatternContract):
    pattern = ShelterChoice


PLATFORM = TestShelterChoice.subject("burger").platform
SURE = 10.0  # 1/s: in a step of 0.1 s it happens
SCAN = empty_scan(PLATFORM, 0, 0.0)
FAR = 2.0


def made(seed: int = 0, **params: Value) -> Pattern[Any]:
    return Subject(ShelterChoice, PLATFORM, params).make(seed)


def stepped(
    pattern: Pattern[Any], now: float, ground: float, *, others: int = 0, far: float = 0.5
) -> Outputs:
    """A step on a floor, with so many others at a distance that tell that they rest."""
    neighbors = tuple(Neighbor(f"b{k}", 0.0, far, 0.0, 0.0) for k in range(others))
    messages = tuple(Message(f"b{k}", "rest", True, 0.0) for k in range(others))
    readings = {"ground": ground}
    return pattern.step(Inputs(now, 0.1, SCAN, True, None, neighbors, messages, readings))


def test_walks_where_the_floor_is_light() -> None:
    found = stepped(made(stop=SURE), 0.0, 1.0)
    assert found.report["state"] == "walk"
    assert found.twist != Twist()


def test_rests_under_a_shelter_and_tells_so() -> None:
    found = stepped(made(stop=SURE, leave=0.0), 0.0, 0.0)
    assert found.report["state"] == "rest"
    assert found.twist == Twist()
    pattern = made(stop=SURE, leave=0.0)
    said = [stepped(pattern, 0.1 * k, 0.0).messages for k in range(12)]
    assert said.count({"rest": True}) == 2  # at 0 and 1 s


def test_does_not_stop_for_a_time_after_a_rest() -> None:
    pattern = made(stop=SURE, leave=SURE, social=0.0, away=1.0)
    states = [stepped(pattern, 0.1 * k, 0.0).report["state"] for k in range(14)]
    assert states == ["rest", *["walk"] * 10, "rest", "walk", "walk"]


@pytest.mark.parametrize(("others", "held"), [(0, 1.0), (9, 51.0)])
def test_leaves_at_the_rate_of_the_source(others: int, held: float) -> None:
    # theta / (1 + rho (x / S)^2), with x = 1 or 10 of 20; rho 0 alone
    social, stays = (200.0 if others else 0.0), []
    for seed in range(150):
        pattern = made(seed, stop=SURE, leave=2.0, social=social)
        stepped(pattern, 0.0, 0.0)
        for k in range(1, 200):
            if stepped(pattern, 0.1 * k, 0.0, others=others).report["state"] == "walk":
                break
        stays.append(k)
    left = sum(k < 199 for k in stays)
    # The chance to be there after 19.9 s; five standard deviations.
    chance = 1.0 - (1.0 - 0.2 / held) ** 199
    assert left / 150 == pytest.approx(chance, abs=0.2)
    assert sum(stays) / 150 == pytest.approx(held / 0.2 * chance, rel=0.5)


def test_robots_that_rest_far_away_or_told_it_long_ago_do_not_count() -> None:
    pattern = made(stop=SURE, leave=0.0)
    assert stepped(pattern, 0.0, 1.0, others=3).report["count"] == 3
    assert stepped(pattern, 0.1, 1.0, others=3, far=FAR).report["count"] == 0
    neighbors = tuple(Neighbor(f"b{k}", 0.0, 0.5, 0.0, 0.0) for k in range(3))
    later = pattern.step(Inputs(4.0, 0.1, SCAN, True, None, neighbors, (), {"ground": 1.0}))
    assert later.report["count"] == 0


def test_a_full_shelter_is_passed() -> None:
    found = stepped(made(stop=SURE, capacity=3), 0.0, 0.0, others=3)
    assert found.report["state"] == "walk"
