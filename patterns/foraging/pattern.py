"""Foraging: robots search items, and carry them home to a nest under a lamp.

Source: central-place foraging of Lerman and Galstyan, "Mathematical model of foraging in a group of
robots: effect of interference", Autonomous Robots 13, 2002. A robot searches by a random walk,
picks an item up, drives home to the nest, drops the item and searches again. Robots that meet avoid
each other, which costs time. With more robots, each robot delivers fewer items, and the number of
the group's items has a maximum.

Ours: two light sensors find the way to the lamp of the nest, as in the pattern phototaxis. The nest
is where the floor is grey.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from swarmd.api import (
    CombinedPattern,
    Context,
    Inputs,
    Outputs,
    Params,
    Pattern,
    Recovery,
    TopSpeed,
    TopTurn,
    Twist,
    WalkClearance,
    about,
)

_WALK = "walk"
_HOME = "home"
_AIM = 0.2  # rad off an item beyond which the robot turns on the spot
_READ = frozenset({"food", "food_distance", "food_bearing", "held", "ground"})
_EYES = frozenset({"light_1", "light_2"})


class ForagingParams(Params, frozen=True, kw_only=True):
    """Where an item is in reach, how far into the nest it is dropped, and the motion."""

    reach: Annotated[
        float,
        about(
            "closes the gripper where the item is so near to its axle",
            ge=0.01,
            le=2.0,
            unit="m",
            source="ours: the front edge and 4 cm",
            derived=lambda platform: float(platform.footprint[:, 0].max()) + 0.04,
        ),
    ]
    inside: Annotated[
        float,
        about(
            "drives on so long over the floor of the nest before it drops the item",
            ge=0.0,
            le=60.0,
            unit="s",
            source="ours: the edge of the nest stays free",
        ),
    ] = 1.0
    white: Annotated[
        float,
        about("the floor is that of the nest below", ge=0.0, le=1e6, source="ours: a grey nest"),
    ] = 0.8
    speed: TopSpeed
    turn: TopTurn
    clearance: WalkClearance
    recovery: Recovery = False


class Foraging(CombinedPattern[ForagingParams]):
    """Searches, picks up, homes and drops. The item's kind is `food`, the floor's name `ground`."""

    group = "carry"
    params_type = ForagingParams
    needs = frozenset({"scan", "gripper", *(f"reading:{name}" for name in _READ | _EYES)})

    def __init__(self, params: ForagingParams, context: Context) -> None:
        super().__init__(params, context)
        self._in_nest = 0.0  # s

    def make_parts(self) -> Mapping[str, Pattern[Any]]:
        """The search, and the way home."""
        make = self.context.make
        speed = self.params.speed
        turn = self.params.turn
        clear = self.params.clearance
        return {
            _WALK: make("random_walk", part=_WALK, speed=speed, clearance=clear),
            _HOME: make("phototaxis", part=_HOME, speed=speed, turn=turn, spacing=clear),
        }

    def step(self, inputs: Inputs) -> Outputs:
        """Home with an item, to an item that is seen, else the search."""
        params = self.params
        seen = inputs.readings
        if inputs.scan is None or not seen.keys() >= _READ:
            return Outputs()
        is_nest = seen["ground"] < params.white
        if seen["held"]:
            self._in_nest = self._in_nest + inputs.dt if is_nest else 0.0
            twist = self.step_part(_HOME, inputs).twist
            is_home = self._in_nest >= params.inside
            return Outputs(twist, report={"state": "home"}, grip=not is_home)
        self._in_nest = 0.0
        if not seen["food"] or is_nest:
            twist = self.step_part(_WALK, inputs).twist
            return Outputs(twist, report={"state": "search"}, grip=False)
        distance = seen["food_distance"]
        bearing = seen["food_bearing"]
        is_ahead = abs(bearing) < _AIM
        turn = max(-params.turn, min(params.turn, 2.0 * bearing))
        # Slower near the item, to stop 2 cm within reach.
        linear = min(params.speed, distance - params.reach + 0.02) if is_ahead else 0.0
        is_near = is_ahead and distance <= params.reach
        return Outputs(Twist(max(linear, 0.0), turn), report={"state": "fetch"}, grip=is_near)
