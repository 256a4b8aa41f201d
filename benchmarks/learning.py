"""Steps of agents per second of processor time in the environment: `python -m benchmarks.learning`.

Random actions in one process. A step does the work of a step of an experiment (noisy lidars of 360
rays, odometry, protection), and computes observations and the reward. Each sample is 2 s of
simulation.

`--vmas PYTHON` measures VMAS in the same run, by an interpreter that has vmas and torch.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

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


def vmas_rows(python: str) -> Iterator[Row]:
    """One row for each task of VMAS with a lidar, number of agents and of environments."""
    script = str(Path(__file__).with_name("vmas_steps.py"))
    command = [python, "-W", "ignore", script, *map(str, AGENTS)]
    done = subprocess.run(command, stdout=subprocess.PIPE, check=True)
    for result in json.loads(done.stdout):
        what = (
            f"agent-steps a CPU-second, VMAS {result['task']}, {result['agents']} agents, "
            f"{result['rays']} rays, environments: {result['environments']}"
        )
        yield Row(what, result["rates"], unit="")


def main(words: Sequence[str] = ()) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.learning")
    parser.add_argument("--vmas", metavar="PYTHON", help="an interpreter that has vmas and torch")
    python = parser.parse_args(words).vmas
    table_rows = [*rows(), *(vmas_rows(python) if python else ())]
    print_table("Environment for learning, one processor", table_rows)


if __name__ == "__main__":
    main(sys.argv[1:])
