"""Live robots name each other by lidar and odometry, though their clocks are an hour apart."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from pathlib import Path

import pytest

from swarmd.core.verbs import RunRequest
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.outcome import Outcome
from swarmd.sim.live.fleet import Fleet, FleetSpec
from swarmd.sim.live.link import WorldView
from tests.support.processes import DAEMON, unique_swarm, wait_until
from tests.support.swarmctl import await_applied, heard_statuses

IDS = ("tb3-01", "tb3-02", "tb3-03")
UNSHARE = ("unshare", "--time", "--boottime", "3600")
SEEKING = """
from swarmd.patterns.random_walk.pattern import RandomWalk, RandomWalkParams

class Seeking(RandomWalk):
    '''A random walk that needs the places of peers.'''
    params_type = RandomWalkParams
    needs = RandomWalk.needs | {"neighbors.distance", "neighbors.bearing"}
"""
PLACE = re.compile(r"(\S+) at (\S+) m, (\S+) deg")
FAR = 0.6  # m; a robot moves on until the world has told the truth


def why_no_time_namespace() -> str:
    """Why this machine gives no process a later boottime; empty if it does."""
    words = [*UNSHARE, "cat", "/proc/uptime"]
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False)
    except OSError as error:
        return str(error)
    own = float(Path("/proc/uptime").read_text().split()[0])
    is_later = done.returncode == 0 and float(done.stdout.split()[0]) > own + 1800.0
    return "" if is_later else done.stderr.strip() or "the time of the process is the same"


@pytest.mark.integration
def test_live_robots_whose_clocks_differ_name_each_other(tmp_path: Path) -> None:
    if refusal := why_no_time_namespace():
        pytest.skip(f"no time namespace: {refusal}")
    plugins = tmp_path / "plugins"
    plugins.mkdir()
    (plugins / "seeking.py").write_text(SEEKING)
    spec = FleetSpec(
        swarm=unique_swarm(),
        robots=dict.fromkeys(IDS, "waffle_pi"),
        folder=tmp_path,
        arena="4x4",
        layout="grid:1.2",
        plugin_dir=plugins,
        absent=frozenset({IDS[2]}),
    )
    right: set[tuple[str, str]] = set()
    counts = {True: 0, False: 0}
    with (
        Fleet(spec) as fleet,
        Operator(NetworkSettings(swarm=spec.swarm)) as operator,
        WorldView(spec.swarm, fleet.endpoint) as world,
    ):
        command = [
            *UNSHARE,
            sys.executable,
            "-m",
            *DAEMON,
            "--config",
            str(tmp_path / "tb3-03.yaml"),
        ]
        with (tmp_path / "tb3-03.log").open("w") as log:
            ahead = subprocess.Popen(command, stderr=log)
        try:
            epochs = {id: one.epoch for id, one in heard_statuses(operator, IDS).items()}

            def run() -> Outcome:
                return operator.request(RunRequest, epochs, pattern="seeking")

            def have_all_named() -> bool:
                statuses = heard_statuses(operator, IDS)
                state = world.ask("poses").state
                poses = dict(zip(state.ids, state.poses, strict=True))
                for id, status in statuses.items():
                    x, y, yaw = poses[id]
                    for line in status.places:
                        found = PLACE.fullmatch(line)
                        assert found
                        peer, angle = found[1], yaw + math.radians(float(found[3]))
                        px, py, _ = poses[peer]
                        off_x = x + float(found[2]) * math.cos(angle) - px
                        off_y = y + float(found[2]) * math.sin(angle) - py
                        is_right = math.hypot(off_x, off_y) < FAR
                        counts[is_right] += 1
                        if is_right:
                            right.add((id, peer))
                return len(right) == 6

            await_applied(run, "all run")
            wait_until(have_all_named, "each robot has named each other", cap=180.0)
        finally:
            ahead.terminate()
            try:
                ahead.wait(60.0)
            except subprocess.TimeoutExpired:
                ahead.kill()
                ahead.wait()
    assert counts[False] <= 0.1 * counts[True]
