"""Many daemons and a fresh operator each time: every robot acks, every time."""

from __future__ import annotations

import statistics
import time
from typing import TYPE_CHECKING

import pytest

from swarmd.core.messages import State
from tests.support.processes import wait_until

if TYPE_CHECKING:
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration


@pytest.mark.parametrize(
    ("count", "runs"), [(8, 6), pytest.param(20, 50, marks=pytest.mark.evidence)]
)
def test_every_robot_acks_each_of_many_cold_runs(swarm: Swarm, count: int, runs: int) -> None:
    """Without a base: a pattern is loaded and acked all the same, and no scans hold the robot."""
    robots = tuple(f"tb3-{number:02}" for number in range(1, count + 1))
    began = time.monotonic()
    daemons = [swarm.spawn(robot) for robot in robots]
    for daemon in daemons:
        daemon.wait_ready()
    print(f"{count} daemons ready after {time.monotonic() - began:.1f} s")
    # Many hosts that start at once on a busy machine may take longer than a load may last.
    wait_until(lambda: swarm.ctl("run", "drive", "--all").code == 0, "loaded once by all", 120.0)
    before = {robot: swarm.status(robot).generation for robot in robots}
    seconds = []
    for number in range(runs):
        pattern = ("random_walk", "drive")[number % 2]
        began = time.monotonic()
        done = swarm.ctl("run", pattern, "--all", "--timeout", "60s", "-o", "json")
        seconds.append(time.monotonic() - began)
        assert done.code == 0, (number, done.json["line"], done.err)
        assert tuple(done.json["applied"]) == robots, (number, done.json["line"])
        assert done.json["line"] == f"{count} targeted, {count} applied"
    print(f"a cold run: median {statistics.median(seconds):.3f} s, worst {max(seconds):.3f} s")
    for robot in robots:
        status = swarm.status(robot)
        assert status.generation == before[robot] + runs
        assert status.state in (State.RUNNING, State.STOPPED)
    done = swarm.ctl("stop")
    assert done.outcome == (0, f"{count} targeted, {count} applied")
