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
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct, structs

import swarmd
from benchmarks.table import markdown
from studies import keeper, kept
from swarmd.core.pin import restart_pinned
from swarmd.core.values import Array
from swarmd.kit.observation import Observation
from swarmd.kit.policy_network import PolicyNetwork, from_text, network_from_bytes
from swarmd.patterns.policy.pattern import Policy

ROOM: Mapping[str, Any] = {
    "arena": {"size": [4, 4], "boxes": [], "poles": []},
    "groups.tb3.count": 4,
    "duration": 20,
}
EXAMPLE = Path(__file__).resolve().parents[1] / "examples/learning/train_aggregation.py"
GENERATIONS = 23
"""Of each training."""
DECISIONS = 4 * 98
"""Of a run: four robots decide five times a second for 20 s, without the first 0.4 s, in which
sensors are read for the first time."""
MODES = ("barrier", "off")
"""The modes of protection."""
SHIPPED = "pattern `policy`"
RANDOM = "random"
TRAINED = "trained with "
Act = Callable[[Observation], Array]


class Training(Struct, frozen=True):
    """A training in a mode of protection."""

    mode: str
    generations: int


class Run(Struct, frozen=True):
    """A run to do.

    `actions`: SHIPPED, RANDOM, or TRAINED with the mode of protection of the training, which then
    had so many `generations`. `number`: the number of runs of random actions before it.
    """

    actions: str
    mode: str
    seed: int
    generations: int = 0
    number: int = 0


class Values(Struct, frozen=True):
    """What a run gave."""

    returned: float
    """m."""
    limited: float
    """The share of decisions in which protection changed the request."""
    contacts: float
    """A robot-minute."""


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The results of runs, (seeds,) each, as in `Values`."""

    returns: Array
    limited: Array
    contacts: Array


def shipped() -> PolicyNetwork:
    """The network of pattern `policy`."""
    return from_text(Policy.network)


def random_actions(seed: int = 0, run: int = 0) -> Act:
    """Actions that are drawn evenly; those of run 1 follow those of run 0, and so on."""
    spec = shipped().spec
    bits = np.random.PCG64(seed)
    bits.advance(run * DECISIONS * spec.actions)
    rng = np.random.Generator(bits)
    return lambda observation: rng.uniform(-1.0, 1.0, spec.actions)


def measure(act: Act, seeds: Sequence[int], mode: str = "barrier") -> Found:
    """Run the environment with the actions of `act`, once for each seed, in a protection mode."""
    return found_of([_measured(act, seed, mode) for seed in seeds])


def found_of(runs: Iterable[Values]) -> Found:
    """The values of runs as arrays."""
    return Found(*np.array([structs.astuple(run) for run in runs]).T)


def _measured(act: Act, seed: int, mode: str) -> Values:
    env = swarmd.env(
        "aggregation",
        set={**ROOM, "platforms.waffle_pi.protection.mode": mode},
        spec=shipped().spec,
        reward={"mean_distance_to_centroid_end": -1.0},
    )
    observations, _ = env.reset(seed)
    total = 0.0
    limited = 0
    contacts = 0
    steps = 0
    while env.agents:
        actions = {agent: act(observations[agent]) for agent in env.agents}
        observations, rewards, _, _, infos = env.step(actions)
        total += float(np.mean(list(rewards.values())))
        limited += sum(info["limited"] for info in infos.values())
        contacts += sum(info["contacts"] for info in infos.values())
        steps += len(infos)
    minutes = steps * env.spec.period / 60.0
    return Values(total, limited / steps, contacts / minutes)


def train(training: Training) -> bytes:
    """The file of the network that the example's program trains."""
    mode = training.mode
    generations = str(training.generations)
    options = ["--protection", mode, "--generations", generations, "--seconds", "1e9"]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "network.npz"
        command = [sys.executable, str(EXAMPLE), str(file), *options]
        subprocess.run(command, check=True, stdout=sys.stderr)
        return file.read_bytes()


def perform(run: Run) -> Values:
    """Measure a run in this process; a network that is trained has a record."""
    if run.actions == RANDOM:
        act = random_actions(run=run.number)
    elif run.actions == SHIPPED:
        act = shipped().act
    else:
        act = _trained(Training(run.actions.removeprefix(TRAINED), run.generations)).act
    return _measured(act, run.seed, run.mode)


@cache
def _trained(training: Training) -> PolicyNetwork:
    """The trained network; cached, since a look for its record takes longer than a run."""
    return network_from_bytes(keeper.records(train, [training])[0].found)


def runs_of(actions: Sequence[str], seeds: Sequence[int], generations: int) -> list[Run]:
    """The runs of all kinds of actions in all modes of protection."""
    return [
        Run(
            kind,
            mode,
            seed,
            generations if kind.startswith(TRAINED) else 0,
            row * len(seeds) + column if kind == RANDOM else 0,
        )
        for kind in actions
        for row, mode in enumerate(MODES)
        for column, seed in enumerate(seeds)
    ]


def table(records: Sequence[keeper.Record[Run, Values]]) -> str:
    """Markdown: a row for each kind of actions in each mode."""
    rows = [["actions", "protection", "return [m]", "changed", "contacts a robot-minute"]]
    groups: dict[tuple[str, str], list[Values]] = {}
    for record in records:
        groups.setdefault((record.task.actions, record.task.mode), []).append(record.found)
    for names, some in groups.items():
        found = found_of(some)
        rows.append([*names, *map(kept.mean_of, (found.returns, found.limited, found.contacts))])
    return markdown(rows)


def main() -> None:
    """Train, run, and print the table; fewer seeds also mean fewer generations."""
    options = kept.chosen("learning", __doc__)
    generations = GENERATIONS * options.seeds // kept.SEEDS
    keeper.records(train, [Training(mode, generations) for mode in MODES], jobs=options.jobs)
    actions = (SHIPPED, RANDOM, *(f"{TRAINED}{mode}" for mode in MODES))
    runs = runs_of(actions, range(options.seeds), generations)
    kept.print_parts({"learning": table(keeper.records(perform, runs, jobs=options.jobs))})


if __name__ == "__main__":
    restart_pinned()  # as in a night, so that runs have its bits
    main()
