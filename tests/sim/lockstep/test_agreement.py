"""Lockstep agrees with real daemons in real time."""

from __future__ import annotations

import math
import secrets
from pathlib import Path

import numpy as np
import pytest

from swarmd.core.values import Array
from swarmd.core.verbs import RunRequest
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.sim.live.demo_run import WorldWatcher
from swarmd.sim.live.fleet import Fleet, FleetSpec
from swarmd.sim.live.link import WorldView
from swarmd.sim.live.starting import await_robots
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.trace import Trace, load_trace
from tests.support.processes import wait_until

SECONDS = 3.0
WITHIN = 0.05
PHASES = range(5)
TRIES = 4
"""Live runs until one agrees: a busy machine delays daemons and not lockstep."""
Poses = list[tuple[float, float, float]]


def in_lockstep(pattern: str, poses: Poses, seed: int) -> Trace:
    group = {"robots": [f"r{i}" for i in range(len(poses))], "pattern": pattern}
    start = {"layout": "list", "poses": [[x, y, math.degrees(yaw)] for x, y, yaw in poses]}
    return simulate_run(
        scenario_of(
            {
                "duration": SECONDS + 1.0,
                "trace_rate": 50.0,
                "realism": "ideal",
                "arena": {"size": [12.0, 12.0]},
                "groups": {"all": group},
                "start": start,
            }
        ),
        seed,
    )


def live(pattern: str, poses: Poses, folder: Path) -> Trace:
    robots = {f"r{i}": "waffle_pi" for i in range(len(poses))}
    placed = ",".join(f"{x}:{y}:{math.degrees(yaw)}" for x, y, yaw in poses)
    swarm, trace = f"agree-{secrets.token_hex(4)}", folder / "trace.npz"
    spec = FleetSpec(
        swarm=swarm,
        robots=robots,
        folder=folder,
        arena="12x12",
        layout=f"list:{placed}",
        realism="ideal",
        trace=str(trace),
    )
    with Operator(NetworkSettings(swarm=swarm)) as operator, Fleet(spec) as fleet:
        view = await_robots(operator, fleet)
        with WorldView(swarm, fleet.endpoint) as world:
            world.ask("start")
            epochs = view.epochs(tuple(robots))
            outcome = operator.request(RunRequest, epochs, pattern=pattern)
            assert len(outcome.applied) == len(robots), outcome.line
            watch = WorldWatcher(world)
            while (state := watch.wait()).recorded < SECONDS + 1.0:
                watch.wait(since=state.time)
            world.ask("finish")
    return load_trace(trace)


def opinions(operator: Operator) -> list[object]:
    """The opinions that the robots report now."""
    members = operator.members().members.values()
    return [one.status.report.get("opinion") for one in members if one.status is not None]


def way(trace: Trace) -> Array:
    """(k, n, 2) places every 0.1 s, from the first motion command of each robot on.

    A lidar sweeps five times a second, so that one may see the other 0.2 s before it is seen.
    """
    ticks = np.arange(0.0, SECONDS, 0.1)
    places = []
    for robot in range(len(trace.ids)):
        first = int(np.argmax((trace.safe[:, robot] != 0.0).any(axis=1)))
        t = trace.t - trace.t[first]
        places.append([np.interp(ticks, t, trace.pose[:, robot, k]) for k in (0, 1)])
    return np.transpose(np.array(places), (2, 0, 1))


@pytest.mark.integration
@pytest.mark.parametrize(
    ("pattern", "poses"),
    [
        pytest.param("drive", [(-2.0, 0.5, 0.4)], marks=pytest.mark.evidence),
        ("attraction", [(-1.2, 0.1, 0.2), (1.1, -0.2, 2.6)]),
    ],
)
def test_lockstep_and_daemons_drive_the_same_paths(
    pattern: str, poses: Poses, tmp_path: Path
) -> None:
    """To within 5 cm of what lockstep gives for one of some phases of the lidars."""
    expected = [way(in_lockstep(pattern, poses, seed)) for seed in PHASES]
    apart: list[float] = []
    while not apart or (min(apart) > WITHIN and len(apart) < TRIES):
        folder = tmp_path / str(len(apart))
        folder.mkdir()
        seen = way(live(pattern, poses, folder))
        went = np.hypot(*np.moveaxis(seen[-1] - seen[0], -1, 0))
        assert went.min() > 0.3
        apart.append(
            min(float(np.hypot(*np.moveaxis(one - seen, -1, 0)).max()) for one in expected)
        )
    assert min(apart) <= WITHIN, f"{apart} m apart at most, in as many live runs"


VOTE = {"opinions": 2, "window": 1.0}
AGREE_TIMEOUT = 40.0
"""s, many times what lockstep takes: a loaded machine is slow."""


@pytest.mark.evidence
@pytest.mark.integration
def test_voters_with_daemons_agree_and_stay_so(tmp_path: Path) -> None:
    ids = tuple(f"r{i}" for i in range(4))
    swarm = f"agree-{secrets.token_hex(4)}"
    spec = FleetSpec(
        swarm=swarm,
        robots=dict.fromkeys(ids, "waffle_pi"),
        folder=tmp_path,
        arena="6x6",
        layout="grid:1.5",
    )
    with Operator(NetworkSettings(swarm=swarm)) as operator, Fleet(spec) as fleet:
        epochs = await_robots(operator, fleet).epochs(ids)
        outcome = operator.request(RunRequest, epochs, pattern="majority_rule", params=VOTE)
        assert len(outcome.applied) == len(ids)
        wait_until(lambda: agreed(opinions(operator)), "agreed", AGREE_TIMEOUT)
        with WorldView(swarm, fleet.endpoint) as world:
            watch = WorldWatcher(world)
            since = watch.wait().time
            while (state := watch.wait()).time < since + 1.5:
                watch.wait(since=state.time)
        assert agreed(opinions(operator))


def agreed(held: list[object]) -> bool:
    return len(held) == 4 and None not in held and len(set(held)) == 1
