"""Robots of a simulated swarm name each other by lidar and odometry alone."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from swarmd.patterns.random_walk.pattern import RandomWalk
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenariofile import scenario_of

MIDDLE = -0.032  # m, of a Burger ahead of its axle


class Seeking(RandomWalk):
    """A random walk that needs the places of peers."""

    needs = RandomWalk.needs | {"neighbors.distance"}


def simulated(pattern: type[RandomWalk]) -> Lockstep:
    """30 s of four Burgers among three pillars as wide as a robot."""
    poles = [((1.0, 1.0), 0.1), ((-1.0, 0.6), 0.1), ((0.2, -1.0), 0.12)]
    scenario = scenario_of(
        {
            "duration": 30.0,
            "arena": {"size": [4, 4], "poles": [{"at": at, "radius": r} for at, r in poles]},
            "realism": "realistic",
            "radio": {"loss": 0.1, "delay": 0.1},
            "groups": {
                "all": {
                    "platform": "burger",
                    "count": 4,
                    "start": {"layout": "random", "clearance": 0.3},
                    "pattern": "random_walk",
                }
            },
        }
    )
    run = Lockstep(scenario, 3, patterns={"random_walk": pattern})
    run.advance(scenario.duration)
    return run


def places(run: Lockstep) -> list[tuple[str, Any]]:
    """What each robot knows of each peer."""
    now = run.world.time
    return [
        (shell.robot.id, neighbor)
        for shell in run.shells
        if shell is not None
        for neighbor in shell.robot._sensors.neighbors(now)
    ]


@pytest.mark.compiled_only(reason="a long simulated run")
def test_robots_know_where_their_peers_are() -> None:
    run = simulated(Seeking)
    poses = dict(zip(run.world.ids, run.world.poses(), strict=True))
    errors = []
    for robot, peer in places(run):
        if peer.distance is not None:
            x, y, yaw = poses[robot]
            px, py, heading = poses[peer.id]
            seen = np.array([math.cos(yaw + peer.bearing), math.sin(yaw + peer.bearing)])
            middle = MIDDLE * np.array([math.cos(heading), math.sin(heading)])
            away = (x, y) + peer.distance * seen - (px, py) - middle
            errors.append(float(np.hypot(*away)))
            assert abs(math.remainder(peer.heading + yaw - heading, math.tau)) < 0.5
    assert len(errors) >= 6  # of twelve pairs, hidden ones among them
    assert max(errors) < 0.35


@pytest.mark.compiled_only(reason="a long simulated run")
def test_a_pattern_that_only_uses_places_is_told_them() -> None:
    class Using(RandomWalk):
        uses_places = True

    run = simulated(Using)
    assert any(peer.distance is not None for _, peer in places(run))


@pytest.mark.compiled_only(reason="a long simulated run")
def test_nothing_is_told_where_no_pattern_needs_places() -> None:
    run = simulated(RandomWalk)
    assert all(shell is not None and shell.robot._sensors.kin is None for shell in run.shells)
    assert {peer.distance for _, peer in places(run)} == {None}


ARENA: dict[str, Any] = {"groups.all.start": {"layout": "random", "clearance": 0.65}}
AMONG_PILLARS: dict[str, Any] = {
    "arena.poles": [
        {"at": at, "radius": 0.15}
        for at in ([-2.1, 1.2], [-1.2, -1.4], [0.2, 0.6], [1.5, -0.9], [2.3, 1.3])
    ]
}
BY_KIN: dict[str, Any] = {"groups.all.parameters.kin": True}
AT_REST: dict[str, Any] = {"groups.all.parameters.speed": 0.0, "groups.all.parameters.turn": 0.0}
WAYS: dict[str, dict[str, Any]] = {
    "by width, no pillars": {},
    "by kin, no pillars": BY_KIN,
    "by width": AMONG_PILLARS,
    "by kin": {**AMONG_PILLARS, **BY_KIN},
    "at rest": {**AMONG_PILLARS, **AT_REST},
}


@pytest.mark.evidence
@pytest.mark.parametrize("visibility", ["real", "body"])
def test_attraction_gathers_among_pillars_as_without_them(visibility: str) -> None:
    """The table "Attraction among pillars" of docs/evidence/kin.md."""
    linked = {}
    for way, changes in WAYS.items():
        sets = {"lidar_visibility": visibility, **ARENA, **changes}
        results = simulate("paper_exp1_hardware_free", range(8000, 8040), set=sets, traces=False)
        clusters = results.metric("largest_cluster", results.runs[0].variant.name)
        linked[way] = int((clusters >= 6).sum())
        print(f"{visibility}, {way}: {linked[way]} of {len(clusters)}")
    assert linked["by kin"] > linked["by width"]
    assert linked["by kin, no pillars"] >= linked["by width, no pillars"]
    if visibility == "real":
        assert linked["by kin"] >= linked["by width, no pillars"] - 2
    assert linked["at rest"] == 0


PLACINGS: dict[str, list[tuple[float, float]]] = {
    "none": [],
    "scattered": [(-2.1, 1.2), (-1.2, -1.4), (0.2, 0.6), (1.5, -0.9), (2.3, 1.3)],
    "row": [(-2.4, 0.0), (-1.2, 0.0), (0.0, 0.0), (1.2, 0.0), (2.4, 0.0)],
    "corners and middle": [(-2.4, -1.5), (-2.4, 1.5), (2.4, -1.5), (2.4, 1.5), (0.0, 0.0)],
    "cluster": [(0.0, 0.0), (0.6, 0.0), (-0.6, 0.0), (0.0, 0.6), (0.0, -0.6)],
    "diagonal": [(-2.2, -1.5), (-1.1, -0.75), (0.0, 0.0), (1.1, 0.75), (2.2, 1.5)],
    "two pairs and one": [(-1.8, -0.8), (-1.2, -0.8), (1.2, 0.8), (1.8, 0.8), (0.0, -1.4)],
}


@pytest.mark.evidence
@pytest.mark.parametrize("placing", PLACINGS)
def test_attraction_by_kin_in_other_placings(placing: str) -> None:
    """The table of placings of docs/evidence/kin.md; seeds of which none chose anything."""
    largest = {}
    for way, changes in {"width": {}, "kin": BY_KIN, "at rest": AT_REST}.items():
        sets: dict[str, Any] = {"lidar_visibility": "real", **ARENA, **changes}
        if PLACINGS[placing]:
            sets["arena.poles"] = [{"at": [*at], "radius": 0.15} for at in PLACINGS[placing]]
        results = simulate("paper_exp1_hardware_free", range(8100, 8120), set=sets, traces=False)
        clusters = results.metric("largest_cluster", results.runs[0].variant.name)
        largest[way] = float(np.mean(clusters))
        linked = int((clusters >= 6).sum())
        print(f"{placing}, {way}: {linked} of {len(clusters)}, mean {largest[way]:.2f}")
    assert largest["at rest"] < 2.0
    if placing in ("none", "scattered", "row", "two pairs and one"):
        assert largest["kin"] > largest["width"]
