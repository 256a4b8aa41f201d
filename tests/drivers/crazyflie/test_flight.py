"""The flight of a drone: invariants over random histories, and its story from run to landing."""

from __future__ import annotations

import random
from typing import Any

import pytest

from swarmd.core.values import ZERO, Twist
from swarmd.drivers.crazyflie.flight import (
    BLIND_TIME,
    LANDED_HEIGHT,
    MAX_PAUSE,
    MAX_STEP,
    MOTORS_OFF,
    TOUCH_HEIGHT,
    Flight,
    FlightRules,
    HoverSetpoint,
    Phase,
    Seen,
    Wish,
)

RULES = FlightRules(height=0.5, take_off_rate=0.3, land_rate=0.4, land_after=3.0)
TWIST = Twist(0.1, 0.5, -0.1)
PERIOD = 0.05


class Drone:
    """A flight with a drone that follows the set-points of its height at once."""

    def __init__(self) -> None:
        self.flight, self.now, self.height = Flight(RULES), 0.0, 0.02
        self.last: HoverSetpoint | None = None

    def step(self, wish: Wish, period: float = PERIOD, **seen: Any) -> HoverSetpoint | None:
        self.now += period
        is_flying = self.height > LANDED_HEIGHT
        values = {"height": self.height, "is_flying": is_flying, "may_fly": True, "is_clear": True}
        reported = Seen(**{**values, "fault": "", **seen})
        self.last = self.flight.step(self.now, wish, TWIST, reported)
        if self.last is not None:
            self.height = max(self.last.height, 0.02)
        return self.last

    def until(self, phase: Phase, wish: Wish, **seen: Any) -> float:
        """The s until this phase is reached."""
        begin = self.now
        while self.flight.phase is not phase:
            self.step(wish, **seen)
            assert self.now - begin < 20.0
        return self.now - begin

    def fly(self) -> None:
        self.step(Wish.HOVER)
        self.until(Phase.FLIGHT, Wish.FLY)


def test_a_run_takes_off_flies_and_a_stop_hovers_and_lands() -> None:
    drone = Drone()
    assert drone.step(Wish.HOVER) == MOTORS_OFF
    climb = drone.until(Phase.FLIGHT, Wish.FLY)
    assert climb == pytest.approx((RULES.height - TOUCH_HEIGHT) / RULES.take_off_rate, abs=0.3)
    assert drone.step(Wish.FLY) == HoverSetpoint(TWIST, RULES.height)
    assert drone.step(Wish.HOVER) == HoverSetpoint(ZERO, RULES.height)
    assert drone.until(Phase.LANDING, Wish.HOVER) == pytest.approx(RULES.land_after, abs=0.2)
    drone.until(Phase.GROUND, Wish.HOVER)
    assert drone.last == MOTORS_OFF or drone.step(Wish.HOVER) == MOTORS_OFF


@pytest.mark.parametrize(
    ("wish", "seen", "cause"),
    [
        (Wish.LAND, {}, "asked"),
        (Wish.FLY, {"is_battery_low": True}, "battery"),
        (Wish.FLY, {"may_fly": False}, "not ready"),
    ],
)
def test_these_land_a_flying_drone_at_once(wish: Wish, seen: dict[str, Any], cause: str) -> None:
    drone = Drone()
    drone.fly()
    drone.step(wish, **seen)
    assert drone.flight.phase is Phase.LANDING
    assert cause in drone.flight.text
    drone.until(Phase.GROUND, Wish.FLY)
    for _ in range(100):  # the same wish to fly starts nothing
        assert drone.step(Wish.FLY) in (None, MOTORS_OFF)
    drone.step(Wish.HOVER)
    drone.until(Phase.FLIGHT, Wish.FLY)


@pytest.mark.parametrize(
    ("seen", "cause"),
    [
        ({"is_clear": False}, "range is not clear"),
        ({"may_fly": False}, "not ready"),
        ({"is_battery_low": True}, "battery"),
        ({"is_unarmed": True, "may_fly": False}, "not armed"),
        ({"fault": "no Flow deck v2: deck.bcFlow2 is 0"}, "no Flow deck"),
    ],
)
def test_these_keep_a_drone_on_the_ground(seen: dict[str, Any], cause: str) -> None:
    drone = Drone()
    drone.step(Wish.HOVER)
    for _ in range(100):
        assert drone.step(Wish.FLY, **seen) == MOTORS_OFF
    assert cause in drone.flight.text


def test_a_drone_that_is_found_in_the_air_lands() -> None:
    drone = Drone()
    drone.height = 0.4
    assert drone.step(Wish.FLY) == HoverSetpoint(ZERO, 0.4)
    drone.until(Phase.GROUND, Wish.FLY)


@pytest.mark.parametrize("before", [Phase.TAKE_OFF, Phase.FLIGHT, Phase.LANDING])
@pytest.mark.parametrize("wish", [Wish.FLY, Wish.HOVER, Wish.LAND])
@pytest.mark.parametrize("lost", [1.7, 2.5, 8.0])
def test_a_drone_on_the_floor_keeps_its_motors_off_when_its_link_returns(
    before: Phase, wish: Wish, lost: float
) -> None:
    """The daemon waits while the link is lost, and wants the same as before once it is back."""
    drone = Drone()
    drone.step(Wish.HOVER)
    if before is Phase.LANDING:
        drone.fly()
    drone.until(before, Wish.LAND if before is Phase.LANDING else Wish.FLY)
    for _ in range(round(lost / PERIOD)):
        drone.step(Wish.WAIT, is_flying=None, height=None, may_fly=False, is_clear=False)
    assert drone.last is None  # the firmware stops the motors 2 s after the last report
    drone.height = 0.02
    for _ in range(200):
        assert drone.step(wish) == MOTORS_OFF
        wish = Wish.FLY if wish is Wish.FLY else Wish.WAIT


def test_a_drone_that_is_still_in_the_air_when_its_link_returns_lands() -> None:
    drone = Drone()
    drone.fly()
    while drone.step(Wish.WAIT, is_flying=None, height=None, may_fly=False) is not None:
        assert drone.flight.phase is Phase.LANDING
    assert drone.height > LANDED_HEIGHT
    for _ in range(3):  # reports of before, which arrive at once
        assert drone.step(Wish.FLY) is None
    drone.until(Phase.LANDING, Wish.FLY)
    drone.until(Phase.GROUND, Wish.FLY)
    assert {drone.step(Wish.FLY) for _ in range(200)} == {MOTORS_OFF}


def test_reports_of_before_a_pause_of_the_daemon_start_no_motors() -> None:
    drone = Drone()
    drone.fly()
    drone.step(Wish.FLY, 5.0)  # the drone fell meanwhile; this report is old
    assert drone.last is None
    drone.height = 0.02
    assert {drone.step(Wish.FLY) for _ in range(200)} == {MOTORS_OFF}


def test_a_standing_drone_that_another_program_flies_is_named() -> None:
    drone = Drone()
    drone.step(Wish.HOVER)
    drone.height = 0.5
    drone.until(Phase.LANDING, Wish.HOVER, is_flying=True)
    assert "another program" in drone.flight.text


def test_a_landed_drone_whose_motors_still_count_as_flying_gets_motors_off() -> None:
    """The firmware reports a flight until 2 s after the motors had thrust."""
    drone = Drone()
    drone.fly()
    drone.until(Phase.LANDING, Wish.LAND)
    drone.until(Phase.GROUND, Wish.HOVER, is_flying=True)
    assert drone.step(Wish.HOVER, is_flying=True) == MOTORS_OFF


def test_a_drone_of_unknown_state_gets_no_motors_off() -> None:
    drone = Drone()
    assert drone.step(Wish.HOVER, is_flying=None, height=None) is None


def test_the_invariants_hold_in_random_histories() -> None:
    broken = dict[int, str]()
    for seed in range(200):
        try:
            check_history(seed)
        except AssertionError as error:
            broken[seed] = str(error)
    assert broken == {}


def check_history(seed: int) -> None:
    """Raise AssertionError if an invariant does not hold in the history of a seed."""
    draw, drone = random.Random(seed), Drone()
    rested, wish, seen = False, Wish.HOVER, dict[str, Any]()
    began_landing = heard_at = 0.0
    for _ in range(600):
        if draw.random() < 0.05:
            wish = draw.choice(list(Wish))
        if draw.random() < 0.05:
            seen = {
                name: draw.random() < 0.9 if name != "is_battery_low" else draw.random() < 0.1
                for name in ("may_fly", "is_clear", "is_battery_low")
            }
            if draw.random() < 0.1:
                seen |= {"height": None, "is_flying": None}
        before, height = drone.flight.phase, drone.last.height if drone.last else 0.0
        period = draw.choice((PERIOD, PERIOD, PERIOD, 0.0, 0.3, 5.0))
        put, after = drone.step(wish, period, **seen), drone.flight.phase
        # A drone moves only in flight, at its height, and as asked.
        if put is not None and not put.twist.is_zero:
            assert after is Phase.FLIGHT
            assert wish is Wish.FLY
            assert put == HoverSetpoint(TWIST, RULES.height)
        # The height changes no faster than declared.
        if put is not None and Phase.GROUND not in (before, after):
            assert put.height - height <= RULES.take_off_rate * MAX_STEP + 1e-9
            assert height - put.height <= RULES.land_rate * MAX_STEP + 1e-9
        # A drone that is not heard is sent nothing.
        heard_at = drone.now if seen.get("is_flying", True) is not None else heard_at
        assert put is None or drone.now - heard_at <= BLIND_TIME
        # A take-off begins only after a rest, and where all is well.
        if before is Phase.GROUND and after is Phase.TAKE_OFF:
            assert rested
            assert wish is Wish.FLY
            assert seen.get("may_fly", True)
            assert seen.get("is_clear", True)
            assert not seen.get("is_battery_low", False)
        if after is Phase.GROUND:
            is_restful = wish in (Wish.HOVER, Wish.LAND)
            rested = (rested and before is Phase.GROUND) or (
                (before is Phase.GROUND or period > MAX_PAUSE) and is_restful
            )
            assert put in (None, MOTORS_OFF)
        elif put is not None:
            assert put.height >= TOUCH_HEIGHT
        # A wish to land is followed at once, and a landing ends.
        if wish is Wish.LAND:
            assert after in (Phase.GROUND, Phase.LANDING)
        if before is Phase.LANDING:
            assert after in (Phase.LANDING, Phase.GROUND)
        if after is Phase.LANDING and before is not Phase.LANDING:
            began_landing = drone.now
        steps_of_pause = 5.0 * RULES.height / RULES.land_rate / MAX_STEP
        assert after is not Phase.LANDING or drone.now - began_landing < 10.0 + steps_of_pause
