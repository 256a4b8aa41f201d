"""The compiled kernels of the simulator give the bits of the interpreted files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.values import Array, Platform
from swarmd.settings.platforms import load_platform, platform_names
from swarmd.sim.world.arena import Arena, parse_arena
from swarmd.sim.world.layouts import parse_layout
from swarmd.sim.world.lidar import LidarModel, RangeSensors, Visibility
from swarmd.sim.world.noise import NoisyLidar
from swarmd.sim.world.realism import IDEAL, REALISTIC, Actuation, LidarNoise, Realism
from swarmd.sim.world.world import World
from tests.support.examples import examples
from tests.support.kernel_forms import compares_forms

pytestmark = compares_forms

REALISMS = (IDEAL, REALISTIC, Realism(actuation=Actuation(delay=0.05, angular_acceleration=0.5)))
ROOM = parse_arena("8x7,box/a:0:0:0.3:0.3:0:1,box:2:2:1:0.1:20,pole:-2:2:0.1,segment:-3:-2:-1:-2")
STRANGE = (np.nan, np.inf, -np.inf, 1e300, 0.0, -0.0)
VISIBILITIES: tuple[Visibility, ...] = ("body", "real")


def bits_of_world(
    kinds: list[str], realism: Realism, visibility: Visibility, commands: Array
) -> list[bytes]:
    """The bytes of states, odometry and scans of a run with commands (k, n, 3), 10 steps each."""
    platforms = [load_platform(kind) for kind in kinds]
    starts = parse_layout("random:0.02", [p.footprint for p in platforms], ROOM, seed=1)
    robots = {f"r{row}": platform for row, platform in enumerate(platforms)}
    world = World(robots, ROOM, starts, realism=realism, lidars=LidarModel(visibility))
    kept: list[bytes] = []
    for turn, command in enumerate(commands):
        world.set_commands(command)
        if turn % 3 == 0:
            world.begin_scans(np.arange(len(kinds)))
        for _ in range(10):
            world.step()
            # Without the sign of a zero, which numpy's minimum leaves open.
            kept += [(world.poses() + 0.0).tobytes(), (world.twists() + 0.0).tobytes()]
            kept.append(repr(world.contacts()).encode())
            kept += [scan.ranges.tobytes() for _, scan in world.arrived_scans()]
        kept.append(repr([one.pose for one in world.odometry()]).encode())
    return kept


@settings(deadline=None, max_examples=examples(40))
@given(
    st.lists(st.sampled_from(platform_names()), min_size=1, max_size=6),
    st.sampled_from(REALISMS),
    st.sampled_from(VISIBILITIES),
    st.integers(0, 2**32 - 1),
)
def test_of_a_world(kinds: list[str], realism: Realism, visibility: Visibility, seed: int) -> None:
    rng = np.random.default_rng(seed)
    commands = rng.normal(0.0, 1.0, (8, len(kinds), 3))
    is_strange = rng.random(commands.shape) < 0.1
    commands[is_strange] = rng.choice(STRANGE, int(is_strange.sum()))
    found = []
    for is_compiled in ("1", "0"):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("SWARMD_COMPILED", is_compiled)
            found.append(bits_of_world(kinds, realism, visibility, commands))
    assert found[0] == found[1]


ARENAS = tuple(
    parse_arena(text)
    for text in (
        "4x4",
        "30x2",
        "7x6,box:1:1:0.5:0.3:30,box:-2:-1:0.2:1.5:-75,pole:-2:2:0.1,pole:2:-2:0.3,pole:0:0:0.02",
        "6x6,segment:-1:-2:1.5:-1.2,box/a:1:1:0.5:0.3:30:0.3,box/b:0:0:0.3:0.3:0:1",
    )
)
NOISES = (REALISTIC.lidar, LidarNoise(dropout=0.5), LidarNoise(near_sd=0.1))
BURGER, JACKAL = load_platform("burger"), load_platform("jackal")
WEDGE = np.array([[-0.2, 0.0], [0.2, -0.2], [0.2, 0.2]])
KINDS = (
    BURGER,
    load_platform("waffle_pi"),
    JACKAL,
    replace(BURGER, name="triangle", footprint=WEDGE),
    replace(JACKAL, name="fan", scan=replace(JACKAL.scan, bearings=np.linspace(-2.0, 2.0, 97))),
)


def bits_of_sensors(
    platforms: Sequence[Platform],
    arena: Arena,
    visibility: Visibility,
    noise: LidarNoise,
    at: Array,
) -> list[bytes]:
    rows = np.arange(len(platforms))
    exact = RangeSensors(platforms, arena, visibility).cast(at, rows)
    noisy = NoisyLidar(noise, platforms, [f"r{row}" for row in rows], 3)
    # The second time: the streams of random numbers stay side by side.
    return [row.tobytes() for ranges in (exact, *(noisy.apply(rows, exact) for _ in "12"))
            for row in ranges]  # fmt: skip


@st.composite
def poses(draw: st.DrawFn, arena: Arena, n: int) -> Array:
    """(n, 3): anywhere around the arena, often at round numbers; some rows are absent."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    half = np.array([0.6 * arena.length, 0.6 * arena.width, 4.0 * math.pi])
    drawn = np.round(rng.uniform(-half, half, (n, 3)), draw(st.sampled_from([0, 1, 15])))
    drawn[rng.random(n) < draw(st.sampled_from([0.0, 0.3])), :] = np.nan
    return drawn


@settings(deadline=None, max_examples=examples(80))
@given(st.data())
def test_of_sensors_anywhere(data: st.DataObject) -> None:
    platforms = data.draw(st.lists(st.sampled_from(KINDS), min_size=1, max_size=6))
    arena, noise = data.draw(st.sampled_from(ARENAS)), data.draw(st.sampled_from(NOISES))
    visibility: Visibility = data.draw(st.sampled_from(VISIBILITIES))
    at = data.draw(poses(arena, len(platforms) + len(arena.movable_boxes)))
    found = []
    for is_compiled in ("1", "0"):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("SWARMD_COMPILED", is_compiled)
            found.append(bits_of_sensors(platforms, arena, visibility, noise, at))
    assert found[0] == found[1]
