"""A fleet: real processes that start together and end together in every case."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import pytest
import yaml

from swarmd.core.errors import SwarmError
from swarmd.core.messages import State
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.settings.settings import load_daemon_settings
from swarmd.sim.cli.sim import how_it_ends, signal_daemons
from swarmd.sim.live.fleet import Fleet, FleetSpec, Ready, daemon_config, robot_ids, world_options
from swarmd.sim.live.link import WorldView
from swarmd.sim.live.starting import await_robots, statuses_of
from swarmd.sim.world.faults import (
    FaultKind,
    FrozenProcess,
    KilledProcess,
    NoisyScan,
    ProcessFault,
)
from tests.support.processes import (
    assert_keeps_nothing_of_its_daemon,
    children,
    unique_swarm,
    wait_until,
)
from tests.support.swarmctl import Finished, swarmctl

READY = Ready("tcp/127.0.0.1:1", "simulated", {"endpoint": "tcp/127.0.0.1:1"})
ROBOTS = {"tb3-01": "burger", "tb3-02": "waffle_pi"}


def make_spec(folder: Path, **changes: object) -> FleetSpec:
    options: dict[str, object] = {
        "swarm": unique_swarm(),
        "robots": ROBOTS,
        "folder": folder,
        "arena": "4x4",
        "layout": "grid:1.5",
        **changes,
    }
    return FleetSpec(**options)  # type: ignore[arg-type]  # a test's shorthand


def family(fleet: Fleet) -> set[int]:
    """The ids of a fleet's processes and of theirs, once each daemon has a host."""
    found: set[int] = set()

    def look() -> bool:
        found.clear()
        found.update(pid for own in fleet.pids.values() for pid in (own, *children(own)))
        return len(found) == 1 + 2 * len(ROBOTS)

    wait_until(look, "each daemon has a host")
    return found


def is_gone(pid: int) -> bool:
    """True if the process has ended, even if its parent has not waited for it."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except OSError:
        return True


def all_gone(pids: set[int]) -> bool:
    return all(is_gone(pid) for pid in pids)


@contextmanager
def up(spec: FleetSpec) -> Iterator[Fleet]:
    with Fleet(spec) as fleet, Operator(NetworkSettings(swarm=spec.swarm)) as operator:
        view = await_robots(operator, fleet)
        assert {s.state for s in statuses_of(view).values()} == {State.IDLE}
        yield fleet


@pytest.mark.parametrize(
    ("platform", "ids"),
    [
        ("burger", ("tb3-01", "tb3-02")),
        ("jackal", ("jackal-01", "jackal-02")),
        ("my_robot", ("my-robot-01", "my-robot-02")),
    ],
)
def test_robots_are_named_by_their_platform(platform: str, ids: tuple[str, ...]) -> None:
    assert robot_ids(platform, 2) == ids


def test_options_of_the_world_and_of_daemons(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.yaml").write_text("extends: turtlebot4\n")
    spec = make_spec(tmp_path, robots={"a": "own.yaml", "b": "burger"}, seconds=3.0, seed=4)
    world = world_options(spec)
    assert (world.robots, world.seconds, world.seed) == (spec.robots, 3.0, 4)
    assert (world.realism, world.layout) == ("realistic", "grid:1.5")
    own, shipped = (daemon_config(spec, robot, READY) for robot in "ab")
    assert Path(str(own["state_dir"])).is_relative_to(tmp_path)  # its latches stay there
    assert own["platform"] == str(Path.cwd() / "own.yaml")
    assert shipped["platform"] == "burger"
    assert own["driver_options"] == {**READY.driver_options, "detections": True}
    assert shipped["driver_options"] == READY.driver_options
    path = tmp_path / "a.yaml"
    path.write_text(yaml.safe_dump(own))
    assert "detections" in load_daemon_settings(path, {}, {}).platform.provides


@pytest.mark.integration
def test_world_and_daemons_come_up_and_go_even_if_one_is_frozen(tmp_path: Path) -> None:
    with up(make_spec(tmp_path)) as fleet:
        pids = family(fleet)
        assert set(fleet.pids) == {"world", *ROBOTS}
        assert len(pids) == 5  # the world, two daemons, a host each
        fleet.check()
        assert_keeps_nothing_of_its_daemon(fleet.pids["tb3-01"])
        os.kill(fleet.pids["tb3-01"], signal.SIGSTOP)  # so that it ends only by SIGKILL
        assert not any(is_gone(pid) for pid in pids)
    wait_until(lambda: all_gone(pids), "all processes of the fleet are gone")


def is_halted(pid: int) -> bool:
    """True if the process was stopped by a signal."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "T"


@pytest.mark.integration
def test_faults_by_command_reach_the_world_and_the_daemons(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    spec = make_spec(tmp_path / "fleet")

    def fault(*words: str) -> Finished:
        return swarmctl("sim", "fault", *words, "--swarm", spec.swarm)

    assert (fault("tb3-01", "scan=frozen").code, fault("scan=frozen").code) == (1, 2)
    with up(spec) as fleet, WorldView(spec.swarm, fleet.endpoint) as world:
        assert fault("tb3-01", "tb3-02", "scan=noise", "sd=0.3").code == 0
        faults = dict.fromkeys(ROBOTS, "scan noise")
        assert world.ask("poses").state.faults == faults
        assert fault("tb3-02", "scan=noise", "--end").code == 0
        assert world.ask("poses").state.faults == {"tb3-01": "scan noise"}
        pid = fleet.pids["tb3-01"]
        assert fault("tb3-01", "scan=frozen", "--for", "10ms").code == 0
        assert world.ask("poses").state.faults == {"tb3-01": "scan noise"}
        assert fault("tb3-01", "process=frozen").code == 0
        wait_until(lambda: is_halted(pid), "the daemon is halted")
        assert fault("tb3-01", "process=frozen", "--end").code == 0
        wait_until(lambda: not is_halted(pid), "the daemon continues")
        for words, subject in (
            (("tb3-09", "scan=frozen"), "'tb3-09'"),
            (("tb3-09", "process=killed"), "'tb3-09'"),
            (("tb3-01", "scan=frosen"), "'frozen'"),
        ):
            refused = fault(*words)
            assert (refused.code > 0, subject in refused.err) == (True, True), refused
            assert refused.err.count("\n") == 1
        assert fault("tb3-02", "process=killed").code == 0
        wait_until(lambda: "tb3-02" in fleet.ended(), "the daemon is killed")
    assert fault("tb3-01", "scan=frozen").code == 1


@pytest.mark.parametrize("kind", [KilledProcess(), FrozenProcess()])
@pytest.mark.parametrize("is_on", [True, False])
def test_a_process_that_has_the_id_of_an_ended_daemon_gets_no_signal(
    monkeypatch: pytest.MonkeyPatch, kind: ProcessFault, is_on: bool
) -> None:
    sent: list[tuple[int, int]] = []
    monkeypatch.setattr(os, "kill", lambda pid, number: sent.append((pid, number)))
    pids = {"world": os.getpid(), "tb3-01": os.getpid(), "tb3-02": -1}
    for robot in ("tb3-01", "tb3-02"):
        with pytest.raises(SwarmError, match=robot) if is_on else nullcontext():
            signal_daemons(pids, "default", kind, [robot], is_on=is_on)
    assert sent == []


@pytest.mark.parametrize(
    ("kind", "seconds", "subject"),
    [
        (KilledProcess(), None, "sim up"),
        (KilledProcess(), 10.0, "sim up"),
        (FrozenProcess(), None, "sim fault tb3-02 KIND --swarm lab --end"),
        (NoisyScan(), None, "sim fault tb3-02 KIND --swarm lab --end"),
        (NoisyScan(), 10.0, "10 s"),
    ],
)
def test_a_fault_by_command_says_how_it_ends(
    kind: FaultKind, seconds: float | None, subject: str
) -> None:
    words = ["tb3-02", "KIND", "--swarm", "lab"]
    assert subject in how_it_ends(kind, words, seconds)


@pytest.mark.integration
def test_no_process_is_left_when_the_parent_is_killed(tmp_path: Path) -> None:
    code = f"""
import signal, sys
from pathlib import Path
sys.path.insert(0, {str(Path(__file__).parent)!r})
from test_fleet import family, make_spec, up
with up(make_spec(Path({str(tmp_path)!r}))) as fleet:
    print(*family(fleet), flush=True)
    signal.pause()
"""
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pids = {int(word) for word in parent.stdout.readline().split()}
        assert len(pids) == 5
        assert not any(is_gone(pid) for pid in pids)
        parent.kill()
    wait_until(lambda: all_gone(pids), "all processes of the fleet are gone")


@pytest.mark.integration
def test_an_impossible_world_ends_with_the_reason(tmp_path: Path) -> None:
    spec = make_spec(tmp_path, layout="row:0.1")
    with pytest.raises(SwarmError, match=r"world.*row:0\.1.*world\.log"):
        Fleet(spec).__enter__()


@pytest.mark.integration
def test_a_daemon_that_ends_ends_the_wait(tmp_path: Path) -> None:
    spec = make_spec(tmp_path)
    with Fleet(spec) as fleet, Operator(NetworkSettings(swarm=spec.swarm)) as operator:
        os.kill(fleet.pids["tb3-01"], signal.SIGKILL)
        with pytest.raises(SwarmError, match=r"tb3-01 was killed by SIGKILL \(log: .*tb3-01\.log"):
            await_robots(operator, fleet)
