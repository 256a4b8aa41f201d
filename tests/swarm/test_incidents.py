"""Incidents of real daemons: each robot keeps its last minute under one id."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from swarmd.core.incident import IncidentKind
from swarmd.core.verbs import INCIDENTS, IncidentsReply, KeptIncident
from tests.support.fake_body import Body
from tests.support.processes import DaemonProcess, wait_until
from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

NAMES = ("r1", "r2", "r3", "r4")


@pytest.fixture
def four(swarm: Swarm) -> Mapping[str, tuple[DaemonProcess, Body]]:
    """Four robots that drive."""
    bodies = {name: swarm.body(name) for name in NAMES}
    daemons = {name: swarm.spawn(name, body) for name, body in bodies.items()}
    for daemon in daemons.values():
        daemon.wait_ready()
    done = swarm.ctl("wait", "--for", "presence=alive", "--for", f"count={len(NAMES)}")
    assert done.code == 0, done
    swarm.run_drive("--all")
    for body in bodies.values():
        body.wait_moving(0.0)
    return {name: (daemons[name], bodies[name]) for name in NAMES}


def incidents(swarm: Swarm, robot: str) -> Mapping[str, KeptIncident]:
    """By id, the incidents that a robot keeps; none without an answer."""
    replies = swarm.look(robot, "control", INCIDENTS.name, IncidentsReply)
    return {one.incident.id: one for reply in replies for one in reply.incidents}


def await_kept(swarm: Swarm, kind: IncidentKind, robots: tuple[str, ...] = NAMES) -> str:
    """The id of the incident of this kind, once each of the robots has its file."""
    found: list[str] = []

    def is_kept() -> bool:
        first = incidents(swarm, robots[0])
        found[:] = [id for id, one in first.items() if one.incident.kind == kind]
        return bool(found) and all(
            (one := incidents(swarm, robot).get(found[0])) is not None and one.size > 0
            for robot in robots
        )

    wait_until(is_kept, f"{robots} keep an incident {kind}", cap=60.0)
    return found[0]


def test_a_stop_of_all_is_one_incident_of_four_robots(
    swarm: Swarm, four: Mapping[str, tuple[DaemonProcess, Body]], tmp_path: Path
) -> None:
    assert swarm.ctl("estop", "--reason", "a cat").code == 0
    id = await_kept(swarm, IncidentKind.ESTOP)
    for name in NAMES:
        (one,) = incidents(swarm, name).values()
        assert one.incident.id == id
        assert "a cat" in one.incident.text


def test_a_daemon_that_is_killed_is_one_incident_of_all(
    swarm: Swarm, four: Mapping[str, tuple[DaemonProcess, Body]]
) -> None:
    daemon, body = four["r2"]
    since = swarm.status("r2").uptime
    # Its beacons, one a second, have shown to all that it runs.
    swarm.await_status("r2", "longer there", lambda status: status.uptime > since + 2.5)
    daemon.kill()
    others = tuple(name for name in NAMES if name != "r2")
    id = await_kept(swarm, IncidentKind.SILENT, others)
    swarm.spawn("r2", body).wait_ready()
    assert await_kept(swarm, IncidentKind.SILENT) == id
    assert incidents(swarm, "r2")[id].incident.robot == "r2"


def test_a_mark_is_kept_by_robots_that_are_not_asked(
    swarm: Swarm, four: Mapping[str, tuple[DaemonProcess, Body]]
) -> None:
    epochs = swarm.operator.members().epochs(["r1"])
    from swarmd.core.verbs import MarkRequest

    swarm.operator.request(MarkRequest, epochs, words="it shook", incident="abcdefabcdef")
    assert await_kept(swarm, IncidentKind.MARK) == "abcdefabcdef"


def test_a_fetched_incident_is_replayed_to_the_bit_with_its_cause(
    swarm: Swarm, four: Mapping[str, tuple[DaemonProcess, Body]], tmp_path: Path
) -> None:
    since = swarm.status("r1").uptime
    swarm.await_status("r1", "longer there", lambda status: status.uptime > since + 3.0)
    assert swarm.ctl("estop", "--reason", "a cat").code == 0
    id = await_kept(swarm, IncidentKind.ESTOP)
    done = swarm.ctl("incidents", "fetch", id, "-d", str(tmp_path))
    assert done.code == 0, done
    done = swarm.ctl("replay", str(tmp_path), "--why", "r2")
    print(done.out)
    assert done.code == 0, done
    assert "a cat" in done.out
