"""The world, the radio and the robots of a scenario, as lockstep and live runs build them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from msgspec import to_builtins

from swarmd.sim.scenarios.pseudo_reality import draws
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.world.lidar import LidarModel
from swarmd.sim.world.radio import Radio, needs_radio
from swarmd.sim.world.world import World


def world_of(scenario: Scenario, seed: int, *, sectors: int = 10) -> World:
    """The world at rest, with the start poses of the seed; ConfigError without room for them."""
    return World(
        scenario.robots,
        scenario.arena,
        scenario.starts(seed),
        lidars=LidarModel(scenario.visibility, sectors),
        realism=scenario.realism,
        fields=scenario.fields,
        items=scenario.items,
        seed=seed,
    )


def radio_of(scenario: Scenario, seed: int) -> Radio:
    """The radio between the scenario's robots."""
    return Radio(scenario.radio, tuple(scenario.robots), scenario.arena, seed=seed)


def has_live_radio(scenario: Scenario) -> bool:
    """True if a live world must carry the messages of patterns."""
    faults = [event.fault for event in scenario.events if event.fault is not None]
    return needs_radio(scenario.radio) or any(one.carried_by == "radio" for one in faults)


def meta_of(scenario: Scenario, seed: int) -> Mapping[str, Any]:
    """What a trace holds of its scenario."""
    platforms = scenario.robots.values()
    return {
        "scenario": scenario.name,
        "seed": seed,
        "duration": scenario.duration,
        "arena": scenario.arena.text,
        "lidar_visibility": scenario.visibility,
        "radio": to_builtins(scenario.radio),
        "pseudo_reality": draws(scenario.pseudo_reality, seed),
        "groups": {name: list(ids) for name, ids in scenario.groups.items()},
        "modes": {p.name: p.protection["mode"] for p in platforms},
        "thresholds": {p.name: p.protection.get("threshold", 0.0) for p in platforms},
        "v_max": {p.name: p.limits.linear for p in platforms},
        "events": [
            {
                "at": e.at,
                "action": e.text if e.fault else e.action,
                "robots": list(e.robots),
                "pattern": e.pattern,
            }
            for e in scenario.events
        ],
    }
