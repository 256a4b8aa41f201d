"""Cooperative transport: robots push a box to a lamp from where the box hides the lamp.

Source: Chen, Gauci, Li, Kolling and Gross, "Occlusion-based cooperative transport with a swarm of
miniature mobile robots", IEEE Transactions on Robotics 31(2), 2015: a robot searches the object and
goes there. Where the object hides the goal, the robot pushes. Elsewhere the robot moves around the
object. Robots do not communicate. The source proves that a convex object arrives at the goal if
robots push on its whole hidden side.

Ours: the robot recognises the box, the lamp and other robots, all around (`detections`), goes
around on a ring by the shorter way, and pushes towards the middle of the box.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any

from swarmd.api import (
    CombinedPattern,
    Context,
    Detection,
    Inputs,
    NearPoints,
    Outputs,
    Params,
    Pattern,
    Recovery,
    TopSpeed,
    TopTurn,
    TouchZone,
    Twist,
    about,
    of_threshold,
)

_SEARCH = "search"
_LEAD = 0.6  # rad further along the ring: where a robot on its way around steers
_BRAKE = 0.3


class CooperativeTransportParams(Params, frozen=True, kw_only=True):
    """The ring around the box, the distance from other robots, and the speeds."""

    ring: Annotated[
        float,
        about(
            "goes around the box at this distance from its middle",
            ge=0.05,
            le=20.0,
            unit="m",
            source="ours: past the corners of a box of 0.4 m",
        ),
    ] = 0.6
    spacing: Annotated[
        float,
        about(
            "keeps this distance from other robots, from axle to axle",
            ge=0.0,
            le=20.0,
            unit="m",
            source="ours: 0.5 times the protection threshold",
            derived=of_threshold(0.5),
        ),
    ]
    push: Annotated[
        float,
        about("speed of a robot that pushes", ge=0.0, le=0.3, unit="m/s", source="ours"),
    ] = 0.1
    speed: TopSpeed
    turn: TopTurn
    recovery: Recovery = False


class CooperativeTransport(CombinedPattern[CooperativeTransportParams]):
    """Searches the box, goes around while the lamp is seen, and pushes where the lamp is hidden."""

    group = "carry"
    params_type = CooperativeTransportParams
    needs = frozenset({"scan", "detections"})
    touches = TouchZone(bearing=0.0, half_width=math.radians(60.0), speed=0.1)

    def __init__(self, params: CooperativeTransportParams, context: Context) -> None:
        super().__init__(params, context)
        self._side = 1.0

    def make_parts(self) -> Mapping[str, Pattern[Any]]:
        """The search."""
        return {_SEARCH: self.context.make("random_walk", part=_SEARCH, speed=self.params.speed)}

    def step(self, inputs: Inputs) -> Outputs:
        """The search without a box, a push where the box hides the lamp, else the way around."""
        params = self.params
        seen = inputs.detections or ()
        placed = [detection for detection in seen if detection.distance is not None]
        boxes, lamps, robots = (
            [detection for detection in placed if detection.kind == kind]
            for kind in ("box", "lamp", "robot")
        )
        box = min(boxes, key=_away, default=None)
        if box is None:
            return Outputs(self.step_part(_SEARCH, inputs).twist, report={"state": "search"})
        lamp = min(lamps, key=_away, default=None)
        is_hidden = lamp is None
        x, y = _place(box) if lamp is None else self._around(box, lamp)
        length = max(math.hypot(x, y), 1e-9)
        speed = params.push if is_hidden else params.speed
        others = NearPoints([(_away(robot), robot.bearing) for robot in robots])
        x, y = others.keep_clear(x / length, y / length, spacing=params.spacing, brake=_BRAKE)
        twist = others.steer(x, y, speed, params.turn, spacing=params.spacing, brake=_BRAKE)
        return Outputs(
            Twist(twist.linear, twist.angular), report={"state": "push" if is_hidden else "around"}
        )

    def _around(self, box: Detection, lamp: Detection) -> tuple[float, float]:
        """The way along the ring to the side of the box that is far from the lamp."""
        x, y = _place(box)
        to_lamp = _place(lamp)
        own = math.atan2(-y, -x)  # from the box to the robot
        behind = math.atan2(y - to_lamp[1], x - to_lamp[0])  # from the lamp to the box, and on
        left = math.remainder(behind - own, 2.0 * math.pi)
        if abs(left) < 0.75 * math.pi:  # beyond, noise would change the side
            self._side = math.copysign(1.0, left)
        at = own + self._side * _LEAD
        return x + self.params.ring * math.cos(at), y + self.params.ring * math.sin(at)


def _away(detection: Detection) -> float:
    return math.inf if detection.distance is None else detection.distance


def _place(detection: Detection) -> tuple[float, float]:
    away = _away(detection)
    bearing = detection.bearing
    return away * math.cos(bearing), away * math.sin(bearing)
