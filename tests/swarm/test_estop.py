"""Emergency stops across a swarm: who holds them, who takes them over, and what clears them."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

import pytest

from swarmd.core.clock import boottime
from swarmd.core.messages import Code, Reason, Refusal, State
from swarmd.core.verbs import ResetRequest
from tests.support.processes import wait_until

if TYPE_CHECKING:
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration


def test_newcomers_take_over_an_estop_of_the_swarm_alone(swarm: Swarm) -> None:
    """The latch goes from robot to robot: r4 meets only r3, which had it from the others."""
    daemons = [swarm.start("r1")]
    assert swarm.ctl("estop", "r1").code == 0
    daemons.append(swarm.start("r2"))
    assert swarm.status("r1").state is State.ESTOPPED
    assert swarm.status("r2").state is State.IDLE

    assert swarm.ctl("estop", "--all", "--reason", "smoke").code == 0
    held = dict(swarm.status("r2").latches)
    assert [(latch.scope, latch.reason) for latch in held.values()] == [("swarm", "smoke")]
    body = swarm.body("r3")
    started = boottime()
    swarm.start("r3", body)
    assert dict(swarm.await_state("r3", State.ESTOPPED).latches) == held
    entries = swarm.ctl("audit", "r3", "-o", "json").json["entries"]
    assert [one["text"] for one in entries if one["verb"] == "latch"] == ["smoke"]
    body.wait_zero(started)
    assert swarm.ctl("run", "drive", "r3").code == 7
    assert not body.moved_since(started)

    for daemon in daemons:
        daemon.kill()
    swarm.start("r4")
    assert dict(swarm.await_state("r4", State.ESTOPPED).latches) == held


def test_a_reset_that_crosses_a_second_estop_is_refused(swarm: Swarm) -> None:
    body = swarm.body("r1")
    swarm.start("r1", body)
    swarm.start("r2")
    assert swarm.ctl("estop", user="anna").code == 0
    seen = swarm.operator.members()
    first = set(swarm.status("r1").latches)

    assert swarm.ctl("estop", user="ben").code == 0
    began = boottime()
    ids = tuple(sorted(first))
    outcome = swarm.operator.request(ResetRequest, seen.epochs(("r1", "r2")), ids=ids)
    assert {name: reply.code for name, reply in outcome.replies.items()} == {
        "r1": Code.REFUSED,
        "r2": Code.REFUSED,
    }
    assert {reply.refusal for reply in outcome.replies.values()} == {Refusal.STALE_EPOCH}

    # Nor with a fresh look, if only the first is named: the second stays.
    fresh = swarm.operator.members()
    outcome = swarm.operator.request(ResetRequest, fresh.epochs(("r1", "r2")), ids=ids)
    assert outcome.exit_code == 7
    for robot in ("r1", "r2"):
        status = swarm.status(robot)
        assert status.state is State.ESTOPPED
        assert [latch.issuer.split("@")[0] for latch in status.latches.values()] == ["ben"]
    assert not body.moved_since(began)

    assert swarm.ctl("reset", "--all", "--yes").code == 0
    assert {swarm.status(robot).state for robot in ("r1", "r2")} == {State.IDLE}
    assert not body.moved_since(began)  # re-armed is not moving


def test_a_reset_never_clears_an_estop_that_it_did_not_see(swarm: Swarm) -> None:
    robots = ("r1", "r2")
    for robot in robots:
        swarm.start(robot)
    for crossing in range(3):
        assert swarm.ctl("estop", "--reason", f"first {crossing}").code == 0
        resetting = swarm.begin("reset", "--all", "--yes")
        stopping = swarm.begin("estop", "--reason", f"second {crossing}")
        reset, estop = swarm.finish(resetting), swarm.finish(stopping)
        assert estop.code == 0, estop
        was_seen = f"(second {crossing})" in reset.err
        for robot in robots:
            status = swarm.status(robot)
            reasons = {latch.reason for latch in status.latches.values()}
            assert was_seen or f"second {crossing}" in reasons, (reset, reasons)
            assert status.state is (State.ESTOPPED if reasons else State.IDLE)
        print(f"crossing {crossing}: the reset {'saw' if was_seen else 'missed'} the second stop")


def test_a_frozen_daemon_is_named_and_estopped_after_the_thaw(
    swarm: Swarm,
) -> None:
    bodies = {robot: swarm.body(robot) for robot in ("r1", "r2", "r3")}
    daemons = {robot: swarm.start(robot, body) for robot, body in bodies.items()}
    swarm.run_drive("--all")
    for body in bodies.values():
        body.wait_moving()

    daemons["r3"].freeze()
    done = swarm.ctl("estop", "--reason", "smoke")
    assert done.outcome == (3, "3 targeted, 2 applied, 1 no answer (r3)")
    assert {swarm.status(robot).state for robot in ("r1", "r2")} == {State.ESTOPPED}

    thawed = boottime()
    daemons["r3"].send(signal.SIGCONT)
    status = swarm.await_state("r3", State.ESTOPPED)
    assert [latch.reason for latch in status.latches.values()] == ["smoke"]
    assert not bodies["r3"].moved_anew(thawed)


def test_a_daemon_that_thaws_hands_no_earlier_stop_on_to_a_later_run(swarm: Swarm) -> None:
    """Its sockets hold copies of the stop that were young when it was frozen."""
    bodies = {robot: swarm.body(robot) for robot in ("r1", "r2")}
    daemons = {robot: swarm.start(robot, body) for robot, body in bodies.items()}
    swarm.run_drive("--all")
    daemons["r2"].freeze()
    assert swarm.ctl("stop", "--all").code == 3
    swarm.run_drive("r1")
    began = boottime()
    wait_until(lambda: boottime() - began > 6.0, "the run is older than the copies")

    daemons["r2"].thaw()
    assert swarm.await_state("r2", State.STOPPED).reason in (Reason.LOOP_STALLED, Reason.OPERATOR)
    handed = boottime()
    wait_until(lambda: boottime() - handed > 3.0, "it would have handed the stop on")
    assert swarm.status("r1").state is State.RUNNING
    ended = [line for line in daemons["r2"].text().splitlines() if "the run ended" in line]
    assert len(ended) == 1
    assert "stopped (loop_stalled)" in ended[0]


def test_an_estop_without_acks_is_no_success(swarm: Swarm) -> None:
    daemons = [swarm.start(robot) for robot in ("r1", "r2")]
    for daemon in daemons:
        daemon.freeze()
    done = swarm.ctl("estop", "--timeout", "0.5s")
    assert (done.code, done.out) == (6, "")
    assert done.err.startswith(f"error: no daemon of swarm '{swarm.name}' can be reached")

    # The robots on the roster are named even if no daemon answers.
    roster = swarm.folder / "swarm.yaml"
    roster.write_text(f"swarm: {swarm.name}\nroster: [r1, r2]\n")
    done = swarm.ctl("estop", "--config", str(roster), "--timeout", "0.5s")
    assert done.outcome == (5, "2 targeted, 0 applied, 2 no answer (r1, r2)")


@pytest.mark.parametrize("is_healed", [True, False], ids=["thawed", "interrupted"])
def test_until_all_waits_for_a_frozen_robot_and_shows_it(swarm: Swarm, is_healed: bool) -> None:
    frozen = swarm.spawn("r1")
    swarm.start("r2")
    frozen.wait_ready()
    wait_until(lambda: "r1" in swarm.presences("r2"), "r2 knows r1")
    frozen.freeze()
    estop = swarm.begin("estop", "--until-all")
    assert estop.stderr is not None
    assert estop.stderr.readline().startswith("waiting for r1 ")
    frozen.thaw() if is_healed else estop.send_signal(signal.SIGINT)
    done = swarm.finish(estop)
    if is_healed:
        assert done.outcome == (0, "2 targeted, 2 applied")
    else:
        assert done.outcome == (3, "2 targeted, 1 applied, 1 no answer (r1)")
        assert "view not complete: r1 " in done.err
