"""A hand on a robot, from the operator's side: takes it, tells it commands, releases it.

`take` sends a request and gives a `Hand`, for a terminal, a program or a page::

    hand = take(operator, view, "tb3-03")      # RequestError if the robot refuses
    hand.move(0.1, 0.5)                        # m/s ahead, rad/s to the left, for 0.7 s
    hand.release()                             # the run beneath it goes on
    hand.close()                               # without a release: the robot holds its run

A page calls `move` ten times a second with `seconds=STICK_TIME` while its stick is held, `release`
for a button, and `close` when the browser is gone. `Hand.status` tells what the robot says.
"""

from __future__ import annotations

import asyncio
import math
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, Self

from swarmd.core.clock import boottime
from swarmd.core.closing import Closing, is_program_on
from swarmd.core.codec import Decoder
from swarmd.core.errors import CodecError, ConfigError, RequestError, SwarmError
from swarmd.core.messages import Epoch, Status
from swarmd.core.values import ZERO, Twist
from swarmd.core.verbs import DriveRequest
from swarmd.link.datagram import Drive
from swarmd.operator.session.exit_codes import FAILED, REFUSED

if TYPE_CHECKING:
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.session.outcome import Outcome

PERIOD = 0.1
"""Seconds between two commands."""
KEY_TIME = 0.7
"""Seconds of motion after a key: a terminal has no key-up, and repeats after up to 0.66 s."""
STICK_TIME = 0.5
"""Seconds of motion after a word of a stick, which sends ten a second."""
MAX_TIME = 60.0
"""Seconds of one motion at most."""
_COPY_GAP = 0.03  # s between a new command and its copies
_COPIES = 2  # of a new command, so that it is there sooner if one gets lost
MAX_SPEED = 100.0  # m/s and rad/s, of a datagram

_status = Decoder(Status)


class Word(NamedTuple):
    """One command that is due: its number, and the twist."""

    order: int
    twist: Twist


class Commands:
    """What a hand tells the robot, and when. Pure: times in s come in.

    A motion lasts for its seconds, then the command is zero. A command is sent each PERIOD, and a
    new one at once, with two copies.
    """

    def __init__(self, now: float) -> None:
        self._order = 0
        self._twist = ZERO
        self._ends_at = now
        self._due_at = now
        self._copies = 0

    def move(self, twist: Twist, seconds: float, now: float) -> None:
        """Ask for `twist` for some seconds from now on."""
        if twist != self._present(now):
            self._begin(now)
        self._twist = twist
        self._ends_at = now + seconds

    def take(self, now: float) -> Word | None:
        """The command that is due; None before its time."""
        if self._twist != ZERO and now >= self._ends_at:
            self._twist = ZERO
            self._begin(now)
        if now < self._due_at:
            return None
        self._order += 1
        self._due_at = now + (_COPY_GAP if self._copies else PERIOD)
        self._copies = max(self._copies - 1, 0)
        return Word(self._order, self._twist)

    def pause(self, now: float) -> float:
        """Seconds until the next command is due."""
        due = self._due_at if self._twist == ZERO else min(self._due_at, self._ends_at)
        return max(due - now, 0.0)

    def _present(self, now: float) -> Twist:
        return self._twist if now < self._ends_at else ZERO

    def _begin(self, now: float) -> None:
        self._due_at = now
        self._copies = _COPIES


class Hand(Closing):
    """A robot in the hand of this operator; a thread tells it commands, ten times a second.

    The end of a `with` block releases the robot: a run beneath goes on. If the block raises, the
    robot is not released: it stands, and holds a run until `resume` or a new run. So it does if
    this program ends, or is not heard for 0.5 s.
    """

    def __init__(
        self,
        operator: Operator,
        robot: str,
        id: str,
        *,
        is_wanted: Callable[[], bool],
    ) -> None:
        self.robot = robot
        self.id = id
        self.status: Status | None = None
        """The last status of the robot; None before the first."""
        self._operator = operator
        self._is_wanted = is_wanted
        self.on_close: Callable[[], object] = lambda: None
        """Called once, when the hand is closed."""
        self._commands = Commands(boottime())
        self._changed = threading.Condition()
        self._is_closed = False
        self._over = ""
        self._epoch: Epoch | None = None  # of the robot when it was taken
        self._thread = threading.Thread(target=self._tell, name="swarmd-hand", daemon=True)

    def start(self, epoch: Epoch | None) -> Self:
        """Begin to tell commands; `epoch`: that of the robot when it was taken."""
        self._epoch = epoch
        self._operator.watch("status", self._on_status, self.robot)
        self._thread.start()
        return self

    @property
    def is_over(self) -> bool:
        """True once the robot is no longer driven by this hand."""
        return bool(self.over)

    @property
    def over(self) -> str:
        """Why the robot is no longer driven by this hand, in words; empty while it is."""
        with self._changed:
            return self._over

    def move(
        self, forward: float, turn: float = 0.0, left: float = 0.0, *, seconds: float = KEY_TIME
    ) -> None:
        """Drive for `seconds`, then stand; a later call replaces this one. Does not wait.

        `forward`, `left` in m/s and `turn` in rad/s (a positive value turns left). Protection
        decides how much of it the robot does. RequestError once this hand is over; ConfigError for
        a value that is no speed or time.
        """
        for name, value in (("forward", forward), ("turn", turn), ("left", left)):
            if not abs(value) <= MAX_SPEED:
                raise ConfigError(f"{name} is {value!r}; expected a speed in m/s or rad/s")
        if not 0.0 < seconds <= MAX_TIME:
            raise ConfigError(f"seconds is {seconds!r}; expected more than 0, at most {MAX_TIME:g}")
        with self._changed:
            if self._over:
                raise RequestError(f"{self.robot} is no longer driven: {self._over}", FAILED)
            twist = Twist(float(forward), float(turn), float(left))
            self._commands.move(twist, seconds, boottime())
            self._changed.notify()

    def stand(self) -> None:
        """Stand at once, and keep the robot."""
        self.move(0.0)

    def release(self, *, timeout: float | None = None) -> Outcome:
        """Release the robot by word: a run beneath goes on, else it stands. Then close.

        The outcome tells whether it did: a robot whose hand was lost, or that was stopped, refuses.
        """
        self._stand_quietly()
        try:
            return self._operator.request(
                DriveRequest,
                {self.robot: None},
                timeout=timeout,
                issued=boottime(),
                is_release=True,
                hand=self.id,
            )
        finally:
            self.close()

    def close(self) -> None:
        """Tell nothing any more: the hand is lost within 0.5 s unless it was released."""
        with self._changed:
            is_first = not self._is_closed
            self._is_closed = True
            self._over = self._over or "it was let go here"
            self._changed.notify()
        if not is_first:
            return
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(1.0)
        self._operator.unwatch("status", self.robot)
        self.on_close()

    def __exit__(self, *error: object) -> None:
        has_raised = error[0] is not None
        if not has_raised and not self.is_over:
            outcome = self.release()
            if not outcome.applied:
                text = _answer(outcome, self.robot)
                raise RequestError(f"{self.robot} was not released: {text}", outcome.exit_code)
        else:
            self._stand_quietly()
            self.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *error: object) -> None:
        await asyncio.to_thread(self.__exit__, *error)

    def _stand_quietly(self) -> None:
        with self._changed:
            self._commands.move(ZERO, PERIOD, boottime())
            self._changed.notify()

    def _tell(self) -> None:
        """Tell commands until the hand is closed, is over, or the program ends."""
        while is_program_on() and self._is_wanted():
            with self._changed:
                word = self._commands.take(boottime())
                is_ended = self._is_closed or (self._over and word is None)
            if word is not None:
                with suppress(SwarmError, OSError):  # without a network the lease ends the hand
                    self._operator.send_to_robots(partial(self._drive, word), (self.robot,))
            if is_ended:
                return
            with self._changed:
                if not self._is_closed:
                    self._changed.wait(self._commands.pause(boottime()))

    def _drive(self, word: Word) -> Drive:
        twist = word.twist
        return Drive(
            robot=self.robot,
            hand=self.id,
            operator=self._operator.name[:128],
            order=word.order,
            sent=math.floor(1000.0 * boottime()),  # ms
            linear=twist.linear,
            angular=twist.angular,
            lateral=twist.lateral,
        )

    def _on_status(self, robot: str, payload: bytes) -> None:
        """Take a status; Zenoh's thread calls it."""
        try:
            status = _status(payload)
        except CodecError:
            return
        if status.robot != self.robot:
            return
        # After a restart of the daemon another instance counts its changes anew.
        taken = self._epoch
        is_same = taken is not None and status.epoch.instance == taken.instance
        if taken is not None and is_same and status.epoch.revision < taken.revision:
            return
        self.status = status
        if status.driven_by == self._operator.name[:128]:
            return
        with self._changed:
            if not self._over:
                self._over = f"{status.reason or 'changed'} {status.detail}".strip()
                if status.driven_by:
                    self._over = f"driven by {status.driven_by}"
            self._changed.notify()


def take(
    operator: Operator,
    view: MembersView,
    robot: str,
    *,
    timeout: float | None = None,
    issued: float | None = None,
    is_wanted: Callable[[], bool] = lambda: True,
) -> Hand:
    """Take a robot by hand: it stands, and a run beneath it waits. RequestError if it refuses.

    `view`: the last look of `operator`, which the hand uses until it is closed. `issued`: when the
    user asked for it, in s on the clock since boot. Nothing is told once `is_wanted` returns False,
    as when the connection is closed.
    """
    epochs = view.epochs((robot,))
    outcome = operator.request(DriveRequest, epochs, timeout=timeout, issued=issued)
    reply = outcome.replies.get(robot)
    if reply is None or not outcome.applied:
        raise RequestError(f"{robot}: {_answer(outcome, robot)}", outcome.exit_code or REFUSED)
    hand = Hand(operator, robot, reply.id, is_wanted=is_wanted)
    return hand.start(reply.epoch)


def _answer(outcome: Outcome, robot: str) -> str:
    """What a robot answered to a request, in words."""
    reply = outcome.replies.get(robot)
    if reply is not None:
        return reply.text
    return "no answer; a robot of swarmd 0.2.0 or older cannot be driven by hand"
