"""What operators and peers ask of one robot, and what it refuses."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest

from swarmd.api import Inputs, MovementPattern, Outputs, Params, Twist
from swarmd.core.events import (
    DriverInput,
    DuplicateInput,
    LatchesInput,
    NetworkInput,
    OdometryInput,
    RosterInput,
)
from swarmd.core.goal import Goal
from swarmd.core.host_messages import KillHost, Loaded, PatternFailed, Stepped
from swarmd.core.keys import is_id
from swarmd.core.messages import Code, Epoch, Latch, Reason, Reply, State
from swarmd.core.refusal import Refusal
from swarmd.core.values import Odometry, Pose
from swarmd.core.verbs import StopRequest
from swarmd.patterns.drive.pattern import Drive
from swarmd.robot.latches import MAX_HELD
from tests.support.kernel_forms import interpreted
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS, Forward, idle, standing_state, started

STOP_TIME = 2.0  # s after which a robot that moves on has not stopped (docs/operating.md)


class NeedsRadio(Forward):
    needs = frozenset({"reading:radio"})


class Broken(Forward):
    def __init__(self, *args: object) -> None:
        raise ZeroDivisionError("on purpose")


def test_stale_epoch_is_refused_and_names_the_operator() -> None:
    harness = idle()
    seen = harness.epoch
    first = harness.send(harness.request("run", seen, pattern="forward", operator="alice"))
    second = harness.send(harness.request("run", seen, pattern="finisher", operator="bob"))
    assert first is not None
    assert first.code is Code.APPLIED
    assert second is not None
    assert second.refusal is Refusal.STALE_EPOCH
    assert "by alice (run forward)" in second.text
    earlier = harness.answer(harness.request("run", Epoch("boot0", 1), pattern="finisher"))
    assert earlier.refusal is Refusal.STALE_EPOCH
    assert harness.status.pattern == "forward"


def test_replayed_run_never_moves_the_robot() -> None:
    harness = idle()
    request = harness.request("run", pattern="forward")
    harness.send(request)
    harness.ask("stop")
    assert harness.answer(request).refusal is Refusal.STALE_EPOCH
    harness.advance(1.0)
    assert harness.twist.is_zero


def test_robot_that_is_no_target_does_not_answer() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    other = StopRequest(id="x", operator="a", targets={"tb3-02": Epoch("b", 0)})
    assert harness.send(other) is None
    assert standing_state(harness) == (State.IDLE, Reason.NEVER_ASKED)


def test_a_stop_that_another_robot_hands_on_late_does_not_undo_a_reset() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.ask("stop", id="s1")
    harness.ask("reset")
    harness.advance(1.0)
    late = harness.ask("stop", id="s1", age=3.0)
    assert late is not None
    assert (late.code, harness.status.state) == (Code.APPLIED, State.IDLE)
    harness.ask("stop", id="s2", age=0.5)
    assert harness.status.state is State.STOPPED


def test_a_stop_that_another_robot_hands_on_late_changes_no_robot_that_is_estopped() -> None:
    harness = started()
    harness.advance(1.0)
    harness.ask("stop", id="s1")
    harness.ask("estop", id="e1")
    epoch = harness.status.epoch
    harness.advance(0.5)
    late = harness.ask("stop", id="s1", age=0.5)
    assert late is not None
    assert (late.code, harness.status.state) == (Code.APPLIED, State.ESTOPPED)
    assert harness.status.epoch == epoch  # a reset that was asked for at this epoch counts


def late_stop(harness: RobotHarness, age: float, **fields: Any) -> Reply:
    """The answer to a stop of all robots that a peer hands on."""
    return harness.answer(StopRequest(operator="bob", age=age, **{"id": "s0", **fields}))


JOINED = Goal(generation=1, issuer="bob", id="g1", pattern="forward", on_join="run", valid=600.0)


def test_a_stop_that_was_covered_by_a_later_one_makes_no_run_newer() -> None:
    harness = started()
    harness.applied("stop")
    harness.advance(3.0)
    epoch = harness.epoch
    assert late_stop(harness, 4.0).code is Code.APPLIED  # covered: the epoch stays
    harness.send(harness.request("run", epoch, pattern="forward", age=1.0))
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING
    assert late_stop(harness, 0.7, id="s1").code is Code.APPLIED  # issued after the run
    assert standing_state(harness) == (State.STOPPED, Reason.OPERATOR)


def test_a_stop_from_before_the_reset_of_a_stopped_robot_changes_nothing() -> None:
    """The table of `robot/requests.py`: it was issued before a reset, and did not arrive till now.

    A stop that was issued after the reset stops the robot, which must stay idle for no run.
    """
    harness = started()
    harness.applied("stop", operator="bob")
    harness.advance(3.0)
    harness.applied("reset")
    harness.advance(1.0)
    epoch = harness.epoch
    assert late_stop(harness, 2.0, id="unheard").code is Code.APPLIED
    assert (harness.status.state, harness.epoch) == (State.IDLE, epoch)
    assert late_stop(harness, 0.5, id="later").code is Code.APPLIED
    assert harness.status.state is State.STOPPED


def test_a_stop_from_before_the_reset_of_an_idle_robot_changes_nothing() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.advance(5.0)
    harness.applied("reset")
    epoch = harness.epoch
    assert late_stop(harness, 2.0).code is Code.APPLIED
    assert (harness.status.state, harness.epoch) == (State.IDLE, epoch)


@pytest.mark.parametrize("verb", ["run", "resume", "reload"])
def test_a_stop_that_is_older_than_the_wish_to_run_ends_no_run(verb: str) -> None:
    harness = started() if verb == "reload" else RobotHarness(patterns=PATTERNS)
    if verb == "resume":
        harness.find(JOINED, 100.0, may_join=False)
    harness.advance(5.0)
    fields: dict[str, dict[str, Any]] = {
        "run": {"pattern": "forward"},
        "reload": {"pattern": "forward", "is_rerun": True},
    }
    harness.ask(verb, **fields.get(verb, {}))
    harness.advance(2.0)
    assert late_stop(harness, 3.0).refusal is Refusal.OVERTAKEN
    assert harness.status.state is State.RUNNING
    assert late_stop(harness, 1.5).code is Code.APPLIED
    assert standing_state(harness) == (State.STOPPED, Reason.OPERATOR)


@pytest.mark.parametrize("verb", ["run", "resume", "reload"])
def test_a_stop_ends_a_run_whose_request_was_issued_earlier_and_came_sooner(verb: str) -> None:
    """On a slow link the request takes 3 s."""
    harness = started() if verb == "reload" else RobotHarness(patterns=PATTERNS)
    if verb == "resume":
        harness.find(JOINED, 100.0, may_join=False)
    harness.advance(5.0)
    fields: dict[str, dict[str, Any]] = {
        "run": {"pattern": "forward"},
        "reload": {"pattern": "forward", "is_rerun": True},
    }
    harness.ask(verb, age=3.0, **fields.get(verb, {}))
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING
    assert late_stop(harness, 4.0).refusal is Refusal.OVERTAKEN
    assert late_stop(harness, 3.0, id="s1").code is Code.APPLIED
    assert standing_state(harness) == (State.STOPPED, Reason.OPERATOR)


@pytest.mark.parametrize(("age", "ends"), [(12.0, False), (9.0, True)])
def test_a_stop_ends_a_joined_run_if_it_is_newer_than_the_goal(age: float, ends: bool) -> None:
    harness = idle()
    harness.find(JOINED, 10.0)
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING
    assert (late_stop(harness, age).code is Code.APPLIED) is ends
    assert (standing_state(harness)[0] is State.STOPPED) is ends


def test_a_stop_after_a_reset_and_a_join_stops() -> None:
    """Estopped, split, a run with on_join on the other side, reset here, healed."""
    harness = RobotHarness(patterns=PATTERNS)
    harness.ask("estop", id="e1")
    harness.advance(5.0)
    harness.ask("reset", ids=("e1",))
    harness.advance(1.0)
    harness.find(msgspec.structs.replace(JOINED, generation=7), 0.5)
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING
    before_the_reset = late_stop(harness, 5.0)
    assert before_the_reset.refusal is Refusal.OVERTAKEN, "it drives"
    assert late_stop(harness, 0.6, id="s1").code is Code.APPLIED
    assert standing_state(harness) == (State.STOPPED, Reason.OPERATOR)


@pytest.mark.parametrize(
    ("verb", "fields", "refusal"),
    [
        ("run", {"pattern": "unheard_of"}, Refusal.UNKNOWN_PATTERN),
        ("run", {"pattern": "forward", "params": {"speed": "fast"}}, Refusal.INVALID_PARAMETER),
        ("run", {"pattern": "broken"}, Refusal.PATTERN_FAILED),
        ("resume", {}, Refusal.NO_GOAL),
    ],
)
def test_a_refused_run_does_not_overtake_a_stop(
    verb: str, fields: dict[str, Any], refusal: Refusal
) -> None:
    harness = RobotHarness(patterns={**PATTERNS, "broken": Broken})
    harness.advance(1.0)
    harness.applied("run", pattern="forward")
    harness.advance(5.0)
    refused = harness.ask(verb, **fields)
    harness.advance(0.5)
    assert refused is not None
    assert refused.refusal is refusal
    assert late_stop(harness, 3.0).code is Code.APPLIED
    assert standing_state(harness) == (State.STOPPED, Reason.OPERATOR)


def test_a_restart_after_a_fault_keeps_the_wish_of_the_run() -> None:
    harness = started()
    harness.advance(5.0)
    generation = harness.status.generation
    assert generation is not None
    harness.host_says(PatternFailed(generation, "on purpose"))
    harness.advance(1.0)
    assert harness.status.state is State.RUNNING
    assert late_stop(harness, 4.0).code is Code.APPLIED
    assert standing_state(harness) == (State.STOPPED, Reason.OPERATOR)


def test_a_stop_between_a_run_and_a_load_ends_the_run_alone() -> None:
    harness = started()
    harness.advance(5.0)
    harness.is_hung = True
    request = harness.request("run", pattern="forward")
    harness.send(request)
    harness.advance(0.1)
    assert late_stop(harness, 2.0).refusal is Refusal.OVERTAKEN
    assert (harness.status.state, harness.twist.is_zero) == (State.STOPPED, True)
    harness.is_hung = False
    harness.host_answers(harness.sent[-1])
    assert harness.reply_to(request).code is Code.APPLIED
    assert harness.status.state is State.RUNNING


def test_a_copy_of_a_stop_that_was_carried_out_ends_no_later_run_whatever_its_age() -> None:
    harness = started()
    harness.advance(1.0)
    late_stop(harness, 0.0)
    harness.advance(1.0)
    harness.applied("run", pattern="forward")
    harness.advance(1.0)
    assert late_stop(harness, 0.0).refusal is Refusal.OVERTAKEN
    assert late_stop(harness, 0.0, id="s1").code is Code.APPLIED


def test_each_end_of_a_run_is_told_with_its_cause() -> None:
    harness = started()
    harness.advance(1.0)
    harness.ask("stop", id="s1")
    assert harness.ended == ["stopped (operator) by alice"]
    harness.ask("stop", id="s1")
    assert len(harness.ended) == 1


def test_thawed_daemon_stops_before_it_reads_requests() -> None:
    harness = started()
    waiting = harness.request("run", pattern="forward")
    harness.advance(3.0, ticks=False)
    late = harness.answer(waiting)
    assert late.refusal is Refusal.STALE_EPOCH
    assert "stall" in late.text
    assert harness.twist.is_zero
    assert standing_state(harness) == (State.STOPPED, Reason.LOOP_STALLED)
    harness.advance(2.0)
    assert harness.twist.is_zero


def test_estop_latches_and_is_written_before_the_ack() -> None:
    harness = started()
    reply = harness.answer(harness.request("estop", id="e1", scope="swarm"))
    assert reply.code is Code.APPLIED
    assert reply.text.startswith("commanded zero")
    assert set(harness.written[-1].held) == {"e1"}
    assert harness.written[-1].held["e1"].scope == "swarm"
    assert harness.twist.is_zero
    assert standing_state(harness) == (State.ESTOPPED, Reason.ESTOP)
    assert harness.refused("run", pattern="forward").refusal is Refusal.ESTOPPED
    harness.applied("stop")


def test_an_estop_with_an_id_that_is_no_name_of_a_latch_gets_one_of_its_own() -> None:
    """A name that was reset would latch no peer again."""
    harness = started()
    names = []
    for id in ("5C1E-A", "5C1E-B", "5C1E-A"):
        harness.applied("estop", id=id)
        [latch_id] = harness.written[-1].held
        assert is_id(latch_id)
        assert len(latch_id) == 32  # of the hash
        names.append(latch_id)
        harness.applied("reset", ids=(latch_id,))
    assert names[0] == names[2] != names[1]


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_answer_to_a_stop_has_the_measured_speed_and_its_age(verb: str) -> None:
    harness = started()
    harness.odometry = Twist(0.123, -0.001)
    harness.advance(0.1)
    harness.odometry = None
    harness.advance(0.2)
    text = harness.applied(verb).text
    assert text == "commanded zero; measured 0.12 m/s, 0.00 rad/s, 0.2 s ago"


def test_answer_to_a_stop_has_the_speed_to_the_left_of_a_base_that_moves_sideways() -> None:
    harness = RobotHarness("rosbot_xl", patterns=PATTERNS)
    harness.odometry = Twist(0.0, 0.0, -0.3)
    harness.advance(0.2)
    reply = harness.answer(harness.request("stop"))
    assert "measured 0.00 m/s, 0.00 rad/s, -0.30 m/s to the left" in reply.text


def test_answer_to_a_stop_never_says_commanded_if_nothing_was_sent() -> None:
    harness = started()
    harness.step(DriverInput(False, "no bridge at 7447"))
    harness.odometry = None
    harness.advance(1.0)
    request = harness.request("estop")
    reply = harness.answer(request)
    assert reply.is_moving  # the driver may come back
    assert reply.text.startswith("nothing was sent: driver lost: no bridge at 7447; measured ")
    assert reply.text.endswith(" 1.0 s ago")
    assert "commanded" not in reply.text
    harness.advance(1.9)
    assert harness.answer(request).code is Code.APPLIED
    harness.advance(0.1)
    reply = harness.answer(request)
    assert (reply.code, reply.refusal) == (Code.FAILED, Refusal.NOT_STOPPED)
    assert "commanded" not in reply.text


@pytest.mark.parametrize("verb", ["stop", "estop"])
@pytest.mark.parametrize(("gets_zero", "is_stopped"), [(False, False), (True, True)])
def test_a_robot_that_never_moved_has_stopped_only_if_zero_reaches_its_base(
    verb: str, gets_zero: bool, is_stopped: bool
) -> None:
    """The base may move on from the life before. A driver without a base takes each zero."""
    harness = RobotHarness(patterns=PATTERNS)
    harness.odometry = None
    harness.step(DriverInput(False, "no bridge at 7447", gets_zero=gets_zero))
    harness.advance(60.0)
    request = harness.request(verb)
    assert harness.answer(request).is_moving is not is_stopped
    harness.advance(STOP_TIME)
    reply = harness.answer(request)
    assert (reply.code is Code.APPLIED, reply.is_moving) == (is_stopped, False)
    assert reply.refusal is (None if is_stopped else Refusal.NOT_STOPPED)
    sent = "commanded zero; " if is_stopped else "nothing was sent: driver lost: "
    assert reply.text.startswith(f"{sent}no bridge at 7447")


def test_a_daemon_that_starts_gives_its_base_time_to_be_heard() -> None:
    """The base may move on from the life before: a stop meanwhile is asked again."""
    harness = RobotHarness(patterns=PATTERNS)
    harness.step(DriverInput(False, "not connected yet"))
    request = harness.request("estop")
    assert harness.answer(request).is_moving
    harness.step(DriverInput(True, ""))
    harness.odometry = None
    harness.advance(0.1)
    assert harness.answer(request).is_moving
    harness.odometry = Twist(0.3)
    harness.advance(STOP_TIME)
    reply = harness.answer(request)
    assert (reply.code, reply.refusal) == (Code.FAILED, Refusal.NOT_STOPPED)


def test_answer_to_a_stop_says_that_someone_else_drives() -> None:
    harness = started()
    words = "someone else drives: " + "x" * 999
    harness.step(DriverInput(False, words, gets_zero=True))
    text = harness.applied("estop").text
    assert text.startswith("commanded zero; someone else drives: ")
    assert " ago" in text
    assert text.count("x") == 200 - len("someone else drives: ")  # 200 characters of the driver


def test_answer_to_a_stop_without_odometry() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    assert harness.applied("stop").text == "commanded zero; no odometry"


@pytest.mark.parametrize("verb", ["stop", "estop"])
@pytest.mark.parametrize(
    ("measured", "final"),
    [
        (Twist(), Code.APPLIED),
        (Twist(0.02, 0.05), Code.APPLIED),  # the most noise of a base at rest
        (Twist(0.2), Code.FAILED),
        (Twist(0.0, -0.4), Code.FAILED),
        (Twist(0.0, 0.0, -0.2), Code.FAILED),
        (None, Code.FAILED),  # odometry has ended: it may move
    ],
)
def test_a_robot_has_stopped_once_odometry_shows_that_its_base_rests(
    verb: str, measured: Twist | None, final: Code
) -> None:
    """It says at once that zero was commanded, and after two seconds that the base moves on."""
    harness = started()
    harness.odometry = Twist(0.2)
    harness.advance(0.1)
    request = harness.request(verb)
    first = harness.answer(request)
    assert (first.code, first.is_moving) == (Code.APPLIED, True)
    harness.odometry = measured
    harness.advance(0.1)
    assert harness.answer(request).is_moving  # a base that has yet to respond may seem to rest
    harness.advance(STOP_TIME)
    reply = harness.answer(request)
    assert (reply.code, reply.is_moving) == (final, False)
    assert reply.refusal is (None if final is Code.APPLIED else Refusal.NOT_STOPPED)
    assert harness.twist.is_zero


@pytest.mark.parametrize("moves", [Twist(0.2), Twist(0.0, 0.5), Twist(0.0, 0.0, 0.2)])
def test_a_base_that_was_moved_in_any_direction_has_time_to_respond(moves: Twist) -> None:
    """At rest is what was measured after the last command to move (`answer` of motion.md)."""

    class Moving(MovementPattern[Params]):
        def drive(self, inputs: Inputs) -> Twist:
            return moves

    harness = RobotHarness("rosbot_xl", patterns={"moving": Moving})
    harness.advance(1.0)
    harness.ask("run", pattern="moving")
    harness.advance(1.0)
    assert harness.twist == moves
    request = harness.request("stop")
    assert harness.answer(request).is_moving  # by odometry it rests: the base is late
    harness.advance(0.3)
    assert not harness.answer(request).is_moving


def test_odometry_from_before_the_last_command_shows_no_rest() -> None:
    """A base that started late seemed to rest as its odometry ended."""
    harness = started()
    harness.odometry = Twist()
    harness.advance(0.1)
    harness.odometry = None
    request = harness.request("stop")
    assert harness.answer(request).is_moving
    harness.advance(0.5)
    assert harness.answer(request).is_moving
    harness.advance(1.5)
    assert harness.answer(request).refusal is Refusal.NOT_STOPPED


@pytest.mark.parametrize(("after", "is_moving"), [(0.199, True), (0.2, False)])
def test_rest_counts_that_is_measured_a_fifth_of_a_second_after_the_last_command(
    after: float, is_moving: bool
) -> None:
    """`_is_at_rest` has the bound, which counts itself: a base responds within 0.2 s."""
    harness = started()
    assert not harness.twist.is_zero  # commanded at this tick, for the last time
    request = harness.request("stop")
    harness.send(request)
    harness.now += after
    harness.step(OdometryInput(Odometry(harness.now, Pose(), Twist())))
    assert harness.answer(request).is_moving is is_moving


@pytest.mark.parametrize(("seconds", "is_moving"), [(1.9, True), (2.0, False)])
def test_a_base_without_odometry_has_been_heard_two_seconds_after_the_start(
    seconds: float, is_moving: bool
) -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.odometry = None
    harness.advance(seconds)
    assert harness.applied("stop").is_moving is is_moving


def test_a_robot_that_stands_says_at_once_that_it_has_stopped() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.advance(0.2)
    reply = harness.applied("estop")
    assert not reply.is_moving


def test_a_robot_names_no_emergency_stop_that_was_reset() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.ask("estop", id="e1", reason="smoke")
    harness.ask("estop", id="e2", reason="cable")
    assert "smoke" in harness.status.detail
    assert "cable" in harness.status.detail
    harness.ask("reset", ids=("e1",))
    assert "smoke" not in harness.status.detail
    assert "cable" in harness.status.detail


def test_latch_on_disk_holds_the_next_instance() -> None:
    harness = started()
    harness.send(harness.request("estop", id="e1"))
    reborn = RobotHarness(patterns=PATTERNS, latches=harness.written[-1], instance="boot2")
    assert standing_state(reborn) == (State.ESTOPPED, Reason.ESTOP)


@pytest.mark.parametrize(("reason", "detail"), [("", "by ben"), ("smoke is gone", "smoke is gone")])
def test_a_reset_is_told_with_its_reason_or_its_operator(reason: str, detail: str) -> None:
    harness = idle()
    harness.applied("estop", id="e1")
    harness.applied("reset", ids=("e1",), operator="ben", reason=reason)
    assert harness.status.detail == detail


def test_a_reset_of_an_idle_robot_says_that_it_ended_nothing() -> None:
    assert idle().applied("reset").text == "idle: nothing to reset"


def test_the_time_of_the_last_reset_is_that_of_a_reset() -> None:
    """Peers hand on no stop that was issued before it, so a robot without a reset has none."""
    harness = idle()
    assert harness.robot.reset_at == -math.inf
    harness.applied("stop")
    harness.advance(0.5)
    harness.applied("reset")
    assert harness.robot.reset_at == harness.now


def test_reset_that_crosses_a_second_estop_leaves_it_latched() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.send(harness.request("estop", id="e1"))
    reset = harness.request("reset", ids=["e1"])
    harness.send(harness.request("estop", id="e2"))
    assert harness.answer(reset).refusal is Refusal.STALE_EPOCH
    assert set(harness.status.latches) == {"e1", "e2"}
    assert harness.refused("reset", ids=["e1"]).refusal is Refusal.ESTOPPED
    assert standing_state(harness)[0] is State.ESTOPPED
    harness.ask("reset", ids=["e2"])
    assert not harness.written[-1].held
    assert standing_state(harness) == (State.IDLE, Reason.RESET)


def test_swarm_wide_latch_of_a_peer_is_adopted_unless_reset() -> None:
    harness = started()
    swarm_wide = {"e9": Latch(issuer="alice", scope="swarm")}
    only_there = {"e8": Latch(issuer="alice", scope="robots")}
    harness.step(LatchesInput(only_there))
    assert harness.status.state is State.RUNNING
    harness.step(LatchesInput(swarm_wide))
    assert standing_state(harness) == (State.ESTOPPED, Reason.ESTOP)
    harness.ask("reset", ids=["e9"])
    harness.step(LatchesInput(swarm_wide))
    assert standing_state(harness)[0] is State.IDLE


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_stop_cancels_a_load(verb: str) -> None:
    harness = idle()
    harness.is_hung = True
    run = harness.request("run", pattern="forward")
    assert harness.send(run) is None
    harness.ask(verb)
    assert harness.reply_to(run).refusal is Refusal.OVERTAKEN
    harness.host_says(Loaded(1, 10.0, frozenset(), {}))
    harness.is_hung = False
    harness.advance(1.0)
    assert harness.twist.is_zero
    assert harness.status.state in (State.STOPPED, State.ESTOPPED)


def test_run_during_a_load_is_refused_and_names_the_operator() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.is_hung = True
    assert harness.ask("run", pattern="forward", operator="alice") is None
    refused = harness.refused("run", pattern="forward", operator="bob")
    assert refused.refusal is Refusal.BUSY
    assert refused.text == "still loading forward, by alice"


def test_load_that_hangs_in_an_idle_robot_fails_after_3_s() -> None:
    harness = idle()
    harness.is_hung = True
    run = harness.request("run", pattern="forward")
    assert harness.send(run) is None
    harness.advance(2.9)
    assert not harness.is_answered(run)
    harness.advance(0.15)
    answer = harness.reply_to(run)
    assert (answer.code, answer.refusal) == (Code.FAILED, Refusal.PATTERN_FAILED)
    assert "loading took more than 3 s" in answer.text
    assert isinstance(harness.sent[-1], KillHost)
    assert standing_state(harness) == (State.IDLE, Reason.NEVER_ASKED)


def test_hanging_host_of_a_stopped_robot_is_killed() -> None:
    harness = started()
    harness.is_hung = True
    harness.advance(0.2)
    harness.ask("stop")
    harness.sent.clear()
    harness.advance(1.1)
    assert [type(command) for command in harness.sent] == [KillHost]
    assert standing_state(harness) == (State.STOPPED, Reason.OPERATOR)


def test_outputs_of_an_older_generation_are_dropped() -> None:
    harness = started(speed=0.1)
    old = harness.status.generation
    harness.ask("run", pattern="forward", params={"speed": 0.0})
    harness.advance(0.2)
    harness.host_says(Stepped(old, Outputs(Twist(0.2)), 5))
    assert harness.twist.is_zero


@pytest.mark.parametrize(("speed", "is_noted"), [(0.9, True), (-0.9, True), (0.26, False)])
@pytest.mark.parametrize(("verb", "fields"), [("param", {}), ("run", {"pattern": "forward"})])
def test_speed_above_the_limit_is_noted_in_the_reply(
    verb: str, fields: dict[str, Any], speed: float, is_noted: bool
) -> None:
    reply = started(speed=0.1).applied(verb, params={"speed": speed}, **fields)
    assert ("waffle_pi is limited to 0.26 m/s" in reply.text) is is_noted


@pytest.mark.parametrize(
    ("platform", "lateral", "note"),
    [
        ("waffle_pi", 0.1, "lateral is 0.1 m/s, but waffle_pi is limited to 0 m/s"),
        ("rosbot_xl", 0.9, "limited to 0.8 m/s"),
        ("rosbot_xl", -0.8, None),
    ],
)
def test_a_lateral_speed_above_the_limit_is_noted_in_the_reply(
    platform: str, lateral: float, note: str | None
) -> None:
    harness = RobotHarness(platform, patterns={"drive": Drive})
    harness.advance(1.0)
    text = harness.applied("run", pattern="drive", params={"lateral": lateral}).text
    assert ("limited to" in text) is (note is not None)
    assert (note or "") in text


def test_param_set_holds_until_the_next_run() -> None:
    harness = started(speed=0.1)
    harness.applied("param", params={"speed": "0.15"})
    assert harness.status.params["speed"].value == 0.15
    assert harness.status.params["speed"].source == "request"
    harness.advance(0.2)
    assert harness.twist == Twist(0.15)
    harness.ask("run", pattern="forward")
    harness.advance(0.2)
    assert harness.twist == Twist(0.2)


def test_change_of_the_network_ends_the_run_and_nothing_late_starts_motion() -> None:
    harness = started()
    seen = harness.epoch
    harness.step(NetworkInput("wlan0 has no address"))
    assert harness.twist.is_zero
    assert standing_state(harness) == (State.STOPPED, Reason.NETWORK_CHANGED)
    assert harness.status.detail == "wlan0 has no address"
    late = harness.answer(harness.request("run", seen, pattern="forward"))
    assert late.refusal is Refusal.STALE_EPOCH
    harness.advance(1.0)
    assert harness.twist.is_zero
    harness.ask("run", pattern="forward")
    harness.advance(0.2)
    assert harness.twist == Twist(0.2)


def test_a_roster_ends_the_run_and_one_without_the_robot_refuses_further_ones() -> None:
    harness = started()
    seen = harness.epoch
    harness.step(RosterInput("generation 3", is_revoked=False))
    assert harness.twist.is_zero
    assert standing_state(harness) == (State.STOPPED, Reason.ROSTER_CHANGED)
    late = harness.answer(harness.request("run", seen, pattern="forward"))
    assert late.refusal is Refusal.STALE_EPOCH
    harness.ask("run", pattern="forward")
    harness.advance(0.2)
    assert not harness.twist.is_zero
    harness.step(RosterInput("generation 4", is_revoked=True))
    assert harness.twist.is_zero
    refused = harness.answer(harness.request("run", harness.epoch, pattern="forward"))
    assert refused.refusal is Refusal.REVOKED
    harness.applied("stop")
    harness.applied("reset")  # it moves nothing, and ends what an operator may have to end


def test_change_of_the_network_cancels_a_load() -> None:
    harness = idle()
    harness.is_hung = True
    run = harness.request("run", pattern="forward")
    assert harness.send(run) is None
    harness.step(NetworkInput("wlan0 is down"))
    assert harness.reply_to(run).refusal is Refusal.OVERTAKEN
    harness.is_hung = False
    harness.advance(1.0)
    assert harness.twist.is_zero
    assert standing_state(harness) == (State.IDLE, Reason.NEVER_ASKED)


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_change_of_the_network_leaves_a_standing_robot_its_reason(verb: str) -> None:
    harness = started()
    harness.ask(verb)
    before, revision = standing_state(harness), harness.epoch.revision
    harness.step(NetworkInput("wlan0 has 10.0.0.9 now"))
    assert standing_state(harness) == before
    assert harness.epoch.revision == revision + 1
    assert harness.status.events[-1].text == "network: wlan0 has 10.0.0.9 now"


def test_duplicate_id_faults_until_it_left_and_a_reset() -> None:
    harness = started()
    harness.step(DuplicateInput("instance b"))
    assert harness.twist.is_zero
    assert standing_state(harness) == (State.FAULTED, Reason.DUPLICATE_ID)
    assert harness.refused("reset").refusal is Refusal.DUPLICATE_ID
    harness.step(DuplicateInput(None))
    harness.ask("reset")
    assert standing_state(harness) == (State.IDLE, Reason.RESET)


def test_reset_that_crosses_a_folded_estop_leaves_it_latched() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    for n in range(MAX_HELD + 2):
        harness.send(harness.request("estop", id=f"e{n}"))
    reset = harness.request("reset", ids=list(harness.status.latches))
    harness.send(harness.request("estop", id="second"))
    assert harness.answer(reset).refusal is Refusal.STALE_EPOCH
    assert harness.status.state is State.ESTOPPED
    revision = harness.epoch.revision
    harness.send(harness.request("estop", id="second"))
    assert harness.epoch.revision == revision  # the operator's own repetition


def test_many_latches_of_a_peer_change_the_robot_once() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    many = {f"e{n}": Latch(issuer="eve", scope="swarm") for n in range(3 * MAX_HELD)}
    harness.step(LatchesInput(many))
    revision = harness.epoch.revision
    for _ in range(3):
        harness.step(LatchesInput(many))
    assert harness.epoch.revision == revision
    assert harness.status.state is State.ESTOPPED
    assert harness.status.detail == "by eve"


@pytest.mark.parametrize(
    ("verb", "fields", "refusal"),
    [
        ("run", {"pattern": "nothing"}, Refusal.UNKNOWN_PATTERN),
        ("run", {"pattern": "forward", "params": {"pace": 1}}, Refusal.INVALID_PARAMETER),
        ("run", {"pattern": "forward", "params": {"speed": 9}}, Refusal.INVALID_PARAMETER),
        ("run", {"pattern": "forward", "until": ("someday",)}, Refusal.INVALID_CONDITION),
        ("run", {"pattern": "radio"}, Refusal.MISSING_SENSOR),
        ("run", {"pattern": "broken"}, Refusal.PATTERN_FAILED),
        ("param", {"params": {"speed": 9}}, Refusal.INVALID_PARAMETER),
        ("param", {"params": {"pace": 1}}, Refusal.INVALID_PARAMETER),
        ("reload", {"pattern": "nothing"}, Refusal.UNKNOWN_PATTERN),
    ],
)
def test_each_refused_request_has_its_code(
    verb: str, fields: dict[str, object], refusal: Refusal
) -> None:
    harness = RobotHarness(patterns={**PATTERNS, "radio": NeedsRadio, "broken": Broken})
    harness.advance(1.0)
    harness.ask("run", pattern="forward")
    reply = harness.ask(verb, **fields)
    assert reply is not None
    assert (reply.code, reply.refusal) == (Code.REFUSED, refusal), reply.text
    harness.advance(0.5)
    assert harness.twist == Twist(0.2)


def test_each_state_refuses_with_its_code() -> None:
    harness = RobotHarness(patterns=PATTERNS)

    def refusal(verb: str, **fields: object) -> Refusal | None:
        reply = harness.ask(verb, **fields)
        assert reply is not None
        return reply.refusal

    assert refusal("param", params={"speed": 0.1}) is Refusal.NOT_RUNNING
    harness.ask("estop", id="e1")
    assert refusal("run", pattern="forward") is Refusal.ESTOPPED
    assert refusal("reset") is Refusal.ESTOPPED
    assert refusal("reset", ids=("e1",)) is None
    harness.step(DuplicateInput("instance b"))
    assert refusal("run", pattern="forward") is Refusal.FAULTED
    assert refusal("reset") is Refusal.DUPLICATE_ID


FOUND = "braked at 0.60 +- 0.02 m/s2 in 3 stops, declared 1.00"


def slowed() -> RobotHarness:
    """An idle robot whose monitor has found weak brakes."""
    harness = idle()
    kernel = interpreted(
        "swarmd.robot.protection.assumption_monitor", because="a field of C is set"
    )
    monitor = kernel.AssumptionMonitor(harness.robot.platform)
    harness.robot._protection._monitor = monitor
    monitor._linear.braking, monitor._linear.evidence = 0.56, FOUND
    monitor._reduce()
    harness.advance(0.1)
    assert (harness.status.findings, harness.status.decision.speed_share) == ((FOUND,), 0.56)
    return harness


def test_reset_ends_the_findings_that_it_names() -> None:
    harness = slowed()
    revision = harness.epoch.revision
    harness.applied("reset", findings=(FOUND,), reason="new tyres", operator="alice")
    assert harness.epoch.revision > revision
    harness.advance(0.1)
    assert (harness.status.findings, harness.status.decision.speed_share) == ((), 1.0)
    assert f"ended by alice (new tyres): {FOUND}" in [one.text for one in harness.status.events]


@pytest.mark.parametrize("findings", [(), ("braked at 0.70 +- 0.02 m/s2",)])
def test_reset_leaves_findings_that_it_does_not_name(findings: tuple[str, ...]) -> None:
    harness = slowed()
    harness.ask("estop")
    harness.applied("reset", ids=tuple(harness.status.latches), findings=findings)
    harness.advance(0.1)
    assert harness.status.state is State.IDLE
    assert (harness.status.findings, harness.status.decision.speed_share) == ((FOUND,), 0.56)


def test_reset_of_an_emergency_stop_ends_the_findings_that_it_names() -> None:
    harness = slowed()
    harness.ask("estop")
    assert harness.refused("reset", findings=(FOUND,)).refusal is Refusal.ESTOPPED
    assert harness.status.findings == (FOUND,)
    harness.applied("reset", ids=tuple(harness.status.latches), findings=(FOUND,))
    assert harness.status.state is State.IDLE
    assert not harness.status.findings


@pytest.mark.parametrize(
    ("verb", "fields", "state"),
    [("run", {"pattern": "forward"}, State.RUNNING), ("drive", {"operator": "anna"}, State.IDLE)],
)
def test_findings_of_a_robot_that_runs_or_is_driven_are_not_ended(
    verb: str, fields: dict[str, Any], state: State
) -> None:
    harness = slowed()
    harness.applied(verb, **fields)
    refused = harness.refused("reset", findings=(FOUND,))
    assert refused.refusal is Refusal.BUSY
    harness.advance(0.1)
    assert (harness.status.state, harness.status.findings) == (state, (FOUND,))
    assert harness.status.decision.speed_share == 0.56


# The last order, a start or a stop, by when it was issued

STARTS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("run", {"pattern": "forward"}),
    ("resume", {}),
    ("reload", {"pattern": "forward", "is_rerun": True}),
)


def at_rest(verb: str) -> RobotHarness:
    """A robot that can start by this verb, and that a stop reached one second ago."""
    harness = started() if verb == "reload" else RobotHarness(patterns=PATTERNS)
    if verb == "resume":
        harness.find(JOINED, 100.0, may_join=False)
    harness.advance(5.0)
    harness.applied("stop", operator="bob")
    if verb == "reload":  # a rerun needs a run, which a third operator wanted after the stop
        harness.ask("run", pattern="forward", operator="carla")
    harness.advance(1.0)
    return harness


@pytest.mark.parametrize(("verb", "fields"), STARTS)
def test_a_start_that_was_issued_before_a_known_stop_is_refused(
    verb: str, fields: dict[str, Any]
) -> None:
    """Its operator may have looked at the robot after the stop, and quotes its present epoch."""
    harness = at_rest(verb)
    reply = harness.refused(verb, age=1.1, **fields)
    assert reply.refusal is Refusal.OVERTAKEN
    assert "bob" in reply.text
    harness.send(harness.request(verb, age=0.9, **fields))
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING
    assert harness.status.changed_by.startswith("alice")


def test_a_reload_that_starts_no_run_is_older_than_no_stop() -> None:
    harness = at_rest("run")
    harness.send(harness.request("reload", pattern="forward", age=5.0))
    harness.advance(0.5)
    assert harness.replies[-1].code is Code.APPLIED


def test_a_copy_that_arrives_late_keeps_its_time_of_issue() -> None:
    """The age of the copy counts from its sending; the robot's own clock tells more."""
    harness = at_rest("run")
    stopped = harness.now - 1.0
    at = {harness.robot.id: stopped - 0.1}
    late = harness.refused("run", pattern="forward", age=0.2, issued_at=at)
    assert late.refusal is Refusal.OVERTAKEN
    at = {harness.robot.id: stopped + 0.1}
    harness.send(harness.request("run", pattern="forward", age=1.5, issued_at=at))
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING


@pytest.mark.parametrize("others", [{}, {"at": {"tb3-01": 1007.0}}], ids=["at once", "at a time"])
def test_a_stop_that_a_robot_learns_later_ends_an_earlier_run(others: dict[str, Any]) -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.advance(5.0)
    harness.send(harness.request("run", pattern="forward", age=3.0, **others))
    harness.advance(0.5)
    assert late_stop(harness, 3.4).code is Code.APPLIED
    harness.advance(3.0)
    assert (harness.status.state, harness.twist.is_zero) == (State.STOPPED, True)


def test_orders_of_one_machine_are_compared_by_its_clock() -> None:
    """Whatever the ways took: the stop seems to be later than it was, and the run earlier.

    A stop that came after the run is refused only if the robot's own clock agrees.
    """
    harness = RobotHarness(patterns=PATTERNS)
    harness.advance(5.0)
    harness.applied("stop", operator="bob", clock="a", issued=70.0)
    run: dict[str, Any] = {"pattern": "forward", "age": 0.5, "clock": "a"}
    assert harness.refused("run", issued=69.9, **run).refusal is Refusal.OVERTAKEN
    other = {**run, "clock": "b"}
    assert harness.refused("run", issued=70.1, **other).refusal is Refusal.OVERTAKEN
    harness.send(harness.request("run", issued=70.1, **run))
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING
    earlier = late_stop(harness, 1.1, clock="a", issued=70.05)
    assert earlier.refusal is Refusal.OVERTAKEN
    assert late_stop(harness, 9.0, id="s1", clock="a", issued=70.2).code is Code.APPLIED
    assert standing_state(harness) == (State.STOPPED, Reason.OPERATOR)


def test_an_emergency_stop_of_one_machine_is_compared_by_its_clock() -> None:
    """The robot is reset since; the request of the run seems younger than it is."""
    harness = RobotHarness(patterns=PATTERNS)
    harness.advance(5.0)
    harness.applied("estop", id="e1", clock="a", issued=70.0)
    harness.applied("reset", ids=("e1",))
    harness.advance(1.0)
    run: dict[str, Any] = {"pattern": "forward", "age": 0.1, "clock": "a"}
    assert harness.refused("run", issued=69.9, **run).refusal is Refusal.OVERTAKEN
    harness.applied("run", issued=70.1, **run)


def orders_of(clock: str, *orders: tuple[str, float]) -> RobotHarness:
    """A robot after orders of machines with one clock id, each 3 s after the one before.

    `orders`: each a verb and the time that its machine states.
    """
    harness = RobotHarness(patterns=PATTERNS)
    harness.advance(5.0)
    for number, (verb, issued) in enumerate(orders):
        fields: dict[str, Any] = {"pattern": "forward"} if verb == "run" else {}
        id = f"{verb}{number}"
        harness.send(harness.request(verb, id=id, age=0.1, clock=clock, issued=issued, **fields))
        harness.advance(3.0)
    return harness


@pytest.mark.parametrize(
    "ahead", [1e6, 600.0, 30.0, 3.5], ids=["forged", "set back", "a clone", "a close clone"]
)
def test_a_stop_counts_that_follows_a_run_of_a_machine_whose_clock_is_ahead(ahead: float) -> None:
    """A snapshot and a clone have the clock id of their original, and another time."""
    harness = orders_of("a", ("run", 100.0 + ahead), ("stop", 103.0))
    assert standing_state(harness) == (State.STOPPED, Reason.OPERATOR)


@pytest.mark.parametrize("ahead", [1e8, 600.0, 30.0, 3.5])
def test_a_stop_of_a_clock_that_is_ahead_bars_no_later_run(ahead: float) -> None:
    harness = orders_of("a", ("stop", 100.0 + ahead), ("run", 103.0))
    assert harness.status.state is State.RUNNING
    later = orders_of("a", ("stop", 100.0 + ahead), ("stop", 103.0), ("run", 106.0))
    assert later.status.state is State.RUNNING


def test_a_run_of_before_the_stop_of_a_clone_is_refused() -> None:
    """Its request came later, and its machine states a later time."""
    harness = orders_of("a", ("stop", 100.0))
    run: dict[str, Any] = {"pattern": "forward", "clock": "a", "age": 3.5}
    assert harness.refused("run", issued=130.0, **run).refusal is Refusal.OVERTAKEN
    late = {**run, "age": 2.5}
    harness.send(harness.request("run", issued=131.0, **late))
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING


def test_an_earlier_stop_of_another_clone_is_not_forgotten() -> None:
    """A run of before both stops, by the clock of the later one it follows that one."""
    harness = orders_of("a", ("stop", 500.0), ("stop", 103.0))
    run: dict[str, Any] = {"pattern": "forward", "clock": "a"}
    assert harness.refused("run", issued=499.0, age=4.9, **run).refusal is Refusal.OVERTAKEN
    assert harness.refused("run", issued=505.9, age=6.5, **run).refusal is Refusal.OVERTAKEN


def test_a_copy_of_a_stop_ends_no_run_that_was_asked_for_at_the_same_time() -> None:
    """The first copy has ended all runs that were asked for before it (module, `_StopTime`)."""
    harness = started()
    harness.applied("stop", id="s1")
    harness.send(harness.request("run", pattern="forward"))
    harness.advance(0.5)
    assert late_stop(harness, 0.0, id="s1").refusal is Refusal.OVERTAKEN
    assert harness.status.state is State.RUNNING


@pytest.mark.parametrize(("others", "is_known"), [(63, True), (64, False)])
def test_a_robot_knows_the_copies_of_its_last_64_stops(others: int, is_known: bool) -> None:
    """A copy that it does not know any more counts as a new stop: in doubt the robot stops."""
    harness = RobotHarness(patterns=PATTERNS)
    harness.advance(1.0)
    for n in range(others + 1):
        harness.applied("stop", id=f"s{n}")
    harness.advance(0.1)
    harness.send(harness.request("run", pattern="forward"))
    harness.advance(0.5)
    late_stop(harness, 0.0, id="s0")
    assert (harness.status.state is State.RUNNING) is is_known


def test_an_old_stop_makes_no_stop_after_it_new_again() -> None:
    """Stops that a later one covers change nothing, whatever order they come in."""
    harness = RobotHarness(patterns=PATTERNS)
    harness.advance(5.0)
    harness.applied("stop", id="newest")
    epoch = harness.epoch
    assert late_stop(harness, 3.0, id="oldest").code is Code.APPLIED
    assert late_stop(harness, 1.0, id="between").code is Code.APPLIED
    assert harness.epoch == epoch


def test_two_stops_of_one_instant_change_a_robot_that_stands_once() -> None:
    """The table of requests.py: two operators stop it together, and no third request is stale."""
    harness = idle()
    harness.applied("stop", id="anna")
    epoch = harness.epoch
    harness.applied("stop", id="ben")
    assert harness.epoch == epoch
    harness.applied("reset")
    harness.applied("stop", id="carl")  # the reset may have been asked for after it
    assert standing_state(harness) == (State.IDLE, Reason.RESET)
    harness.advance(0.1)
    harness.applied("stop", id="dora")
    assert standing_state(harness) == (State.STOPPED, Reason.OPERATOR)


def test_a_stop_that_was_issued_before_an_emergency_stop_changes_nothing_after_it() -> None:
    harness = started()
    harness.advance(1.0)
    harness.applied("estop", id="e1")
    epoch = harness.epoch
    harness.advance(0.5)
    assert late_stop(harness, 0.6, id="s1").code is Code.APPLIED
    assert harness.epoch == epoch  # a reset that was asked for at this epoch counts


def test_a_reset_of_one_latch_of_two_makes_earlier_requests_stale() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.applied("estop", id="e1")
    harness.applied("estop", id="e2")
    before = harness.epoch
    assert harness.refused("reset", ids=["e1"]).refusal is Refusal.ESTOPPED
    assert set(harness.status.latches) == {"e2"}
    late = harness.answer(harness.request("reset", before, ids=["e2"]))
    assert late.refusal is Refusal.STALE_EPOCH
    assert standing_state(harness) == (State.ESTOPPED, Reason.ESTOP)


@pytest.mark.parametrize("late_by", [0.5, 0.51])  # its load would end later still
def test_a_run_whose_start_time_is_over_makes_no_other_request_stale(late_by: float) -> None:
    harness = idle()
    before = harness.epoch
    late = harness.refused("run", pattern="forward", at={harness.robot.id: harness.now - late_by})
    assert late.refusal is Refusal.TOO_LATE
    assert "start 0.5 s ago" in late.text
    assert harness.epoch == before


@pytest.mark.parametrize(
    ("fields", "refusal"),
    [
        ({"age": 5.0}, None),
        ({"age": 5.01}, Refusal.TOO_LATE),
        ({"ahead": -0.49}, None),
        ({"ahead": 60.0}, None),
        ({"ahead": 60.01}, Refusal.INVALID_REQUEST),
    ],
)
def test_a_start_counts_up_to_the_bounds_of_its_times(
    fields: dict[str, float], refusal: Refusal | None
) -> None:
    """5 s of age, 0.5 s after its start time, and 60 s before it."""
    harness = idle()
    more: dict[str, Any] = {"age": fields["age"]} if "age" in fields else {}
    at = {harness.robot.id: harness.now + fields["ahead"]} if "ahead" in fields else {}
    reply = harness.send(harness.request("run", pattern="forward", at=at, **more))
    assert (reply.refusal if reply is not None else None) is refusal


STATED = ("age", "issued_at")


@pytest.mark.parametrize("stated", STATED)
@pytest.mark.parametrize(("verb", "fields"), STARTS)
def test_a_start_of_more_than_five_seconds_is_refused(
    verb: str, fields: dict[str, Any], stated: str
) -> None:
    """docs/evidence/motion.md: 5 s beside what the request declares, with the age in the answer."""
    harness = at_rest(verb)
    harness.advance(20.0)

    def aged(age: float) -> dict[str, Any]:
        at = {harness.robot.id: harness.now - age}
        return {**fields, "issued_at": at} if stated == "issued_at" else {**fields, "age": age}

    late = harness.refused(verb, **aged(5.1))
    assert late.refusal is Refusal.TOO_LATE
    assert "5.1 s" in late.text
    assert "of work" not in late.text
    late = harness.refused(verb, planned=4.0, **aged(9.1))
    assert late.refusal is Refusal.TOO_LATE
    assert "4.0 s of work" in late.text
    harness.send(harness.request(verb, planned=4.0, **aged(8.9)))
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING
    assert harness.status.changed_by.startswith("alice")


@pytest.mark.parametrize("stated", STATED)
@pytest.mark.parametrize(("verb", "fields"), STARTS)
def test_a_start_declares_at_most_an_hour_of_work(
    verb: str, fields: dict[str, Any], stated: str
) -> None:
    """docs/evidence/security.md: `planned` of a start counts up to an hour, beside the 5 s of
    every start.

    The robot knows no stop: one that is later than the start would refuse the start, too.
    """
    harness = started() if verb == "reload" else RobotHarness(patterns=PATTERNS)
    if verb == "resume":
        harness.find(JOINED, 100.0, may_join=False)
    harness.advance(1.0)

    def aged(age: float) -> dict[str, Any]:
        at = {harness.robot.id: harness.now - age}
        return {**fields, "issued_at": at} if stated == "issued_at" else {**fields, "age": age}

    late = harness.refused(verb, planned=1e6, **aged(3605.001))
    assert late.refusal is Refusal.TOO_LATE
    harness.send(harness.request(verb, planned=1e6, **aged(3604.999)))
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING


def test_a_start_that_claims_to_come_from_the_future_hides_no_stop() -> None:
    """A lie about the time of a run lasts no longer than the way of the request."""
    harness = RobotHarness(patterns=PATTERNS)
    harness.advance(5.0)
    at = {harness.robot.id: harness.now + 1000.0}
    harness.send(harness.request("run", pattern="forward", issued_at=at))
    harness.advance(1.0)
    assert harness.status.state is State.RUNNING
    assert late_stop(harness, 0.5).code is Code.APPLIED
    assert standing_state(harness) == (State.STOPPED, Reason.OPERATOR)


@pytest.mark.parametrize("verb", ["run", "reset", "param", "resume", "label", "reload"])
def test_an_epoch_that_the_robot_has_not_had_yet_is_refused(verb: str) -> None:
    """docs/architecture/robot.md: a robot refuses any other epoch than its own."""
    harness = started()
    fields: dict[str, dict[str, Any]] = {
        "run": {"pattern": "forward"},
        "param": {"params": {"speed": 0.1}},
        "label": {"labels": ("red",)},
        "reload": {"pattern": "forward"},
    }
    later = msgspec.structs.replace(harness.epoch, revision=harness.epoch.revision + 1)
    reply = harness.answer(harness.request(verb, later, **fields.get(verb, {})))
    assert reply.refusal is Refusal.STALE_EPOCH
    assert harness.status.state is State.RUNNING


STAND = Goal(generation=1, issuer="bob", id="g1")


def test_a_goal_to_stand_of_an_operator_counts_as_a_stop() -> None:
    """The robot knows a stop by a standing goal (docs/evidence/motion.md)."""
    harness = RobotHarness(patterns=PATTERNS)
    harness.advance(5.0)
    harness.applied("goal", goal=STAND, operator="bob", age=2.0)
    assert harness.refused("run", pattern="forward", age=3.0).refusal is Refusal.OVERTAKEN
    harness.applied("run", pattern="forward", age=1.0)


def test_a_goal_to_stand_from_a_peer_counts_as_a_stop() -> None:
    """A robot that boots after a stop of all learns it by this goal."""
    harness = RobotHarness(patterns=PATTERNS)
    harness.find(STAND, 10.0, may_join=False)
    assert harness.refused("run", pattern="forward", age=11.0).refusal is Refusal.OVERTAKEN
    harness.send(harness.request("run", pattern="forward", age=9.0, planned=5.0))
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING


def test_a_latch_from_a_peer_counts_as_a_stop_after_its_reset() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.step(LatchesInput({"e1": Latch(issuer="bob", scope="swarm")}))
    harness.advance(1.0)
    harness.applied("reset", ids=("e1",))
    assert harness.refused("run", pattern="forward", age=1.1).refusal is Refusal.OVERTAKEN
    harness.send(harness.request("run", pattern="forward", age=0.9))
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING


def test_a_daemon_that_restarts_knows_the_last_stop() -> None:
    before = RobotHarness(patterns=PATTERNS)
    before.applied("stop", operator="bob")
    harness = RobotHarness(patterns=PATTERNS, goals=before.record, instance="boot2")
    harness.advance(1.0)
    assert harness.refused("run", pattern="forward", age=1.1).refusal is Refusal.OVERTAKEN
    harness.send(harness.request("run", pattern="forward", age=0.9))
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING


def test_parameters_are_not_set_while_a_pattern_restarts_or_takes_others() -> None:
    restarting = started()
    restarting.host_says(PatternFailed(restarting.status.generation, "it broke"))
    assert restarting.status.reason is Reason.PATTERN_RESTARTING
    assert restarting.refused("param", params={"speed": 0.1}).refusal is Refusal.NOT_RUNNING

    taking = started()
    taking.is_hung = True
    assert taking.ask("param", params={"speed": 0.1}) is None
    assert taking.refused("param", params={"speed": 0.15}).refusal is Refusal.BUSY
