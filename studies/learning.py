"""Return of learned policies, and the effect of protection on them: `python -m studies.learning`.

Four Waffle Pis in 4 x 4 m, 20 s, as in examples/learning, with seeds
that the training did not use. Prints a table: the return (the decrease in m of the mean distance to
the centroid), the share of decisions in which protection changed the request, and contacts per
robot-minute, each as the mean over seeds with its 95 % interval.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import swarmd
from swarmd.core.values import Array
from swarmd.kit.observation import Observation
from swarmd.kit.policy_network import PolicyNetwork, from_text, network_from_bytes
from swarmd.patterns.policy.pattern import Policy
from swarmd.sim.experiments.statistics import mean_interval

ROOM = {
    "arena": {"size": [4, 4], "boxes": [], "poles": []},
    "groups.tb3.count": 4,
    "duration": 20,
}
EXAMPLE = Path(__file__).resolve().parents[1] / "examples/learning/train_aggregation.py"
Act = Callable[[Observation], Array]


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The results of runs, (seeds,) each."""

    returns: Array  # m
    limited: Array  # share of decisions in which protection changed the request
    contacts: Array  # per robot-minute


def shipped() -> PolicyNetwork:
    """The network of pattern `policy`."""
    return from_text(Policy.network)


def random_actions(seed: int = 0) -> Act:
    """Actions that are drawn evenly."""
    rng, count = np.random.default_rng(seed), shipped().spec.actions
    return lambda observation: rng.uniform(-1.0, 1.0, count)


def measure(act: Act, seeds: Sequence[int], mode: str = "barrier") -> Found:
    """Run the environment with the actions of `act`, once for each seed, in a protection mode."""
    env = swarmd.env(
        "aggregation",
        set={**ROOM, "platforms.waffle_pi.protection.mode": mode},
        spec=shipped().spec,
        reward={"mean_distance_to_centroid_end": -1.0},
    )
    rows = []
    for seed in seeds:
        observations, _ = env.reset(seed)
        total, limited, contacts, steps = 0.0, 0, 0, 0
        while env.agents:
            actions = {agent: act(observations[agent]) for agent in env.agents}
            observations, rewards, _, _, infos = env.step(actions)
            total += float(np.mean(list(rewards.values())))
            limited += sum(info["limited"] for info in infos.values())
            contacts += sum(info["contacts"] for info in infos.values())
            steps += len(infos)
        minutes = steps * env.spec.period / 60.0
        rows.append((total, limited / steps, contacts / minutes))
    return Found(*np.array(rows).T)


def trained(mode: str, generations: int) -> PolicyNetwork:
    """The network of the example's program after so many generations in a mode of protection."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "policy.npz"
        options = ["--protection", mode, "--generations", str(generations), "--seconds", "1e9"]
        subprocess.run([sys.executable, str(EXAMPLE), str(file), *options], check=True)
        return network_from_bytes(file.read_bytes())


def table(kinds: Mapping[str, Act], seeds: Sequence[int]) -> list[str]:
    """The lines of the table in Markdown, of each kind of actions in both modes."""
    lines = ["| actions | protection | return, m | changed | contacts a robot-minute |"]
    lines.append("|---|---|---|---|---|")
    for name, act in kinds.items():
        for mode in ("barrier", "off"):
            measured = measure(act, seeds, mode)
            cells = map(_shown, (measured.returns, measured.limited, measured.contacts))
            lines.append(f"| {name} | {mode} | {' | '.join(cells)} |")
    return lines


def _shown(values: Array) -> str:
    interval = mean_interval(values)
    mean = f"{values.mean():.2f}"
    return mean if interval is None else f"{mean} ({interval.low:.2f} to {interval.high:.2f})"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m studies.learning", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="runs of each row [20]")
    parser.add_argument("--train", type=int, default=0, help="also train so many generations [0]")
    chosen = parser.parse_args()
    acts = {"policy": shipped().act, "random": random_actions()}
    for protection in ("barrier", "off") if chosen.train else ():
        acts[f"trained with {protection}"] = trained(protection, chosen.train).act
    print("\n".join(table(acts, range(chosen.seeds))))
