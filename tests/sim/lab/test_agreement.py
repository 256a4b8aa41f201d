"""The laboratory tells the truth: lockstep and real daemons in real time go the same way."""

from __future__ import annotations

import math
import secrets
from pathlib import Path

import numpy as np
import pytest

from swarmd.network.operator import Operator
from swarmd.network.session import SessionSettings
from swarmd.sim.lab.lockstep import simulate_run
from swarmd.sim.lab.scenariofile import scenario_of
from swarmd.sim.live.fleet import Fleet, FleetSpec
from swarmd.sim.live.link import WorldView
from swarmd.sim.live.show import Watch, await_up
from swarmd.sim.trace import Trace, load_trace
from swarmd.values import Array

SECONDS = 5.0
WITHIN = 0.05
Poses = list[tuple[float, float, float]]


def in_lockstep(pattern: str, poses: Poses) -> Trace:
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
        0,
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
        trace=trace,
    )
    with Operator(SessionSettings(swarm=swarm)) as operator, Fleet(spec) as fleet:
        view = await_up(operator, fleet, tuple(robots))
        with WorldView(swarm, fleet.endpoint) as world:
            world.ask("start")
            epochs = view.epochs(tuple(robots))
            outcome = operator.request("run", epochs, {"pattern": pattern, "params": {}})
            assert len(outcome.applied) == len(robots), outcome.line
            watch = Watch(world)
            while (state := watch.wait()).recorded < SECONDS + 2.0:
                watch.wait(since=state.time)
            world.ask("finish")
    return load_trace(trace)


def way(trace: Trace) -> Array:
    """(k, n, 2) places every 0.1 s from the first instant at which anyone was commanded to move."""
    first = int(np.argmax((trace.safe != 0.0).any(axis=(1, 2))))
    t = trace.t - trace.t[first]
    ticks = np.arange(0.0, SECONDS, 0.1)
    n = len(trace.ids)
    places = [[np.interp(ticks, t, trace.pose[:, i, k]) for k in (0, 1)] for i in range(n)]
    return np.transpose(np.array(places), (2, 0, 1))


@pytest.mark.integration
@pytest.mark.parametrize(
    ("pattern", "poses"),
    [
        ("drive", [(-2.0, 0.5, 0.4)]),
        ("attraction", [(-1.2, 0.1, 0.3), (1.1, -0.2, 2.0)]),
    ],
)
def test_lockstep_and_daemons_go_the_same_way(pattern: str, poses: Poses, tmp_path: Path) -> None:
    expected, seen = way(in_lockstep(pattern, poses)), way(live(pattern, poses, tmp_path))
    apart = np.hypot(*np.moveaxis(expected - seen, -1, 0))
    went = np.hypot(*np.moveaxis(expected[-1] - expected[0], -1, 0))
    assert went.min() > 0.3
    assert apart.max() <= WITHIN, f"{apart.max():.3f} m apart at most"
