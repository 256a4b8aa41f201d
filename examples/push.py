"""A pattern that pushes. The robot's configuration must grant the touch zone:

touch: {push: {half_width_deg: 20, speed: 0.1}}
"""

import math

from swarmd.api import Annotated, Inputs, MovementPattern, Params, Recovery, TouchZone, Twist, about


class PushParams(Params, frozen=True):
    """`recovery` is off: it would lead the robot around the object to push."""

    speed: Annotated[float, about("forward speed", ge=0.0, le=0.3, unit="m/s")] = 0.1
    recovery: Recovery = False


class Push(MovementPattern[PushParams]):
    """Drives straight ahead; pushes if that is granted, and stops before obstacles otherwise."""

    params_type = PushParams
    needs = frozenset[str]()
    is_symmetric = True
    touches = TouchZone(bearing=0.0, half_width=math.radians(20.0), speed=0.1)

    def drive(self, inputs: Inputs) -> Twist:
        """A constant command; protection limits it to the zone's speed near an obstacle ahead."""
        return Twist(linear=self.params.speed)
