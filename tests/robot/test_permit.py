"""The permit of the running pattern, from its load to its end."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

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
from swarmd.core.messages import Reason, State
from swarmd.core.refusal import Refusal
from swarmd.kit.touch_config import TouchGrants, TouchSection
from swarmd.robot.protection.decision import NO_PERMIT, Decision, DecisionContext, Permit, Steered
from swarmd.testing.scans import Disc, scan_of
from tests.support.hand import FORWARD, HandOn
from tests.support.protection import Protection
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


class Patient(Forward):
    """Goes on with late scans."""

    scan_delay = 0.4


class Greedy(Push):
    """Asks for all there is."""

    touches = TouchZone(0.0, math.pi, 2.0)


PATTERNS: Mapping[str, type[Pattern[Any]]] = {
    "forward": Forward,
    "push": Push,
    "team": Team,
    "greedy": Greedy,
    "patient": Patient,
}


class RecordingProtection(Protection):
    """Records the last permit."""

    permit: Permit

    def decide(
        self,
        requested: Twist | None,
        context: DecisionContext,
        is_running: bool,
        hold: Reason | None,
        permit: Permit = NO_PERMIT,
        steered: Steered | None = None,
    ) -> Decision:
        self.permit = permit
        return super().decide(requested, context, is_running, hold, permit, steered)


@pytest.fixture(autouse=True)
def record_permits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("swarmd.robot.robot.Protection", RecordingProtection)


def make_harness(**touch: TouchZone) -> RobotHarness:
    granted: TouchGrants = {
        name: TouchSection(
            bearing_deg=math.degrees(zone.bearing),
            half_width_deg=math.degrees(zone.half_width),
            speed=zone.speed,
        )
        for name, zone in touch.items()
    }
    made = RobotHarness(patterns=PATTERNS, touch=granted)
    made.advance(1.0)
    return made


def run_pattern(harness: RobotHarness, pattern: str, **args: Any) -> None:
    harness.applied("run", pattern=pattern, **args)
    harness.advance(0.3)


def permit(harness: RobotHarness) -> Permit:
    """The permit of the last decision."""
    protection = harness.robot._protection
    assert isinstance(protection, RecordingProtection)
    return protection.permit


def event_texts(harness: RobotHarness) -> list[str]:
    return [event.text for event in harness.status.events]


def test_granted_touch_zone_reaches_protection_and_events() -> None:
    harness = make_harness(push=LESS)
    assert permit(harness) == NO_PERMIT
    run_pattern(harness, "push")
    assert permit(harness).touch == LESS
    assert event_texts(harness)[-1] == f"push {MAY}"


@pytest.mark.parametrize(
    ("pattern", "granted"),
    [("push", ()), ("push", ("other",)), ("forward", ("forward",)), ("team", ("team", "push"))],
)
def test_touch_zone_needs_a_declaration_and_a_grant(pattern: str, granted: tuple[str, ...]) -> None:
    harness = make_harness(**dict.fromkeys(granted, LESS))
    run_pattern(harness, pattern)
    assert harness.status.state is State.RUNNING
    assert permit(harness).touch is None
    assert ("not granted" in event_texts(harness)[-1]) is (pattern == "push")


@pytest.mark.parametrize("end", ["stop", "estop", "seconds"])
def test_permit_ends_with_the_run(end: str) -> None:
    harness = make_harness(push=LESS)
    run_pattern(harness, "push", seconds=1.0)
    assert permit(harness).touch == LESS
    if end != "seconds":
        harness.ask(end)
        assert permit(harness) == NO_PERMIT
    harness.advance(1.0)
    assert permit(harness) == NO_PERMIT


def test_each_run_has_its_own_permit() -> None:
    harness = make_harness(push=LESS)
    run_pattern(harness, "push")
    run_pattern(harness, "forward")
    assert permit(harness).touch is None
    run_pattern(harness, "push")
    assert permit(harness).touch == LESS


def test_permit_ends_with_a_fault_and_returns_with_the_restart() -> None:
    harness = make_harness(push=LESS)
    run_pattern(harness, "push")
    harness.host_says(PatternFailed(harness.status.generation, "ValueError"))
    assert permit(harness) == NO_PERMIT
    harness.advance(0.3)
    assert harness.status.state is State.RUNNING
    assert permit(harness).touch == LESS
    assert event_texts(harness)[-2:] == ["push restarted", f"push {MAY}"]


def test_restart_without_a_declared_zone_has_none() -> None:
    harness = make_harness(push=LESS)
    run_pattern(harness, "push")
    harness.is_hung = True
    harness.host_says(PatternFailed(harness.status.generation, "ValueError"))
    harness.advance(0.15)
    harness.host_says(Loaded(harness.status.generation, 10.0, frozenset(), {}))
    assert harness.status.state is State.RUNNING
    assert permit(harness).touch is None


def test_pattern_with_an_excessive_zone_is_refused() -> None:
    harness = make_harness(greedy=LESS)
    refused = harness.refused("run", pattern="greedy")
    assert refused.refusal is Refusal.PATTERN_FAILED
    assert "touches is TouchZone" in refused.text


@pytest.mark.parametrize("name", ["touch", "touches", "bearing_deg"])
def test_no_request_can_grant_a_touch_zone(name: str) -> None:
    harness = make_harness()
    given = harness.refused("run", pattern="push", params={name: 0.1})
    assert given.refusal is Refusal.INVALID_PARAMETER
    run_pattern(harness, "push")
    assert permit(harness).touch is None
    later = harness.refused("param", params={name: 0.1})
    assert later.refusal is Refusal.INVALID_PARAMETER
    assert permit(harness).touch is None


def test_recovery_is_permitted_unless_the_pattern_declares_otherwise() -> None:
    harness = make_harness()
    run_pattern(harness, "forward")
    assert permit(harness).may_recover
    run_pattern(harness, "push")
    assert not permit(harness).may_recover


@pytest.mark.parametrize(("pattern", "value"), [("forward", "false"), ("push", "true")])
def test_parameter_recovery_overrides_the_default(pattern: str, value: str) -> None:
    harness = make_harness()
    run_pattern(harness, pattern, params={"recovery": value})
    assert permit(harness).may_recover is (value == "true")
    run_pattern(harness, pattern)
    assert permit(harness).may_recover is not (value == "true")
    harness.ask("param", params={"recovery": value})
    harness.advance(0.1)
    assert permit(harness).may_recover is (value == "true")
    assert harness.status.params["recovery"].source == "request"


def test_parameter_avoidance_says_whether_the_robot_avoids() -> None:
    harness = make_harness()
    run_pattern(harness, "forward")
    assert permit(harness).avoids is None
    for value, wanted in (("orca", True), ("none", False), ("platform", None)):
        harness.ask("param", params={"avoidance": value})
        harness.advance(0.1)
        assert permit(harness).avoids is wanted
    run_pattern(harness, "forward", params={"avoidance": "orca"})
    assert permit(harness).avoids is True
    unknown = harness.refused("param", params={"avoidance": "rvo"})
    assert unknown.refusal is Refusal.INVALID_PARAMETER
    assert "platform, orca, none" in unknown.text


def test_a_robot_shows_the_tracks_by_which_it_avoids() -> None:
    harness = make_harness()
    noise = np.random.default_rng(1)
    harness.scans = lambda seq, now: replace(
        scan_of(harness.platform, [Disc(1.0, 0.5, 0.1)], seq=seq, noise=0.005, rng=noise), stamp=now
    )
    run_pattern(harness, "forward", params={"avoidance": "none"})
    harness.advance(1.0)
    assert harness.robot.tracks(harness.now) is None
    harness.ask("param", params={"avoidance": "orca"})
    harness.advance(1.5)
    found = harness.robot.tracks(harness.now)
    assert found is not None
    assert [(one.x, one.y) for one in found.tracks] == [pytest.approx((1.0, 0.5), abs=0.1)]


def test_a_pattern_may_go_on_with_late_scans() -> None:
    harness = make_harness()
    sensors = harness.robot._sensors
    run_pattern(harness, "forward")
    assert (permit(harness).scan_delay, sensors.permitted_delay) == (0.0, 0.0)
    run_pattern(harness, "patient")
    assert (permit(harness).scan_delay, sensors.permitted_delay) == (0.4, 0.4)
    assert any("0.40 s later" in event.text for event in harness.status.events)
    harness.ask("param", params={"recovery": False})
    harness.advance(0.1)
    assert permit(harness).scan_delay == 0.4
    harness.ask("stop")
    harness.advance(0.1)
    assert sensors.permitted_delay == 0.0


def test_what_a_pattern_is_permitted_a_hand_above_it_is_not() -> None:
    harness = make_harness()
    sensors = harness.robot._sensors
    run_pattern(harness, "patient")
    hand = HandOn(harness)
    hand.take()
    hand.drive(0.3)
    assert harness.twist == FORWARD
    assert sensors.permitted_delay == 0.0
    hand.release()
    harness.advance(0.1)
    assert sensors.permitted_delay == 0.4
