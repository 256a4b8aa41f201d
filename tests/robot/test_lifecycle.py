"""What faults of hosts, loops and disks taught the robot's conduct, told in simulated time."""

from __future__ import annotations

import pytest

from swarmd.api import Inputs, MovementPattern, Params, Twist
from swarmd.core.host_messages import KillHost, Load, Loaded
from swarmd.core.messages import Code, Reason, Reply, Request, State
from tests.support.robot_harness import RobotHarness


class Forward(MovementPattern[Params]):
    """Drives straight."""

    def drive(self, inputs: Inputs) -> Twist:
        return Twist(0.2)


class Backward(MovementPattern[Params]):
    """Drives back."""

    def drive(self, inputs: Inputs) -> Twist:
        return Twist(-0.1)


def driving() -> RobotHarness:
    story = RobotHarness(patterns={"forward": Forward, "backward": Backward})
    story.advance(1.0)
    reply = story.ask("run", pattern="forward")
    assert reply is not None
    assert reply.code is Code.APPLIED
    story.advance(0.5)
    return story


def answer(story: RobotHarness, request: Request) -> Reply | None:
    return next((reply for reply in story.replies if reply.id == request.id), None)


def standing(story: RobotHarness) -> tuple[State, Reason | None]:
    status = story.status
    return status.state, status.reason


@pytest.mark.parametrize("is_stopped_first", [True, False])
def test_a_pattern_asked_for_while_the_one_before_hangs_is_loaded_in_a_new_host(
    is_stopped_first: bool,
) -> None:
    story = driving()
    story.is_hung = True
    story.advance(0.5)
    if is_stopped_first:
        story.ask("stop")
    run = story.request("run", pattern="backward")
    assert story.send(run) is None
    story.sent.clear()
    story.is_hung = False  # the new host will answer; the old one never got the load
    story.advance(1.0)
    reply = answer(story, run)
    assert reply is not None
    assert reply.code is Code.APPLIED
    loads = [command for command in story.sent if isinstance(command, Load)]
    assert [load.is_fresh for load in loads] == [True]
    assert not any(isinstance(command, KillHost) for command in story.sent)
    assert story.twist == Twist(-0.1)


def test_a_host_that_stays_silent_fails_the_load_three_seconds_later() -> None:
    story = driving()
    story.is_hung = True
    story.advance(0.5)
    run = story.request("run", pattern="backward")
    story.send(run)
    story.advance(3.3)
    assert answer(story, run) is None
    story.advance(0.5)
    reply = answer(story, run)
    assert reply is not None
    assert reply.code is Code.FAILED
    assert standing(story) == (State.STOPPED, Reason.LOAD_FAILED)


def test_a_driving_robot_whose_next_pattern_loads_for_long_stands_and_then_drives_it() -> None:
    story = driving()
    story.is_hung = True
    run = story.request("run", pattern="backward")
    story.send(run)
    story.advance(2.9)
    assert story.twist.is_zero
    assert standing(story) == (State.RUNNING, Reason.COMMAND_EXPIRED)
    assert answer(story, run) is None
    story.host_says(Loaded(story.status.generation, 10.0, frozenset(), {}))
    reply = answer(story, run)
    assert reply is not None
    assert reply.code is Code.APPLIED
    assert standing(story)[0] is State.RUNNING


def test_a_load_that_never_ends_stops_a_driving_robot_for_that_reason() -> None:
    story = driving()
    story.is_hung = True
    run = story.request("run", pattern="backward")
    story.send(run)
    story.advance(3.1)
    reply = answer(story, run)
    assert reply is not None
    assert reply.text == "backward: loading took more than 3 s"
    assert standing(story) == (State.STOPPED, Reason.LOAD_FAILED)


def test_scans_that_stop_while_a_pattern_loads_still_stop_the_robot_after_two_seconds() -> None:
    story = driving()
    story.is_hung = True
    story.scans = lambda seq, now: None
    story.send(story.request("run", pattern="backward"))
    story.advance(2.9)
    assert standing(story) == (State.STOPPED, Reason.STALE_SCAN)


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_change_of_parameters_that_a_stop_overtakes_is_answered(verb: str) -> None:
    story = driving()
    story.is_hung = True
    change = story.request("param", params={"speed": "0.1"})
    assert story.send(change) is None
    story.ask(verb)
    reply = answer(story, change)
    assert reply is not None
    assert reply.code is Code.REFUSED


def test_a_loop_that_stood_still_for_over_a_second_is_stalled_wherever_in_its_beat() -> None:
    story = driving()
    story.advance(1.0 + 1e-6, ticks=False)
    story.carry_out(story.robot.tick(story.now))
    assert story.twist.is_zero
    assert standing(story) == (State.STOPPED, Reason.LOOP_STALLED)
