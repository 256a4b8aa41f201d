"""Steps of agents per second of processor time in the environment: `python -m benchmarks.learning`.

Random actions in one process. A step does the work of a step of an experiment (noisy lidars of 360
rays, odometry, protection), and computes observations and the reward. Each sample is 2 s of
simulation.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import numpy as np

import swarmd
from benchmarks.table import Row, print_table

AGENTS = (7, 15)
PARTS, STEPS = 10, 20


def rates(agents: int, mode: str, parts: int = PARTS) -> list[float]:
    """Agent-steps a processor second of each part, after a first one."""
    side = math.ceil(math.sqrt(3.0 * agents))
    env = swarmd.env(
        "aggregation",
        seed=0,
        set={
            "arena": {"size": [side, side], "boxes": [], "poles": []},
            "groups.tb3.count": agents,
            "duration": 0.1 * STEPS * (parts + 2),
            "realism": "realistic",
            "platforms.waffle_pi.protection.mode": mode,
        },
    )
    env.reset()
    random, rates_of_parts = np.random.default_rng(0), []
    for _ in range(parts + 1):
        start = time.process_time()
        for _ in range(STEPS):
            env.step({agent: random.uniform(-1.0, 1.0, 2) for agent in env.agents})
        rates_of_parts.append(agents * STEPS / (time.process_time() - start))
    return rates_of_parts[1:]


def rows(parts: int = PARTS) -> Iterator[Row]:
    """One row for each number of agents and mode."""
    for agents in AGENTS:
        for mode in ("barrier", "off"):
            what = f"agent-steps a CPU-second, {agents} agents, 360 rays, {mode}"
            yield Row(what, rates(agents, mode, parts), unit="")


def main() -> None:
    print_table("Environment for learning, one processor", rows())


if __name__ == "__main__":
    main()
