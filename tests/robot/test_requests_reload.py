"""Replacing code, told in simulated time: what a trial may change, and what ends it."""

from __future__ import annotations

from typing import Any

import pytest

from swarmd.api import Inputs, MovementPattern, Params, Twist
from swarmd.core.errors import PluginError
from swarmd.core.host_messages import (
    CancelTrial,
    KillHost,
    Load,
    LoadRefused,
    StartTrial,
    Step,
    TrialDone,
)
from swarmd.core.messages import Code, Reason, Refusal, Reply, Request, State
from swarmd.robot.requests import TRIAL_TIMEOUT
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS, standing_state


class Forward(MovementPattern[Params]):
    """Drives straight."""

    def drive(self, inputs: Inputs) -> Twist:
        return Twist(0.2)


class Broken(MovementPattern[Params]):
    """Cannot be made."""

    def __init__(self, *args: object) -> None:
        raise PluginError("broken as it is")

    def drive(self, inputs: Inputs) -> Twist:
        return Twist()


def driving() -> RobotHarness:
    story = RobotHarness(patterns={**PATTERNS, "own": Forward, "broken": Broken})
    story.advance(1.0)
    story.ask("run", pattern="own")
    story.advance(0.5)
    assert story.twist == Twist(0.2)
    story.sent.clear()
    return story


def answer(story: RobotHarness, request: Request) -> Reply:
    return next(reply for reply in story.replies if reply.id == request.id)


def begun(story: RobotHarness, **args: Any) -> Request:
    """A reload whose trial is under way, while the pattern in force goes on."""
    request = story.request("reload", pattern="own", **args)
    actions = story.robot.on_request(request, story.now)
    assert isinstance(actions.trial, StartTrial)
    assert actions.replies == ()
    assert actions.twist == Twist(0.2)
    return request


def test_a_robot_that_is_reloaded_stops_and_its_host_is_replaced() -> None:
    story = driving()
    reply = story.ask("reload", pattern="own")
    assert reply is not None
    assert (reply.code, reply.text) == (Code.APPLIED, "reloaded, and stopped")
    assert [type(command) for command in story.sent] == [StartTrial, KillHost]
    assert story.twist.is_zero
    assert standing_state(story) == (State.STOPPED, Reason.RELOADED)
    story.advance(2.0)
    assert story.twist.is_zero


def test_asked_to_it_loads_in_a_fresh_host_with_the_same_parameters_and_the_time_left() -> None:
    story = driving()
    story.ask("run", pattern="own", params={"recovery": False}, seconds=60.0)
    story.advance(20.0)
    story.sent.clear()
    reply = story.ask("reload", pattern="own", is_rerun=True)
    assert reply is not None
    assert (reply.code, reply.text) == (Code.APPLIED, "runs own")
    loads = [command for command in story.sent if isinstance(command, Load)]
    assert [(load.is_fresh, dict(load.layers[-1][1])) for load in loads] == [
        (True, {"recovery": False})
    ]
    story.advance(39.0)
    assert story.twist == Twist(0.2)
    story.advance(2.0)
    assert standing_state(story) == (State.IDLE, Reason.FINISHED)


def test_the_trial_has_the_parameters_in_force() -> None:
    story = driving()
    story.ask("run", pattern="own", params={"recovery": False})
    request = story.request("reload", pattern="own")
    actions = story.robot.on_request(request, story.now)
    assert isinstance(actions.trial, StartTrial)
    assert dict(actions.trial.load.layers[-1][1]) == {"recovery": False}


@pytest.mark.parametrize(
    ("pattern", "refusal"),
    [("broken", Refusal.PATTERN_FAILED), ("owm", Refusal.UNKNOWN_PATTERN)],
)
def test_code_that_cannot_be_loaded_is_refused_and_what_runs_goes_on(
    pattern: str, refusal: Refusal
) -> None:
    story = driving()
    generation = story.status.generation
    reply = story.ask("reload", pattern=pattern, is_rerun=True)
    assert reply is not None
    assert (reply.code, reply.refusal) == (Code.REFUSED, refusal)
    story.advance(1.0)
    assert story.twist == Twist(0.2)
    assert story.status.generation == generation
    assert not any(isinstance(command, KillHost | Load) for command in story.sent)


def test_a_trial_that_takes_too_long_is_ended_and_what_runs_goes_on() -> None:
    story = driving()
    request = begun(story, is_rerun=True)
    story.advance(TRIAL_TIMEOUT - 0.1)
    assert not any(reply.id == request.id for reply in story.replies)
    story.advance(0.2)
    assert answer(story, request).refusal is Refusal.PATTERN_FAILED
    assert isinstance(story.sent[-1], CancelTrial) or any(
        isinstance(c, CancelTrial) for c in story.sent
    )
    story.host_says(TrialDone(1, ""))  # too late
    story.advance(1.0)
    assert story.twist == Twist(0.2)
    assert story.ask("reload", pattern="own") is not None


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_stop_ends_the_trial_and_nothing_runs_again(verb: str) -> None:
    story = driving()
    request = begun(story, is_rerun=True)
    story.ask(verb)
    reply = answer(story, request)
    assert reply.refusal is Refusal.OVERTAKEN
    assert any(isinstance(command, CancelTrial) for command in story.sent)
    story.host_says(TrialDone(1, ""))
    story.advance(1.0)
    assert story.twist.is_zero


def test_a_frozen_guardian_ends_the_trial() -> None:
    story = driving()
    request = begun(story, is_rerun=True)
    story.advance(2.0, ticks=False)
    story.host_says(TrialDone(1, ""))
    assert answer(story, request).refusal is Refusal.OVERTAKEN
    assert standing_state(story) == (State.STOPPED, Reason.LOOP_STALLED)
    story.advance(1.0)
    assert story.twist.is_zero


def test_a_robot_that_stopped_for_another_reason_meanwhile_does_not_run_again() -> None:
    story = driving()
    request = begun(story, is_rerun=True)
    story.scans = lambda seq, now: None
    story.advance(4.0)
    assert standing_state(story) == (State.STOPPED, Reason.STALE_SCAN)
    story.host_says(TrialDone(1, ""))
    assert "stopped, as before" in answer(story, request).text
    story.advance(1.0)
    assert standing_state(story) == (State.STOPPED, Reason.STALE_SCAN)


def test_one_trial_at_a_time_and_no_change_meanwhile() -> None:
    story = driving()
    begun(story, operator="ben")
    for verb, args in (
        ("reload", {"pattern": "forward"}),
        ("run", {"pattern": "forward"}),
        ("param", {"params": {"recovery": False}}),
    ):
        reply = story.ask(verb, **args)
        assert reply is not None
        assert reply.refusal is Refusal.BUSY


def test_another_epoch_is_refused() -> None:
    story = driving()
    seen = story.epoch
    story.ask("stop")
    reply = story.send(story.request("reload", seen, pattern="own", is_rerun=True))
    assert reply is not None
    assert reply.refusal is Refusal.STALE_EPOCH


def test_what_does_not_run_is_tried_and_the_next_load_is_in_a_fresh_host() -> None:
    story = driving()
    reply = story.ask("reload", pattern="forward", is_rerun=True)
    assert reply is not None
    assert (reply.code, reply.text) == (
        Code.APPLIED,
        "a run of forward takes the new code; own goes on",
    )
    story.advance(0.5)
    assert story.twist == Twist(0.2)
    assert [type(one) for one in story.sent if not isinstance(one, Step)] == [
        StartTrial,
        CancelTrial,
    ]
    for is_fresh in (True, False):
        story.ask("run", pattern="forward")
        loads = [command for command in story.sent if isinstance(command, Load)]
        assert loads[-1].is_fresh is is_fresh


def test_an_idle_robot_gets_a_fresh_host_and_stays_idle() -> None:
    story = RobotHarness(patterns={"own": Forward})
    story.advance(1.0)
    reply = story.ask("reload", pattern="own", is_rerun=True)
    assert reply is not None
    assert reply.text == "a run of own takes the new code; idle, as before"
    assert [type(command) for command in story.sent] == [StartTrial, KillHost]
    assert standing_state(story) == (State.IDLE, Reason.NEVER_ASKED)


def test_what_ran_comes_back_after_a_load_that_replaced_its_host_is_refused() -> None:
    story = driving()
    story.ask("reload", pattern="forward")
    story.is_hung = True
    request = story.request("run", pattern="forward")
    story.send(request)
    story.is_hung = False
    story.host_says(LoadRefused(story.status.generation, "broken meanwhile"))
    assert answer(story, request).text == "broken meanwhile"
    assert isinstance(story.sent[-1], KillHost)  # the host that was refused has no pattern to step
    story.advance(0.5)
    assert standing_state(story)[0] is State.RUNNING
    assert story.status.pattern == "own"
    assert story.twist == Twist(0.2)


def test_the_outcome_of_an_earlier_trial_is_not_that_of_a_later_one() -> None:
    story = driving()
    story.is_hung = True
    first = story.request("reload", pattern="own")
    story.send(first)
    story.ask("estop")
    second = story.request("reload", pattern="own")
    story.send(second)
    story.host_says(TrialDone(1, "the first is broken"))
    assert all(reply.id != second.id for reply in story.replies)
    story.host_says(TrialDone(2, ""))
    assert answer(story, second).text == "a run of own takes the new code; estopped, as before"


def test_a_step_that_the_old_host_still_owes_is_not_awaited_of_the_new_one() -> None:
    story = driving()
    story.is_hung = True
    story.advance(0.2)
    story.ask("reload", pattern="own")
    story.host_says(TrialDone(1, ""))
    assert isinstance(story.sent[-1], KillHost)
    story.sent.clear()
    story.is_hung = False
    story.advance(1.5)
    assert story.sent == []


def test_who_asks_after_a_reload_is_told_of_it() -> None:
    story = driving()
    seen = story.epoch
    story.ask("reload", pattern="forward", operator="ben")
    reply = story.send(story.request("run", seen, pattern="forward"))
    assert reply is not None
    assert reply.text == "robot changed since you looked, by ben (reload forward)"
