"""Physics steps and the whole simulated second, by the number of robots: `benchmarks.world`."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial

import numpy as np

from benchmarks.lidar import SIZES, make_world, samples
from benchmarks.table import Row, print_table
from swarmd.sim.world.odometer import ODOMETRY_RATE
from swarmd.sim.world.realism import REALISMS
from swarmd.sim.world.world import World

SCAN_RATE = 5


def drive(world: World) -> None:
    rng = np.random.default_rng(1)
    world.set_commands(rng.uniform(-1.0, 1.0, (len(world.ids), 3)) * [0.2, 1.0, 0.0])


def simulated_second(world: World) -> None:
    """100 steps, and each robot's scans and odometry spread over them."""
    robots = np.arange(len(world.ids))
    for step in range(round(1.0 / world.dt)):
        world.step()
        for sense, rate in ((world.begin_scans, SCAN_RATE), (world.odometry, ODOMETRY_RATE)):
            period = round(1.0 / (rate * world.dt))
            due = robots[robots % period == step % period]
            if len(due):
                sense(due)
        world.arrived_scans()


def rows() -> Iterator[Row]:
    for n in SIZES:
        start = time.perf_counter()
        world = make_world(n)
        yield Row(f"world made, {n} robots", [time.perf_counter() - start])
        drive(world)
        yield Row(f"step of 10 ms, {n} robots", samples(partial(world.step, 10), 10))
        yield from whole_rows(n)


def whole_rows(n: int) -> Iterator[Row]:
    for name, realism in REALISMS.items():
        world = make_world(n, realism)
        drive(world)
        taken = samples(partial(simulated_second, world), 1)
        yield Row(
            f"times real time, {n} robots, {name}",
            [1.0 / seconds for seconds in taken],
            note=f"physics, {SCAN_RATE} scans and {ODOMETRY_RATE:.0f} odometries a second each,"
            " no patterns",
            unit="x",
        )


def main() -> None:
    print_table("World", rows())


if __name__ == "__main__":
    main()
