"""Firefly synchronisation, alone."""

from __future__ import annotations

import math

import pytest

from swarmd.core.values import Inputs, Message, Outputs, Value
from swarmd.patterns.firefly_synchronization.pattern import FireflySynchronization
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject


class TestFireflySynchronization(PatternContract):
    pattern = FireflySynchronization


class Firefly:
    """A robot that is stepped ten times a second from its first flash on; `now` is 0 there."""

    def __init__(self, **params: Value) -> None:
        self.pattern = Subject(FireflySynchronization, load_platform("burger"), params).make()
        self.now = self.flash_at = 0.0
        while self.step().report["flashes"] == 0:
            pass
        self.flash_at = self.now - 2.0 * self.phase

    def step(self, *heard: Value, age: float = 0.0) -> Outputs:
        self.now += 0.1
        messages = tuple(Message("b", "flash", value, age) for value in heard)
        found = self.pattern.step(Inputs(self.now, 0.1, messages=messages))
        self.phase = float(found.report["phase"])
        return found

    def step_to(self, phase: float) -> None:
        while self.phase < phase:
            self.step()


def age_of(value: Value) -> float:
    assert isinstance(value, list)
    assert isinstance(value[1], float)
    return value[1]


def test_flashes_once_a_period_alone() -> None:
    firefly = Firefly()
    for _ in range(100):
        firefly.step()
    assert firefly.step().report["flashes"] == 6
    assert firefly.phase == pytest.approx((firefly.now - firefly.flash_at) / 2.0 % 1.0)


def test_a_flash_of_another_makes_it_jump_ahead_as_the_source_has_it() -> None:
    firefly = Firefly()
    firefly.step_to(0.5)
    before = firefly.phase
    firefly.step([7, 0.0])
    rise = math.exp(0.3)
    expected = rise * (before + 0.05) + (rise - 1.0) / math.expm1(3.0)
    assert firefly.phase == pytest.approx(expected)


def test_a_late_jump_joins_the_flash_of_the_other() -> None:
    firefly = Firefly()
    firefly.step_to(0.8)
    found = firefly.step([7, 0.05], age=0.02)
    assert found.report["flashes"] == 2
    assert firefly.phase == pytest.approx(0.035)


def test_a_flash_counts_for_nothing_in_the_refractory_share() -> None:
    firefly = Firefly()
    firefly.step_to(0.1)
    before = firefly.phase
    firefly.step([7, 0.0])
    assert firefly.phase == pytest.approx(before + 0.05)


def test_a_repeated_message_counts_once() -> None:
    firefly = Firefly()
    firefly.step_to(0.5)
    firefly.step([7, 0.0])
    before = firefly.phase
    firefly.step([7, 0.1])
    assert firefly.phase == pytest.approx(before + 0.05)


def test_each_flash_is_sent_eight_times_with_its_age() -> None:
    firefly = Firefly()
    firefly.step_to(0.9)
    while firefly.phase > 0.5:
        found = firefly.step()
    sent = [found, *(firefly.step() for _ in range(12))]
    ages = [age_of(one.messages["flash"]) for one in sent if one.messages]
    assert len(ages) == 8
    assert ages[7] == pytest.approx(ages[0] + 0.7)


def test_names_a_robot_one_and_a_half_periods_after_its_last_flash() -> None:
    firefly = Firefly()
    firefly.step([7, 0.0])
    for _ in range(29):
        assert firefly.step().report["silent"] == ""
    firefly.step()
    assert firefly.step().report["silent"] == "b"
    assert firefly.step([8, 0.0]).report["silent"] == ""
