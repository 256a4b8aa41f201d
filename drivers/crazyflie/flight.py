"""The flight of one drone at one height: take-off, flight, landing. Pure.

Each step takes the time, what the robot's daemon wants, and what the drone reports, and gives the
set-point to send. Units: s, m, m/s, rad/s.

1. A connection begins on the ground. Nothing is sent until the supervisor is heard; then the motors
   are off, or a drone that has been high for FOUND_TIME lands.
2. A drone takes off only if the daemon begins to want a flight: in an earlier step since the last
   landing or connection the daemon commanded none. So a wish that outlives a landing or a lost link
   starts nothing.
3. The drone moves sideways or turns only in FLIGHT, at the height of flight.
4. A landing that has begun is completed while the drone is heard.
5. A drone that is not heard lands for BLIND_TIME. Then nothing is sent, and rule 1 holds: such a
   drone may have stopped its motors, and a set-point would start them where it lies. The same after
   a pause of MAX_PAUSE between two steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from swarmd.core.values import ZERO, Twist

TOUCH_HEIGHT = 0.05
"""m: the lowest set-point of a landing."""
LANDED_HEIGHT = 0.12
"""m: a drone below this height has landed."""
LANDING_RESERVE = 2.0
"""s after the lowest set-point until the motors stop although the height is not known."""
CLIMB_RESERVE = 5.0
"""s after the highest set-point of a take-off until a drone that is still low lands."""
BLIND_TIME = 0.5
"""s without the supervisor, beside the time for which a report counts, until nothing is sent.

With that time (1 s) and the delay of the link it must stay below the 2 s after which the firmware
stops the motors.
"""
MAX_PAUSE = 1.5
"""s between two steps after which the firmware may stop the motors before a set-point arrives."""
FOUND_TIME = 0.3
"""s for which a drone must be reported in the air until it lands: reports that waited for a process
that stood still arrive within ms of each other."""
MAX_STEP = 0.1
"""s: a longer pause between two steps changes the set-point of the height by no more."""
NOT_ARMED = "the firmware is not armed; arm it, such as in the maker's client"
_FOUND_FLYING = "the drone was in the air when it was found"
_FLOWN_BY_OTHERS = "another program flies the drone, such as a second daemon; end that program"
_TOO_LOW = "the drone did not reach its height; does another program command it, too?"
_REACHED = 0.8  # share of the height at which a take-off is over


class Phase(StrEnum):
    """Where in its flight a drone is."""

    GROUND = "on the ground"
    TAKE_OFF = "takes off"
    FLIGHT = "flies"
    LANDING = "lands"


class Wish(StrEnum):
    """What the daemon wants."""

    FLY = "fly"
    HOVER = "hover"
    LAND = "land"
    WAIT = "wait"  # no command is fresh: as HOVER, but a take-off must wait for a command


@dataclass(frozen=True, slots=True)
class FlightRules:
    """The declared numbers of a flight.

    `height` in m; `take_off_rate` and `land_rate` in m/s; `land_after`: s of hovering without a
    wish to fly until the drone lands.
    """

    height: float
    take_off_rate: float
    land_rate: float
    land_after: float


@dataclass(frozen=True, slots=True)
class Seen:
    """What the drone reports; None for what is not fresh.

    `height` in m above the floor. `is_flying`: by the firmware. `may_fly`: the firmware is ready,
    and neither tumbled, crashed nor locked. `is_unarmed`: the firmware waits to be armed.
    `fault`: why decks or state estimate forbid a take-off; empty if they permit it. `is_clear`: all
    ranges permit a take-off. `is_battery_low`: the voltage has been low for long.
    """

    height: float | None = None
    is_flying: bool | None = None
    may_fly: bool = False
    is_unarmed: bool = False
    fault: str = "nothing is heard yet"
    is_clear: bool = False
    is_battery_low: bool = False

    @property
    def is_low(self) -> bool:
        """The height is known, and that of a drone that has landed."""
        return self.height is not None and self.height <= LANDED_HEIGHT


@dataclass(frozen=True, slots=True)
class HoverSetpoint:
    """Velocity in the drone's frame, and height; `height` 0: the motors are off."""

    twist: Twist
    height: float


MOTORS_OFF = HoverSetpoint(ZERO, 0.0)


class Flight:
    """The state of a flight; `text` explains the last decision."""

    def __init__(self, rules: FlightRules) -> None:
        self._rules = rules
        self.phase = Phase.GROUND
        self.text = ""
        self._has_rested = False  # the daemon commanded no flight since the last landing
        self._has_stood = False  # the firmware reported no flight since the last landing
        self._target = 0.0  # set-point of the height
        self._now = -math.inf
        self._wanted_at = -math.inf
        self._deadline = -math.inf
        # the supervisor; a drone that is not in the air
        self._heard_at = -math.inf
        self._low_at = -math.inf

    @property
    def descent_time(self) -> float:
        """s that a landing takes from the last set-point of the height."""
        return self._target / self._rules.land_rate

    def step(self, now: float, wish: Wish, twist: Twist, seen: Seen) -> HoverSetpoint | None:
        """The set-point to send at `now`; None on the ground if the motors may still run.

        `twist`: the safe command, which the drone follows while `wish` is FLY.
        """
        pause = now - self._now
        passed = min(max(pause, 0.0), MAX_STEP)
        self._now = now
        if seen.is_flying is not None:
            self._heard_at = now
        is_alone = pause > MAX_PAUSE or now - self._heard_at > BLIND_TIME
        if self.phase is not Phase.GROUND and is_alone:
            self._end("the drone was lost in flight")
        if self.phase is Phase.GROUND:
            self._on_ground(wish, seen)
        elif self.phase is Phase.TAKE_OFF:
            self._in_take_off(wish, seen, passed)
        elif self.phase is Phase.FLIGHT:
            self._in_flight(wish, seen)
        else:
            self._in_landing(seen, passed)
        if self.phase is Phase.GROUND:
            is_down = seen.is_flying is False or (seen.is_flying and seen.is_low)
            return MOTORS_OFF if is_down else None
        if self.phase is Phase.FLIGHT and wish is Wish.FLY:
            return HoverSetpoint(twist, self._target)
        return HoverSetpoint(ZERO, self._target)

    def _on_ground(self, wish: Wish, seen: Seen) -> None:
        if not seen.is_flying or seen.height is None or seen.is_low:
            self._low_at = self._now
        elif self._now - self._low_at >= FOUND_TIME:
            self._land(_FLOWN_BY_OTHERS if self._has_stood else _FOUND_FLYING, seen.height)
            return
        self._has_stood |= seen.is_flying is False
        if wish is not Wish.FLY:
            if wish is not Wish.WAIT:
                self._has_rested = True
                self.text = ""
            return
        obstacle = _take_off_obstacle(seen) if self._has_rested else "waits for the next run"
        self.text = obstacle and f"does not take off: {obstacle}"
        if not obstacle:
            self.phase = Phase.TAKE_OFF
            self._target = TOUCH_HEIGHT
            self._has_rested = False

    def _in_take_off(self, wish: Wish, seen: Seen, passed: float) -> None:
        cause = _landing_cause(wish, seen)
        if wish is not Wish.FLY:
            cause = cause or "the run ended during the take-off"
        if not seen.is_clear:
            cause = cause or "an obstacle is near during the take-off"
        if cause:
            self._land(cause, self._target)
            return
        if self._target < self._rules.height:
            rise = self._rules.take_off_rate * passed
            self._target = min(self._target + rise, self._rules.height)
            self._deadline = self._now + CLIMB_RESERVE
        elif seen.height is not None and seen.height >= _REACHED * self._rules.height:
            self.phase = Phase.FLIGHT
            self._wanted_at = self._now
        elif self._now >= self._deadline:
            self._land(_TOO_LOW, self._target)

    def _in_flight(self, wish: Wish, seen: Seen) -> None:
        if seen.is_flying is False and seen.is_low:
            self._end("the firmware has stopped the motors")
            return
        if wish is Wish.FLY:
            self._wanted_at = self._now
        cause = _landing_cause(wish, seen)
        if self._now - self._wanted_at >= self._rules.land_after:
            cause = cause or f"nothing to do for {self._rules.land_after:g} s"
        if cause:
            self._land(cause, self._target)

    def _in_landing(self, seen: Seen, passed: float) -> None:
        if seen.is_flying is False and seen.is_low:
            self._end(self.text)  # a set-point would start the motors
            return
        if self._target > TOUCH_HEIGHT:
            self._target = max(self._target - self._rules.land_rate * passed, TOUCH_HEIGHT)
            self._deadline = self._now + LANDING_RESERVE
            return
        if seen.is_low or self._now >= self._deadline:
            self._end(self.text)

    def _land(self, cause: str, height: float) -> None:
        self.phase = Phase.LANDING
        self.text = cause
        self._target = min(max(height, TOUCH_HEIGHT), self._rules.height)
        self._deadline = self._now + LANDING_RESERVE

    def _end(self, text: str) -> None:
        self.phase = Phase.GROUND
        self.text = text
        self._has_rested = False
        self._has_stood = False
        self._target = 0.0
        self._low_at = self._now


def _take_off_obstacle(seen: Seen) -> str:
    """Why a drone on the ground must not take off; empty if it may."""
    if seen.is_unarmed:
        return NOT_ARMED
    if not seen.may_fly or seen.is_flying is None:
        return "the firmware is not ready to fly"
    if seen.fault:
        return seen.fault
    if seen.is_battery_low:
        return "the battery is low"
    return "" if seen.is_clear else "a range is not clear"


def _landing_cause(wish: Wish, seen: Seen) -> str:
    """Why a drone in the air must land now; empty if it need not."""
    if wish is Wish.LAND:
        return "landing is asked for"
    if seen.is_battery_low:
        return "the battery is low"
    if seen.height is None:
        return "the height is not heard"
    return "" if seen.may_fly else "the firmware is not ready to fly"
