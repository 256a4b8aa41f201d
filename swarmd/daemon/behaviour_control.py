"""What pushed behaviours ask of the robot and its pattern host."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

from swarmd.core.errors import PluginError
from swarmd.core.events import CodeInput, HostInput, Input, NoteInput
from swarmd.core.host_messages import TrialDone
from swarmd.core.messages import Epoch, Reply
from swarmd.core.verbs import ReloadRequest, Request
from swarmd.pattern_host.runner import ProcessRunner
from swarmd.plugins import Origin
from swarmd.robot.robot import Robot

log = logging.getLogger(__name__)


class BehaviourControl:
    """The `RobotControl` of a daemon.

    `on_request` takes a request to the robot, `step` another input, `reply` the answer to a push,
    and `warn` a line for the events and a warning for the log.
    """

    def __init__(
        self,
        robot: Robot,
        runner: ProcessRunner,
        *,
        on_request: Callable[[Request], None],
        step: Callable[[Input], None],
        reply: Callable[[Reply], None],
        warn: Callable[[str], None],
    ) -> None:
        self._robot = robot
        self._runner = runner
        self._on_request, self._step = on_request, step
        self._reply, self._warn = reply, warn

    def try_code(self, request: ReloadRequest) -> None:
        """Hand a reload of pushed code to the robot."""
        self._on_request(request)

    def end_trial(self, event: TrialDone) -> None:
        """Hand the end of a trial of pushed code to the robot."""
        self._step(HostInput(event))

    def code_changed(self) -> None:
        """Let the next run have a fresh pattern host."""
        self._step(CodeInput())

    def reply(self, reply: Reply) -> None:
        """Answer a push."""
        self._reply(reply)

    def event(self, text: str) -> None:
        """A line for the events and the log."""
        log.info("%s", text)
        self._step(NoteInput(text))

    def fault(self, text: str) -> None:
        """A line for the events and a warning for the log."""
        self._warn(text)

    def epoch(self) -> Epoch:
        """The robot's present epoch."""
        return self._robot.epoch

    def labels(self) -> tuple[str, ...]:
        """The robot's present labels."""
        return self._robot.labels

    def own_patterns(self) -> Mapping[str, Origin]:
        """The patterns that the robot has beside pushed ones."""
        try:
            return self._runner.own_patterns()
        except PluginError:  # the folder is gone; a run is refused with the reason
            return {}
