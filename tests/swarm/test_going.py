"""Daemons that are killed, frozen or terminated: how peers list them, and how they return."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

import pytest

from swarmd.core.clock import boottime
from swarmd.core.messages import Presence, Reason, State
from tests.support.processes import CAP

if TYPE_CHECKING:
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration


def test_a_killed_daemon_is_listed_as_failed_and_returns_idle(swarm: Swarm) -> None:
    body = swarm.body("r1")
    first = swarm.start("r1", body)
    swarm.start("r2")
    swarm.run_drive("r1")
    body.wait_moving()
    before = swarm.status("r1")
    assert before.state is State.RUNNING

    first.kill()
    print(f"failed after {swarm.await_presence('r2', 'r1', Presence.FAILED):.3f} s")
    assert not swarm.statuses("r1")

    returned = boottime()
    swarm.start("r1", body)
    print(f"alive again {swarm.await_presence('r2', 'r1', Presence.ALIVE):.3f} s after ready")
    body.wait_zero(returned)  # it has the body again
    after = swarm.status("r1")
    assert (after.state, after.reason) == (State.IDLE, Reason.NEVER_ASKED)
    assert after.instance != before.instance
    assert not body.moved_since(returned)


def test_a_frozen_daemon_fails_after_its_lease_and_is_alive_once_thawed(swarm: Swarm) -> None:
    body = swarm.body("r1")
    daemon = swarm.start("r1", body)
    swarm.start("r2")
    swarm.run_drive("r1")
    body.wait_moving()

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
    status = swarm.status("r1")
    assert (status.state, status.reason) == (State.STOPPED, Reason.LOOP_STALLED)
    body.wait_zero(thawed)
    assert not body.moved_anew(thawed)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_daemon_that_is_ended_commands_zero_and_is_listed_as_left(
    swarm: Swarm, number: signal.Signals
) -> None:
    body = swarm.body("r1")
    daemon = swarm.start("r1", body)
    swarm.start("r2")
    swarm.run_drive("r1")
    body.wait_moving()

    daemon.send(number)
    assert daemon.process.wait(CAP) == 0
    swarm.await_presence("r2", "r1", Presence.LEFT)
    assert body.commands[-1].twist.is_zero
    done = swarm.ctl("stop")  # does not wait for a robot that left
    assert done.outcome == (0, "1 targeted, 1 applied")
