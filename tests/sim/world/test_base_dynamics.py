"""Commands arrive late by whole steps, and bases take time to follow."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swarmd.core.values import Array
from swarmd.settings.platforms import load_platform
from swarmd.sim.world.base_dynamics import Actuators
from swarmd.sim.world.realism import IDEAL, Actuation

BURGER = load_platform("burger")
DT = 0.01
ONE = np.array([[0.1, -1.0, 0.0], [0.2, 0.5, 0.0]])


def actuators(**values: Any) -> Actuators:
    return Actuators(Actuation(**values), [BURGER, BURGER], DT)


def driven(actuated: Actuators, steps: int) -> Array:
    return np.array([actuated.now() for _ in range(steps)])


def test_ideal_actuation_passes_commands_on_at_once() -> None:
    actuated = Actuators(IDEAL.actuation, [BURGER, BURGER], DT)
    told = np.array([[np.nan, 1e300, -0.0], [0.1234567, np.inf, 0.3]])
    actuated.put(told)
    assert np.array_equal(actuated.now().view(np.int64), told.view(np.int64))
    assert np.array_equal(actuated.now().view(np.int64), told.view(np.int64))


def test_commands_are_copied() -> None:
    actuated, told = actuators(), ONE.copy()
    actuated.put(told)
    told[:] = 0.0
    assert np.array_equal(actuated.now(), ONE)


@pytest.mark.parametrize(
    ("delay", "steps"), [(0.0, 0), (0.03, 3), (0.034, 3), (0.048, 5), (0.29, 29)]
)
def test_a_command_is_late_by_whole_steps(delay: float, steps: int) -> None:
    actuated = actuators(delay=delay)
    driven(actuated, 5)
    actuated.put(ONE)
    got = driven(actuated, steps + 4)
    assert actuated.delay_steps == steps
    assert not got[:steps].any()
    assert np.array_equal(got[steps:], np.tile(ONE, (4, 1, 1)))


def test_commands_keep_their_order_and_length_in_the_line() -> None:
    actuated = actuators(delay=0.02)
    got = []
    for step in range(8):
        actuated.put(np.full((2, 3), 0.01 * step))
        got.append(float(actuated.now()[0, 0]))
    assert got == pytest.approx([0.0, 0.0, 0.0, 0.01, 0.02, 0.03, 0.04, 0.05])


def test_a_cap_makes_a_ramp_of_its_own_slope() -> None:
    actuated = actuators(linear_acceleration=1.0)
    actuated.put(np.array([[0.1, 2.0, 0.0], [-0.05, -2.0, 0.0]]))
    got = driven(actuated, 15)
    assert got[:10, 0, 0] == pytest.approx(0.01 * np.arange(1, 11))
    assert got[10:, 0, 0] == pytest.approx(0.1)
    assert got[:5, 1, 0] == pytest.approx(-0.01 * np.arange(1, 6))
    assert np.array_equal(got[:, 0, 1], np.full(15, 2.0))


def test_turning_has_a_cap_of_its_own() -> None:
    actuated = actuators(angular_acceleration=5.0)
    actuated.put(ONE)
    got = driven(actuated, 3)
    assert got[:, 0, 1] == pytest.approx([-0.05, -0.1, -0.15])
    assert got[:, 0, 0] == pytest.approx(0.1)


def test_a_base_turns_around_at_once_after_a_command_beyond_its_limits() -> None:
    actuated = actuators(linear_acceleration=1.0)
    actuated.put(np.full((2, 3), 50.0))
    assert driven(actuated, 100)[-1, 0, 0] == BURGER.limits.linear
    actuated.put(np.zeros((2, 3)))
    assert actuated.now()[0, 0] == pytest.approx(BURGER.limits.linear - 0.01)


def test_a_command_that_is_no_number_is_zero_behind_a_ramp() -> None:
    actuated = actuators(linear_acceleration=1.0)
    actuated.put(np.full((2, 3), np.nan))
    assert not actuated.now().any()
    actuated.put(ONE)
    assert actuated.now()[0, 0] == pytest.approx(0.01)
