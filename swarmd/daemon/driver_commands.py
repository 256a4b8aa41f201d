"""Carries out the commands that the driver receives from the robot's own system, such as ROS.

A command becomes the request of an operator for this one robot: with an id, an audit entry, and the
epoch (count of the robot's changes) that the robot had when the command was issued.

1. The robot refuses a run or reset if its epoch has changed since the command was issued.
2. A run or reset of unknown age, or older than MAX_COMMAND_AGE, is refused.
3. A stop or emergency stop of any age is carried out, and repeated until the base rests.
4. Only operators command: in a secured swarm the name must be an operator of the roster, or have a
   permit, by which the request server judges the request.
"""

from __future__ import annotations

import asyncio
import secrets
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Protocol

from msgspec.structs import replace

from swarmd.core import verbs
from swarmd.core.clock import boottime
from swarmd.core.messages import Code, Epoch, Latch, Reply, State
from swarmd.core.refusal import Refusal
from swarmd.daemon.requests import RequestServer
from swarmd.driver_api.command_source import Answer, DriverCommand
from swarmd.link.keys.identity import Identity
from swarmd.link.keys.key_permit import Denial, judge
from swarmd.link.keys.roster import Role

MAX_COMMAND_AGE = 2.5
"""Seconds after which a run or reset is refused."""
REPEAT_PERIOD = 0.1
"""Seconds between two copies of a stop whose base still moves. After 2 s the stop fails."""


class CommandedRobot(Protocol):
    """The parts of a robot that its commands need."""

    @property
    def id(self) -> str:
        """The name of the robot."""

    @property
    def state(self) -> State:
        """The present state."""

    @property
    def epoch(self) -> Epoch:
        """The present epoch."""

    @property
    def latches(self) -> Mapping[str, Latch]:
        """The emergency stops that hold the robot, by id."""


class DriverCommands:
    """Makes requests of the commands of a driver, and hands them to the request server.

    `identity` returns the present identity; None: a swarm without keys, in which anyone commands.
    """

    def __init__(
        self,
        robot: CommandedRobot,
        requests: RequestServer,
        identity: Callable[[], Identity | None],
        *,
        clock: Callable[[], float] = boottime,
    ) -> None:
        """Keep the present epoch; call `note_epoch` at each tick. `clock`: in s."""
        self._robot = robot
        self._requests = requests
        self._identity = identity
        self._clock = clock
        # Since when (s) the robot has had each epoch, oldest first.
        self._epochs: deque[tuple[float, Epoch]] = deque()
        self.note_epoch(clock())

    def note_epoch(self, now: float) -> None:
        """Keep a changed epoch. Epochs that ended before the greatest age are forgotten."""
        epochs = self._epochs
        if not epochs or epochs[-1][1] != self._robot.epoch:
            epochs.append((now, self._robot.epoch))
        while len(epochs) > 1 and epochs[1][0] <= now - MAX_COMMAND_AGE:
            epochs.popleft()

    def take(self, command: DriverCommand, answer: Answer) -> None:
        """Carry out or refuse a command; `answer` gets the reply, also later."""
        now = self._clock()
        self.note_epoch(now)
        if command.verb in ("stop", "estop"):
            answer = partial(self._answer_stop, answer)
        request = self._request_of(command, now)
        refusal = self._refusal_of(command)
        if refusal is not None:
            self._requests.refuse(request, command.source, answer, *refusal)
        elif isinstance(request, verbs.StopRequest | verbs.EstopRequest):
            self._stop(request, command.source, answer)
        else:
            self._requests.take(request, command.source, answer)

    def _stop(
        self, request: verbs.StopRequest | verbs.EstopRequest, source: str, answer: Answer
    ) -> None:
        """Carry a stop out again and again, until the base rests or the robot reports a failure.

        A copy of an emergency stop that was reset meanwhile is refused, as a relayed copy.
        """
        is_estop = isinstance(request, verbs.EstopRequest)
        copy = replace(request, is_relayed=True) if is_estop else request

        def on_reply(reply: Reply) -> None:
            if reply.code is Code.APPLIED and reply.is_moving:
                asyncio.get_running_loop().call_later(
                    REPEAT_PERIOD, partial(self._stop, copy, source, answer)
                )
            else:
                answer(reply)

        self._requests.take(request, source, on_reply)

    def _answer_stop(self, answer: Answer, reply: Reply) -> None:
        """Answer with the state that results, before the text of the reply or of the refusal."""
        answer(
            replace(
                reply,
                text=": ".join(filter(None, (self._robot.state, reply.refusal, reply.text))),
            )
        )

    def _request_of(self, command: DriverCommand, now: float) -> verbs.Request:
        """The request of a command, with the epoch of the robot when the command was issued."""
        latch_ids = tuple(
            latch_id
            for latch_id, latch in self._robot.latches.items()
            if command.resets_others or latch.issuer == command.operator
        )
        # Without an age, `_refusal_of` refuses a run or reset; a stop needs no age.
        epoch = self._epoch_at(now - (command.age or 0.0))
        return _request_of(command, {self._robot.id: epoch}, latch_ids)

    def _epoch_at(self, at: float) -> Epoch:
        """The epoch at the time `at`, or the oldest epoch that is known."""
        epoch = self._epochs[0][1]
        for since, later in self._epochs:
            if since <= at:
                epoch = later
        return epoch

    def _refusal_of(self, command: DriverCommand) -> tuple[Refusal, str] | None:
        """Why the command is refused for its operator or its age; None if it is accepted."""
        if why := permission_fault(command.operator, self._identity()):
            return Refusal.NOT_PERMITTED, why
        if command.verb in ("stop", "estop"):
            return None
        if command.age is None:
            return Refusal.TOO_LATE, command.doubt
        if command.age > MAX_COMMAND_AGE:
            text = f"issued up to {command.age:.1f} s ago; at most {MAX_COMMAND_AGE:g} s count"
            return Refusal.TOO_LATE, text
        return None


def command_fault(
    command: DriverCommand, robot: str, identity: Identity | None, *, wall: float
) -> str:
    """Why `robot` would refuse a command for its operator or a permit; empty if it would not.

    `wall`: s since 1970, by which a permit may have ended.
    """
    fault = permission_fault(command.operator, identity)
    if fault or identity is None or identity.roster.role_of(command.operator) is Role.OPERATOR:
        return fault
    permit = identity.roster.permits[command.operator]
    judged = judge(permit, _request_of(command, {robot: None}), robot, wall=wall)
    return judged.text if isinstance(judged, Denial) else ""


def permission_fault(operator: str, identity: Identity | None) -> str:
    """Why this operator may not command the robot; empty if it may. `identity`: of the robot."""
    if identity is None or identity.roster.role_of(operator) in (Role.OPERATOR, Role.PERMIT):
        return ""
    return (
        f"{operator} is no operator of roster {identity.roster.generation}; name an operator in"
        " driver_options"
    )


def _request_of(
    command: DriverCommand, targets: dict[str, Epoch | None], latch_ids: tuple[str, ...] = ()
) -> verbs.Request:
    """The request of a command to one robot. `latch_ids`: the emergency stops of a reset."""
    id = secrets.token_hex(8)
    operator = command.operator
    match command.verb:
        case "stop":
            return verbs.StopRequest(id=id, operator=operator, targets=targets)
        case "estop":
            reason = command.reason or command.source
            return verbs.EstopRequest(
                id=id, operator=operator, targets=targets, scope="robots", reason=reason
            )
        case "reset":
            return verbs.ResetRequest(id=id, operator=operator, targets=targets, ids=latch_ids)
        case "run":
            run = command.run
            assert run is not None
            return verbs.RunRequest(
                id=id,
                operator=operator,
                targets=targets,
                pattern=run.pattern,
                params=dict(run.params),
                seconds=run.seconds,
                until=run.until,
                age=command.age or 0.0,
            )
