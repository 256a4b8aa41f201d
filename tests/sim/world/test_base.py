"""Commands arrive late by whole steps, and bases take time to follow; compiled as interpreted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.kernels import load_kernel
from swarmd.core.values import Array
from swarmd.settings.platforms import load_platform, platform_names
from swarmd.sim.world import base as interpreted
from swarmd.sim.world.arena import parse_arena
from swarmd.sim.world.layouts import parse_layout
from swarmd.sim.world.odometer import Odometers
from swarmd.sim.world.realism import IDEAL, REALISTIC, Actuation, Realism
from swarmd.sim.world.world import World
from tests.support.examples import examples

compiled = load_kernel("swarmd.sim.world.base")
needs_compiled = pytest.mark.skipif(compiled is interpreted, reason="the kernels are not compiled")
BURGER = load_platform("burger")
# Without ramps of its own.
QUICK = replace(
    BURGER, body={**BURGER.body, "linear_acceleration": 1e9, "angular_acceleration": 1e9}
)
DT = 0.01
ONE = np.array([[0.1, -1.0, 0.0], [0.2, 0.5, 0.0]])


def bases(**values: Any) -> Any:
    memory = tuple(np.zeros(6) for _ in range(3))
    return compiled.Bases(Actuation(**values), [QUICK, QUICK], memory, DT)


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
    some = compiled.Bases(IDEAL.actuation, [QUICK, QUICK], memory, DT)
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
    some = compiled.Bases(IDEAL.actuation, [BURGER], tuple(np.zeros(3) for _ in range(3)), DT)
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


REALISMS = (
    IDEAL,
    REALISTIC,
    Realism(actuation=Actuation(delay=0.05, angular_acceleration=0.5)),
)
ARENA = parse_arena("8x7,box/a:0:0:0.3:0.3:0:1,box:2:2:1:0.1:20")
STRANGE = (np.nan, np.inf, -np.inf, 1e300, 0.0, -0.0)


def states(kinds: list[str], realism: Realism, commands: Array, *, is_compiled: bool) -> bytes:
    """The bytes of poses, twists and contacts of a run with commands (k, n, 3), 10 steps each."""
    platforms = [load_platform(kind) for kind in kinds]
    starts = parse_layout("random:0.02", [p.footprint for p in platforms], ARENA, seed=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SWARMD_COMPILED", str(int(is_compiled)))
        robots = {f"r{row}": platform for row, platform in enumerate(platforms)}
        world = World(robots, ARENA, starts, realism=realism)
    kept: list[bytes] = []
    for command in commands:
        world.set_commands(command)
        for _ in range(10):
            world.step()
            # Without the sign of a zero, which numpy's minimum leaves open.
            kept += [(world.poses() + 0.0).tobytes(), (world.twists() + 0.0).tobytes()]
            kept.append(repr(world.contacts()).encode())
    return b"".join(kept)


@needs_compiled
@settings(deadline=None, max_examples=examples(40))
@given(
    st.lists(st.sampled_from(platform_names()), min_size=1, max_size=6),
    st.sampled_from(REALISMS),
    st.integers(0, 2**32 - 1),
)
def test_worlds_have_the_bits_of_the_interpreted_file(
    kinds: list[str], realism: Realism, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    commands = rng.normal(0.0, 1.0, (8, len(kinds), 3))
    is_strange = rng.random(commands.shape) < 0.1
    commands[is_strange] = rng.choice(STRANGE, int(is_strange.sum()))
    compiled, reference = (
        states(kinds, realism, commands, is_compiled=is_one) for is_one in (True, False)
    )
    assert compiled == reference


@needs_compiled
@settings(deadline=None, max_examples=examples(40))
@given(
    st.lists(st.sampled_from(platform_names()), min_size=1, max_size=6), st.integers(0, 2**32 - 1)
)
def test_odometry_has_the_bits_of_the_interpreted_file(kinds: list[str], seed: int) -> None:
    rng, n = np.random.default_rng(seed), len(kinds)
    platforms, ids = [load_platform(kind) for kind in kinds], [f"r{row}" for row in range(n)]
    poses = rng.normal(0.0, 3.0, (n, 3))
    both = []
    for is_compiled in (True, False):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("SWARMD_COMPILED", str(int(is_compiled)))
            both.append(Odometers(REALISTIC.odometry, platforms, poses, ids, 3))
    for _ in range(40):  # more than the block of random numbers
        rows = np.flatnonzero(rng.random(n) < 0.8)[::2]  # as those of one of two processes
        poses = poses + rng.normal(0.0, 0.5, (n, 3))
        twists = rng.normal(0.0, 1.0, (n, 3))
        read = [one.read(rows, poses, twists) for one in both]
        for compiled, reference in zip(*read, strict=True):
            assert (compiled + 0.0).tobytes() == (reference + 0.0).tobytes()
