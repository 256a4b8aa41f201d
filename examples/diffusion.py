"""ARGoS's example controller footbot_diffusion as a pattern: straight on, or away from walls."""

import numpy as np

from swarmd.api import Annotated, Inputs, MovementPattern, Params, Twist, about


class DiffusionParams(Params, frozen=True):
    """As the XML attributes of the controller's `params` tag."""

    alpha: Annotated[
        float, about("half angle to the sides that is ahead", ge=1, le=90, unit="deg")
    ] = 30
    delta: Annotated[float, about("sum of proximities that makes it turn", ge=0.0, le=10.0)] = 0.02
    velocity: Annotated[float, about("driving speed", ge=0.0, le=1.0, unit="m/s")] = 0.2
    near: Annotated[float, about("range of a proximity sensor", ge=0.05, le=3.0, unit="m")] = 0.6


class Diffusion(MovementPattern[DiffusionParams]):
    """ControlStep: one vector of all proximities decides."""

    params_type = DiffusionParams

    def drive(self, inputs: Inputs) -> Twist:
        """Straight if nothing is near ahead, else a turn on the spot to the freer side."""
        scan, params = inputs.scan, self.params
        assert scan is not None  # a MovementPattern is stepped from the first scan on
        is_near = np.isfinite(scan.ranges) & (scan.ranges < params.near)
        proximity = np.where(is_near, 1.0 - scan.ranges / params.near, 0.0) / len(scan.ranges)
        x, y = np.sum(proximity * np.cos(scan.bearings)), np.sum(proximity * np.sin(scan.bearings))
        angle = np.degrees(np.arctan2(y, x))
        if np.hypot(x, y) < params.delta or abs(angle) > params.alpha:
            return Twist(linear=params.velocity)
        return Twist(angular=-1.0 if angle > 0.0 else 1.0)
