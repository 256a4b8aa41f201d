"""Commands arrive late by whole steps, and bases take time to follow."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from swarmd.core.values import Array
from swarmd.settings.platforms import load_platform
from swarmd.sim.world import base
from swarmd.sim.world.realism import IDEAL, Actuation

BURGER = load_platform("burger")
# Without ramps of its own.
QUICK = replace(
    BURGER, body={**BURGER.body, "linear_acceleration": 1e9, "angular_acceleration": 1e9}
)
DT = 0.01
ONE = np.array([[0.1, -1.0, 0.0], [0.2, 0.5, 0.0]])


def bases(**values: Any) -> Any:
    memory = tuple(np.zeros(6) for _ in range(3))
    return base.Bases(Actuation(**values), [QUICK, QUICK], memory, DT)


def driven(some: Any, steps: int) -> Array:
    """The velocities (steps, n, 3) to which bases drive."""
    followed = []
    for _ in range(steps):
        some.drive()
        followed.append(some.driven.copy())
    return np.array(followed)


def test_ideal_actuation_passes_commands_on_at_once() -> None:
    some = bases()
    some.put(ONE)
    assert np.array_equal(driven(some, 2), [ONE, ONE])


def test_commands_are_clipped_and_those_that_are_no_numbers_are_zero() -> None:
    some = bases()
    some.put(np.array([[np.nan, 1e300, -0.0], [-50.0, np.inf, -np.inf]]))
    limits = BURGER.limits
    wanted = [[0.0, limits.angular, 0.0], [-limits.linear, 0.0, 0.0]]
    assert np.array_equal(driven(some, 1)[0], wanted)


def test_forces_reach_the_command_within_a_step_up_to_the_grip_of_the_tyres() -> None:
    memory = qpos, qvel, force = tuple(np.zeros(6) for _ in range(3))
    some = base.Bases(IDEAL.actuation, [QUICK, QUICK], memory, DT)
    qpos[:] = 1.0, 2.0, 0.5 * np.pi, -1.0, -2.0, 0.0
    qvel[:] = 0.0, 0.05, 0.0, 0.0, 0.0, 0.0
    some.put(np.array([[0.08, 0.0, 0.0], [0.2, 0.0, 0.0]]))
    some.drive()
    mass = some.inert[0, 0]
    np.testing.assert_allclose(force[:3], [0.0, 3.0 * mass, 0.0], atol=1e-12)
    np.testing.assert_allclose(force[3:], [0.8 * 9.81 * mass, 0.0, 0.0], atol=1e-12)
    positions, velocities = some.before
    assert np.array_equal(positions, qpos)
    assert np.array_equal(velocities, qvel)


def test_a_base_ramps_with_its_own_accelerations() -> None:
    some = base.Bases(IDEAL.actuation, [BURGER], tuple(np.zeros(3) for _ in range(3)), DT)
    some.put(np.array([[0.2, 1.0, 0.0]]))
    rates = BURGER.body["linear_acceleration"], BURGER.body["angular_acceleration"]
    np.testing.assert_allclose(driven(some, 2)[:, 0, :2], np.outer([DT, 2.0 * DT], rates))


def test_commands_are_copied() -> None:
    some, told = bases(), ONE.copy()
    some.put(told)
    told[:] = 0.0
    assert np.array_equal(driven(some, 1)[0], ONE)


@pytest.mark.parametrize(
    ("delay", "steps"), [(0.0, 0), (0.03, 3), (0.034, 3), (0.048, 5), (0.29, 29)]
)
def test_a_command_is_late_by_whole_steps(delay: float, steps: int) -> None:
    some = bases(delay=delay)
    driven(some, 5)
    some.put(ONE)
    got = driven(some, steps + 4)
    assert some.delay_steps == steps
    assert not got[:steps].any()
    assert np.array_equal(got[steps:], np.tile(ONE, (4, 1, 1)))


def test_commands_keep_their_order_and_length_in_the_line() -> None:
    some = bases(delay=0.02)
    got = []
    for step in range(8):
        some.put(np.full((2, 3), 0.01 * step))
        got.append(float(driven(some, 1)[0, 0, 0]))
    assert got == pytest.approx([0.0, 0.0, 0.0, 0.01, 0.02, 0.03, 0.04, 0.05])


def test_a_cap_makes_a_ramp_of_its_own_slope() -> None:
    some = bases(linear_acceleration=1.0)
    some.put(np.array([[0.1, 2.0, 0.0], [-0.05, -2.0, 0.0]]))
    got = driven(some, 15)
    assert got[:10, 0, 0] == pytest.approx(0.01 * np.arange(1, 11))
    assert got[10:, 0, 0] == pytest.approx(0.1)
    assert got[:5, 1, 0] == pytest.approx(-0.01 * np.arange(1, 6))
    assert np.array_equal(got[:, 0, 1], np.full(15, 2.0))


def test_turning_has_a_cap_of_its_own() -> None:
    some = bases(angular_acceleration=5.0)
    some.put(ONE)
    got = driven(some, 3)
    assert got[:, 0, 1] == pytest.approx([-0.05, -0.1, -0.15])
    assert got[:, 0, 0] == pytest.approx(0.1)


def test_a_base_turns_around_at_once_after_a_command_beyond_its_limits() -> None:
    some = bases(linear_acceleration=1.0)
    some.put(np.full((2, 3), 50.0))
    assert driven(some, 100)[-1, 0, 0] == BURGER.limits.linear
    some.put(np.zeros((2, 3)))
    assert driven(some, 1)[0, 0, 0] == pytest.approx(BURGER.limits.linear - 0.01)


def test_a_base_with_a_response_time_follows_as_a_first_order_lag() -> None:
    lagged = replace(QUICK, body={**QUICK.body, "response_time": 0.2})
    some = base.Bases(IDEAL.actuation, [lagged], tuple(np.zeros(3) for _ in range(3)), DT)
    some.put(np.array([[0.2, 0.0, 0.0]]))
    followed = driven(some, 40)[:, 0, 0]
    times = DT * np.arange(1, 41)
    np.testing.assert_allclose(followed, 0.2 * (1.0 - np.exp(-times / 0.2)), atol=1e-12)


def test_drift_is_added_to_the_velocity() -> None:
    memory = _, _, force = tuple(np.zeros(3) for _ in range(3))
    some = base.Bases(IDEAL.actuation, [QUICK], memory, DT)
    some.drift[0] = 0.01, -0.02
    some.drive()
    np.testing.assert_allclose(force, [*(some.inert[0, 0] / DT * some.drift[0]), 0.0], atol=1e-12)
