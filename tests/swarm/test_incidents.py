"""Incidents of real daemons: each of four robots keeps its last minute under one id."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from swarmd.core.incident import IncidentKind
from swarmd.core.messages import Presence, Reason, State
from swarmd.core.verbs import INCIDENTS, IncidentsReply, KeptIncident
from tests.support.fake_body import Body
from tests.support.processes import DaemonProcess, wait_until
from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

NAMES = ("r1", "r2", "r3", "r4")
Robots = Mapping[str, tuple[DaemonProcess, Body]]
CAP = 120.0


@pytest.fixture(scope="module")
def robots(shared_swarm: Swarm) -> Robots:
    """Four robots for all tests; each test gives another one an incident."""
    bodies = {name: shared_swarm.body(name) for name in NAMES}
    daemons = {name: shared_swarm.spawn(name, body) for name, body in bodies.items()}
    for daemon in daemons.values():
        daemon.wait_ready()
    done = shared_swarm.ctl("wait", "--for", "presence=alive", "--for", f"count={len(NAMES)}")
    assert done.code == 0, done
    return {name: (daemons[name], bodies[name]) for name in NAMES}


@pytest.fixture
def swarm(shared_swarm: Swarm, robots: Robots) -> Swarm:
    """The swarm, once all that can run and their beacons, one a second, have shown it."""
    shared_swarm.ctl("run", "drive", "--all")
    since = shared_swarm.status("r1").uptime
    shared_swarm.await_status("r1", "longer there", lambda one: one.uptime > since + 2.5)
    return shared_swarm


def kept_by(swarm: Swarm, robot: str) -> Mapping[str, KeptIncident]:
    """By id, the incidents whose files a robot has; none without an answer."""
    replies = swarm.look(robot, "control", INCIDENTS.name, IncidentsReply)
    return {one.incident.id: one for reply in replies for one in reply.incidents if one.size}


def await_kept(
    swarm: Swarm, what: Callable[[KeptIncident], bool], robots: tuple[str, ...] = NAMES
) -> set[str]:
    """The ids of the incidents for which `what` is true, once each robot has a file of one.

    A robot of a busy machine may have had another one of the same kind.
    """
    found: set[str] = set()

    def is_kept() -> bool:
        kept = [kept_by(swarm, robot) for robot in robots]
        found.update(id for id, one in kept[0].items() if what(one))
        found.intersection_update(*kept)
        return bool(found)

    wait_until(is_kept, f"{robots} keep it", cap=CAP)
    return found


def test_a_mark_is_kept_by_robots_that_are_not_asked(swarm: Swarm) -> None:
    assert swarm.ctl("incident", "mark", "it shook", "r1").code == 0
    (id,) = await_kept(swarm, lambda one: one.incident.kind == IncidentKind.MARK)
    for name in NAMES:
        told = kept_by(swarm, name)[id].incident
        assert (told.robot, told.by) == ("r1", "r1")
        assert "it shook" in told.text


def test_a_daemon_that_is_killed_is_one_incident_of_all(
    swarm: Swarm, robots: Robots, tmp_path: Path
) -> None:
    daemon, body = robots["r2"]
    daemon.kill()
    others = tuple(name for name in NAMES if name != "r2")
    told = await_kept(swarm, lambda one: "r2 is not heard" in one.incident.text, others)
    # Its own minute is not there so far: its peers tell what they knew of it.
    swarm.ctl("incidents", "fetch", max(told), "-d", str(tmp_path))
    assert {path.name for path in tmp_path.iterdir() if path.is_dir()} == {*others}
    done = swarm.ctl("replay", str(tmp_path), "--why", "r2")
    assert done.code == 0, done
    assert f"incident {max(told)} of r2" in done.out.splitlines()[0]
    assert "declared failed; its last beacon" in done.out
    swarm.spawn("r2", body).wait_ready()
    died = await_kept(swarm, lambda one: one.incident.id in told)
    own = [kept_by(swarm, "r2")[id].begin for id in died]
    assert all(begin is not None and begin < 0.0 for begin in own)  # before it was killed


def test_a_daemon_that_is_frozen_is_one_incident_of_all(swarm: Swarm, robots: Robots) -> None:
    daemon, _ = robots["r4"]
    daemon.freeze()
    try:
        swarm.await_presence("r1", "r4", Presence.FAILED)
    finally:
        daemon.thaw()
    mine = ("r4", IncidentKind.SILENT)
    assert await_kept(swarm, lambda one: (one.incident.robot, one.incident.kind) == mine)


def test_a_full_disk_is_told_and_stops_nothing(swarm: Swarm, robots: Robots) -> None:
    folder = swarm.folder / "state" / swarm.name / "r1" / "incidents"
    aside = folder.with_name("aside")
    kept = kept_by(swarm, "r1").keys()
    folder.rename(aside)
    folder.write_text("in the way")
    assert swarm.ctl("incident", "mark", "no room", "r1").code == 0
    full = swarm.await_status("r1", "told", lambda one: "not on disk" in one.health.black_box)
    assert full.state is State.RUNNING
    folder.unlink()
    aside.rename(folder)
    assert kept_by(swarm, "r1").keys() >= kept


def test_a_lost_base_is_replayed_to_the_bit_with_its_cause(
    swarm: Swarm, robots: Robots, tmp_path: Path
) -> None:
    robots["r3"][1].close()
    swarm.await_status("r3", "lost", lambda one: one.reason is Reason.DRIVER_LOST)
    assert swarm.ctl("incident", "mark", "its cable is out", "r3").code == 0, "at once"
    id = max(await_kept(swarm, lambda one: one.incident.kind == IncidentKind.DRIVER))
    done = swarm.ctl("incidents", "fetch", id, "-d", str(tmp_path))
    assert done.code == 0, done
    assert {path.name for path in tmp_path.iterdir() if path.is_dir()} == {*NAMES}
    done = swarm.ctl("replay", str(tmp_path), "--why", "r3")
    assert done.code == 0, done
    (line,) = (line for line in done.out.splitlines() if line.startswith(f"incident {id}"))
    assert "driver_lost" in line
    listed = swarm.ctl("incidents", "-o", "json").json
    assert id in str(listed)
