"""Daemons that are killed, frozen or terminated: how peers list them, and how they return."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

import pytest

from swarmd.core.clock import boottime
from swarmd.core.messages import Presence, Reason, State
from tests.support.processes import CAP, DaemonProcess, wait_until

if TYPE_CHECKING:
    from tests.support.fake_body import Body
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration


LEAVING = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


@pytest.fixture(scope="module")
def body(shared_swarm: Swarm) -> Body:
    """The body of `r1`, whose daemons come and go; the daemon of `r2` lists it."""
    shared_swarm.start("r2", shared_swarm.resting("r2"))
    return shared_swarm.body("r1")


def drive(swarm: Swarm, body: Body) -> DaemonProcess:
    daemon = swarm.start("r1", body)
    began = boottime()
    swarm.run_drive("r1")
    body.wait_moving(began)
    return daemon


def test_a_killed_daemon_is_listed_as_failed_and_returns_idle(
    shared_swarm: Swarm, body: Body
) -> None:
    swarm = shared_swarm
    first = drive(swarm, body)
    before = swarm.status("r1")
    assert before.state is State.RUNNING

    first.kill()
    print(f"failed after {swarm.await_presence('r2', 'r1', Presence.FAILED):.3f} s")
    assert not swarm.statuses("r1")

    returned = boottime()
    again = swarm.start("r1", body)
    print(f"alive again {swarm.await_presence('r2', 'r1', Presence.ALIVE):.3f} s after ready")
    body.wait_zero(returned)  # it has the body again
    after = swarm.status("r1")
    assert (after.state, after.reason) == (State.IDLE, Reason.NEVER_ASKED)
    assert after.instance != before.instance
    assert not body.moved_since(returned)
    assert again.terminate() == 0


def test_a_frozen_daemon_fails_after_its_lease_and_is_alive_once_thawed(
    shared_swarm: Swarm, body: Body
) -> None:
    swarm = shared_swarm
    daemon = drive(swarm, body)
    daemon.freeze()
    print(f"failed after {swarm.await_presence('r2', 'r1', Presence.FAILED):.3f} s")
    listed = swarm.ctl("members", "-o", "json").json
    assert {m["robot"]: m["presence"] for m in listed["members"]} == {
        "r1": "failed",
        "r2": "alive",
    }

    thawed = boottime()
    daemon.thaw()
    print(f"alive again after {swarm.await_presence('r2', 'r1', Presence.ALIVE):.3f} s")
    status = swarm.await_state("r1", State.STOPPED)
    assert status.reason is Reason.LOOP_STALLED
    body.wait_zero(thawed)
    assert body.moved_anew(thawed) == []
    assert daemon.terminate() == 0


def test_a_daemon_that_is_ended_commands_zero_and_is_listed_as_left(
    shared_swarm: Swarm, body: Body
) -> None:
    swarm = shared_swarm
    for number in LEAVING:
        daemon = drive(swarm, body)
        daemon.send(number)
        assert daemon.process.wait(CAP) == 0
        assert "Traceback" not in daemon.text()
        swarm.await_presence("r2", "r1", Presence.LEFT)
        wait_until(lambda: body.commands[-1].twist.is_zero, "the last command is zero")
    done = swarm.ctl("stop")  # does not wait for a robot that left
    assert done.outcome == (0, "1 targeted, 1 applied")
