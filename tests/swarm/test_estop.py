"""Emergency stops across a swarm: who holds them, who takes them over, and what clears them."""

from __future__ import annotations

import re
import signal
from typing import TYPE_CHECKING

import pytest

from swarmd.core.clock import boottime
from swarmd.core.messages import Code, Presence, Reason, State, Status
from swarmd.core.refusal import Refusal
from swarmd.core.values import Twist
from swarmd.core.verbs import ResetRequest, StopRequest
from tests.support.processes import wait_until

if TYPE_CHECKING:
    from tests.support.fake_body import Body
    from tests.support.processes import DaemonProcess
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

ROBOTS = ("r1", "r2", "r3")


class Trio:
    """Three robots that stand, alive and without latches, at the beginning of each test."""

    def __init__(self, swarm: Swarm) -> None:
        self.swarm = swarm
        self.bodies: dict[str, Body] = {robot: swarm.body(robot) for robot in ROBOTS}
        spawned = {robot: swarm.spawn(robot, body) for robot, body in self.bodies.items()}
        self.daemons: dict[str, DaemonProcess] = spawned
        for daemon in spawned.values():
            daemon.wait_ready()

    def calm(self) -> None:
        for daemon in self.daemons.values():
            daemon.thaw()
        for robot in ROBOTS:
            for other in ROBOTS:
                if other != robot:
                    self.swarm.await_presence(robot, other, Presence.ALIVE)
        assert self.swarm.ctl("stop", "--all").code == 0
        wait_until(lambda: self.swarm.ctl("reset", "--all", "--yes").code == 0, "all are reset")


@pytest.fixture(scope="module")
def running(shared_swarm: Swarm) -> Trio:
    return Trio(shared_swarm)


@pytest.fixture
def trio(running: Trio) -> Trio:
    running.calm()
    return running


def held_by(status: Status) -> dict[str, tuple[str, str, str]]:
    """Issuer, scope and reason of the emergency stops of a robot by id."""
    latches = status.latches.items()
    return {name: (latch.issuer, latch.scope, latch.reason) for name, latch in latches}


def age_of(status: Status) -> float:
    """The age of a robot's only emergency stop in s."""
    (latch,) = status.latches.values()
    assert latch.age is not None
    return latch.age


def test_newcomers_take_over_an_estop_of_the_swarm_alone(swarm: Swarm) -> None:
    """The latch goes from robot to robot: r4 meets only r3, which had it from the others.

    Each robot, also one that was started again, tells who issued it, when and why.
    """
    daemons = [swarm.start("r1", swarm.resting("r1"))]
    assert swarm.ctl("estop", "r1").code == 0
    daemons.append(swarm.start("r2", swarm.resting("r2")))
    assert swarm.status("r1").state is State.ESTOPPED
    assert swarm.status("r2").state is State.IDLE

    issued = boottime()
    assert swarm.ctl("estop", "--all", "--reason", "smoke\x1b[2J").code == 0
    held = held_by(swarm.status("r2"))
    assert [one[1:] for one in held.values()] == [("swarm", "smoke\x1b[2J")]
    body = swarm.body("r3")
    started = boottime()
    swarm.start("r3", body)
    assert held_by(swarm.await_state("r3", State.ESTOPPED)) == held
    # A peer tells its latches, or hands the stop on, whichever comes first.
    told = [one for one in swarm.audit("r3") if one["verb"] in ("latch", "estop")]
    assert ["smoke" in f"{one['what']} {one['text']}" for one in told] == [True] * len(told) != []
    body.wait_zero(started)
    assert swarm.ctl("run", "drive", "r3").code == 7
    assert not body.moved_since(started)

    for daemon in daemons:
        daemon.kill()
    swarm.start("r4").kill()
    restarted = boottime()
    swarm.start("r4")
    assert held_by(swarm.await_state("r4", State.ESTOPPED)) == held
    asked = boottime()
    assert asked - restarted < age_of(swarm.status("r4")) < boottime() - issued
    (issuer, _, _) = next(iter(held.values()))
    note = re.compile(rf"by {re.escape(issuer)}, [0-9.]+ \w+ ago, for swarm: smoke\?\[2J")
    (line,) = (one for one in swarm.ctl("members").out.splitlines() if "emergency" in one)
    assert line.startswith("# emergency stop: r3, r4 (")
    assert note.search(line)
    assert len(note.findall(swarm.ctl("describe", "r4").out)) == 2, "why, and Emergency stops"


def test_a_reset_that_crosses_a_second_estop_is_refused(trio: Trio) -> None:
    swarm, body = trio.swarm, trio.bodies["r1"]
    assert swarm.ctl("estop", user="anna").code == 0
    seen = swarm.operator.members()
    first = set(swarm.status("r1").latches)

    assert swarm.ctl("estop", user="ben").code == 0
    began = boottime()
    ids = tuple(sorted(first))
    outcome = swarm.operator.request(ResetRequest, seen.epochs(ROBOTS), ids=ids)
    codes = {name: reply.code for name, reply in outcome.replies.items()}
    assert codes == dict.fromkeys(ROBOTS, Code.REFUSED)
    assert {reply.refusal for reply in outcome.replies.values()} == {Refusal.STALE_EPOCH}

    # Nor with a fresh look, if only the first is named: the second stays.
    fresh = swarm.operator.members()
    outcome = swarm.operator.request(ResetRequest, fresh.epochs(ROBOTS), ids=ids)
    assert outcome.exit_code == 7
    for robot in ROBOTS:
        status = swarm.status(robot)
        assert status.state is State.ESTOPPED
        assert [latch.issuer.split("@")[0] for latch in status.latches.values()] == ["ben"]
    assert not body.moved_since(began)

    assert swarm.ctl("reset", "--all", "--yes").code == 0
    assert {swarm.status(robot).state for robot in ROBOTS} == {State.IDLE}
    assert not body.moved_since(began)  # re-armed is not moving


def test_a_reset_never_clears_an_estop_that_it_did_not_see(trio: Trio) -> None:
    swarm = trio.swarm
    for crossing in range(3):
        assert swarm.ctl("estop", "--reason", f"first {crossing}").code == 0
        resetting = swarm.begin("reset", "--all", "--yes")
        stopping = swarm.begin("estop", "--reason", f"second {crossing}")
        reset, estop = resetting.finish(), stopping.finish()
        assert estop.code == 0, estop
        was_seen = f"second {crossing}" in reset.err
        for robot in ROBOTS:
            status = swarm.status(robot)
            reasons = {latch.reason for latch in status.latches.values()}
            assert was_seen or f"second {crossing}" in reasons, (reset, reasons)
            assert status.state is (State.ESTOPPED if reasons else State.IDLE)
        print(f"crossing {crossing}: the reset {'saw' if was_seen else 'missed'} the second stop")


def test_a_frozen_daemon_is_named_and_estopped_after_the_thaw(trio: Trio) -> None:
    swarm, frozen = trio.swarm, trio.daemons["r3"]
    began = boottime()
    swarm.run_drive("--all")
    for body in trio.bodies.values():
        body.wait_moving(began)

    frozen.freeze()
    done = swarm.ctl("estop", "--reason", "smoke")
    assert done.outcome == (3, "3 targeted, 2 applied, 1 no answer (r3)")
    assert {swarm.status(robot).state for robot in ("r1", "r2")} == {State.ESTOPPED}

    thawed = boottime()
    frozen.thaw()
    status = swarm.await_state("r3", State.ESTOPPED)
    assert [latch.reason for latch in status.latches.values()] == ["smoke"]
    assert trio.bodies["r3"].moved_anew(thawed) == []


def test_a_robot_whose_base_moves_on_is_never_counted_as_stopped(trio: Trio) -> None:
    swarm, bodies = trio.swarm, trio.bodies
    began = boottime()
    swarm.run_drive("--all")
    for body in bodies.values():
        body.wait_moving(began)
    bodies["r2"].odometry = Twist(0.2)
    try:
        for verb in ("stop", "estop"):
            done = swarm.ctl(verb, "-o", "json")
            replies = done.json["replies"]
            codes = {robot: reply["code"] for robot, reply in replies.items()}
            assert (done.code, codes) == (3, {"r1": "applied", "r2": "failed", "r3": "applied"})
            assert replies["r2"]["refusal"] == Refusal.NOT_STOPPED
            assert "0.20 m/s" in replies["r2"]["text"]
        # As a program on Zenoh asks, too.
        epochs = swarm.operator.members().epochs(ROBOTS)
        asked = swarm.operator.request(StopRequest, epochs)
        assert (asked.failed, asked.applied) == (("r2",), ("r1", "r3"))
    finally:
        bodies["r2"].odometry = Twist()
    wait_until(lambda: swarm.ctl("stop").code == 0, "r2 rests")


def test_a_daemon_that_thaws_hands_no_earlier_stop_on_to_a_later_run(trio: Trio) -> None:
    """Its sockets hold copies of the stop that were young when it was frozen."""
    swarm, frozen = trio.swarm, trio.daemons["r2"]
    swarm.run_drive("--all")
    said = len(frozen.text())
    frozen.freeze()
    assert swarm.ctl("stop", "--all").code == 3
    swarm.run_drive("r1")
    began = boottime()
    wait_until(lambda: boottime() - began > 6.0, "the run is older than the copies")

    frozen.thaw()
    assert swarm.await_state("r2", State.STOPPED).reason in (Reason.LOOP_STALLED, Reason.OPERATOR)
    handed = boottime()
    wait_until(lambda: boottime() - handed > 3.0, "it would have handed the stop on")
    assert swarm.status("r1").state is State.RUNNING
    ended = [line for line in frozen.text()[said:].splitlines() if "the run ended" in line]
    assert len(ended) == 1
    assert "stopped (loop_stalled)" in ended[0]


def test_until_all_waits_for_a_frozen_robot_and_shows_it(trio: Trio) -> None:
    swarm, frozen = trio.swarm, trio.daemons["r1"]
    for is_healed in (True, False):
        frozen.freeze()
        estop = swarm.begin("estop", "--until-all")
        assert estop.err.readline().startswith("waiting for r1 ")
        frozen.thaw() if is_healed else estop.send_signal(signal.SIGINT)
        done = estop.finish()
        if is_healed:
            assert done.outcome == (0, "3 targeted, 3 applied")
        else:
            assert done.outcome == (3, "3 targeted, 2 applied, 1 no answer (r1)")
            assert "view not complete: r1 " in done.err


def test_an_estop_without_acks_is_no_success(trio: Trio) -> None:
    swarm = trio.swarm
    for daemon in trio.daemons.values():
        daemon.freeze()
    done = swarm.ctl_once("estop", "--timeout", "0.5s")
    assert (done.code, done.out) == (6, "")
    assert done.err.startswith(f"error: no daemon of swarm '{swarm.name}' can be reached")

    # The robots on the roster are named even if no daemon answers.
    roster = swarm.folder / "swarm.yaml"
    roster.write_text(f"swarm: {swarm.name}\nroster: [r1, r2]\n")
    done = swarm.ctl("estop", "--config", str(roster), "--timeout", "0.5s")
    assert done.outcome == (5, "2 targeted, 0 applied, 2 no answer (r1, r2)")
    for daemon in trio.daemons.values():
        daemon.thaw()  # sessions to a frozen daemon take seconds to close
