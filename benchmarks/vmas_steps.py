"""Speed of the simulator VMAS: `PYTHON benchmarks/vmas_steps.py AGENTS [AGENTS ...]`.

The speed is in agent-steps per second of processor time. PYTHON is an interpreter with vmas and
torch, which are no dependencies of swarmd; `python -m benchmarks.learning --vmas PYTHON` runs this
file. The tasks are those of VMAS with a lidar, which BenchMARL uses, too. Actions are random, in
one environment and in 32 at once, on one thread. Prints a JSON list of rows: task, agents,
environments, rays, and the speed of each sample.
"""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Iterator
from typing import Any

import torch
import vmas

TASKS: dict[str, dict[str, Any]] = {
    "navigation": {},
    "navigation, 360 rays": {"n_lidar_rays": 360},
    "flocking": {},
    "discovery": {"use_agent_lidar": True},
    "sampling": {},
}
ENVIRONMENTS = (1, 32)
SAMPLES, SECONDS = 5, 1.0


def rates(task: str, agents: int, environments: int) -> tuple[int, list[float]]:
    """The rays of an agent, and agent-steps per processor second by sample.

    A first sample, for warming up, is discarded.
    """
    env = vmas.make_env(
        scenario=task.partition(",")[0],
        num_envs=environments,
        device="cpu",
        continuous_actions=True,
        seed=0,
        n_agents=agents,
        **TASKS[task],
    )
    env.reset()
    found = []
    for _ in range(SAMPLES + 1):
        start, steps = time.process_time(), 0
        while time.process_time() - start < SECONDS:
            env.step([env.get_random_action(agent) for agent in env.agents])
            steps += 1
        found.append(agents * environments * steps / (time.process_time() - start))
    rays = sum(sensor.measure().shape[-1] for sensor in env.agents[0].sensors)
    return rays, found[1:]


def rows(agents: list[int]) -> Iterator[dict[str, Any]]:
    """A row for each task, number of agents and number of environments."""
    for task in TASKS:
        for count in agents:
            for environments in ENVIRONMENTS:
                rays, found = rates(task, count, environments)
                yield {
                    "task": task.partition(",")[0],
                    "agents": count,
                    "environments": environments,
                    "rays": rays,
                    "rates": found,
                }


if __name__ == "__main__":
    torch.set_num_threads(1)
    with contextlib.redirect_stdout(sys.stderr):  # gym greets
        measured = list(rows([int(word) for word in sys.argv[1:]]))
    print(json.dumps(measured))
