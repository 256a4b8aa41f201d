"""A low battery ends a run once, and may start one pattern, which no rule lets start again."""

from __future__ import annotations

import math
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.clock import TICK
from swarmd.core.events import DriverInput, LatchesInput, LeaseInput, ReadingsInput
from swarmd.core.goal import GoalState
from swarmd.core.low_battery import LowBatterySettings
from swarmd.core.messages import BatterySummary, Latch, Reason, State
from swarmd.core.refusal import Refusal
from swarmd.robot.low_battery import CONFIRM_TIME, LowBattery
from tests.support.examples import examples
from tests.support.goals import make_goal
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS, Forward, standing_state

STOPS = LowBatterySettings(below=0.2)
RUNS = LowBatterySettings(below=0.2, pattern="home", params={"speed": 0.1}, seconds=20.0)
WAIT = CONFIRM_TIME + 1.0


class Home(Forward):
    """The pattern of RUNS."""


def made(given: LowBatterySettings | None = STOPS, **fields: Any) -> RobotHarness:
    harness = RobotHarness(patterns={**PATTERNS, "home": Home}, on_low_battery=given, **fields)
    harness.advance(0.5)
    return harness


def charged(harness: RobotHarness, charge: float | None, seconds: float = WAIT) -> None:
    """Readings of this charge at 2 Hz for a time; None: readings without a battery."""
    for _ in range(round(2.0 * seconds)):
        harness.step(ReadingsInput({} if charge is None else {"battery": charge}))
        harness.advance(0.5)


def running(given: LowBatterySettings | None = STOPS) -> RobotHarness:
    harness = made(given)
    harness.applied("run", pattern="forward")
    harness.advance(0.5)
    assert not harness.twist.is_zero
    return harness


def battery(harness: RobotHarness) -> BatterySummary:
    told = harness.status.battery
    assert told is not None
    return told


def stands(harness: RobotHarness, seconds: float = 3.0) -> bool:
    """Whether all commands of the next seconds are zero."""
    harness.commands.clear()
    harness.advance(seconds)
    return all(twist.is_zero for _, twist in harness.commands)


@pytest.mark.parametrize(
    ("readings", "is_low"),
    [
        ([(0.0, 0.1)], False),
        ([(0.0, 0.1), (CONFIRM_TIME, 0.1)], True),
        ([(0.0, 0.1), (4.0, 0.2), (5.0, 0.1), (9.0, 0.1)], False),
        ([(0.0, 0.1), (3.0, None), (5.0, 0.1), (9.0, 0.1)], False),
        ([(0.0, None), (60.0, None)], False),
        ([(0.0, 0.1), (5.0, 0.1), (6.0, 0.25), (7.0, None), (8.0, 0.29)], True),
        ([(0.0, 0.1), (5.0, 0.1), (6.0, 0.31)], False),
        ([(0.0, 0.1), (5.0, 0.1), (6.0, 0.31), (7.0, 0.1), (11.0, 0.1)], False),
    ],
)
def test_the_battery_is_low_by_these_readings(
    readings: list[tuple[float, float | None]], is_low: bool
) -> None:
    known = LowBattery()
    for at, charge in readings:
        before = known.is_low
        assert known.take(charge, STOPS, at) is (known.is_low is not before)
    assert known.is_low is is_low


@pytest.mark.parametrize(("given", "charge"), [(None, 0.1), (STOPS, 0.21), (STOPS, None)])
def test_a_run_goes_on(given: LowBatterySettings | None, charge: float | None) -> None:
    harness = running(given)
    charged(harness, charge)
    assert not harness.twist.is_zero


def test_a_reading_before_a_lost_link_is_not_fresh_and_confirms_nothing_after_it() -> None:
    harness = running()
    charged(harness, 0.1, 0.5)
    harness.step(DriverInput(False, "gone"))
    harness.advance(0.5)
    assert battery(harness).charge is None
    harness.advance(WAIT)
    harness.step(DriverInput(True, "there"))
    charged(harness, 0.1, 0.5)
    assert not battery(harness).is_low
    charged(harness, 0.1)
    assert battery(harness).is_low


def test_a_low_battery_ends_the_run_and_is_told() -> None:
    harness = running()
    epoch = harness.epoch
    charged(harness, 0.15)
    assert standing_state(harness) == (State.STOPPED, Reason.LOW_BATTERY)
    assert "0.15" in harness.status.detail
    assert any("low_battery" in event.text for event in harness.status.events)
    assert battery(harness) == BatterySummary(charge=0.15, below=0.2, is_low=True)
    late = harness.answer(harness.request("run", epoch, pattern="forward"))
    assert late.refusal is Refusal.STALE_EPOCH
    charged(harness, 0.9)  # a charged battery starts nothing
    assert stands(harness)
    assert not battery(harness).is_low


def test_an_operator_may_run_a_robot_with_a_low_battery_and_is_told() -> None:
    harness = running()
    charged(harness, 0.15)
    assert "its battery is low (0.15)" in harness.applied("run", pattern="forward").text
    for charge in (0.1, 0.22, 0.05, None):
        charged(harness, charge)
        assert not harness.twist.is_zero
    charged(harness, 0.4)
    charged(harness, 0.1)  # low once more
    assert standing_state(harness) == (State.STOPPED, Reason.LOW_BATTERY)


def test_the_pattern_of_a_low_battery_runs_and_ends() -> None:
    harness = running(RUNS)
    charged(harness, 0.15)
    assert harness.status.pattern == "home"
    assert harness.twist.linear == pytest.approx(0.1)
    assert battery(harness).runs
    charged(harness, 0.35)  # neither a charge nor a second fall of it begins the run anew
    charged(harness, 0.15)
    harness.advance(20.0 - 3.0 * WAIT)
    assert not harness.twist.is_zero
    harness.advance(2.0 * WAIT)
    assert standing_state(harness) == (State.IDLE, Reason.FINISHED)
    charged(harness, 0.1)
    assert stands(harness)


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_stop_ends_the_pattern_of_a_low_battery_for_good(verb: str) -> None:
    harness = running(RUNS)
    late = harness.request("stop")  # issued before the battery was low, and arrives later
    charged(harness, 0.15)
    if verb == "stop":
        harness.answer(type(late)(**{**_fields(late), "age": WAIT + 0.3}))
    else:
        harness.ask("estop", scope="swarm")
    assert harness.twist.is_zero
    for charge in (0.1, 0.5, 0.1):
        charged(harness, charge)
        assert harness.twist.is_zero
    assert harness.robot.state is (State.STOPPED if verb == "stop" else State.ESTOPPED)


def _fields(request: Any) -> dict[str, Any]:
    return {name: getattr(request, name) for name in request.__struct_fields__}


def test_a_stop_that_is_older_than_the_run_does_not_end_what_follows_the_run() -> None:
    harness = made(RUNS)
    old = harness.request("stop")
    harness.advance(1.0)
    harness.applied("run", pattern="forward")
    charged(harness, 0.15)
    answer = harness.answer(type(old)(**{**_fields(old), "age": WAIT + 3.0}))
    assert answer.refusal is Refusal.OVERTAKEN
    assert harness.status.pattern == "home"


def test_a_standing_robot_stays_standing() -> None:
    harness = made(RUNS)
    charged(harness, 0.1)
    assert standing_state(harness) == (State.IDLE, Reason.NEVER_ASKED)
    assert any("below 0.2 (0.10)" in event.text for event in harness.status.events)


def test_a_load_ends_and_no_pattern_follows() -> None:
    harness = made(RUNS)
    harness.ask("run", pattern="forward", at={harness.robot.id: harness.now + 9.0})
    charged(harness, 0.1)
    assert stands(harness, 10.0)
    assert harness.replies[-1].refusal is Refusal.OVERTAKEN


def test_an_unknown_pattern_leaves_the_robot_standing() -> None:
    harness = running(LowBatterySettings(below=0.2, pattern="nowhere"))
    charged(harness, 0.1)
    assert standing_state(harness) == (State.STOPPED, Reason.LOW_BATTERY)
    assert any("nowhere" in event.text for event in harness.status.events)
    assert stands(harness)


def test_a_run_with_a_lease_only_stops() -> None:
    harness = made(RUNS)
    goal = make_goal(pattern="forward", lease=5.0)
    harness.applied("run", pattern="forward", goal=goal)
    for count in range(20):
        harness.step(LeaseInput(goal.id, count))
        charged(harness, 0.15, 0.5)
    assert standing_state(harness) == (State.STOPPED, Reason.LOW_BATTERY)


def test_a_robot_with_a_low_battery_joins_no_goal_and_may_resume_one() -> None:
    harness = made(RUNS)
    charged(harness, 0.15)
    harness.find(make_goal(pattern="forward", on_join="run", valid=600.0))
    assert stands(harness)
    charged(harness, 0.9)
    harness.find(make_goal(pattern="forward", on_join="run", valid=600.0), 5.0)
    assert stands(harness)
    told = harness.status.goal
    assert told is not None
    assert told.state is GoalState.OFFERED
    harness.applied("resume")
    harness.advance(0.5)
    assert not harness.twist.is_zero


def test_a_goal_whose_run_a_low_battery_ended_is_not_joined_again() -> None:
    harness = made()
    goal = make_goal(pattern="forward", on_join="run", valid=600.0)
    harness.find(goal)
    harness.advance(0.5)
    assert not harness.twist.is_zero
    charged(harness, 0.15)
    again = RobotHarness(patterns=PATTERNS, goals=harness.record, instance="boot2")
    again.find(goal, 10.0)
    assert stands(again)
    charged(harness, 0.9)
    harness.find(goal, 20.0)
    assert stands(harness)


@settings(max_examples=examples(40), deadline=None)
@given(st.randoms(use_true_random=False))
def test_no_history_moves_a_robot_that_no_operator_ran(chance: Random) -> None:
    harness = made(RUNS)
    charge: float | None = 0.5
    ran = False  # an operator ran the robot, and has not stopped it since
    did_home = 0  # loads of the pattern of RUNS since the last run
    generation, goals = 1, 0
    for _ in range(40):
        sent = len(harness.sent)
        match action := chance.choice(
            ("run", "stop", "estop", "reset", "goal", "peer", "link", *"ccccccccc")
        ):
            case "run":
                reply = harness.ask("run", pattern="forward", seconds=chance.choice((None, 8.0)))
                if reply is None or reply.refusal is None:
                    ran, did_home = True, 0
            case "stop":
                harness.ask("stop")
                ran = False
            case "estop":
                harness.ask("estop", scope="robots")
                ran = False
            case "reset":
                harness.ask("reset", ids=tuple(harness.status.latches))
            case "goal" if battery(harness).is_low:
                goals += 1
                harness.find(make_goal(goals, pattern="forward", on_join="run", valid=600.0))
            case "peer":
                generation += 1
                latch = Latch(issuer="bob", scope="swarm")
                harness.step(LatchesInput({f"peer{generation}": latch}))
                ran = False
            case "link":
                harness.step(DriverInput(False, "gone"))
                harness.advance(chance.choice((TICK, 0.5, 2.5)))
                harness.step(DriverInput(True, "there"))
            case _:
                charge = chance.choice((None, 0.05, 0.15, 0.19, 0.2, 0.21, 0.29, 0.31, 0.9))
                charged(harness, charge, chance.choice((0.5, 3.0, 6.0)))
        if action != "run" and harness.robot.state is not State.RUNNING:
            ran = False  # nothing but a run of an operator may follow
        homes = [one for one in harness.sent[sent:] if getattr(one, "pattern", "") == "home"]
        did_home += len(homes)
        assert did_home <= 1  # a low battery starts its pattern once in a run
        harness.commands.clear()
        harness.advance(TICK)
        moves = not harness.twist.is_zero
        assert ran or not moves
        assert not moves or math.isfinite(harness.twist.linear)
