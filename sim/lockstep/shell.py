"""The shell of one robot in lockstep, which carries out the actions of the pure `Robot`.

It takes the place of the daemon: patterns run inline, without sockets, threads or clocks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import astuple

from swarmd.core.events import (
    DriverInput,
    HostInput,
    Input,
    KinInput,
    RequestInput,
    ScanInput,
    SensorInput,
    tag_of,
)
from swarmd.core.host_messages import HostCommand, PatternFailed
from swarmd.core.messages import Reply
from swarmd.core.values import OPTION_INPUTS
from swarmd.core.verbs import Request
from swarmd.kit.factory import Find
from swarmd.pattern_host.executor import PatternExecutor
from swarmd.pattern_host.runner import InlineRunner
from swarmd.robot.actions import Actions
from swarmd.robot.latches import LatchRecord
from swarmd.robot.robot import Robot
from swarmd.sim.lockstep.beacons import Beacons

if TYPE_CHECKING:
    from swarmd.sim.lockstep.lockstep import Lockstep


class RobotShell:
    """Runs one `Robot` with its pattern; hands its outputs to the swarm.

    `decided`: the number of scans on which protection decided while the pattern ran. `evaded`: the
    number of these scans on which protection was active. The recorder resets both. `beacons`: used
    in a scenario with a fault of the radio.
    """

    def __init__(self, row: int, robot: Robot, find: Find, outputs: Lockstep, now: float) -> None:
        self.row = row
        self.robot = robot
        self.latches: LatchRecord | None = None
        self.replies: list[Reply] = []
        self.decided = 0
        self.evaded = 0
        self.beacons = Beacons(robot.id, robot.identity.instance)
        self._outputs = outputs
        self._valued: set[str] = set()  # the kinds of OPTION_INPUTS whose last input had a value
        self._runner = InlineRunner(lambda: PatternExecutor(find))
        self.step(DriverInput(True, "simulated"), now)

    @property
    def needs(self) -> frozenset[str]:
        """The inputs that the pattern needs; empty without a pattern."""
        return self._runner.needs

    def sense(self, input: SensorInput, now: float) -> None:
        """Hand a measurement to the robot, except repeated inputs without a value.

        OPTION_INPUTS are the kinds of input, such as seen tags, that depend on a driver's options.
        If inputs of such a kind have no value several times in a row, the robot gets only the
        first of these inputs.
        """
        if not isinstance(input, ScanInput):
            if self._is_new(input):
                self.step(input, now)
            return
        actions = self.robot.step(input, now)
        assert actions is not None
        if self.robot.is_running:
            self.decided += 1
            self.evaded += actions.decision.is_active
        self.carry_out(actions, now)

    def _is_new(self, input: SensorInput) -> bool:
        kind = tag_of(input)
        if kind not in OPTION_INPUTS:
            return True
        had_value = kind in self._valued
        has_value = astuple(input) != (None,)
        (self._valued.add if has_value else self._valued.discard)(kind)
        return had_value or has_value

    def request(self, request: Request, now: float) -> Reply | None:
        """Carry out an operator's request; the reply, or None without a reply.

        A reply comes at once, since the pattern runs inline.
        """
        self.replies.clear()
        self.step(RequestInput(request), now)
        return next((reply for reply in self.replies if reply.id == request.id), None)

    def step(self, input: Input, now: float) -> None:
        """Hand an input to the robot, and carry out its actions."""
        actions = self.robot.step(input, now)
        if actions is not None:
            self.carry_out(actions, now)

    def carry_out(self, actions: Actions, now: float) -> None:
        """Carry out the actions and set the alarm."""
        self._carry_out(actions, now)
        self._outputs.alarms.set(self.row, self.robot.wake_at(now))

    def _carry_out(self, actions: Actions, now: float) -> None:
        outputs = self._outputs
        row = self.row
        twist = actions.twist
        commands = outputs.commands  # three values are set faster than a row
        commands[row, 0] = twist.linear
        commands[row, 1] = twist.angular
        commands[row, 2] = twist.lateral
        outputs.has_new_commands = True
        if actions.latches is not None:
            self.latches = actions.latches
        if actions.trial is not None:
            self._drive(actions.trial, now)
        if actions.host is not None:
            self._drive(actions.host, now)
        if actions.grip is not None:
            outputs.grip(row, actions.grip)
        if actions.messages:
            for name, value in actions.messages.items():
                outputs.send_message(self.row, name, value, now)
        if actions.kin_message is not None:
            outputs.send(row, "kin", KinInput(self.robot.id, actions.kin_message), now)
        if actions.has_status:
            outputs.publish_latches(self.row, self.robot.aged_latches(now))
        if actions.replies:
            self.replies.extend(actions.replies)

    def _drive(self, command: HostCommand, now: float) -> None:
        event = self._runner.send(command)
        if isinstance(event, PatternFailed):
            self._outputs.note_failure(self.row, event.text, now)
        if event is not None:
            actions = self.robot.step(HostInput(event), now)
            assert actions is not None
            self._carry_out(actions, now)
