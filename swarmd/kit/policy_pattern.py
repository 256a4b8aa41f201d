"""A learned policy as a pattern: protection judges its requests as those of any other pattern."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

import numpy as np

from swarmd.core.values import Array, Inputs, Limits, Platform, Twist
from swarmd.kit.behavior import Context, MovementPattern
from swarmd.kit.observation import Observation, PolicySpec, observe, requested_twist
from swarmd.kit.params import Params, Recovery, about
from swarmd.kit.policy_network import from_text

_EARLY = 0.02  # s that a step may come before the period is over, by which ticks jitter


class PolicyParams(Params, frozen=True, kw_only=True):
    """What the actions of a policy request."""

    speed: Annotated[
        float,
        about(
            "linear speed that an action of 1 requests; lateral likewise, up to the base's limit",
            ge=0.0,
            le=10.0,
            unit="m/s",
            source="ours: the platform's limit",
            derived=lambda platform: platform.limits.linear,
        ),
    ]
    turn: Annotated[
        float,
        about(
            "turn rate that an action of 1 requests",
            ge=0.0,
            le=10.0,
            unit="rad/s",
            source="ours: the platform's limit",
            derived=lambda platform: platform.limits.angular,
        ),
    ]
    recovery: Recovery = False


class ActionPattern(MovementPattern[PolicyParams]):
    """Requests the twist of an action; `decide` gives one for each observation of `spec`."""

    params_type = PolicyParams

    def __init__(self, params: PolicyParams, context: Context, spec: PolicySpec) -> None:
        super().__init__(params, context)
        self.spec = spec
        self.needs = spec.needs

    def observed(self, inputs: Inputs) -> Observation:
        """The observation (size,) of these inputs."""
        return observe(self.spec, inputs, self.context.platform)

    def requested(self, action: Array) -> Twist:
        """The twist that an action (actions,) requests."""
        return requested_twist(self.spec, action, scale_of(self.params, self.context.platform))


class PolicyPattern(ActionPattern):
    """A pattern that runs a policy; a plugin sets `network` to the text that `to_text` returns.

    The policy decides every `spec.period` s. Between two decisions the requested twist stays the
    same.
    """

    network: ClassVar[str] = ""

    def __init_subclass__(cls) -> None:
        """Declare what the network observes; ConfigError if `network` holds none."""
        super().__init_subclass__()
        cls.needs = from_text(cls.network).spec.needs

    def __init__(self, params: PolicyParams, context: Context) -> None:
        self._network = from_text(self.network)
        super().__init__(params, context, self._network.spec)
        self._decided_at = -math.inf
        self._action = np.zeros(self.spec.actions)

    def drive(self, inputs: Inputs) -> Twist:
        """The twist of the action for the newest inputs."""
        if inputs.now - self._decided_at >= self.spec.period - _EARLY:
            self._decided_at = inputs.now
            self._action = self._network.act(self.observed(inputs))
        return self.requested(self._action)


def scale_of(params: PolicyParams, platform: Platform) -> Limits:
    """The twist that actions of 1 request."""
    return Limits(params.speed, params.turn, min(params.speed, platform.limits.lateral))
