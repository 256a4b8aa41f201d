"""Protection and steering, compiled or interpreted, as robots load them, and both together."""

from __future__ import annotations

from typing import Any

from swarmd.core.messages import Reason
from swarmd.core.values import Odometry, Platform, Scan, Twist
from swarmd.robot.protection import protection as protection_module
from swarmd.robot.protection.decision import NO_PERMIT, Decision, DecisionContext, Permit
from swarmd.robot.protection.protection import Protection
from swarmd.robot.steering import steering as steering_module
from swarmd.robot.steering.steering import Steering

__all__ = ["Commander", "Protection", "Steering"]


class Commander:
    """Protection and steering of a robot, fed as by the robot.

    `kernels`: the modules of protection and steering; None: as robots load them.
    """

    def __init__(self, platform: Platform, kernels: tuple[Any, Any] | None = None) -> None:
        protection = protection_module if kernels is None else kernels[0]
        steering = steering_module if kernels is None else kernels[1]
        self.protection: Protection = protection.Protection(platform)
        view = protection.ProtectionView(self.protection)
        self.steering: Steering = steering.Steering(platform, view)

    def observe(self, scan: Scan, context: DecisionContext) -> None:
        """A conditioned scan."""
        self.protection.observe(scan, context)
        self.steering.observe(scan, context)

    def on_odometry(self, odometry: Odometry) -> None:
        """A reading."""
        self.protection.on_odometry(odometry)
        self.steering.on_odometry(odometry)

    def decide(
        self,
        requested: Twist | None,
        context: DecisionContext,
        is_running: bool,
        hold: Reason | None,
        permit: Permit = NO_PERMIT,
    ) -> Decision:
        """The decision of protection on what steering asks."""
        steered = self.steering.steer(requested, context, is_running, hold, permit)
        return self.protection.decide(requested, context, is_running, hold, permit, steered)
