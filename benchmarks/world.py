"""Physics steps and the whole simulated second, by the number of robots: `benchmarks.world`."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from benchmarks.lidar import SIZES, make_world, samples
from benchmarks.table import Row, print_table
from swarmd.sim.world.world import World

SCAN_RATE = 5


def drive(world: World) -> None:
    rng = np.random.default_rng(1)
    world.set_commands(rng.uniform(-1.0, 1.0, (len(world.ids), 3)) * [0.2, 1.0, 0.0])


def simulated_second(world: World) -> None:
    """100 steps, and each robot's sweeps spread over them."""
    period = round(1.0 / (SCAN_RATE * world.dt))
    everyone = np.arange(len(world.ids))
    for step in range(round(1.0 / world.dt)):
        world.step()
        due = everyone[everyone % period == step % period]
        if len(due):
            world.scans(due)


def rows() -> Iterator[Row]:
    for n in SIZES:
        start = time.perf_counter()
        world = make_world(n)
        yield Row(f"world made, {n} robots", [time.perf_counter() - start])
        yield from rows_of(world)


def rows_of(world: World) -> Iterator[Row]:
    n = len(world.ids)
    drive(world)
    yield Row(f"step of 10 ms, {n} robots", samples(lambda: world.step(10), 10))
    factors = [1.0 / taken for taken in samples(lambda: simulated_second(world), 1)]
    note = f"physics and {SCAN_RATE} sweeps a second each, no patterns"
    yield Row(f"times real time, {n} robots", factors, note=note, unit="x")


def main() -> None:
    print_table("World", rows())


if __name__ == "__main__":
    main()
