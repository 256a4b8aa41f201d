"""One robot in lockstep: a thin shell that carries out what the pure robot asks for.

It is to `swarmd.robot.robot.Robot` what the daemon is, with an inline pattern and without a
socket, a thread or a clock.
"""

from __future__ import annotations

from typing import Protocol

from swarmd.core.host_messages import HostCommand
from swarmd.core.messages import Reply, Request, Status
from swarmd.core.values import Neighbor, Odometry, Scan, Twist, Value
from swarmd.kit.factory import Find
from swarmd.pattern_host.executor import PatternExecutor
from swarmd.pattern_host.runner import InlineRunner
from swarmd.robot.actions import Actions
from swarmd.robot.latches import LatchRecord
from swarmd.robot.robot import Robot


class RobotOutputs(Protocol):
    """What surrounds a shell: base, radio and alarm of robot `row`."""

    def command(self, row: int, twist: Twist) -> None:
        """Hand the base its command."""

    def send_message(self, row: int, name: str, value: Value, now: float) -> None:
        """Publish a pattern's message on `<pattern>/<channel>`."""

    def publish_status(self, row: int, status: Status) -> None:
        """Publish the robot's status."""

    def set_alarm(self, row: int, at: float | None) -> None:
        """Tick the robot at `at`, even between two ticks."""


class RobotShell:
    """`decided` counts the scans judged while running, `evaded` those with protection active."""

    def __init__(
        self, row: int, robot: Robot, find: Find, outputs: RobotOutputs, now: float
    ) -> None:
        self.row = row
        self.robot = robot
        self.latches: LatchRecord | None = None
        self.replies: list[Reply] = []
        self.decided = 0
        self.evaded = 0
        self._twist: Twist | None = None
        self._outputs = outputs
        self._runner = InlineRunner(lambda: PatternExecutor(find))
        self.settle(robot.on_driver(True, "simulated", now), now)

    def scan(self, scan: Scan, now: float) -> None:
        """A sweep arrives."""
        actions = self.robot.on_scan(scan, now)
        if self.robot.is_running:
            self.decided += 1
            self.evaded += actions.decision.is_active
        self.settle(actions, now)

    def tick(self, now: float) -> None:
        """A beat, or an alarm between two."""
        self.settle(self.robot.tick(now), now)

    def odometry(self, odometry: Odometry, now: float) -> None:
        """A measured pose and twist arrive."""
        self.robot.on_odometry(odometry, now)

    def neighbors(self, neighbors: tuple[Neighbor, ...], now: float) -> None:
        """The radio knows who is within hearing."""
        self.robot.on_neighbors(neighbors, now)

    def hear(self, sender: str, name: str, value: Value, now: float) -> None:
        """A message arrives."""
        self.robot.on_message(sender, name, value, now)

    def ask(self, request: Request, now: float) -> Reply | None:
        """An operator asks; the answer, which an inline pattern gives at once."""
        self.replies.clear()
        self.settle(self.robot.on_request(request, now), now)
        return next((reply for reply in self.replies if reply.id == request.id), None)

    def leave(self, now: float) -> None:
        """The daemon ends in order."""
        self.settle(self.robot.on_leave(now), now)

    def settle(self, actions: Actions, now: float) -> None:
        """Carry the actions out, and set the alarm."""
        self._carry_out(actions, now)
        self._outputs.set_alarm(self.row, self.robot.wake_at(now))

    def _carry_out(self, actions: Actions, now: float) -> None:
        outputs = self._outputs
        if actions.twist is not self._twist:  # most ticks change nothing
            self._twist = actions.twist
            outputs.command(self.row, actions.twist)
        if actions.latches is not None:
            self.latches = actions.latches
        for command in (actions.trial, actions.host):
            if command is not None:
                self._drive(command, now)
        for name, value in actions.messages.items():
            outputs.send_message(self.row, name, value, now)
        if actions.status is not None:
            outputs.publish_status(self.row, actions.status)
        self.replies.extend(actions.replies)

    def _drive(self, command: HostCommand, now: float) -> None:
        self._runner.send(command)
        for event in list(self._runner.events()):
            self._carry_out(self.robot.on_host(event, now), now)
