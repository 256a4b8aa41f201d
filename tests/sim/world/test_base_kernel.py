"""The compiled servos and odometers give the bits of the numpy code."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.kernels import compiled_kernel
from swarmd.core.values import Array
from swarmd.settings.platforms import load_platform, platform_names
from swarmd.sim.world.arena import parse_arena
from swarmd.sim.world.layouts import parse_layout
from swarmd.sim.world.odometer import Odometers
from swarmd.sim.world.realism import IDEAL, REALISTIC, Actuation, Realism
from swarmd.sim.world.world import World
from tests.support.examples import examples

if compiled_kernel("swarmd.sim.world.base_kernel") is None:
    pytest.skip("the kernel is not compiled", allow_module_level=True)

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


@settings(deadline=None, max_examples=examples(40))
@given(
    st.lists(st.sampled_from(platform_names()), min_size=1, max_size=6),
    st.sampled_from(REALISMS),
    st.integers(0, 2**32 - 1),
)
def test_worlds_have_the_bits_of_the_numpy_code(
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


@settings(deadline=None, max_examples=examples(40))
@given(
    st.lists(st.sampled_from(platform_names()), min_size=1, max_size=6), st.integers(0, 2**32 - 1)
)
def test_odometry_has_the_bits_of_the_numpy_code(kinds: list[str], seed: int) -> None:
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
