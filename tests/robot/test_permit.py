"""What the running pattern may, from its load to its end, and that protection is told of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pytest

from swarmd.api import (
    CombinedPattern,
    Inputs,
    MovementPattern,
    Params,
    Pattern,
    Recovery,
    TouchZone,
    Twist,
)
from swarmd.core.host_messages import Loaded, PatternFailed
from swarmd.core.messages import Code, State
from swarmd.protection.arbiter import Protection
from swarmd.protection.decision import NO_PERMIT, Decision, Permit
from tests.support.robot_harness import RobotHarness

ZONE = TouchZone(0.0, math.radians(20.0), 0.1)
LESS = TouchZone(0.0, math.radians(10.0), 0.05)
MAY = "may touch: +-10 deg ahead at up to 0.05 m/s"


class Restful(Params, frozen=True):
    recovery: Recovery = False


class Forward(MovementPattern[Params]):
    """Drives straight and asks for nothing."""

    def drive(self, inputs: Inputs) -> Twist:
        return Twist(0.1)


class Push(MovementPattern[Restful]):
    """Drives straight at what it asks to touch."""

    params_type = Restful
    touches = ZONE

    def drive(self, inputs: Inputs) -> Twist:
        return Twist(0.1)


class Team(CombinedPattern[Params]):
    """Has a part that asks to touch, and asks for nothing itself."""

    def make_parts(self) -> Mapping[str, Pattern[Any]]:
        return {"push": self.context.make("push")}


class Greedy(Push):
    """Asks for all there is."""

    touches = TouchZone(0.0, math.pi, 2.0)


PATTERNS: Mapping[str, type[Pattern[Any]]] = {
    "forward": Forward,
    "push": Push,
    "team": Team,
    "greedy": Greedy,
}


class Attentive(Protection):
    """The front as it is, but it remembers what it was permitted."""

    permit: Permit

    def decide(self, *args: Any, permit: Permit = NO_PERMIT, **more: Any) -> Decision:
        self.permit = permit
        return super().decide(*args, permit=permit, **more)


@pytest.fixture(autouse=True)
def attentive(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("swarmd.robot.robot.Protection", Attentive)


def story(**touch: TouchZone) -> RobotHarness:
    made = RobotHarness(patterns=PATTERNS, touch=touch)
    made.advance(1.0)
    return made


def run(tale: RobotHarness, pattern: str, **args: Any) -> None:
    reply = tale.ask("run", pattern=pattern, **args)
    assert reply is not None
    assert reply.code is Code.APPLIED, reply
    tale.advance(0.3)


def permit(tale: RobotHarness) -> Permit:
    """What protection was told at the last decision."""
    front = tale.robot._protection
    assert isinstance(front, Attentive)
    return front.permit


def said(tale: RobotHarness) -> list[str]:
    return [event.text for event in tale.status.events]


def test_what_is_asked_for_and_granted_reaches_protection_and_is_told() -> None:
    tale = story(push=LESS)
    assert permit(tale) == NO_PERMIT
    run(tale, "push")
    assert permit(tale).touch == LESS
    assert said(tale)[-1] == f"push {MAY}"


def test_without_a_grant_it_runs_protected_as_usual_and_says_where_to_grant_it() -> None:
    tale = story()
    run(tale, "push")
    assert tale.status.state is State.RUNNING
    assert tale.twist == Twist(0.1)
    assert permit(tale).touch is None
    assert "not granted" in said(tale)[-1]
    assert "touch: {push: ...}" in said(tale)[-1]


def test_a_grant_alone_gives_nothing() -> None:
    tale = story(forward=LESS)
    run(tale, "forward")
    assert permit(tale).touch is None
    assert said(tale)[-1] == "runs forward, by alice"


def test_a_grant_is_for_the_pattern_of_that_name_alone() -> None:
    tale = story(other=LESS)
    run(tale, "push")
    assert permit(tale).touch is None


def test_what_a_part_asks_for_does_not_count() -> None:
    tale = story(team=LESS, push=LESS)
    run(tale, "team")
    assert permit(tale).touch is None


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_it_ends_with_the_run(verb: str) -> None:
    tale = story(push=LESS)
    run(tale, "push")
    tale.ask(verb)
    assert permit(tale) == NO_PERMIT
    tale.advance(0.5)
    assert permit(tale) == NO_PERMIT


def test_it_ends_when_the_time_of_the_run_is_over() -> None:
    tale = story(push=LESS)
    run(tale, "push", seconds=1.0)
    assert permit(tale).touch == LESS
    tale.advance(1.0)
    assert permit(tale) == NO_PERMIT


def test_the_next_run_has_its_own() -> None:
    tale = story(push=LESS)
    run(tale, "push")
    run(tale, "forward")
    assert permit(tale).touch is None
    run(tale, "push")
    assert permit(tale).touch == LESS


def test_a_fault_takes_it_and_the_reload_gets_it_again() -> None:
    tale = story(push=LESS)
    run(tale, "push")
    tale.host_says(PatternFailed(tale.status.generation, "ValueError"))
    assert permit(tale) == NO_PERMIT
    tale.advance(0.3)
    assert tale.status.state is State.RUNNING
    assert permit(tale).touch == LESS
    assert said(tale)[-2:] == ["push restarted", f"push {MAY}"]


def test_a_reload_that_asks_for_nothing_any_more_has_nothing() -> None:
    tale = story(push=LESS)
    run(tale, "push")
    tale.is_hung = True
    tale.host_says(PatternFailed(tale.status.generation, "ValueError"))
    tale.advance(0.15)
    tale.host_says(Loaded(tale.status.generation, 10.0, frozenset(), {}))
    assert tale.status.state is State.RUNNING
    assert permit(tale).touch is None


def test_a_pattern_that_hangs_or_is_quarantined_has_nothing() -> None:
    tale = story(push=LESS)
    run(tale, "push")
    for _ in range(4):
        tale.host_says(PatternFailed(tale.status.generation, "ValueError"))
        assert permit(tale) == NO_PERMIT
        tale.advance(1.0)
    assert tale.status.state is State.FAULTED
    assert permit(tale) == NO_PERMIT


def test_a_pattern_that_asks_for_what_nobody_can_grant_is_refused() -> None:
    tale = story(greedy=LESS)
    reply = tale.ask("run", pattern="greedy")
    assert reply is not None
    assert reply.code is Code.REFUSED
    assert "touches is TouchZone" in reply.text


@pytest.mark.parametrize("name", ["touch", "touches", "bearing_deg"])
def test_no_operator_can_grant_it(name: str) -> None:
    tale = story()
    reply = tale.ask("run", pattern="push", params={name: 0.1})
    assert reply is not None
    assert reply.code is Code.REFUSED
    run(tale, "push")
    assert permit(tale).touch is None
    reply = tale.ask("param", params={name: 0.1})
    assert reply is not None
    assert reply.code is Code.REFUSED
    assert permit(tale).touch is None


def test_every_pattern_is_led_around_what_blocks_it_unless_it_declares_otherwise() -> None:
    tale = story()
    run(tale, "forward")
    assert permit(tale).may_recover
    run(tale, "push")
    assert not permit(tale).may_recover


@pytest.mark.parametrize(("pattern", "value"), [("forward", "false"), ("push", "true")])
def test_an_operator_can_change_that(pattern: str, value: str) -> None:
    tale = story()
    run(tale, pattern, params={"recovery": value})
    assert permit(tale).may_recover is (value == "true")
    run(tale, pattern)
    assert permit(tale).may_recover is not (value == "true")
    tale.ask("param", params={"recovery": value})
    tale.advance(0.1)
    assert permit(tale).may_recover is (value == "true")
    assert tale.status.params["recovery"].source == "runtime"
