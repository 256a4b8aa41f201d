"""Speed of the simulator VMAS: `PYTHON vmas_steps.py AGENTS RAYS RANGE NEAR SECONDS ENVIRONMENTS`.

Prints the simulated robot-seconds, of all environments, and their CPU seconds. PYTHON is an
interpreter with vmas and torch, which are no dependencies of swarmd. Discs with differential drive
in a square; a step computes all environments at once, on one thread.

`PYTHON vmas_steps.py TASK AGENTS SECONDS ENVIRONMENTS` measures a task of VMAS with random actions.
"""

from __future__ import annotations

import contextlib
import math
import sys
import time
from typing import Any

import torch
import vmas
from vmas.simulator.core import Agent, Sphere, World
from vmas.simulator.dynamics.diff_drive import DiffDrive
from vmas.simulator.scenario import BaseScenario
from vmas.simulator.sensors import Lidar

STEP = 0.1  # s
SPEED, TURN = 0.2, 1.0  # m/s, rad/s
AHEAD = 1.0  # rad to each side
TASKS: dict[str, dict[str, Any]] = {
    "navigation": {},
    "navigation_360": {"n_lidar_rays": 360},
    "flocking": {},
    "discovery": {"use_agent_lidar": True},
    "sampling": {},
}
"""The tasks of VMAS with a lidar, which BenchMARL uses, too."""


class Walk(BaseScenario):  # type: ignore[misc]  # vmas is not installed where types are checked
    """Discs that observe the rays of their lidars."""

    def make_world(self, batch_dim: int, device: Any, **words: Any) -> World:
        """A square of 1 m2 a robot."""
        self._half = math.sqrt(words["robots"]) / 2.0
        world = World(batch_dim, device, dt=STEP, x_semidim=self._half, y_semidim=self._half)
        for index in range(words["robots"]):
            lidar = Lidar(
                world,
                n_rays=words["rays"],
                max_range=words["range_max"],
                entity_filter=lambda entity: isinstance(entity, Agent),
                render=False,
            )
            agent = Agent(
                name=f"agent_{index}",
                shape=Sphere(0.15),
                sensors=[lidar],
                dynamics=DiffDrive(world, integration="euler"),
            )
            world.add_agent(agent)
        return world

    def reset_world_at(self, env_index: int | None = None) -> None:
        """Random poses."""
        for agent in self.world.agents:
            place = (2.0 * torch.rand(self.world.batch_dim, 2) - 1.0) * self._half
            yaw = 2.0 * math.pi * torch.rand(self.world.batch_dim, 1)
            agent.set_pos(place if env_index is None else place[0], batch_index=env_index)
            agent.set_rot(yaw if env_index is None else yaw[0], batch_index=env_index)

    def observation(self, agent: Agent) -> torch.Tensor:
        """The distances of the rays, by environment."""
        rays: torch.Tensor = agent.sensors[0].measure()
        return rays

    def reward(self, agent: Agent) -> torch.Tensor:
        """None."""
        return torch.zeros(self.world.batch_dim)


def measure(
    robots: int, rays: int, range_max: float, near: float, seconds: float, environments: int
) -> tuple[float, float]:
    """Robot-seconds that were simulated, and their CPU seconds, at least `seconds`."""
    env = vmas.make_env(
        scenario=Walk(),
        num_envs=environments,
        device="cpu",
        continuous_actions=True,
        seed=0,
        robots=robots,
        rays=rays,
        range_max=range_max,
    )
    seen = env.reset()
    bearings = torch.linspace(0.0, 2.0 * math.pi, rays + 1)[:-1]
    is_ahead = torch.cos(bearings) > math.cos(AHEAD)

    def actions() -> list[torch.Tensor]:
        is_near = [one[:, is_ahead].min(dim=1).values < near for one in seen]
        return [torch.stack([SPEED * ~one, TURN * one], dim=1).float() for one in is_near]

    def advance(least: float) -> tuple[int, float]:
        nonlocal seen
        start = time.process_time()
        steps = 0
        while (taken := time.process_time() - start) < least:
            seen = env.step(actions())[0]
            steps += 1
        return steps, taken

    advance(seconds / 2.0)
    steps, taken = advance(seconds)
    return robots * environments * steps * STEP, taken


def measure_task(task: str, agents: int, seconds: float, environments: int) -> tuple[float, float]:
    """Agent-steps of a task of VMAS with random actions, and their CPU seconds."""
    env = vmas.make_env(
        scenario=task.partition("_")[0],
        num_envs=environments,
        device="cpu",
        continuous_actions=True,
        seed=0,
        n_agents=agents,
        **TASKS[task],
    )
    env.reset()

    def advance(least: float) -> tuple[int, float]:
        start = time.process_time()
        steps = 0
        while (taken := time.process_time() - start) < least:
            env.step([env.get_random_action(agent) for agent in env.agents])
            steps += 1
        return steps, taken

    advance(seconds / 2.0)
    steps, taken = advance(seconds)
    return float(agents * environments * steps), taken


if __name__ == "__main__":
    torch.set_num_threads(1)
    with contextlib.redirect_stdout(sys.stderr):  # gym greets
        if sys.argv[1] in TASKS:
            found = measure_task(
                sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])
            )
        else:
            farthest, turns_at, cpu = map(float, sys.argv[3:6])
            cell = int(sys.argv[1]), int(sys.argv[2]), farthest, turns_at, cpu, int(sys.argv[6])
            found = measure(*cell)
    print(*found)
