"""A hand on the robot of a harness: who drives, and the commands that reach the robot."""

from __future__ import annotations

from typing import Any

from swarmd.core.events import DriveInput
from swarmd.core.messages import Reply
from swarmd.core.values import Twist
from tests.support.robot_harness import RobotHarness

WORD = 0.1  # s between two commands
FORWARD = Twist(0.15, 0.0)
BACK = Twist(-0.05, 0.2)


class HandOn:
    """The hand of `driver`; `ahead`: s by which the driver's clock is ahead of the robot's."""

    def __init__(self, harness: RobotHarness, driver: str = "anna", ahead: float = 50.0) -> None:
        self.harness = harness
        self.driver = driver
        self.ahead = ahead
        self.id = "none"
        self.order = 0

    def take(self, **fields: Any) -> Reply | None:
        """Ask for the robot."""
        request = self.harness.request("drive", operator=self.driver, **fields)
        self.id = request.id
        return self.harness.send(request)

    def release(self) -> Reply | None:
        """Release the robot by word."""
        request = self.harness.request("drive", operator=self.driver, is_release=True, hand=self.id)
        return self.harness.send(request)

    def word(self, twist: Twist = FORWARD, *, age: float = 0.0, order: int | None = None) -> None:
        """A command arrives that was sent `age` s ago."""
        self.order += 1
        sent = self.harness.now + self.ahead - age
        number = self.order if order is None else order
        self.harness.step(DriveInput(self.id, self.driver, number, sent, twist))

    def drive(self, seconds: float, twist: Twist = FORWARD) -> None:
        """Commands arrive ten times a second; the time goes on."""
        for _ in range(round(seconds / WORD)):
            self.word(twist)
            self.harness.advance(WORD)
