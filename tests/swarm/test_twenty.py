"""Many daemons and a fresh operator each time: every robot acks, every time."""

from __future__ import annotations

import statistics
import time
from typing import TYPE_CHECKING

import pytest

from swarmd.core.messages import State
from tests.support.processes import wait_until
from tests.support.swarmctl import STALLED

if TYPE_CHECKING:
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration


def run_until_applied(swarm: Swarm, pattern: str, robots: tuple[str, ...]) -> None:
    """Each robot acks the run and applies it; after a stall of a busy machine it is asked again."""
    for _ in range(5):
        before = {robot: swarm.status(robot).generation for robot in robots}
        done = swarm.ctl("run", pattern, "--all", "--timeout", "60s", "-o", "json")
        replies = done.json["replies"]
        assert (tuple(sorted(replies)), done.json["missing"]) == (robots, []), done.out
        for robot in done.json["applied"]:
            assert swarm.status(robot).generation == before[robot] + 1
        others = [replies[robot]["text"] for robot in robots if robot not in done.json["applied"]]
        if not others:
            line = f"{len(robots)} targeted, {len(robots)} applied"
            assert (done.code, done.json["line"]) == (0, line)
            return
        assert all(map(STALLED.search, others)), done.out
    pytest.fail(f"{pattern} was not applied by all in five runs: {done.out}")


@pytest.mark.parametrize(
    ("count", "runs"), [(5, 4), pytest.param(20, 50, marks=pytest.mark.evidence)]
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
    seconds = []
    for number in range(runs):
        pattern = ("random_walk", "drive")[number % 2]
        began = time.monotonic()
        run_until_applied(swarm, pattern, robots)
        seconds.append(time.monotonic() - began)
    print(f"a cold run: median {statistics.median(seconds):.3f} s, worst {max(seconds):.3f} s")
    for robot in robots:
        status = swarm.status(robot)
        assert status.state in (State.RUNNING, State.STOPPED)
    done = swarm.ctl("stop")  # fails: the base that a driver never reached may move
    assert done.code == 1
    assert done.outcome[1].startswith(f"{count} targeted, 0 applied, {count} failed ({robots[0]}")
