"""Return of learned policies, and the effect of protection on them: `python -m studies.learning`.

Four Waffle Pis in 4 x 4 m, 20 s, as in examples/learning, with seeds
that the training did not use; two further policies are trained here, with protection and without.
Prints the table of docs/learning.md: the return (the decrease in m of the mean distance to the
centroid), the share of decisions in which protection changed the request, and contacts per
robot-minute, each as the mean over seeds with its 95 % interval. The same command resumes.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import swarmd
from benchmarks.table import markdown
from studies import kept
from swarmd.core.values import Array
from swarmd.kit.observation import Observation
from swarmd.kit.policy_network import PolicyNetwork, from_text, network_from_bytes
from swarmd.patterns.policy.pattern import Policy

ROOM = {
    "arena": {"size": [4, 4], "boxes": [], "poles": []},
    "groups.tb3.count": 4,
    "duration": 20,
}
EXAMPLE = Path(__file__).resolve().parents[1] / "examples/learning/train_aggregation.py"
GENERATIONS = 23
"""Of each training."""
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


def trained(mode: str, generations: int, folder: Path) -> PolicyNetwork:
    """The network of the example's program after so many generations in a mode of protection.

    It is kept in `folder`.
    """
    file = folder / f"{mode}-{generations}.npz"
    if not file.exists():
        folder.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(".part.npz")
        options = ["--protection", mode, "--generations", str(generations), "--seconds", "1e9"]
        subprocess.run(
            [sys.executable, str(EXAMPLE), str(part), *options], check=True, stdout=sys.stderr
        )
        part.rename(file)
    return network_from_bytes(file.read_bytes())


def table(kinds: Mapping[str, Act], seeds: Sequence[int]) -> str:
    """Markdown: a row for each kind of actions in both modes."""
    rows = [["actions", "protection", "return [m]", "changed", "contacts a robot-minute"]]
    for name, act in kinds.items():
        for mode in ("barrier", "off"):
            found = measure(act, seeds, mode)
            rows.append(
                [name, mode, *map(kept.mean_of, (found.returns, found.limited, found.contacts))]
            )
    return markdown(rows)


def main() -> None:
    """Train, run, and print the table; fewer seeds also mean fewer generations."""
    seeds, folder = kept.chosen("learning", __doc__).seeds, kept.kept_folder("learning")
    acts = {"pattern `policy`": shipped().act, "random": random_actions()}
    for mode in ("barrier", "off"):
        acts[f"trained with {mode}"] = trained(mode, GENERATIONS * seeds // kept.SEEDS, folder).act
    kept.print_parts({"learning": table(acts, range(seeds))})


if __name__ == "__main__":
    main()
