"""Drives to the nearest object of a kind that a camera recognises, such as an AprilTag."""

import math

from swarmd.api import (
    ZERO,
    Annotated,
    Detection,
    Inputs,
    MovementPattern,
    Params,
    TopSpeed,
    Twist,
    about,
)


class ApproachTagParams(Params, frozen=True, kw_only=True):
    """What it looks for, and where it stops."""

    kind: Annotated[str, about("kind of the object, as in `kinds` of the driver")] = "robot"
    distance: Annotated[float, about("stops so near to its middle", ge=0.1, le=5.0, unit="m")] = 0.8
    speed: TopSpeed


class ApproachTag(MovementPattern[ApproachTagParams]):
    """Turns on the spot until it sees one, drives to it, and stops there.

    It stands while it sees only tags whose distance is not measured.
    """

    params_type = ApproachTagParams
    needs = frozenset({"scan", "detections"})

    def drive(self, inputs: Inputs) -> Twist:
        """The requested command; protection may change it."""
        seen = [one for one in inputs.detections or () if one.kind == self.params.kind]
        tag = min(seen, key=_distance, default=None)
        if tag is None:
            return Twist(angular=0.5)
        if tag.distance is None or tag.distance <= self.params.distance:
            return ZERO
        return Twist(
            linear=self.params.speed * max(0.0, 1.0 - abs(tag.bearing)), angular=tag.bearing
        )


def _distance(tag: Detection) -> float:
    return math.inf if tag.distance is None else tag.distance
