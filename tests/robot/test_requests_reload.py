"""Replacing code, in simulated time: what a trial may change, and what ends it."""

from __future__ import annotations

from typing import Any

import pytest

from swarmd.api import Twist
from swarmd.core.errors import PluginError
from swarmd.core.events import RequestInput
from swarmd.core.goal import Goal, GoalState
from swarmd.core.host_messages import (
    CancelTrial,
    KillHost,
    Load,
    LoadRefused,
    StartTrial,
    Step,
    TrialDone,
)
from swarmd.core.messages import Code, Reason, State
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import Request
from tests.support.robot_harness import RobotHarness, acted
from tests.support.stub_patterns import PATTERNS, Forward, standing_state


class Broken(Forward):
    """Cannot be made."""

    def __init__(self, *args: object) -> None:
        raise PluginError("broken as it is")


def driving() -> RobotHarness:
    harness = RobotHarness(patterns={**PATTERNS, "own": Forward, "broken": Broken})
    harness.advance(1.0)
    harness.ask("run", pattern="own")
    harness.advance(0.5)
    assert harness.twist == Twist(0.2)
    harness.sent.clear()
    return harness


def begun(harness: RobotHarness, **args: Any) -> Request:
    """A reload whose trial is under way, while the pattern in force goes on."""
    request = harness.request("reload", pattern="own", **args)
    actions = acted(harness.robot, RequestInput(request), harness.now)
    assert isinstance(actions.trial, StartTrial)
    assert actions.replies == ()
    assert actions.twist == Twist(0.2)
    return request


def test_reload_stops_the_robot_and_kills_the_host() -> None:
    harness = driving()
    assert harness.applied("reload", pattern="own").text == "reloaded, and stopped"
    assert [type(command) for command in harness.sent] == [StartTrial, KillHost]
    assert harness.twist.is_zero
    assert standing_state(harness) == (State.STOPPED, Reason.RELOADED)
    harness.advance(2.0)
    assert harness.twist.is_zero


def test_rerun_keeps_parameters_and_remaining_seconds() -> None:
    harness = driving()
    harness.ask("run", pattern="own", params={"recovery": False}, seconds=60.0)
    harness.advance(20.0)
    harness.sent.clear()
    assert harness.applied("reload", pattern="own", is_rerun=True).text == "runs own"
    (trial,) = (command for command in harness.sent if isinstance(command, StartTrial))
    assert dict(trial.load.layers[-1][1]) == {"recovery": False}
    loads = [command for command in harness.sent if isinstance(command, Load)]
    assert [(load.is_fresh, dict(load.layers[-1][1])) for load in loads] == [
        (True, {"recovery": False})
    ]
    harness.advance(39.0)
    assert harness.twist == Twist(0.2)
    harness.advance(2.0)
    assert standing_state(harness) == (State.IDLE, Reason.FINISHED)


def test_a_trial_of_another_pattern_gets_no_parameters_of_the_run() -> None:
    harness = driving()
    harness.ask("run", pattern="own", params={"speed": 0.1})
    harness.advance(0.5)
    harness.sent.clear()
    harness.ask("reload", pattern="forward")
    (trial,) = (command for command in harness.sent if isinstance(command, StartTrial))
    assert dict(trial.load.layers[-1][1]) == {}


def test_rerun_of_a_run_with_half_a_second_left_drives_for_half_a_second() -> None:
    harness = driving()
    harness.ask("run", pattern="own", seconds=2.0)
    harness.advance(1.5)
    assert harness.applied("reload", pattern="own", is_rerun=True).text == "runs own"
    harness.advance(0.7)
    assert standing_state(harness) == (State.IDLE, Reason.FINISHED)


def test_a_run_whose_time_is_over_as_the_trial_passes_does_not_drive_again() -> None:
    """docs/patterns.md: run again with the time left, which is none."""
    harness = driving()
    harness.ask("run", pattern="own", seconds=2.0)
    harness.advance(1.95)
    request = begun(harness, is_rerun=True)
    harness.now += 0.06  # before the tick that would have ended the run
    before = len(harness.commands)
    harness.host_says(TrialDone(1, ""))
    assert harness.reply_to(request).code is Code.APPLIED
    assert standing_state(harness) == (State.IDLE, Reason.FINISHED)
    harness.advance(0.5)
    assert all(twist.is_zero for _, twist in harness.commands[before:])


@pytest.mark.parametrize("has_goal", [True, False])
def test_rerun_keeps_the_goal_of_the_run_and_takes_no_other(has_goal: bool) -> None:
    harness = driving()
    harness.ask("stop")
    goal = Goal(generation=1, issuer="bob", id="g1", pattern="own")
    harness.find(goal)  # a run without it ends it
    harness.ask("run", pattern="own", goal=goal if has_goal else None)
    for _ in range(2):
        harness.advance(0.5)
        assert harness.twist == Twist(0.2)
        known = harness.status.goal
        assert known is not None
        assert known.state is (GoalState.RUNNING if has_goal else GoalState.ENDED)
        assert harness.applied("reload", pattern="own", is_rerun=True).text == "runs own"


@pytest.mark.parametrize(
    ("pattern", "refusal"), [("broken", Refusal.PATTERN_FAILED), ("owm", Refusal.UNKNOWN_PATTERN)]
)
def test_code_that_cannot_be_loaded_leaves_the_run_alone(pattern: str, refusal: Refusal) -> None:
    harness = driving()
    generation = harness.status.generation
    assert harness.refused("reload", pattern=pattern, is_rerun=True).refusal is refusal
    harness.advance(1.0)
    assert harness.twist == Twist(0.2)
    assert harness.status.generation == generation
    assert not any(isinstance(command, KillHost | Load) for command in harness.sent)


@pytest.mark.parametrize("verb", ["run", "resume", "reload"])
def test_a_late_copy_of_what_was_refused_during_a_trial_starts_nothing(verb: str) -> None:
    harness = driving()
    begun(harness)
    fields: dict[str, Any] = {} if verb == "resume" else {"pattern": "own"}
    refused = harness.request(verb, **fields)
    assert harness.answer(refused).refusal is Refusal.BUSY
    harness.host_says(TrialDone(1, "broken"))
    assert harness.answer(refused).refusal is Refusal.STALE_EPOCH


def test_trial_timeout_leaves_the_run_alone() -> None:
    harness = driving()
    request = begun(harness, is_rerun=True)
    harness.advance(9.95)  # docs/patterns.md: a trial may take 10 s
    assert not harness.is_answered(request)
    harness.advance(0.05)
    assert harness.reply_to(request).refusal is Refusal.PATTERN_FAILED
    assert any(isinstance(command, CancelTrial) for command in harness.sent)
    harness.host_says(TrialDone(1, ""))  # too late
    harness.advance(1.0)
    assert harness.twist == Twist(0.2)
    harness.applied("reload", pattern="own")


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_stop_ends_the_trial(verb: str) -> None:
    harness = driving()
    request = begun(harness, is_rerun=True)
    harness.ask(verb)
    reply = harness.reply_to(request)
    assert reply.refusal is Refusal.OVERTAKEN
    assert any(isinstance(command, CancelTrial) for command in harness.sent)
    harness.host_says(TrialDone(1, ""))
    harness.advance(1.0)
    assert harness.twist.is_zero


def test_copies_of_stops_that_the_robot_obeyed_before_leave_the_trial_alone() -> None:
    harness = driving()
    harness.ask("stop", id="s1")
    harness.advance(1.0)
    harness.ask("stop", id="s2")
    request = harness.request("reload", pattern="own")
    harness.robot.step(RequestInput(request), harness.now)
    revision = harness.status.epoch.revision
    harness.advance(3.0)
    for id, age in (("s1", 4.0), ("s2", 3.0), ("s1", 4.1), ("s0", 4.2)):
        late = harness.ask("stop", id=id, age=age)
        assert late is not None
        assert late.code is Code.APPLIED
    assert not harness.is_answered(request)
    assert harness.status.epoch.revision == revision
    harness.host_says(TrialDone(1, ""))
    assert harness.reply_to(request).code is Code.APPLIED
    assert standing_state(harness) == (State.STOPPED, Reason.OPERATOR)


def test_copies_of_an_emergency_stop_that_holds_the_robot_leave_the_trial_alone() -> None:
    harness = driving()
    harness.ask("estop", id="e1")
    request = harness.request("reload", pattern="own")
    harness.robot.step(RequestInput(request), harness.now)
    harness.applied("estop", id="e1")
    assert not harness.is_answered(request)
    harness.ask("estop", id="e2")
    assert harness.reply_to(request).refusal is Refusal.OVERTAKEN
    assert harness.status.state is State.ESTOPPED


def test_frozen_daemon_ends_the_trial() -> None:
    harness = driving()
    request = begun(harness, is_rerun=True)
    harness.advance(2.0, ticks=False)
    harness.host_says(TrialDone(1, ""))
    assert harness.reply_to(request).refusal is Refusal.OVERTAKEN
    assert standing_state(harness) == (State.STOPPED, Reason.LOOP_STALLED)
    harness.advance(1.0)
    assert harness.twist.is_zero


def test_robot_that_stopped_during_the_trial_stays_stopped() -> None:
    harness = driving()
    request = begun(harness, is_rerun=True)
    harness.scans = lambda seq, now: None
    harness.advance(4.0)
    assert standing_state(harness) == (State.STOPPED, Reason.STALE_SCAN)
    harness.host_says(TrialDone(1, ""))
    assert "stopped, as before" in harness.reply_to(request).text
    harness.advance(1.0)
    assert standing_state(harness) == (State.STOPPED, Reason.STALE_SCAN)


def test_requests_during_a_trial_are_refused() -> None:
    harness = driving()
    begun(harness, operator="ben")
    for verb, args in (
        ("reload", {"pattern": "forward"}),
        ("run", {"pattern": "forward"}),
        ("param", {"params": {"recovery": False}}),
    ):
        reply = harness.ask(verb, **args)
        assert reply is not None
        assert reply.refusal is Refusal.BUSY


def test_reload_of_another_pattern_makes_the_next_load_fresh() -> None:
    harness = driving()
    reply = harness.ask("reload", pattern="forward", is_rerun=True)
    assert reply is not None
    assert (reply.code, reply.text) == (
        Code.APPLIED,
        "a run of forward takes the new code; own goes on",
    )
    harness.advance(0.5)
    assert harness.twist == Twist(0.2)
    assert [type(one) for one in harness.sent if not isinstance(one, Step)] == [
        StartTrial,
        CancelTrial,
    ]
    for is_fresh in (True, False):
        harness.ask("run", pattern="forward")
        loads = [command for command in harness.sent if isinstance(command, Load)]
        assert loads[-1].is_fresh is is_fresh


def test_reload_of_an_idle_robot_kills_its_host() -> None:
    harness = RobotHarness(patterns={"own": Forward})
    harness.advance(1.0)
    assert "idle, as before" in harness.applied("reload", pattern="own", is_rerun=True).text
    assert [type(command) for command in harness.sent] == [StartTrial, KillHost]
    assert standing_state(harness) == (State.IDLE, Reason.NEVER_ASKED)


def test_pattern_restarts_after_a_refused_fresh_load() -> None:
    harness = driving()
    harness.ask("reload", pattern="forward")
    harness.is_hung = True
    request = harness.request("run", pattern="forward")
    harness.send(request)
    harness.is_hung = False
    harness.host_says(LoadRefused(harness.status.generation, "broken meanwhile"))
    assert harness.reply_to(request).text == "broken meanwhile"
    assert isinstance(harness.sent[-1], KillHost)  # the fresh host has no pattern
    harness.advance(0.5)
    assert standing_state(harness)[0] is State.RUNNING
    assert harness.status.pattern == "own"
    assert harness.twist == Twist(0.2)


def test_end_of_an_earlier_trial_is_ignored() -> None:
    harness = driving()
    harness.is_hung = True
    first = harness.request("reload", pattern="own")
    harness.send(first)
    harness.ask("estop")
    second = harness.request("reload", pattern="own")
    harness.send(second)
    harness.host_says(TrialDone(1, "the first is broken"))
    assert not harness.is_answered(second)
    harness.host_says(TrialDone(2, ""))
    assert harness.reply_to(second).text == "a run of own takes the new code; estopped, as before"


def test_step_of_the_killed_host_is_not_awaited() -> None:
    harness = driving()
    harness.is_hung = True
    harness.advance(0.2)
    harness.ask("reload", pattern="own")
    harness.host_says(TrialDone(1, ""))
    assert isinstance(harness.sent[-1], KillHost)
    harness.sent.clear()
    harness.is_hung = False
    harness.advance(1.5)
    assert harness.sent == []


def test_stale_epoch_after_a_reload_names_the_reload() -> None:
    harness = driving()
    seen = harness.epoch
    harness.ask("reload", pattern="forward", operator="ben")
    reply = harness.answer(harness.request("run", seen, pattern="forward"))
    assert reply.text == "robot changed since you looked, by ben (reload forward)"
