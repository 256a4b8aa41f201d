"""The hand of one page: a stick that drives a robot, told by the page's connection.

1. A page takes one robot, by the word `take`. It then tells `move` ten times a second, also while
   its stick rests, and `release` for the button.
2. A word counts only if it is newer than the last one, and if the picture that it quotes is not
   older than MAX_AGE: a connection that stood still delivers old words at once.
3. Each motion lasts for STICK_TIME from its arrival.
4. Without a word that counts for SILENCE, or if the page is closed or hidden, the hand is lost: the
   robot holds its run. It is never released by itself.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine, Mapping
from contextlib import suppress
from typing import Any, Protocol

from swarmd.core.errors import SwarmError
from swarmd.operator.client.hand_over import in_thread
from swarmd.operator.session.outcome import Outcome

STICK_TIME = 0.5  # s of motion after a word
MAX_AGE = 1.0  # s of the picture that a word quotes; two frames may be on their way
SILENCE = 1.0  # s without a word that counts, after which the hand is lost
_WATCH_PERIOD = 0.1  # s

Tell = Callable[[Mapping[str, Any]], None]


class HeldRobot(Protocol):
    """A robot that is driven by hand, as `operator/verbs/drive/ask.py` has it."""

    @property
    def over(self) -> str:
        """Why the robot is no longer driven by this hand; empty while it is."""

    def move(
        self, forward: float, turn: float = 0.0, left: float = 0.0, *, seconds: float = STICK_TIME
    ) -> None:
        """Drive for some seconds, then stand."""

    def release(self) -> Outcome:
        """Let the run beneath go on."""

    def close(self) -> None:
        """Tell nothing any more: the hand is lost."""


Take = Callable[[str], HeldRobot]
"""Takes a robot by hand, in a thread. SwarmError if the robot refuses."""


class PageHand:
    """The hand of one page; all methods on the loop. `tell` sends the page what became of it."""

    def __init__(self, take: Take, tell: Tell, clock: Callable[[], float]) -> None:
        self._take = take
        self._tell = tell
        self._clock = clock
        self._hand: HeldRobot | None = None
        self._robot = ""
        self._order = -1
        self._heard_at = -math.inf
        self._is_closed = False
        self._watching: asyncio.Task[None] | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    def on_word(self, word: Mapping[str, Any], age: float | None) -> None:
        """Carry out a word of the page; `age`: s since its picture was sent, None: not known."""
        match word.get("do"):
            case "take":
                self._begin(str(word.get("robot"))[:64], age)
            case "move":
                self._move(word, age)
            case "release":
                self._release()
            case "lost":
                self._lose("it was let go")

    def close(self) -> None:
        """The page is closed: the hand is lost."""
        self._is_closed = True
        self._lose("")

    async def closed(self) -> None:
        """Wait until nothing of this hand is under way."""
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _begin(self, robot: str, age: float | None) -> None:
        if self._robot:
            self._say(robot, f"this page drives {self._robot}")
        elif age is None or age > MAX_AGE:
            self._say(robot, "not carried out: it came too late")
        else:
            self._robot = robot
            self._order = -1
            self._start(self._take_robot(robot))

    async def _take_robot(self, robot: str) -> None:
        try:
            hand = await in_thread(lambda: self._take(robot))
        except SwarmError as error:
            self._end(str(error))
            return
        if self._is_closed or self._robot != robot:  # let go meanwhile
            await in_thread(hand.close)
            return
        self._hand = hand
        self._heard_at = self._clock()
        self._tell({"kind": "hand", "robot": robot, "is_held": True, "text": ""})
        self._watching = self._start(self._watch(hand))

    async def _watch(self, hand: HeldRobot) -> None:
        """Lose the hand once the robot is no longer driven, or the page is not heard."""
        while not hand.over and self._clock() - self._heard_at <= SILENCE:
            await asyncio.sleep(_WATCH_PERIOD)
        self._watching = None
        self._lose(hand.over or "the page was not heard: the robot holds its run")

    def _move(self, word: Mapping[str, Any], age: float | None) -> None:
        hand = self._hand
        order = word.get("order")
        if hand is None or not isinstance(order, int) or order <= self._order:
            return
        if age is None or age > MAX_AGE:
            return
        self._order = order
        try:
            forward = float(word.get("forward", 0.0))
            turn = float(word.get("turn", 0.0))
            left = float(word.get("left", 0.0))
            hand.move(forward, turn, left, seconds=STICK_TIME)
        except (TypeError, ValueError):
            return
        except SwarmError as error:
            self._lose(str(error))
            return
        self._heard_at = self._clock()

    def _release(self) -> None:
        hand = self._let_go()
        if hand is not None:
            self._start(self._release_robot(hand))

    async def _release_robot(self, hand: HeldRobot) -> None:
        try:
            outcome = await in_thread(hand.release)
        except SwarmError as error:
            self._end(str(error))
            return
        refused = [reply.text for reply in outcome.replies.values() if outcome.exit_code != 0]
        self._end("released" if outcome.exit_code == 0 else f"not released: {'; '.join(refused)}")

    def _lose(self, text: str) -> None:
        hand = self._let_go()
        if hand is not None:
            self._start(self._close(hand))
        if self._robot:
            self._end(text)

    def _let_go(self) -> HeldRobot | None:
        """The robot that this page has held until now; None without one."""
        hand = self._hand
        self._hand = None
        if self._watching is not None:
            self._watching.cancel()
            self._watching = None
        return hand

    async def _close(self, hand: HeldRobot) -> None:
        with suppress(SwarmError):
            hand.move(0.0, seconds=STICK_TIME)  # else the last motion lasts until its end
        with suppress(SwarmError):
            await in_thread(hand.close)

    def _end(self, text: str) -> None:
        robot = self._robot
        self._robot = ""
        self._say(robot, text)

    def _say(self, robot: str, text: str) -> None:
        if not self._is_closed:
            self._tell({"kind": "hand", "robot": robot, "is_held": False, "text": text})

    def _start(self, work: Coroutine[None, None, None]) -> asyncio.Task[None]:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task
