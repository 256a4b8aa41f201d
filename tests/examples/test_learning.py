"""The example of learning: a short training improves, and its file becomes a pattern."""

from __future__ import annotations

from pathlib import Path

import pytest

import swarmd
from swarmd.kit.policy_network import network_from_bytes, network_of, parameter_count
from swarmd.pattern_host.loader import import_file

EXAMPLE = Path(__file__).resolve().parents[2] / "examples/learning/train_aggregation.py"
HELD_OUT = range(3)


@pytest.mark.long
def test_three_generations_gather_robots_of_other_seeds() -> None:
    example = import_file(EXAMPLE)
    room = {**example.ROOM, "groups.tb3.count": 3, "duration": 10}
    env = swarmd.env("aggregation", set=room, spec=example.SPEC)
    *_, (generation, _, network) = example.train(env, 3600.0, generations=3, population=6)
    assert generation == 2
    start = network_of(example.SPEC, [0.0] * parameter_count(example.SPEC))  # type: ignore[arg-type]
    assert abs(example.score(env, start, HELD_OUT)) < 0.01  # it stands
    learned = network_from_bytes(network.to_bytes())
    assert example.score(env, learned, HELD_OUT) > 0.1
