"""BEECLUST: robots gather where it is warm (Schmickl and Hamann 2011). They send no messages."""

from swarmd.api import (
    Annotated,
    Avoidance,
    Inputs,
    Params,
    TimedPattern,
    Twist,
    about,
    nearest,
    robots_near,
)


class BeeclustParams(Params, frozen=True):
    """The speed, the distance of a meeting, and how the wait depends on the temperature."""

    speed: Annotated[float, about("driving speed", ge=0.0, le=1.0, unit="m/s")] = 0.2
    near: Annotated[float, about("distance of a meeting", ge=0.1, le=3.0, unit="m")] = 0.45
    wait: Annotated[float, about("longest wait", ge=0.0, le=600.0, unit="s")] = 120.0
    cold: Annotated[float, about("no wait at or below", ge=-50.0, le=100.0, unit="degC")] = 20.0
    half: Annotated[float, about("half of the wait at cold +", ge=0.1, le=50, unit="degC")] = 5.0
    avoidance: Avoidance = "none"  # a bee that is to meet others passes none of them


class Beeclust(TimedPattern[BeeclustParams]):
    """Drives; waits where it meets a robot, the longer the warmer it is; then turns away."""

    params_type = BeeclustParams
    needs = frozenset({"scan", "reading:temperature"})

    def drive(self, inputs: Inputs) -> Twist:
        """Stands in state wait, turns in state turn, and drives otherwise."""
        state = self.state(inputs.now)
        if state != "drive":
            return Twist(angular=1.0 if state == "turn" else 0.0)
        turn = self.context.rng.uniform(1.5, 4.7)
        ahead = nearest(inputs.scan, half_width=1.0)
        if robots_near(inputs.scan, self.context.platform, within=self.params.near, half_width=1.0):
            warmth = max(inputs.readings["temperature"] - self.params.cold, 0.0) ** 2
            share = warmth / (warmth + self.params.half**2)
            self.begin(inputs.now, wait=share * self.params.wait, turn=turn)
        elif ahead is not None and ahead.range < self.params.near:
            self.begin(inputs.now, turn=turn)
        return Twist(linear=self.params.speed)
