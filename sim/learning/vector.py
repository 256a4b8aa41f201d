"""Many environments at once, in worker processes: gymnasium's AsyncVectorEnv over whole swarms.

::

    from swarmd.sim.learning.vector import vector_env

    envs = vector_env(4, "aggregation", seed=1)
    observations, infos = envs.reset()                     # (4, agents, numbers)
    observations, rewards, *_ = envs.step(envs.action_space.sample())
    envs.close()
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AsyncVectorEnv
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError
from swarmd.kit.observation import Observation
from swarmd.sim.experiments.plan import check_seeds
from swarmd.sim.learning.environment import SwarmEnv, env
from swarmd.sim.scenarios.scenario import Scenario

Swarm = NDArray[np.float32]
"""(agents, numbers): observations or actions of all agents that a run can have."""


class JointEnv(gymnasium.Env[Swarm, Swarm]):
    """A SwarmEnv as a gymnasium environment of one agent: row i is `possible_agents[i]`.

    The row of an absent agent is zero, and its action has no effect. The reward is the mean over
    the agents that were present before or after the step. `infos` have `rewards` (agents,) and
    `present` (agents,) bool.
    """

    def __init__(self, swarm: SwarmEnv) -> None:
        self.swarm = swarm
        self.agents = list(swarm.possible_agents)
        spec = swarm.spec
        n = len(self.agents)
        self.observation_space = Box(-1.0, 1.0, (n, spec.size), np.float32)
        self.action_space = Box(-1.0, 1.0, (n, spec.actions), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Swarm, dict[str, Any]]:
        """Begin a run; see SwarmEnv.reset."""
        super().reset(seed=seed)
        observations, _ = self.swarm.reset(seed, options)
        return self._rows(observations), self._info({})

    def step(self, action: Swarm) -> tuple[Swarm, float, bool, bool, dict[str, Any]]:
        """Hand the actions (agents, numbers) over and simulate a period."""
        given = dict(zip(self.agents, action, strict=True))
        observations, rewards, terminations, truncations, _ = self.swarm.step(
            {agent: given[agent] for agent in self.swarm.agents}
        )
        mean = float(np.mean(list(rewards.values()))) if rewards else 0.0
        is_truncated = any(truncations.values())
        is_over = not self.swarm.agents and not is_truncated
        living = [agent for agent in observations if not terminations[agent]]
        there = {agent: observations[agent] for agent in living}
        return self._rows(there), mean, is_over, is_truncated, self._info(rewards)

    def close(self) -> None:
        """Discard the run."""
        self.swarm.close()

    def _rows(self, observations: dict[str, Observation]) -> Swarm:
        rows = np.zeros((len(self.agents), self.swarm.spec.size), dtype=np.float32)
        for row, agent in enumerate(self.agents):
            if agent in observations:
                rows[row] = observations[agent]
        return rows

    def _info(self, rewards: dict[str, float]) -> dict[str, Any]:
        return {
            "rewards": np.array([rewards.get(agent, 0.0) for agent in self.agents]),
            "present": np.array([agent in self.swarm.agents for agent in self.agents]),
        }


def vector_env(
    n: int, scenario: str | Path | Scenario, seed: int | None = None, **options: Any
) -> AsyncVectorEnv:
    """`n` environments, each in a process of its own.

    Observations and actions are arrays (n, agents, numbers). `options`: keyword arguments of `env`.
    Environment i begins with `seed` + i. An environment whose run is over begins its next run at
    the following step. Call `close` at the end. ConfigError for an invalid argument, as in `env`.
    """
    if n < 1:
        raise ConfigError(f"vector_env of {n}; expected 1 or more")
    seeds = [None] * n if seed is None else check_seeds(seed + index for index in range(n))
    env(scenario, seed, **options)  # for its ConfigError, which a worker process could not raise
    makers = [partial(_make, scenario, env_seed, options) for env_seed in seeds]
    return AsyncVectorEnv(makers, context="forkserver")


def _make(scenario: str | Path | Scenario, seed: int | None, options: dict[str, Any]) -> JointEnv:
    return JointEnv(env(scenario, seed, **options))
