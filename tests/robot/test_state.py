from __future__ import annotations

from pathlib import Path

import pytest

from swarmd.core.messages import Reason, State
from swarmd.robot import state
from swarmd.robot.state_machine import TRANSITIONS, StateMachine, Trigger

STATES = "idle running stopped estopped faulted"
# By hand, from the docstring of swarmd/robot/state.py and "What fails" of docs/failures.md.
WANTED = {
    "run": "running running running estopped faulted",
    "finish": "idle idle stopped estopped faulted",
    "stop": "stopped stopped stopped estopped faulted",
    "hold_lasted": "idle stopped stopped estopped faulted",
    "load_failed": "idle stopped stopped estopped faulted",
    "stall": "stopped stopped stopped estopped faulted",
    "hazard": "stopped stopped stopped estopped faulted",
    "network": "idle stopped stopped estopped faulted",
    "estop": "estopped estopped estopped estopped estopped",
    "fault": "faulted faulted faulted estopped faulted",
    "reset": "idle running idle idle idle",
}


def test_every_state_and_trigger_leads_where_the_table_says() -> None:
    found = {
        trigger: " ".join(row[State(state)] for state in STATES.split())
        for trigger, row in TRANSITIONS.items()
    }
    assert found == WANTED
    assert sorted(STATES.split()) == sorted(State)


def test_only_run_leads_to_running_and_never_from_a_latch() -> None:
    into = {
        (event, state)
        for event, row in TRANSITIONS.items()
        for state, target in row.items()
        if target is State.RUNNING and state is not State.RUNNING
    }
    assert into == {(Trigger.RUN, State.IDLE), (Trigger.RUN, State.STOPPED)}


def test_estop_wins_over_every_state() -> None:
    assert set(TRANSITIONS[Trigger.ESTOP].values()) == {State.ESTOPPED}


def test_only_a_reset_leaves_estopped_or_faulted() -> None:
    for latched in (State.ESTOPPED, State.FAULTED):
        leaving = {
            event
            for event, row in TRANSITIONS.items()
            if row[latched] is not latched and event is not Trigger.ESTOP
        }
        assert leaving == {Trigger.RESET}


@pytest.mark.parametrize("event", [event for event in Trigger if event is not Trigger.RUN])
def test_every_other_trigger_leaves_running(event: Trigger) -> None:
    machine = StateMachine(0.0)
    machine.apply(Trigger.RUN, None, "", 1.0)
    machine.apply(event, Reason.OPERATOR, "why", 2.0)
    if event is not Trigger.RESET:
        assert machine.state is not State.RUNNING
        assert (machine.reason, machine.detail, machine.since) == (Reason.OPERATOR, "why", 2.0)


def test_trigger_without_a_change_keeps_the_older_reason() -> None:
    machine = StateMachine(0.0)
    machine.apply(Trigger.ESTOP, Reason.ESTOP, "by alice", 1.0)
    machine.apply(Trigger.STOP, Reason.OPERATOR, "by bob", 2.0)
    assert (machine.state, machine.reason) == (State.ESTOPPED, Reason.ESTOP)
    assert machine.detail == "by alice"


@pytest.mark.parametrize(
    ("first", "again"),
    [
        ("run", "run"),
        ("stop", "stop"),
        ("stop", "stall"),
        ("stop", "hazard"),
        ("estop", "estop"),
        ("fault", "fault"),
    ],
)
def test_a_new_cause_of_the_present_state_is_its_reason(first: str, again: str) -> None:
    """By hand: who stops a robot that stands for a hazard is the reason from then on."""
    machine = StateMachine(0.0)
    machine.apply(Trigger(first), Reason.HAZARD, "by itself", 1.0)
    machine.apply(Trigger(again), Reason.OPERATOR, "by bob", 2.0)
    assert (machine.reason, machine.detail, machine.since) == (Reason.OPERATOR, "by bob", 1.0)


def test_only_this_file_fires_triggers() -> None:
    """So a reader finds there all that changes the state of a robot."""
    robot = Path(state.__file__).parent
    named = {path.name for path in robot.glob("*.py") if "Trigger" in path.read_text()}
    assert named == {"state.py", "state_machine.py"}  # the latter defines them
