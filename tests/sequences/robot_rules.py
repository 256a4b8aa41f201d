"""The judges of one robot: what an operator typed and what was acknowledged decides what may move.

A judge watches what the robot does and answers, and what happens to its base. The wanted values
come from `Facts`, which the world writes down itself; of the robot a judge reads only what everyone
sees: commands, answers, state, latches. The delays are those of docs/evidence/motion.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

from swarmd.core.messages import Code, Latch, Reason, Reply, State
from swarmd.core.values import ZERO, Twist
from swarmd.core.verbs import (
    DriveRequest,
    EstopRequest,
    ReloadRequest,
    Request,
    ResetRequest,
    ResumeRequest,
    RunRequest,
    StopRequest,
)
from tests.histories.invariants import BrokenRuleError

Stops = StopRequest | EstopRequest
Starts = RunRequest | ResumeRequest | ReloadRequest

SLACK = 0.05 + 1e-6  # s: one tick
NEVER = -math.inf
AT_REST = 0.02  # m/s, below which a base counts as measured at rest
CREEP = 0.02  # m/s at most towards an obstacle that is near
HOLD_TIME = 2.0  # s of a hold that end a run
HOLD_SLACK = 0.3  # s
LEASE = 0.5  # s without a word after which a hand is lost, by docs/drive.md
FIRST_LEASE = 3.0  # s until the first word

# When the command must be zero, in s after the condition began, and whether a run is over that
# stood for HOLD_TIME. Scans of 5 Hz stop counting after 3.5 periods.
DELAYS = {
    "no scans": (0.7, True),
    "hung host": (0.3, False),
    "no pose": (0.5, True),
    "hazard": (0.0, True),
}
LOST_BASE, OBSTACLE, IN_HAND = "lost base", "obstacle", "in hand"
OBSTACLE_DELAY = 0.2  # s: until the next scan
CLOCK_DELAY = 0.7  # s: scans of a clock that was set back are late; the last one before is used


class Licence(NamedTuple):
    """The newest start that the robot has accepted: a request, or a goal that it joined.

    `typed`: when its operator typed it. `at`: when the robot accepted it.
    """

    id: str
    typed: float
    at: float


@dataclass(slots=True)
class Facts:
    """What was typed, what was answered, and what is the case. Times in s."""

    now: float
    typed: dict[str, float] = field(default_factory=dict)  # by id of a request or a goal
    valid: dict[str, float] = field(default_factory=dict)  # by id of a goal that may be joined
    delivered: set[str] = field(default_factory=set)  # ids of requests that came before
    licence: Licence | None = None
    stop_acked: float = NEVER  # when the latest acknowledged stop was typed
    stop_told: float = NEVER  # when the latest stop was typed that the robot was told of
    reset_acked: float = NEVER  # when the latest acknowledged reset was carried out
    conditions: dict[str, float] = field(default_factory=dict)  # name to begin, of those present
    hand: Licence | None = None  # the hand that the robot is in
    word: float = NEVER  # when its driver was last heard
    is_held: bool = False  # a run waits beneath a hand that was lost
    clock_back: float = NEVER  # when the clock of the sensors was last set back
    base: Twist = ZERO  # what the base does

    @property
    def wants_motion(self) -> bool:
        """True if the robot has accepted a start that was typed after each stop."""
        return self.licence is not None and self.licence.typed > self.stop_told

    @property
    def hand_lasts(self) -> bool:
        """True while the driver of the hand is heard in time."""
        if self.hand is None:
            return False
        until = self.hand.at + FIRST_LEASE if self.word == NEVER else self.word + LEASE
        return self.now <= until + SLACK


class Seen(NamedTuple):
    """What the robot shows at a step: the command and its state, and whether it ran before."""

    twist: Twist
    state: State
    reason: Reason | None
    latches: Mapping[str, Latch]
    pattern: str | None
    was_running: bool

    @property
    def is_running(self) -> bool:
        """True in state running."""
        return self.state is State.RUNNING

    @property
    def moves(self) -> bool:
        """True if the base is commanded to move."""
        return not self.twist.is_zero


class Judge:
    """Judges one rule. `tested`: the rule has been put to the test, not only held idly."""

    rule: ClassVar[str]

    def __init__(self) -> None:
        self.tested = False

    def on_reply(self, request: Request, reply: Reply, seen: Seen, facts: Facts) -> None:
        """The robot has answered a request; `facts` are those before the answer."""

    def on_step(self, seen: Seen, facts: Facts) -> None:
        """The robot has taken an input, and commands `seen.twist`."""

    def on_join(self, goal: str, facts: Facts) -> None:
        """The robot has begun a run without a request, by a goal."""

    def on_end(self, name: str, began: float, facts: Facts) -> None:
        """A condition that began at `began` has ended."""

    def demand(self, holds: bool, text: str) -> None:
        """BrokenRuleError unless the rule holds."""
        if not holds:
            raise BrokenRuleError(self.rule, text)


class Stopped(Judge):
    """After an acknowledged stop only a later request moves the robot."""

    rule = "stopped"

    def on_reply(self, request: Request, reply: Reply, seen: Seen, facts: Facts) -> None:
        if not isinstance(request, Stops):
            return
        self.tested = True
        if reply.code is Code.REFUSED:
            is_older = facts.licence is not None and facts.licence.typed > facts.typed[request.id]
            is_copy = request.id in facts.delivered
            self.demand(is_copy and (is_older or isinstance(request, EstopRequest)), "it refuses")
        else:
            text = f"it acknowledges {request.verb} and "
            self.demand(not seen.moves, text + f"commands {seen.twist}")
            self.demand(not seen.is_running, text + "runs")

    def on_step(self, seen: Seen, facts: Facts) -> None:
        if seen.moves:
            starts = (facts.licence, facts.hand)
            typed = max((one.typed for one in starts if one is not None), default=NEVER)
            ago = facts.now - facts.stop_acked
            self.demand(typed > facts.stop_acked, f"it moves {ago:.2f} s after a stop")


class LaterRun(Judge):
    """No run goes on that was typed before a stop of which the robot was told."""

    rule = "later_run"

    def on_step(self, seen: Seen, facts: Facts) -> None:
        if facts.stop_told > NEVER and seen.is_running and facts.licence is not None:
            self.tested = True
            early = facts.stop_told - facts.licence.typed
            self.demand(early < 0.0, f"it runs by what was typed {early:.2f} s before a stop")


class Late(Judge):
    """A request, goal or report begins at most one run, when it is new."""

    rule = "late"

    def __init__(self) -> None:
        super().__init__()
        self._spent: set[str] = set()
        self._is_asked = False  # a start was accepted in this step

    def on_reply(self, request: Request, reply: Reply, seen: Seen, facts: Facts) -> None:
        if not isinstance(request, Starts):
            return
        is_copy = request.id in facts.delivered
        self.tested |= is_copy or facts.typed[request.id] < facts.stop_told
        if reply.code is Code.APPLIED:
            is_spent = request.id in self._spent
            is_begin = isinstance(request, RunRequest) or not seen.was_running
            is_run = seen.is_running and is_begin
            self.demand(not (is_copy and is_run), f"a copy of {request.verb} is carried out")
            self._is_asked |= not is_spent
            self._spent.add(request.id)

    def on_join(self, goal: str, facts: Facts) -> None:
        self.demand(goal not in self._spent, f"it begins a run by {goal or 'nothing'} again")
        self.demand(goal in facts.typed, "it begins a run that nobody asked for")
        self._spent.add(goal)
        self._is_asked = True

    def on_step(self, seen: Seen, facts: Facts) -> None:
        is_begin = seen.is_running and not seen.was_running
        self.demand(self._is_asked or not is_begin, "it begins a run that nobody asked for")
        self._is_asked = False


class Hand(Judge):
    """Back only by a timely word of the hand that the robot is in; ahead only without a hand.

    A pattern drives ahead, and a hand back.
    """

    rule = "hand"

    def on_reply(self, request: Request, reply: Reply, seen: Seen, facts: Facts) -> None:
        if not isinstance(request, DriveRequest):
            return
        self.tested = True
        if reply.code is Code.APPLIED:
            is_copy = request.id in facts.delivered
            is_end = request.is_release and facts.hand is None
            self.demand(is_copy or not is_end, "it releases a hand that is over")

    def on_step(self, seen: Seen, facts: Facts) -> None:
        if not self.tested:  # nobody has asked for a hand: recovery may drive back
            return
        speed = seen.twist.linear
        self.demand(speed >= 0.0 or facts.hand_lasts, "it drives by a hand that is over")
        is_waiting = facts.hand is not None or facts.is_held
        self.demand(speed <= 0.0 or not is_waiting, "its run goes on beneath a hand")


class Zero(Judge):
    """Zero outside running, unless a hand drives."""

    rule = "zero"

    def on_step(self, seen: Seen, facts: Facts) -> None:
        self.tested |= not seen.is_running
        may_move = seen.is_running or facts.hand is not None
        self.demand(may_move or not seen.moves, f"it is {seen.state} and moves")


class Answer(Judge):
    """What an answer says has happened."""

    rule = "answer"

    def on_reply(self, request: Request, reply: Reply, seen: Seen, facts: Facts) -> None:
        if reply.code is not Code.APPLIED:
            return
        self.tested = True
        text = f"it answers {request.verb} with `applied`, and "
        if isinstance(request, RunRequest):
            self.demand(seen.is_running and seen.pattern == request.pattern, text + "does not run")
        elif isinstance(request, ResumeRequest):
            self.demand(seen.is_running, text + "does not run")
        elif isinstance(request, ResetRequest):
            is_latched = seen.state in (State.ESTOPPED, State.FAULTED) or seen.latches
            self.demand(not is_latched, text + f"is {seen.state}")
        elif isinstance(request, Stops) and not reply.is_moving:
            self.demand(LOST_BASE not in facts.conditions, text + "at rest; its base is lost")
            speed = abs(facts.base.linear)
            self.demand(speed <= AT_REST, text + f"at rest; its base moves at {speed:.2f} m/s")


class LatchHeld(Judge):
    """A latch is held from its emergency stop to the reset that names it."""

    rule = "latch"

    def __init__(self) -> None:
        super().__init__()
        self._held: set[str] = set()
        self._reset: set[str] = set()

    def on_reply(self, request: Request, reply: Reply, seen: Seen, facts: Facts) -> None:
        if isinstance(request, EstopRequest):
            self.tested = True
            if reply.code is Code.REFUSED:
                self.demand(request.is_relayed and request.id in self._reset, "it refuses")
            else:
                is_back = request.is_relayed and request.id in self._reset
                self.demand(not is_back, "it holds again by others what was reset")
                self._held.add(request.id)
        elif isinstance(request, ResetRequest) and reply.code is Code.APPLIED:
            self._reset |= {*request.ids}
            self._held -= {*request.ids}
        elif isinstance(request, RunRequest | ResumeRequest) and reply.code is Code.APPLIED:
            self.demand(not self._held, f"it answers {request.verb} with `applied`")

    def on_step(self, seen: Seen, facts: Facts) -> None:
        names = f"it holds {sorted(seen.latches)}, and {sorted(self._held)} were not reset"
        self.demand(seen.latches.keys() == self._held, names)
        is_estopped = seen.state is State.ESTOPPED
        self.demand(is_estopped == bool(self._held), f"it is {seen.state}: {names}")


class _Held(Judge):
    """Counts how long a reason to stand has lasted, and which starts it has ended."""

    def __init__(self) -> None:
        super().__init__()
        self._over: set[str] = set()  # ids of starts whose runs are over

    def bar(self, facts: Facts) -> None:
        """The present run is over."""
        if facts.licence is not None:
            self._over.add(facts.licence.id)

    def bar_if_long(self, since: float, facts: Facts) -> None:
        """The present run is over if it has stood since `since` for longer than HOLD_TIME."""
        if facts.licence is not None:
            begin = max(since, facts.licence.at)
            if facts.now - begin > HOLD_TIME + HOLD_SLACK:
                self.bar(facts)

    def demand_over(self, seen: Seen, facts: Facts) -> None:
        """No run goes on that is over."""
        is_over = facts.licence is not None and facts.licence.id in self._over
        self.tested |= is_over
        self.demand(not (is_over and seen.is_running), "a run goes on that was over")


class LostBase(_Held):
    """A base or daemon that comes back moves nothing by itself."""

    rule = "lost_base"

    def on_step(self, seen: Seen, facts: Facts) -> None:
        is_lost = LOST_BASE in facts.conditions
        self.tested |= is_lost and facts.wants_motion
        self.demand(not (is_lost and seen.moves), "it commands motion to a lost base")
        self.demand_over(seen, facts)

    def on_end(self, name: str, began: float, facts: Facts) -> None:
        if name == LOST_BASE:
            self.bar_if_long(began, facts)
        elif name == "freeze":
            self.bar(facts)


class Hold(_Held):
    """Zero while there is a reason to stand, and no run after a long one."""

    rule = "hold"

    def on_step(self, seen: Seen, facts: Facts) -> None:
        for name, (delay, _) in DELAYS.items():
            if facts.now > facts.conditions.get(name, math.inf) + delay + SLACK:
                self.tested |= facts.wants_motion
                self.demand(not seen.moves, f"it moves: {name}")
        seen_at = facts.conditions.get(OBSTACLE, math.inf) + OBSTACLE_DELAY
        if facts.now > max(seen_at, facts.clock_back + CLOCK_DELAY) + SLACK:
            self.tested |= facts.wants_motion
            self.demand(seen.twist.linear <= CREEP, f"it drives at an obstacle: {seen.twist}")
        if IN_HAND in facts.conditions:
            self.tested |= facts.wants_motion
            self.demand(not seen.is_running, "it runs in the hand of a person")
        self.demand_over(seen, facts)

    def on_end(self, name: str, began: float, facts: Facts) -> None:
        delay, ends_run = DELAYS.get(name, (0.0, False))
        if name in (IN_HAND, "battery"):
            self.bar(facts)
        elif ends_run:
            self.bar_if_long(began + delay, facts)


class OldGoal(Judge):
    """No robot joins a goal that is too old."""

    rule = "old_goal"

    def __init__(self) -> None:
        super().__init__()
        self._refused: set[str] = set()

    def on_step(self, seen: Seen, facts: Facts) -> None:
        bound = max(facts.stop_told, facts.reset_acked)
        for goal, valid in facts.valid.items():
            self.tested |= facts.typed[goal] < bound or facts.now - facts.typed[goal] > valid

    def on_join(self, goal: str, facts: Facts) -> None:
        typed, valid = facts.typed.get(goal, math.inf), facts.valid.get(goal, math.inf)
        self.demand(facts.now - typed <= valid, f"it joins a goal of {facts.now - typed:.1f} s")
        bound = max(facts.stop_told, facts.reset_acked)
        self.demand(typed > bound, f"it joins a goal that is {bound - typed:.2f} s too old")


class CauseNamed(Judge):
    """A run ends for a named reason, and not by a stop that is older than it."""

    rule = "cause"

    def on_reply(self, request: Request, reply: Reply, seen: Seen, facts: Facts) -> None:
        if isinstance(request, Stops) and reply.code is Code.APPLIED and seen.was_running:
            late = (facts.licence.typed if facts.licence else NEVER) - facts.typed[request.id]
            is_stop = isinstance(request, StopRequest)
            self.demand(not (is_stop and late > 0.0), f"a stop ends a run {late:.2f} s younger")

    def on_step(self, seen: Seen, facts: Facts) -> None:
        if seen.was_running and not seen.is_running:
            self.tested = True
            self.demand(seen.reason is not None, "its run ends without a reason")


JUDGES: tuple[type[Judge], ...] = (
    *(Hand, Zero, Stopped, LaterRun, Late, Answer, LatchHeld, LostBase, Hold, OldGoal, CauseNamed),
)
