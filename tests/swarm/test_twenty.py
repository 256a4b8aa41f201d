"""Twenty daemons and an operator who comes fresh each time: every robot acks, every time."""

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

ROBOTS = tuple(f"tb3-{number:02}" for number in range(1, 21))
RUNS = 50


def test_fifty_cold_runs_in_a_row_each_get_twenty_acks(swarm: Swarm) -> None:
    """Without bodies: a pattern is loaded and acked all the same, and stands for want of scans."""
    began = time.monotonic()
    daemons = [swarm.spawn(robot) for robot in ROBOTS]
    for daemon in daemons:
        daemon.wait_ready()
    print(f"{len(ROBOTS)} daemons ready after {time.monotonic() - began:.1f} s")
    # Twenty hosts that start at once on a busy machine may take longer than a load is waited for.
    wait_until(lambda: swarm.ctl("run", "drive", "--all").code == 0, "loaded once by all", 120.0)
    before = {robot: swarm.status(robot).generation for robot in ROBOTS}
    seconds = []
    for number in range(RUNS):
        pattern = ("random_walk", "drive")[number % 2]
        began = time.monotonic()
        done = swarm.ctl("run", pattern, "--all", "--timeout", "60s", "-o", "json")
        seconds.append(time.monotonic() - began)
        assert done.code == 0, (number, done.json["line"], done.err)
        assert tuple(done.json["applied"]) == ROBOTS, (number, done.json["line"])
        assert done.json["line"] == "20 targeted, 20 applied"
    print(f"a cold run: median {statistics.median(seconds):.3f} s, worst {max(seconds):.3f} s")
    for robot in ROBOTS:
        status = swarm.status(robot)
        assert status.generation == before[robot] + RUNS
        assert status.state in (State.RUNNING, State.STOPPED)
    done = swarm.ctl("stop")
    assert (done.code, done.out.splitlines()[-1]) == (0, "20 targeted, 20 applied")
