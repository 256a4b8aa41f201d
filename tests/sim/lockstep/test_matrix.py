"""Every pattern runs on every platform that has its needs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from swarmd.operator.cli.plugin_check import describe_patterns
from swarmd.plugins import installed_patterns
from swarmd.settings.platforms import load_platform, platform_names
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.scenarios.scenariofile import scenario_of
from tests.support.examples import part

OURS = [n for n, one in installed_patterns().items() if one.value.startswith("swarmd.patterns.")]
OF_THE_RADIO = {"neighbors", "neighbors.distance", "neighbors.bearing", "neighbors.heading"}
APART = 6.0


@pytest.fixture(scope="module")
def needs() -> Mapping[str, frozenset[str]]:
    """The inputs that each pattern needs, as operators see them."""
    rows = describe_patterns(OURS, None, "burger")
    return {row["name"]: frozenset(row["needs"]) for row in rows}


@pytest.mark.integration
def test_every_platform_can_run_most_patterns(needs: Mapping[str, frozenset[str]]) -> None:
    assert set(needs) == set(OURS)
    assert all(len(_fitting(needs, platform)) >= 10 for platform in platform_names())


@pytest.mark.integration
@pytest.mark.long
@pytest.mark.parametrize("seconds", part([1.0], [3.0]))
@pytest.mark.parametrize("platform", platform_names())
def test_every_pattern_runs_on_a_platform_that_has_its_needs(
    platform: str, seconds: float, needs: Mapping[str, frozenset[str]]
) -> None:
    names = _fitting(needs, platform)
    trace = simulate_run(scenario_of(_scenario(names, platform, seconds, needs)), 0)
    ran = {robot: name for name in names for robot in (f"{_group(name)}-01", f"{_group(name)}-02")}
    assert set(trace.ids) == set(ran)
    assert trace.state is not None
    states = dict(zip(trace.ids, trace.state[-1].tolist(), strict=True))
    assert [ran[robot] for robot, state in states.items() if state != "running"] == []


def _fitting(needs: Mapping[str, frozenset[str]], platform: str) -> list[str]:
    """The patterns that run there; the world gives readings and neighbors."""
    provided = load_platform(platform).provides | OF_THE_RADIO
    return [
        name
        for name, wanted in needs.items()
        if {word for word in wanted if not word.startswith("reading:")} <= provided
    ]


def _group(pattern: str) -> str:
    return pattern.replace("_", "-")


def _scenario(
    names: list[str], platform: str, seconds: float, needs: Mapping[str, frozenset[str]]
) -> dict[str, Any]:
    """Two robots of each pattern, each pair far from the others."""
    words = {word for name in names for word in needs[name]}
    readings = sorted(word.removeprefix("reading:") for word in words if ":" in word)
    side = APART * len(names)
    return {
        "duration": seconds,
        "arena": {"size": [side, APART]},
        "fields": [{"kind": "uniform", "name": name, "value": 1.0} for name in readings],
        "radio": {"range_and_bearing": True},
        "groups": {
            _group(name): {
                "platform": platform,
                "count": 2,
                "pattern": name,
                "start": {
                    "layout": "row",
                    "spacing": 1.5,
                    "center": [APART * (index + 0.5) - side / 2.0, 0.0],
                },
            }
            for index, name in enumerate(names)
        },
    }
