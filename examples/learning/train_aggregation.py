"""Learn to gather: CMA-ES evolves a small network in five minutes.

    python train_aggregation.py gather.npz                    # trains, and writes gather.npz
    swarmctl plugin new gather --policy gather.npz            # gather.py: a pattern for robots

docs/learning.md explains the parts.
"""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import cma
import numpy as np

import swarmd
from swarmd.kit.observation import PolicySpec, RobotsPart, ScanPart
from swarmd.kit.policy_network import PolicyNetwork, network_of, parameter_count
from swarmd.sim.learning.environment import SwarmEnv

PARTS = (RobotsPart(sectors=6, range=3.5), ScanPart(sectors=6, range=1.0))
SPEC = PolicySpec(PARTS, period=0.2)  # the lidar of a Waffle Pi turns five times a second
ROOM = {
    "arena": {"size": [4, 4], "boxes": [], "poles": []},
    "groups.tb3.count": 4,
    "duration": 20,
}
SEEDS = 1000  # training draws from here on, so that seeds below are held out


def score(env: SwarmEnv, network: PolicyNetwork, seeds: Iterable[int]) -> float:
    """The mean return of a robot: by how many m the mean distance to the centroid fell."""
    returns = []
    for seed in seeds:
        observations, _ = env.reset(seed)
        total = 0.0
        while env.agents:
            actions = {agent: network.act(observations[agent]) for agent in env.agents}
            observations, rewards, *_ = env.step(actions)
            total += float(np.mean(list(rewards.values())))
        returns.append(total)
    return float(np.mean(returns))


def train(
    env: SwarmEnv, seconds: float, *, generations: int = 10_000, population: int = 10, seed: int = 1
) -> Iterator[tuple[int, float, PolicyNetwork]]:
    """The number, the mean score of the candidates and the mean network of each generation."""
    options = {"seed": seed, "popsize": population, "verbose": -9}
    strategy = cma.CMAEvolutionStrategy([0.0] * parameter_count(SPEC), 0.5, options)
    end = time.monotonic() + seconds
    for generation in range(generations):
        seeds = [SEEDS + generation]  # the same for all candidates
        candidates = strategy.ask()
        scores = [score(env, network_of(SPEC, one), seeds) for one in candidates]
        strategy.tell(candidates, [-one for one in scores])
        yield generation, float(np.mean(scores)), network_of(SPEC, strategy.mean)
        if time.monotonic() > end:
            return


def main() -> None:
    """Train, and write the last mean network."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("out", type=Path, help="the file to write, such as gather.npz")
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--generations", type=int, default=10_000, help="end after so many")
    parser.add_argument("--protection", default="barrier", help="a mode: barrier, or off")
    options = parser.parse_args()
    mode = {"platforms.waffle_pi.protection.mode": options.protection}
    env = swarmd.env("aggregation", set={**ROOM, **mode}, spec=SPEC)
    generations = train(env, options.seconds, generations=options.generations)
    with contextlib.suppress(KeyboardInterrupt):
        for generation, mean, network in generations:
            options.out.write_bytes(network.to_bytes())
            print(f"generation {generation}: mean score {mean:.3f} m", flush=True)
    print(f"{options.out}: {'the network so far' if options.out.exists() else 'not written'}")


if __name__ == "__main__":
    main()
