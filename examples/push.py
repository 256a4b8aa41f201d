"""A pattern that touches: what it asks for, and what its robot's configuration must grant.

touch: {push: {half_width_deg: 20, speed: 0.1}}
"""

import math

from swarmd.api import Annotated, Inputs, MovementPattern, Params, Recovery, TouchZone, Twist, about


class PushParams(Params, frozen=True):
    """How fast; `recovery` is off, for what blocks the way is what it is there for."""

    speed: Annotated[float, about("how fast it pushes", ge=0.0, le=0.3, unit="m/s")] = 0.1
    recovery: Recovery = False


class Push(MovementPattern[PushParams]):
    """Drives straight ahead and pushes what is there, if that is granted; else it stops short."""

    params_type = PushParams
    needs = frozenset[str]()
    is_symmetric = True
    touches = TouchZone(bearing=0.0, half_width=math.radians(20.0), speed=0.1)

    def drive(self, inputs: Inputs) -> Twist:
        """Always the same; protection limits it to the zone's speed near what is ahead."""
        return Twist(linear=self.params.speed)
