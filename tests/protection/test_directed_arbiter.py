"""What the front does not hand on, whatever an arbiter says."""

from __future__ import annotations

import math

import pytest

from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Odometry, Pose, Scan, TouchZone, Twist
from swarmd.protection.arbiter import Protection
from swarmd.protection.decision import DecisionContext, ModeDecision
from swarmd.protection.footprint import ScanGeometry
from swarmd.settings.platforms import load_platform

BURGER = load_platform("burger")


class Says:
    """An arbiter that says what it is told to."""

    mode = "says"

    def __init__(self, twist: Twist) -> None:
        self._twist = twist

    def clearance(self, speed: float) -> None:
        """It never blocks."""

    def observe(self, scan: Scan, geometry: ScanGeometry, context: DecisionContext) -> None:
        """It looks at nothing."""

    def decide(
        self, requested: Twist, context: DecisionContext, *, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """Always the same."""
        return ModeDecision(self._twist, is_active=True)


def handed_on(twist: Twist) -> tuple[Twist, Reason | None]:
    """The command, and why it is zero if it is."""
    protection = Protection(BURGER)
    protection._arbiter = Says(twist)
    context = DecisionContext(1.0, 0.1, Odometry(1.0, Pose(), ZERO), 0.0)
    decision = protection.decide(Twist(0.1), context, is_running=True, hold=None)
    return decision.safe, decision.reason


@pytest.mark.parametrize("twist", [Twist(math.nan), Twist(0.1, math.inf), Twist(0.1, -math.inf)])
def test_what_is_no_number_is_zero(twist: Twist) -> None:
    assert handed_on(twist) == (ZERO, Reason.PROTECTION)


def test_what_is_beyond_the_limits_is_held_within_them() -> None:
    assert handed_on(Twist(-9.0, 9.0, 9.0)) == (Twist(-0.22, 2.84, 0.0), None)
