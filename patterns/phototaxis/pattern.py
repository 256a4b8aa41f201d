"""Phototaxis and antiphototaxis: towards a lamp or away from lamps, by two eyes.

Source: Braitenberg, "Vehicles", 1984, vehicles 2 and 3; both are modules of AutoMoDe (Francesca et
al., Swarm Intelligence 8, 2014). Ours: the eyes, two light sensors, point 45 degrees to either
side, and measure the cosine of the angle to the lamp. So atan2(left - right, left + right) is the
bearing of the lamp, by which the robot steers. A robot that sees no lamp turns once around and on
to a random heading, drives straight for a while and turns again.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

from swarmd.api import (
    Context,
    Inputs,
    Params,
    Recovery,
    TimedPattern,
    TopSpeed,
    TopTurn,
    Twist,
    about,
    near_points,
    of_threshold,
    turn_time,
)

_BRAKE = 0.3  # m before `spacing` over which the speed towards an obstacle falls to zero


class PhototaxisParams(Params, frozen=True, kw_only=True):
    """The sense, where to stand, the search in the dark, and the motion."""

    sense: Annotated[
        Literal["towards", "away"],
        about("towards the lamp, or away from it", source="Braitenberg 1984"),
    ] = "towards"
    bright: Annotated[
        float,
        about(
            "towards: stands where both eyes together read this much; 0: never stands",
            ge=0.0,
            le=1e6,
            source="ours: a robot that has arrived does not push in",
        ),
    ] = 0.0
    dark: Annotated[
        float,
        about(
            "both eyes together see no lamp at or below",
            ge=0.0,
            le=1e6,
            source="ours: noise of a sensor, or light of the room",
        ),
    ] = 0.0
    straight: Annotated[
        float,
        about(
            "drives so long between two turns in the dark",
            ge=0.0,
            le=600.0,
            unit="s",
            source="ours: out of the shadow of another robot",
        ),
    ] = 3.0
    speed: TopSpeed
    turn: TopTurn
    spacing: Annotated[
        float,
        about(
            "keeps this distance from obstacles",
            ge=0.0,
            le=20.0,
            unit="m",
            source="ours: 0.8 times the protection threshold",
            derived=of_threshold(0.8),
        ),
    ]
    recovery: Recovery = False


class Phototaxis(TimedPattern[PhototaxisParams]):
    """Steers by the difference of two eyes, `light_1` on the left and `light_2` on the right."""

    group = "search"
    params_type = PhototaxisParams
    needs = frozenset({"scan", "reading:light_1", "reading:light_2"})
    default_state = "steer"

    def __init__(self, params: PhototaxisParams, context: Context) -> None:
        super().__init__(params, context)
        self._side = 1.0

    def drive(self, inputs: Inputs) -> Twist:
        """The command along the bearing of the lamp; a turn, then a straight, in the dark."""
        params = self.params
        now = inputs.now
        left = inputs.readings["light_1"]
        right = inputs.readings["light_2"]
        is_seen = left + right > params.dark
        is_away = params.sense == "away"
        if is_seen and not is_away:
            self.begin(now)  # no search
            if 0.0 < params.bright <= left + right:
                self.begin(now, arrived=math.inf)
                return Twist()
        state = self.state(now)
        if is_seen:
            bearing = math.atan2(left - right, left + right) + (math.pi if is_away else 0.0)
            return self._towards(inputs, bearing)
        if is_away or state == "straight":
            return self._towards(inputs, 0.0)
        if state != "turn":
            self._side = float(self.context.rng.choice((-1.0, 1.0)))
            turns = float(self.context.rng.uniform(1.0, 2.0))
            turn = turn_time(turns * 2.0 * math.pi, params.turn)
            self.begin(now, turn=turn, straight=params.straight)
        return Twist(angular=self._side * params.turn)

    def _towards(self, inputs: Inputs, bearing: float) -> Twist:
        params = self.params
        scan = self.context.platform.scan
        near = near_points(inputs.scan, within=params.spacing + 1.0, offset=scan.offset)
        x, y = near.keep_clear(
            math.cos(bearing), math.sin(bearing), spacing=params.spacing, brake=_BRAKE
        )
        return near.steer(x, y, params.speed, params.turn, spacing=params.spacing, brake=_BRAKE)
