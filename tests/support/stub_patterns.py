"""Patterns that each do one thing, and a robot that runs one of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from swarmd.api import Inputs, MovementPattern, Outputs, Params, Pattern, Twist, about
from swarmd.core.messages import Reason, State
from tests.support.robot_harness import RobotHarness


class SpeedParams(Params, frozen=True):
    """Parameters of `Forward`."""

    speed: Annotated[float, about("forward", ge=-1.0, le=1.0, unit="m/s")] = 0.2


class Forward(MovementPattern[SpeedParams]):
    """Drives straight."""

    params_type = SpeedParams

    def drive(self, inputs: Inputs) -> Twist:
        return Twist(self.params.speed)


class Raiser(Pattern[Params]):
    """Raises at every third step."""

    count = 0

    def step(self, inputs: Inputs) -> Outputs:
        self.count += 1
        if self.count % 3 == 0:
            raise ZeroDivisionError("on purpose")
        return Outputs(Twist(0.2))


class Finisher(Pattern[Params]):
    """Finishes at the fifth step."""

    count = 0

    def step(self, inputs: Inputs) -> Outputs:
        self.count += 1
        return Outputs(Twist(0.1), done="arrived" if self.count == 5 else None)


class NotFinite(Pattern[Params]):
    """Commands NaN."""

    def step(self, inputs: Inputs) -> Outputs:
        return Outputs(Twist(float("nan")))


class Listener(Pattern[Params]):
    """Sends and receives integers."""

    channels: Mapping[str, type] = {"count": int}
    heard: tuple[object, ...] = ()

    def step(self, inputs: Inputs) -> Outputs:
        self.heard += tuple((m.sender, m.value) for m in inputs.messages)
        return Outputs(messages={"count": 3, "other": 1}, report={"heard": str(self.heard)})


PATTERNS: dict[str, type[Pattern[Any]]] = {
    "forward": Forward,
    "raiser": Raiser,
    "finisher": Finisher,
    "not_finite": NotFinite,
    "listener": Listener,
}


def idle() -> RobotHarness:
    """A harness of a robot with PATTERNS that was started a second ago."""
    story = RobotHarness(patterns=PATTERNS)
    story.advance(1.0)
    return story


def started(pattern: str = "forward", **params: float) -> RobotHarness:
    """A harness half a second after its robot was asked to run one of PATTERNS."""
    story = idle()
    story.applied("run", pattern=pattern, params=params)
    story.advance(0.5)
    return story


def standing_state(story: RobotHarness) -> tuple[State, Reason | None]:
    """State and reason, as members would show them."""
    status = story.status
    return status.state, status.reason
