"""The flight of a drone: invariants over random histories, and its story from run to landing."""

from __future__ import annotations

import random
from typing import Any

import pytest

from swarmd.core.values import ZERO, Twist
from swarmd.drivers.crazyflie.flight import (
    LANDED_HEIGHT,
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
WELL = Seen(height=0.02, is_flying=False, may_fly=True, is_clear=True)
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
        self.last = self.flight.step(self.now, wish, TWIST, Seen(**{**values, **seen}))
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
    began_landing = 0.0
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
        # A take-off begins only after a rest, and where all is well.
        if before is Phase.GROUND and after is Phase.TAKE_OFF:
            assert rested
            assert wish is Wish.FLY
            assert seen.get("may_fly", True)
            assert seen.get("is_clear", True)
            assert not seen.get("is_battery_low", False)
        if after is Phase.GROUND:
            rested = (rested and before is Phase.GROUND) or (
                before is Phase.GROUND and wish is not Wish.FLY
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
