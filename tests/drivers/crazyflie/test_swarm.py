"""Emulated drones with daemons: patterns, a lost link, a killed daemon, and the landing."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import threading
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
import pytest
import yaml

from swarmd.core.messages import Reason, State, Status
from swarmd.core.values import Value
from swarmd.core.verbs import RunRequest
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.outcome import Outcome
from swarmd.sim.live.demo_run import WorldWatcher
from swarmd.sim.live.fleet import Fleet, FleetSpec, robot_ids
from swarmd.sim.live.link import WorldView
from swarmd.sim.live.starting import await_robots
from swarmd.testing.driver_contract import is_running
from tests.support.processes import children, unique_swarm, wait_until
from tests.support.swarmctl import await_applied, heard_statuses

pytest.importorskip("cflib", reason="extra crazyflie")

POSED = {"extends": "crazyflie", "provides": ["scan", "odometry", "reading:height", "pose"]}
DISTANCE = 1.3  # m
CAP = 120.0  # s


class Relay:
    """A link over UDP, which `is_cut` ends in both directions: a radio between driver and drone."""

    def __init__(self, uri: str) -> None:
        """`uri`: the address of the drone; `self.uri`: that for the driver."""
        host, _, port = uri.removeprefix("udp://").rpartition(":")
        self.is_cut = False
        self._ground, self._air = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in "ga")
        self._ground.bind(("127.0.0.1", 0))
        self._air.connect((host, int(port)))
        self.uri = f"udp://127.0.0.1:{self._ground.getsockname()[1]}"
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._carry, daemon=True)
        self._thread.start()

    def __enter__(self) -> Relay:
        return self

    def __exit__(self, *error: object) -> None:
        self._is_over.set()
        self._thread.join()
        self._ground.close()
        self._air.close()

    def _carry(self) -> None:
        peer = None
        while not self._is_over.is_set():
            for link in select.select([self._ground, self._air], [], [], 0.05)[0]:
                with contextlib.suppress(OSError):  # a side that has closed its port
                    data, sender = link.recvfrom(2048)
                    peer = sender if link is self._ground else peer
                    if not self.is_cut and link is self._ground:
                        self._air.send(data)
                    elif not self.is_cut and peer is not None:
                        self._ground.sendto(data, peer)


def stop(operator: Operator, robots: Collection[str]) -> None:
    """Stop these robots."""
    outcome = operator.send_stop("stop", select=lambda known: frozenset(robots), names=robots)
    assert set(outcome.replies) >= set(robots)


@pytest.mark.integration
@pytest.mark.evidence  # its daemons and emulated radios need a machine that does not stall
@pytest.mark.timeout(900)
@pytest.mark.parametrize("count", [3, 7])
def test_drones_survive_a_lost_link_and_a_killed_daemon_and_land(
    tmp_path: Path, count: int
) -> None:
    platform = tmp_path / "posed.yaml"
    platform.write_text(yaml.safe_dump(POSED))
    robots = robot_ids("crazyflie", count)
    spec = FleetSpec(
        swarm=unique_swarm(),
        robots=dict.fromkeys(robots, str(platform)),
        folder=tmp_path / "fleet",
        arena="6x6",
        layout="grid:1.0",
        lidar_visibility="real",
        shared_frame=True,
        emulator="crazyflie",
        absent=frozenset(robots[:1]),
    )
    victim, *others = robots
    pids = set[int]()
    with (
        Operator(NetworkSettings(swarm=spec.swarm)) as operator,
        Fleet(spec) as fleet,
        WorldView(spec.swarm, fleet.endpoint) as view,
        Relay(fleet.ready.driver_options["uri"][victim]) as relay,
    ):
        watch = WorldWatcher(view)
        config = spec.folder / f"{victim}.yaml"
        told = yaml.safe_load(config.read_text())
        told["driver_options"]["uri"] = relay.uri
        config.write_text(yaml.safe_dump(told))
        fleet.start_daemon(victim)

        def statuses(chosen: Collection[str] = robots) -> Mapping[str, Status]:
            return heard_statuses(operator, chosen)

        def run(pattern: str, chosen: Collection[str] = robots, **params: Value) -> None:
            def ask() -> Outcome:
                epochs = operator.members().epochs(tuple(chosen))
                return operator.request(RunRequest, epochs, pattern=pattern, params=params)

            await_applied(ask, f"they run {pattern}")

        def do_all_fly() -> bool:
            """Whether all fly; a drone that landed, or whose run has ended, gets a new run."""
            heard = statuses()
            told = {robot: one.health.driver for robot, one in heard.items()}
            again = [
                robot
                for robot, one in heard.items()
                if one.state is not State.RUNNING or "waits for the next run" in told[robot]
            ]
            if again:
                stop(operator, again)
                run("dispersion", again, distance=DISTANCE)
            return len(told) == len(robots) and all(": flies" in text for text in told.values())

        def have_landed(chosen: Collection[str]) -> bool:
            now = statuses(chosen)
            return all(
                now[robot].state is State.STOPPED and ": on the ground" in now[robot].health.driver
                for robot in chosen
            )

        def lose_link() -> None:
            """The link of a drone that flies is lost; a stall may have ended its run before."""
            for _ in range(3):
                wait_until(do_all_fly, "all fly", CAP)
                relay.is_cut = True
                wait_until(lambda: not statuses()[victim].health.driver_up, "a lost link", CAP)
                wait_until(lambda: statuses()[victim].state is State.STOPPED, "its run ends", CAP)
                if statuses()[victim].reason is Reason.DRIVER_LOST:
                    return
                relay.is_cut = False
                wait_until(lambda: statuses()[victim].health.driver_up, "the link is back", CAP)
            raise AssertionError("no run ended for the lost link")

        def nearest() -> float:
            places = np.array(watch.wait().poses)[:, :2]
            gaps = np.linalg.norm(places[:, None] - places[None, :], axis=-1)
            return float((gaps + 9.0 * np.eye(len(gaps))).min(axis=1).mean())

        await_robots(operator, fleet)
        pids |= {pid for own in fleet.pids.values() for pid in (own, *children(own))}
        # 1. A run takes off, and the drones spread.
        before = nearest()
        run("dispersion", distance=DISTANCE)
        wait_until(do_all_fly, "all fly", CAP)

        def have_spread() -> bool:
            """Whether the drones are farther apart than before; starts those again that landed."""
            do_all_fly()
            return nearest() > before + 0.02

        wait_until(have_spread, "the drones spread", CAP)
        # 2. The drones vote in the air: a new run takes nobody down.
        run("majority_rule", opinions=2)
        wait_until(
            lambda: all(one.report.get("opinion") is not None for one in statuses().values()),
            "each drone has an opinion",
            CAP,
        )
        # A drone whose reports a stall of the machine held back for 1 s lands: not all need to fly.
        assert any(": flies" in one.health.driver for one in statuses().values())
        # 3. A link is lost. The firmware levels the drone and lets it fall; its daemon says so. The
        # others do not hear its place, and land. With the link they fly again.
        lose_link()
        assert victim in {found.robot for one in others for found in statuses()[one].peers}
        wait_until(lambda: not np.any(np.abs(watch.wait().twists[0]) > 0.02), "it stands", CAP)
        wait_until(lambda: have_landed(others), "the others have landed", CAP)
        relay.is_cut = False
        wait_until(lambda: statuses()[victim].health.driver_up, "the link is back", CAP)
        assert "in the air" not in statuses()[victim].health.driver  # it fell
        stop(operator, robots)
        run("dispersion", distance=DISTANCE)
        wait_until(do_all_fly, "all fly again", CAP)
        # 4. A daemon is killed. Its drone falls, unseen and without a told place: the runs of the
        # others end, and these drones land.
        os.kill(fleet.pids[victim], signal.SIGKILL)
        wait_until(lambda: not is_running(fleet.pids[victim]), "the daemon is dead", CAP)
        wait_until(lambda: not np.any(np.abs(watch.wait().twists[0]) > 0.02), "it stands", CAP)
        wait_until(lambda: have_landed(others), "the others have landed", CAP)
        reasons = {one.reason for one in statuses(others).values()}
        assert Reason.INCOMPATIBLE_PEER in reasons
        stop(operator, others)
        state = watch.wait()
        assert state.contacts == state.arena_contacts == 0
    wait_until(lambda: not any(map(is_running, pids)), "no process is left")
