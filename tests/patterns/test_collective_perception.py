"""Collective perception: what a robot measures, tells and decides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from swarmd.core.values import Inputs, Message, Outputs, Value
from swarmd.patterns.collective_perception.pattern import CollectivePerception
from swarmd.settings.platforms import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import scan_of

BURGER = load_platform("burger")
PLATFORM = replace(BURGER, provides=BURGER.provides | {"reading:ground"})
FREE = scan_of(PLATFORM)


class TestCollectivePerception(PatternContract):
    pattern = CollectivePerception


class TestComparison(PatternContract):
    pattern = CollectivePerception
    params = {"rule": "comparison"}  # noqa: RUF012 - read only


def run(
    seconds: float,
    ground: float,
    heard: Sequence[Value] = (),
    *,
    seed: int = 0,
    **params: Value,
) -> list[Outputs]:
    """The outputs at 10 Hz over a floor of this grey; others send these messages at each step."""
    pattern: Any = Subject(CollectivePerception, PLATFORM, params).make(seed)
    messages = tuple(Message(f"r{i}", "colour", value, 0.0) for i, value in enumerate(heard))
    return [
        pattern.step(
            Inputs(
                now=0.1 * k,
                dt=0.1 if k else 0.0,
                scan=FREE,
                messages=messages,
                readings={"ground": ground},
            )
        )
        for k in range(round(10.0 * seconds))
    ]


def told(outputs: Sequence[Outputs]) -> list[Value]:
    return [one.messages["colour"] for one in outputs if one.messages]


@pytest.mark.parametrize(("ground", "quality"), [(0.0, 1.0), (1.0, 0.0)])
def test_the_quality_is_the_share_of_the_floor_that_has_the_own_colour(
    ground: float, quality: float
) -> None:
    sent = told(run(200.0, ground, initial=0))
    assert sent
    assert {tuple(one) for one in sent if isinstance(one, list)} == {(0, quality)}


def test_a_robot_tells_in_proportion_to_the_quality_unless_it_compares() -> None:
    black = len(told(run(1000.0, 0.0, initial=0)))
    white = len(told(run(1000.0, 1.0, initial=0)))
    assert black > 5 * white
    assert len(told(run(1000.0, 1.0, initial=0, rule="comparison"))) > 5 * white


@pytest.mark.parametrize(
    ("rule", "heard", "opinion"),
    [
        ("voter", [[1, 0.1]], 1),
        ("majority", [[1, 0.1], [1, 0.1]], 1),
        ("majority", [[1, 0.1]], 0),  # even with its own: it keeps its opinion
        ("comparison", [[1, 0.1]], 0),
        ("comparison", [[0, 1.0]], 0),
    ],
)
def test_each_rule_decides_by_what_was_heard(rule: str, heard: list[Value], opinion: int) -> None:
    last = run(200.0, 0.0, heard, initial=0, rule=rule)[-1]
    assert last.report["opinion"] == opinion


def test_comparison_adopts_the_opinion_of_a_higher_quality() -> None:
    first = run(60.0, 1.0, [[1, 0.9]], initial=0, rule="comparison")
    assert first[-1].report["opinion"] == 1


@pytest.mark.parametrize("value", [[2, 1.0], [1, 2.0], [1], 1, [True, "x"], ["1", 1.0]])
def test_a_message_without_sense_changes_nothing(value: Value) -> None:
    assert run(100.0, 0.0, [value] * 3, initial=0, rule="voter")[-1].report["opinion"] == 0


def test_a_robot_without_a_reading_of_the_ground_asks_for_nothing() -> None:
    pattern: Any = Subject(CollectivePerception, PLATFORM, {}).make()
    outputs = pattern.step(Inputs(now=0.0, dt=0.0, scan=FREE))
    assert outputs.twist is None
    assert not outputs.messages
