"""Random walk with the waiting rule of BEECLUST: another pattern as a part, and a rule above it."""

from collections.abc import Mapping
from typing import Any

from swarmd.api import (
    ZERO,
    Annotated,
    Avoidance,
    CombinedPattern,
    Inputs,
    Outputs,
    Params,
    Pattern,
    about,
    robots_near,
)


class WaitingWalkParams(Params, frozen=True):
    """The distance of a meeting, and how the wait depends on the temperature."""

    near: Annotated[float, about("distance of a meeting", ge=0.1, le=3.0, unit="m")] = 0.45
    wait: Annotated[float, about("longest wait", ge=0.0, le=600.0, unit="s")] = 120.0
    avoidance: Avoidance = "none"  # a robot that is to meet others passes none of them


class WaitingWalk(CombinedPattern[WaitingWalkParams]):
    """Walks as random_walk; waits where it meets a robot, the longer the warmer it is there."""

    params_type = WaitingWalkParams
    needs = frozenset({"scan", "reading:temperature"})
    wait_until = free_until = 0.0  # s; no robot is met again before the second

    def make_parts(self) -> Mapping[str, Pattern[Any]]:
        """The walk, which turns away from obstacles as near as a meeting."""
        return {"walk": self.context.make("random_walk", part="walk", clearance=self.params.near)}

    def step(self, inputs: Inputs) -> Outputs:
        """The walk's command, or zero while it waits."""
        now, near = inputs.now, self.params.near
        met = robots_near(inputs.scan, self.context.platform, within=near, half_width=1.0)
        if met and now >= self.free_until:
            warmth = max(inputs.readings.get("temperature", 0.0) - 20.0, 0.0) ** 2
            self.wait_until = now + self.params.wait * warmth / (warmth + 25.0)
            self.free_until = self.wait_until + 5.0
        if now < self.wait_until:
            return Outputs(ZERO, report={"state": "wait"})
        return self.step_part("walk", inputs)
