"""Robots of which some do not see each other keep apart by where they tell to be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.scenarios.scenariofile import load_scenario
from swarmd.sim.trace import Trace

UNTOLD = {"radio.range_and_bearing": False, "accepts_unseen": ["burger", "waffle_pi"]}


def mixed(seed: int, changes: Mapping[str, Any] | None = None) -> Trace:
    return simulate_run(load_scenario("mixed_real", {"duration": 8.0, **(changes or {})}), seed)


@pytest.mark.parametrize(
    "seed", [20210, *(pytest.param(seed, marks=pytest.mark.evidence) for seed in (20201, 20208))]
)
def test_robots_that_are_told_do_not_touch_and_go_on(seed: int) -> None:
    trace = mixed(seed)
    assert len(trace.contact_t) == 0
    assert (abs(trace.pose[-1, :, :2] - trace.pose[0, :, :2]).max(axis=1) > 0.1).mean() > 0.7


def test_the_same_robots_touch_where_nobody_tells() -> None:
    trace = mixed(20210, UNTOLD)
    assert trace.contact_speed.max() > 0.3
