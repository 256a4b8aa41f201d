"""A pattern in 15 lines."""

from swarmd.api import Annotated, Inputs, MovementPattern, Params, Twist, about, nearest


class ShyParams(Params, frozen=True):
    """Parameters with their bounds; `swarmctl patterns show shy` lists them."""

    speed: Annotated[float, about("driving speed", ge=0.0, le=1.0, unit="m/s")] = 0.15
    distance: Annotated[float, about("range that counts as near", ge=0.1, le=3.0, unit="m")] = 0.8


class Shy(MovementPattern[ShyParams]):
    """Drives straight; turns while an obstacle ahead is near."""

    params_type = ShyParams

    def drive(self, inputs: Inputs) -> Twist:
        """The requested command; protection may change it."""
        near = nearest(inputs.scan, half_width=1.0)
        if near is not None and near.range < self.params.distance:
            return Twist(angular=1.0)
        return Twist(linear=self.params.speed)
