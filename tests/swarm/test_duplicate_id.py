"""Two daemons with one id: never both in charge, and never both moving for long."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from swarmd.core.clock import boottime
from swarmd.core.messages import Presence, Reason, State, Status
from tests.support.processes import CAP, DaemonProcess, wait_until

if TYPE_CHECKING:
    from tests.support.fake_body import Body
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

ID_HELD = 3


def test_a_second_daemon_is_refused_and_the_first_drives_on(swarm: Swarm) -> None:
    body = swarm.body("r1")
    first = swarm.start("r1", body)
    swarm.run_drive("r1")
    moving = body.wait_stepped()
    before = swarm.status("r1")

    second = swarm.spawn("r1", body)
    assert second.process.wait(CAP) == ID_HELD
    (line,) = [line for line in second.text().splitlines() if line.startswith("error:")]
    assert line == (
        f"error: robot id 'r1' is held by another daemon (instance {before.instance});"
        " stop it, or give this one another id"
    )
    assert first.process.poll() is None
    after = swarm.status("r1")
    assert (after.state, after.epoch) == (State.RUNNING, before.epoch)
    body.wait_moving(boottime())
    assert body.ran_since(moving)


@pytest.mark.parametrize(
    ("count", "times"), [(3, 1), pytest.param(2, 20, marks=pytest.mark.evidence)]
)
def test_of_daemons_started_at_once_exactly_one_owns_the_id(
    swarm: Swarm, count: int, times: int
) -> None:
    for _ in range(times):
        daemons = [swarm.spawn("r1") for _ in range(count)]
        wait_until(lambda: len(_ended(daemons)) >= count - 1, "all but one have given up")  # noqa: B023
        (owner,) = [daemon for daemon in daemons if daemon not in _ended(daemons)]
        owner.wait_ready()
        assert [daemon.process.poll() for daemon in _ended(daemons)] == [ID_HELD] * (count - 1)
        wait_until(lambda: len(swarm.statuses("r1")) == 1, "it alone answers")
        assert owner.terminate() == 0


def _ended(daemons: list[DaemonProcess]) -> list[DaemonProcess]:
    return [daemon for daemon in daemons if daemon.process.poll() is not None]


def test_a_daemon_thawed_beside_its_replacement_faults_both(swarm: Swarm) -> None:
    bodies = [swarm.body("r1") for _ in range(2)]
    frozen = swarm.start("r1", bodies[0])
    swarm.start("r2")
    swarm.run_drive("r1")
    bodies[0].wait_moving()
    frozen.freeze()
    print(f"failed after {swarm.await_presence('r2', 'r1', Presence.FAILED):.1f} s")
    replacement = swarm.start("r1", bodies[1])
    swarm.run_drive("r1")
    bodies[1].wait_moving()

    thawed = boottime()
    frozen.thaw()
    faulted = await_both_faulted(swarm)
    print(f"both faulted after {boottime() - thawed:.1f} s")
    both = {status.instance for status in faulted}
    for status in faulted:
        (other,) = both - {status.instance}
        assert status.detail == f"this id is also held by instance {other}"
    stands = boottime()
    for body in bodies:
        body.wait_zero(stands)
        assert not body.moved_since(stands)
    assert bodies[0].moved_anew(thawed) == []

    note = "# two daemons have one id: r1; stop one of each"
    wait_until(lambda: note in swarm.ctl("members").out, "both are met")
    assert swarm.ctl("run", "drive", "r1").code == 7
    assert not any(body.moved_since(stands) for body in bodies)

    # One goes: the other can be reset, and only then runs again.
    assert frozen.terminate() == 0
    swarm.await_status("r1", "alone", lambda _: len(swarm.statuses("r1")) == 1)
    assert swarm.ctl("run", "drive", "r1").code == 7
    _reset_once_alone(swarm, bodies[1], stands)
    assert replacement.process.poll() is None


def _reset_once_alone(swarm: Swarm, body: Body, stands: float) -> None:
    """The second one needs a moment to notice that the first has gone."""
    wait_until(lambda: swarm.ctl("reset", "r1").code == 0, "r1 can be reset")
    assert swarm.status("r1").state is State.IDLE
    assert not body.moved_since(stands)
    swarm.run_drive("r1")
    body.wait_moving(stands)


def await_both_faulted(swarm: Swarm) -> list[Status]:
    """The statuses of the two daemons that hold `r1`, once both know it."""
    found: list[Status] = []

    def look() -> bool:
        found[:] = swarm.statuses("r1")
        reasons = [(status.state, status.reason) for status in found]
        return reasons == [(State.FAULTED, Reason.DUPLICATE_ID)] * 2

    wait_until(look, "both are faulted")
    return found
