"""Hazards of the base hold the robot, each as documented, and a lift ends its run."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.clock import TICK
from swarmd.core.events import HazardsInput
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.messages import Reason, State
from swarmd.core.refusal import Refusal
from swarmd.robot.hazard_holds import MAX_HAZARDS, HazardHolds
from tests.support.examples import examples
from tests.support.goals import make_goal
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS, idle, standing_state, started

BUMP = Hazard(HazardKind.BUMP, "front left")
LIFTED = Hazard(HazardKind.LIFTED)
# From the table of hazards in docs/failures.md.
PASSING = ("bump", "cliff", "stall", "not_heard")
ENDING = ("wheel_drop", "lifted")
CLEAR_TIME = 0.5  # s
MAX_HOLD_TIME = 2.0  # s


def tell(harness: RobotHarness, *hazards: Hazard) -> None:
    """The base reports these, and no others."""
    harness.step(HazardsInput(hazards))


def test_a_lift_ends_the_run_also_behind_more_hazards_than_are_kept() -> None:
    harness = started()
    bumps = [Hazard(HazardKind.BUMP, str(count)) for count in range(MAX_HAZARDS)]
    tell(harness, *bumps, LIFTED)
    assert harness.status.state is State.STOPPED


def test_the_page_has_each_kind() -> None:
    assert sorted((*PASSING, *ENDING)) == sorted(HazardKind)


@pytest.mark.parametrize("kind", PASSING + ENDING)
def test_each_hazard_zeroes_the_command_at_once(kind: str) -> None:
    harness = started()
    assert not harness.twist.is_zero
    tell(harness, Hazard(HazardKind(kind)))
    assert harness.twist.is_zero
    assert harness.status.reason is Reason.HAZARD


@pytest.mark.parametrize("kind", PASSING)
def test_a_hazard_that_passes_holds_until_it_has_been_gone_for_a_time(kind: str) -> None:
    harness = started()
    tell(harness, Hazard(HazardKind(kind)))
    harness.advance(0.3)
    tell(harness)
    harness.advance(CLEAR_TIME - 0.1)
    assert standing_state(harness) == (State.RUNNING, Reason.HAZARD)
    harness.advance(0.3)
    assert not harness.twist.is_zero


def test_a_hazard_that_comes_again_within_the_time_holds_anew() -> None:
    harness = started()
    for _ in range(3):
        tell(harness, BUMP)
        harness.advance(0.1)
        tell(harness)
        harness.advance(0.4)
        assert harness.twist.is_zero


def test_a_bump_that_lasts_ends_the_run_and_is_named() -> None:
    harness = started()
    tell(harness, BUMP)
    harness.advance(MAX_HOLD_TIME + 0.1)
    assert standing_state(harness) == (State.STOPPED, Reason.HAZARD)
    assert "bump front left" in harness.status.detail
    tell(harness)
    harness.commands.clear()
    harness.advance(3.0)
    assert all(twist.is_zero for _, twist in harness.commands)


@pytest.mark.parametrize("kind", ENDING)
def test_a_robot_that_is_lifted_stops_at_once_and_needs_a_new_run(kind: str) -> None:
    harness = started()
    epoch = harness.epoch
    tell(harness, Hazard(HazardKind(kind)))
    assert standing_state(harness) == (State.STOPPED, Reason.HAZARD)
    harness.advance(0.2)
    tell(harness)  # it is put down
    harness.commands.clear()
    harness.advance(5.0)
    assert all(twist.is_zero for _, twist in harness.commands)
    late = harness.answer(harness.request("run", epoch, pattern="forward"))
    assert late.refusal is Refusal.STALE_EPOCH
    harness.applied("run", pattern="forward")
    harness.advance(0.3)
    assert not harness.twist.is_zero


def test_a_lifted_robot_refuses_a_run() -> None:
    harness = started()
    tell(harness, LIFTED)
    refused = harness.refused("run", pattern="forward")
    assert refused.refusal is Refusal.OVERTAKEN
    assert "lifted" in refused.text
    tell(harness)
    harness.advance(3.0)
    assert harness.twist.is_zero


def test_a_lift_ends_a_run_that_waits_for_its_start() -> None:
    harness = idle()
    harness.ask("run", pattern="forward", at={harness.robot.id: harness.now + 1.0})
    tell(harness, LIFTED)
    tell(harness)
    harness.commands.clear()
    harness.advance(3.0)
    assert all(twist.is_zero for _, twist in harness.commands)
    assert standing_state(harness) == (State.STOPPED, Reason.HAZARD)


def test_an_idle_robot_may_be_carried() -> None:
    harness = idle()
    tell(harness, LIFTED)
    assert standing_state(harness) == (State.IDLE, Reason.NEVER_ASKED)
    tell(harness)
    harness.ask("run", pattern="forward")
    harness.advance(0.2)
    assert harness.twist.is_zero  # CLEAR_TIME
    harness.advance(0.6)
    assert not harness.twist.is_zero


def test_a_robot_that_was_lifted_joins_no_earlier_goal() -> None:
    harness = idle()
    goal = make_goal(pattern="forward", on_join="run", valid=60.0)
    harness.find(goal)
    harness.advance(0.5)
    assert not harness.twist.is_zero
    tell(harness, LIFTED)
    tell(harness)
    harness.find(goal, 1.0)
    harness.commands.clear()
    harness.advance(3.0)
    assert all(twist.is_zero for _, twist in harness.commands)


def test_a_goal_of_before_a_lift_is_not_joined_after_a_restart() -> None:
    harness = idle()
    harness.find(make_goal(pattern="forward", on_join="run", valid=60.0))
    harness.advance(0.5)
    tell(harness, LIFTED)
    lifted, record = harness.now, harness.record
    again = RobotHarness(patterns=PATTERNS, goals=record, instance="boot2")
    again.advance(3.0)
    again.find(make_goal(2, pattern="forward", on_join="run", valid=60.0), again.now - lifted + 0.5)
    again.advance(1.0)
    assert again.twist.is_zero
    again.find(make_goal(3, pattern="forward", on_join="run", valid=60.0), 0.0)  # of after it
    again.advance(1.0)
    assert not again.twist.is_zero


def test_ages_count_from_the_first_report() -> None:
    holds = HazardHolds()
    holds.take((BUMP,), 10.0)
    holds.take((BUMP,), 11.0)
    assert holds.text(12.0) == "bump front left, 2.0 s"
    holds.take((), 12.0)
    holds.take((BUMP,), 13.0)  # a new one
    assert holds.text(13.5) == "bump front left, 0.5 s"


@settings(max_examples=examples(60), deadline=None)
@given(st.randoms(use_true_random=False))
def test_no_history_of_hazards_moves_a_robot_that_is_held(chance: Random) -> None:
    harness = started()
    reported: tuple[Hazard, ...] = ()
    seen = -1e9  # s; when a hazard was reported last
    may_run = True  # since the last run request nothing has ended runs for good
    for _ in range(60):
        what = chance.random()
        if what < 0.3:
            kinds = chance.sample(list(HazardKind), chance.choice((0, 0, 1, 1, 2)))
            reported = tuple(Hazard(kind, chance.choice(("", "front"))) for kind in kinds)
            tell(harness, *reported)
        elif what < 0.4:
            harness.ask("run", pattern="forward")
            may_run = True
        else:
            harness.commands.clear()
            harness.advance(chance.choice((TICK, 0.1, 0.45, 0.6, 2.2)))
        if reported:
            seen = harness.now
        if any(one.kind in ENDING for one in reported):
            may_run = False
            assert harness.robot.state is State.STOPPED
        is_held = bool(reported) or harness.now - seen < CLEAR_TIME - TICK
        if is_held or not may_run:
            assert harness.twist.is_zero
            assert what >= 0.4 or not harness.commands or harness.commands[-1][1].is_zero
    tell(harness)
    harness.advance(CLEAR_TIME + TICK)
    harness.ask("run", pattern="forward")
    harness.advance(0.3)
    assert not harness.twist.is_zero  # every hold ends
