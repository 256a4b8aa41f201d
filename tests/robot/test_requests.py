"""What operators and peers ask of one robot, and what it refuses."""

from __future__ import annotations

import pytest

from swarmd.api import Outputs, Twist
from swarmd.core.host_messages import KillHost, Loaded, Stepped
from swarmd.core.messages import Code, Epoch, Latch, Reason, State, StopRequest
from swarmd.robot.latches import MAX_HELD
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS, standing_state, started


def test_a_request_for_another_epoch_is_refused_and_names_who_changed_it() -> None:
    story = RobotHarness(patterns=PATTERNS)
    story.advance(1.0)
    seen = story.epoch
    first = story.send(story.request("run", seen, pattern="forward", operator="alice"))
    second = story.send(story.request("run", seen, pattern="finisher", operator="bob"))
    assert first is not None
    assert first.code is Code.APPLIED
    assert second is not None
    assert second.code is Code.REFUSED
    assert "by alice (run forward)" in second.text
    assert story.status.pattern == "forward"


def test_a_replayed_run_never_moves_it() -> None:
    story = RobotHarness(patterns=PATTERNS)
    story.advance(1.0)
    request = story.request("run", pattern="forward")
    story.send(request)
    story.ask("stop")
    again = story.send(request)
    assert again is not None
    assert again.code is Code.REFUSED
    story.advance(1.0)
    assert story.twist.is_zero


def test_an_epoch_of_an_earlier_life_is_refused() -> None:
    story = RobotHarness(patterns=PATTERNS, instance="boot2")
    reply = story.send(story.request("run", Epoch("boot1", 0), pattern="forward"))
    assert reply is not None
    assert reply.code is Code.REFUSED


def test_a_robot_that_is_not_named_does_not_answer() -> None:
    story = RobotHarness(patterns=PATTERNS)
    other = StopRequest(id="x", operator="a", targets={"tb3-02": Epoch("b", 0)})
    assert story.send(other) is None
    assert standing_state(story) == (State.IDLE, Reason.NEVER_ASKED)


def test_a_thawed_guardian_stops_before_it_reads_what_waited() -> None:
    story = started()
    waiting = story.request("run", pattern="forward")
    story.advance(3.0, ticks=False)
    late = story.send(waiting)
    assert late is not None
    assert late.code is Code.REFUSED
    assert "stall" in late.text
    assert story.twist.is_zero
    assert standing_state(story) == (State.STOPPED, Reason.LOOP_STALLED)
    story.advance(2.0)
    assert story.twist.is_zero


def test_a_loop_that_is_a_second_late_is_not_yet_stalled() -> None:
    story = started()
    story.advance(0.99, ticks=False)
    story.carry_out(story.robot.tick(story.now))
    assert story.status.state is State.RUNNING


def test_estop_latches_and_is_written_before_the_ack() -> None:
    story = started()
    reply = story.send(story.request("estop", id="e1", scope="swarm"))
    assert reply is not None
    assert reply.code is Code.APPLIED
    assert reply.text.startswith("commanded zero")
    assert set(story.written[-1].held) == {"e1"}
    assert story.twist.is_zero
    assert standing_state(story) == (State.ESTOPPED, Reason.ESTOP)
    refused = story.ask("run", pattern="forward")
    assert refused is not None
    assert refused.code is Code.REFUSED
    stop = story.ask("stop")
    assert stop is not None
    assert stop.code is Code.APPLIED


def test_an_earlier_lifes_latch_holds_the_next_one() -> None:
    story = started()
    story.send(story.request("estop", id="e1"))
    reborn = RobotHarness(patterns=PATTERNS, latches=story.written[-1], instance="boot2")
    assert standing_state(reborn) == (State.ESTOPPED, Reason.ESTOP)


def test_a_reset_that_crosses_a_second_estop_leaves_it_latched() -> None:
    story = RobotHarness(patterns=PATTERNS)
    story.send(story.request("estop", id="e1"))
    reset = story.request("reset", ids=["e1"])
    story.send(story.request("estop", id="e2"))
    reply = story.send(reset)
    assert reply is not None
    assert reply.code is Code.REFUSED
    assert set(story.status.latches) == {"e1", "e2"}
    partly = story.ask("reset", ids=["e1"])
    assert partly is not None
    assert partly.code is Code.REFUSED
    assert standing_state(story)[0] is State.ESTOPPED
    story.ask("reset", ids=["e2"])
    assert standing_state(story) == (State.IDLE, Reason.RESET)


def test_a_peers_swarm_wide_latch_is_taken_over_unless_it_was_reset_here() -> None:
    story = started()
    swarm_wide = {"e9": Latch(issuer="alice", scope="swarm")}
    only_there = {"e8": Latch(issuer="alice", scope="robots")}
    story.carry_out(story.robot.on_latches(only_there, story.now))
    assert story.status.state is State.RUNNING
    story.carry_out(story.robot.on_latches(swarm_wide, story.now))
    assert standing_state(story) == (State.ESTOPPED, Reason.ESTOP)
    story.ask("reset", ids=["e9"])
    story.carry_out(story.robot.on_latches(swarm_wide, story.now))
    assert standing_state(story)[0] is State.IDLE


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_stopping_while_a_pattern_is_loaded_cancels_it(verb: str) -> None:
    story = RobotHarness(patterns=PATTERNS)
    story.advance(1.0)
    story.is_hung = True
    run = story.request("run", pattern="forward")
    assert story.send(run) is None
    story.ask(verb)
    answer = next(reply for reply in story.replies if reply.id == run.id)
    assert answer.code is Code.REFUSED
    story.host_says(Loaded(1, 10.0, frozenset(), {}))
    story.is_hung = False
    story.advance(1.0)
    assert story.twist.is_zero
    assert story.status.state in (State.STOPPED, State.ESTOPPED)


def test_whoever_asks_while_a_pattern_is_loaded_is_told_for_whom() -> None:
    story = RobotHarness(patterns=PATTERNS)
    story.is_hung = True
    assert story.ask("run", pattern="forward", operator="alice") is None
    reply = story.ask("run", pattern="forward", operator="bob")
    assert reply is not None
    assert (reply.code, reply.text) == (Code.REFUSED, "still loading forward, by alice")


def test_a_load_that_hangs_fails_after_three_seconds_and_stops_the_body() -> None:
    story = started()
    story.is_hung = True
    run = story.request("run", pattern="finisher")
    assert story.send(run) is None
    story.advance(3.1)
    answer = next(reply for reply in story.replies if reply.id == run.id)
    assert answer.code is not Code.APPLIED
    assert story.twist.is_zero
    assert story.status.state is State.STOPPED


def test_a_load_that_hangs_in_an_idle_robot_fails_after_three_seconds() -> None:
    story = RobotHarness(patterns=PATTERNS)
    story.advance(1.0)
    story.is_hung = True
    run = story.request("run", pattern="forward")
    assert story.send(run) is None
    story.advance(2.9)
    assert not any(reply.id == run.id for reply in story.replies)
    story.advance(0.15)
    answer = next(reply for reply in story.replies if reply.id == run.id)
    assert answer.code is Code.FAILED
    assert "loading took more than 3 s" in answer.text
    assert isinstance(story.sent[-1], KillHost)
    assert standing_state(story) == (State.IDLE, Reason.NEVER_ASKED)


def test_a_host_that_hangs_is_replaced_even_if_its_robot_was_stopped_meanwhile() -> None:
    story = started()
    story.is_hung = True
    story.advance(0.2)
    story.ask("stop")
    story.sent.clear()
    story.advance(1.1)
    assert [type(command) for command in story.sent] == [KillHost]
    assert standing_state(story) == (State.STOPPED, Reason.OPERATOR)


def test_outputs_of_an_older_generation_are_dropped() -> None:
    story = started(speed=0.1)
    old = story.status.generation
    story.ask("run", pattern="forward", params={"speed": 0.0})
    story.advance(0.2)
    story.host_says(Stepped(old, Outputs(Twist(0.2)), 5))
    assert story.twist.is_zero


@pytest.mark.parametrize(("speed", "is_noted"), [(0.9, True), (-0.9, True), (0.26, False)])
def test_a_speed_above_the_limit_of_the_base_is_noted(speed: float, is_noted: bool) -> None:
    reply = started(speed=0.1).ask("param", params={"speed": speed})
    assert reply is not None
    assert reply.code is Code.APPLIED
    assert ("waffle_pi is limited to 0.26 m/s" in reply.text) is is_noted


def test_param_set_changes_the_running_pattern_until_the_next_run() -> None:
    story = started(speed=0.1)
    reply = story.ask("param", params={"speed": "0.15"})
    assert reply is not None
    assert reply.code is Code.APPLIED
    assert story.status.params["speed"].value == 0.15
    assert story.status.params["speed"].source == "runtime"
    story.advance(0.2)
    assert story.twist == Twist(0.15)
    story.ask("run", pattern="forward")
    story.advance(0.2)
    assert story.twist == Twist(0.2)


def test_param_set_out_of_range_changes_nothing() -> None:
    story = started(speed=0.1)
    reply = story.ask("param", params={"speed": "7"})
    assert reply is not None
    assert reply.code is Code.REFUSED
    assert "speed is '7'" in reply.text
    story.advance(0.2)
    assert story.twist == Twist(0.1)


def test_a_second_holder_of_the_id_faults_it_until_it_has_gone_and_a_reset() -> None:
    story = started()
    story.carry_out(story.robot.on_duplicate("instance b", story.now))
    assert story.twist.is_zero
    assert standing_state(story) == (State.FAULTED, Reason.DUPLICATE_ID)
    refused = story.ask("reset")
    assert refused is not None
    assert refused.code is Code.REFUSED
    story.carry_out(story.robot.on_duplicate(None, story.now))
    story.ask("reset")
    assert standing_state(story) == (State.IDLE, Reason.RESET)


def test_a_reset_that_crosses_one_estop_more_than_are_kept_by_name_leaves_it_latched() -> None:
    story = RobotHarness(patterns=PATTERNS)
    for n in range(MAX_HELD + 2):
        story.send(story.request("estop", id=f"e{n}"))
    reset = story.request("reset", ids=list(story.status.latches))
    story.send(story.request("estop", id="second"))
    reply = story.send(reset)
    assert reply is not None
    assert reply.code is Code.REFUSED
    assert story.status.state is State.ESTOPPED
    revision = story.epoch.revision
    story.send(story.request("estop", id="second"))
    assert story.epoch.revision == revision  # the operator's own repetition


def test_a_peer_with_many_latches_does_not_change_a_robot_again_and_again() -> None:
    story = RobotHarness(patterns=PATTERNS)
    many = {f"e{n}": Latch(issuer="eve", scope="swarm") for n in range(3 * MAX_HELD)}
    story.carry_out(story.robot.on_latches(many, story.now))
    revision = story.epoch.revision
    for _ in range(3):
        story.carry_out(story.robot.on_latches(many, story.now))
    assert story.epoch.revision == revision
    assert story.status.state is State.ESTOPPED
    assert story.status.detail == "by eve"
