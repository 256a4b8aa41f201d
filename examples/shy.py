"""A pattern in 15 lines."""

from swarmd.api import Annotated, Inputs, MovementPattern, Params, Twist, about, nearest


class ShyParams(Params, frozen=True):
    """What can be set, with its bounds; `swarmctl patterns show shy` lists it."""

    speed: Annotated[float, about("how fast it drives", ge=0.0, le=1.0, unit="m/s")] = 0.15
    distance: Annotated[float, about("what counts as near", ge=0.1, le=3.0, unit="m")] = 0.8


class Shy(MovementPattern[ShyParams]):
    """Drives ahead, and turns while something is near ahead."""

    params_type = ShyParams

    def drive(self, inputs: Inputs) -> Twist:
        """What it wishes to do now; protection has the last word."""
        near = nearest(inputs.scan, half_width=1.0)
        if near is not None and near.range < self.params.distance:
            return Twist(angular=1.0)
        return Twist(linear=self.params.speed)
