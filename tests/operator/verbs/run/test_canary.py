"""Canaries: who they are, and when one does not run well."""

from __future__ import annotations

import click
import pytest
from msgspec.structs import replace

from swarmd.core.errors import RequestError
from swarmd.core.messages import DecisionSummary, Health, Reason, State, Status
from swarmd.operator.cli.canary import canaries_of, read_canary
from swarmd.operator.verbs.run.canary import MIN_DECISIONS, fault_of
from tests.support.statuses import RUNNING

NAMES = ("r1", "r2", "r3")


def acting(duty: float, decisions: int = MIN_DECISIONS) -> DecisionSummary:
    return DecisionSummary(duty=duty, decisions=decisions)


@pytest.mark.parametrize(("text", "chosen"), [("1", ("r1",)), ("2", ("r1", "r2")), ("r3", ("r3",))])
def test_a_number_or_a_name_chooses_canaries(text: str, chosen: tuple[str, ...]) -> None:
    assert canaries_of(text, NAMES) == chosen


def test_a_canary_must_be_a_target_and_leave_another_one() -> None:
    with pytest.raises(RequestError, match="r4 is not among the targets: r1"):
        canaries_of("r4", NAMES)
    for text, names in (("3", NAMES), ("r1", ("r1",))):
        with pytest.raises(click.UsageError):
            canaries_of(text, names)
    for text in ("0", "-1", "R1", ""):
        with pytest.raises(click.UsageError):
            read_canary(text)


@pytest.mark.parametrize(
    "now",
    [
        RUNNING,
        replace(RUNNING, state=State.IDLE, reason=Reason.FINISHED),
        replace(RUNNING, decision=acting(0.25)),
        replace(RUNNING, decision=acting(1.0, MIN_DECISIONS - 1)),
        replace(RUNNING, reason=Reason.PROTECTION),
    ],
    ids=["runs", "finished", "a little", "too soon", "protection holds it now"],
)
def test_a_canary_runs_well(now: Status) -> None:
    assert fault_of(None, RUNNING, now) == ""


@pytest.mark.parametrize(
    ("now", "subject"),
    [
        (replace(RUNNING, state=State.FAULTED, reason=Reason.QUARANTINED), "quarantined"),
        (replace(RUNNING, state=State.STOPPED, reason=Reason.DRIVER_LOST), "driver_lost"),
        (replace(RUNNING, reason=Reason.PATTERN_RESTARTING), "pattern failed"),
        (replace(RUNNING, health=Health(host_restarts=1)), "restarted"),
        (replace(RUNNING, decision=acting(0.9)), "90%"),
    ],
    ids=["quarantine", "stopped", "restarting", "restarted", "protection"],
)
def test_a_canary_does_not_run_well(now: Status, subject: str) -> None:
    assert subject in fault_of(None, RUNNING, now)


def test_protection_is_compared_with_the_run_before() -> None:
    usual = replace(RUNNING, decision=acting(0.8))
    assert fault_of(usual, RUNNING, replace(RUNNING, decision=acting(0.9))) == ""
    idle = replace(usual, state=State.IDLE)
    assert fault_of(idle, RUNNING, replace(RUNNING, decision=acting(0.9)))
