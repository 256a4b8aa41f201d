"""One 360-ray scan by the number of robots: `benchmarks.lidar`.

One Waffle Pi a square metre. Lockstep casts several at once (1000 robots at 5 Hz: 50 a
step), the live server one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np

from benchmarks.table import Row, print_table
from swarmd.settings.platforms import load_platform
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.layouts import parse_layout
from swarmd.sim.world.realism import IDEAL, Realism
from swarmd.sim.world.world import World

SIZES = (7, 100, 1000)
BATCH = 50
SECONDS = 1.0


def make_world(n: int, realism: Realism = IDEAL) -> World:
    platform = load_platform("waffle_pi")
    side = max(4.0, n**0.5 + 1.0)
    arena = Arena(side, side)
    starts = parse_layout("grid:1.0", [platform.footprint] * n, arena, seed=0)
    starts[:, 2] = np.random.default_rng(0).uniform(-3.0, 3.0, n)
    return World({f"r{i}": platform for i in range(n)}, arena, starts, realism=realism)


def samples(work: Callable[[], object], per: int) -> list[float]:
    """Seconds for one of the `per` items that each call of `work` does, over SECONDS."""
    taken: list[float] = []
    end = time.perf_counter() + SECONDS
    while not taken or time.perf_counter() < end:
        start = time.perf_counter()
        work()
        taken.append((time.perf_counter() - start) / per)
    return taken


def rows() -> Iterator[Row]:
    for n in SIZES:
        yield from rows_of(make_world(n))


def rows_of(world: World) -> Iterator[Row]:
    n = len(world.ids)
    batch = np.arange(min(n, BATCH))
    together = samples(lambda: world.scans(batch), len(batch))
    goal = "35 us" if n == 1000 else ""
    yield Row(f"scan, {n} robots, {len(batch)} at once", together, goal)
    yield Row(f"scan, {n} robots, one", samples(lambda: world.scans(batch[:1]), 1))


def main() -> None:
    print_table("Range sensor, 360 rays", rows())


if __name__ == "__main__":
    main()
