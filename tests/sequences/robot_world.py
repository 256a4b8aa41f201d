"""The real robot with its operators, its base and what may happen to it; and the actions.

`ACTIONS` has a row for each action. Some actions are switches: the first one begins a condition,
the next one ends it. After each action the time goes on for the `settle` of its row, in which every
command of the robot is judged (`robot_rules.py`). A condition that a robot notices late has a
settle time of its delay and more than the 2 s after which a hold ends a run.

Two operators give orders, on two computers whose clocks have nothing in common.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace

from swarmd.core.clock import TICK
from swarmd.core.events import (
    DriveInput,
    DriverInput,
    GoalInput,
    HazardsInput,
    HostInput,
    Input,
    OdometryInput,
    PoseInput,
    ReadingsInput,
    RequestInput,
)
from swarmd.core.goal import Goal
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.host_messages import HostDied, Loaded, Stepped
from swarmd.core.low_battery import LowBatterySettings
from swarmd.core.messages import Code
from swarmd.core.values import Odometry, Pose, Scan, SharedPose, Twist
from swarmd.core.verbs import DriveRequest, EstopRequest, Request, ResetRequest
from swarmd.robot.actions import Actions
from swarmd.robot.protection.fence.fence_settings import FenceSettings
from swarmd.robot.robot import Robot
from swarmd.testing.scans import empty_scan
from tests.sequences.robot_rules import (
    IN_HAND,
    JUDGES,
    LOST_BASE,
    NEVER,
    OBSTACLE,
    Facts,
    Judge,
    Licence,
    Seen,
    Starts,
    Stops,
)
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS

PATTERN = "forward"
FRAME = "room"
FENCE = FenceSettings(
    frame=FRAME, polygon=[(-500.0, -500.0), (500.0, -500.0), (500.0, 500.0), (-500.0, 500.0)]
)
BATTERY = LowBatterySettings(below=0.2)
FULL, EMPTY = 0.9, 0.1  # charges
FAR = 3.0  # m to what is around
OBSTACLE_RANGE, OBSTACLE_HALF = 0.25, 0.5  # m from the sensor, and rad to each side
MOMENT = 0.01  # s by which an order is older than another one
OLD = 4.0  # s: the age of an order that no stop or reset followed; a start of 5 s is refused
FROZEN = 2.0  # s, longer than the stall that ends a run
CLOCK_STEP = 30.0  # s by which the clock of the drivers is set
LEAST_BATTERY_TIME = 5.0  # s for which a charge must be low
END = 0.5  # s of a run with an end: in the time of the next action
VALID = 60.0  # s for which a goal may be joined
WORD = 2  # ticks from one command of a driver to the next one
BACK = Twist(-0.05)  # what a driver commands; a pattern drives ahead
SILENT = "silent driver"
LATE = 1.0  # s that a command of a driver was under way
NEW = "new"
ANNA, BOB = ("anna", "desk", 700.0), ("bob", "laptop", 90_000.0)
"""Operators: name, clock, and s by which this clock is ahead of that of the robot."""
ENDS_RUN = ("wheel_drop", "lifted")
"""By the table of docs/failures.md, Hazards: what ends a run at once."""
HAZARDS = ("bump", "cliff", "stall", "not_heard", *ENDS_RUN)


class _Watched(RobotHarness):
    """A harness that shows its world every input of the host and all actions."""

    def check_run(self) -> None:
        """Nothing: a planted fault is to be found by the rules."""

    def __init__(self, world: RobotWorld, *args: Any, **options: Any) -> None:
        self._world = world
        super().__init__(*args, **options)

    def step(self, input: Input, now: float | None = None) -> None:
        if isinstance(input, HostInput):
            self._world.on_host(input)
        super().step(input, now)

    def carry_out(self, actions: Actions, now: float | None = None) -> None:
        self._world.on_actions(actions, self.now if now is None else now)
        super().carry_out(actions, now)


class RobotWorld:
    """One robot, what was typed, and what is the case. `make`: makes the robot."""

    def __init__(self, make: Callable[..., Robot] = Robot) -> None:
        self.facts = Facts(1000.0)
        self.judges: tuple[Judge, ...] = ()
        self._sent: dict[str, Request] = {}  # by id, as they arrived last
        self._kinds: dict[str, list[str]] = {}  # by kind of request, the ids in order
        self._reports: dict[type, list[HostInput]] = {Loaded: [], Stepped: []}
        self._was_running = False
        self._charge = self._told_charge = FULL
        self._shift = 0.0  # s, of the clock of the drivers
        self._count = 0
        self._ticks = 0
        self._hand = ""  # id of the last request for a hand, whose driver goes on until the release
        self._words = 0
        self.harness = _Watched(
            self, patterns=PATTERNS, fence=FENCE, on_low_battery=BATTERY, make=make
        )
        self.harness.scans = self._scan
        self.harness.odometry = None
        self.advance(1.0)
        self.judges = tuple(judge() for judge in JUDGES)

    # What `World` of search.py wants

    def act(self, label: str) -> None:
        """Carry out the action `label`, as `name` or `name:kind`, and let it settle."""
        name, _, kind = label.partition(":")
        action = ACTIONS[name]
        action.carry_out(self, kind)
        self.advance(action.settle)
        for kept in (self.harness.commands, self.harness.sent, self.harness.replies):
            kept.clear()

    @property
    def tested(self) -> frozenset[str]:
        """The rules that were put to the test. No exception was raised by any input."""
        return frozenset(one.rule for one in self.judges if one.tested) | {"exception"}

    @property
    def outcome(self) -> str:
        """State and reason, and whether the robot moves."""
        robot = self.harness.robot
        motion = "stands" if self.harness.twist.is_zero else "moves"
        return f"{robot.state} {robot.reason or ''} {motion}"

    # The robot acts

    def on_host(self, input: HostInput) -> None:
        """The pattern host reports something."""
        kept = self._reports.get(type(input.event))
        if kept is not None:
            kept[1:] = [input]  # the first and the last one

    def on_actions(self, actions: Actions, now: float) -> None:
        """The robot has taken an input: judge its answers and its command."""
        if not self.judges:
            return
        facts, robot = self.facts, self.harness.robot
        facts.now = now
        seen = Seen(
            actions.twist,
            robot.state,
            robot.reason,
            robot.latches,
            self.harness.status.pattern if actions.replies else None,
            self._was_running,
        )
        for reply in actions.replies:
            request = self._sent[reply.id]
            for judge in self.judges:
                judge.on_reply(request, reply, seen, facts)
            self._note(request, reply.code, is_running=seen.is_running)
        if seen.is_running and not self._was_running and not actions.replies:
            self._join()
        for judge in self.judges:
            judge.on_step(seen, facts)
        self._was_running = seen.is_running

    def _note(self, request: Request, code: Code, *, is_running: bool) -> None:
        facts, typed = self.facts, self.facts.typed[request.id]
        if isinstance(request, Stops) and code is not Code.REFUSED:
            facts.stop_acked = max(facts.stop_acked, typed)
        elif isinstance(request, ResetRequest) and code is Code.APPLIED:
            facts.reset_acked = facts.now
        elif isinstance(request, Starts) and code is Code.APPLIED and is_running:
            facts.licence = Licence(request.id, typed, facts.now)
            facts.is_held = False
        self._note_hand(request, code, typed, is_running=is_running)

    def _note_hand(self, request: Request, code: Code, typed: float, *, is_running: bool) -> None:
        """What an answer changes of the hand that the robot is in."""
        facts = self.facts
        if isinstance(request, DriveRequest):
            is_copy = request.id in facts.delivered
            if code is Code.APPLIED and not is_copy:
                is_taken = not request.is_release
                facts.hand = Licence(request.id, typed, facts.now) if is_taken else None
                facts.word = NEVER
                facts.is_held = False
        elif isinstance(request, Stops) and code is not Code.REFUSED:
            if facts.hand is not None and typed > facts.hand.typed:
                facts.hand = None
            facts.is_held &= is_running

    def _join(self) -> None:
        """The robot runs without a request: by the goal that it says it has."""
        told = self.harness.status.goal
        goal = "" if told is None or told.own is None else told.own.goal.id
        for judge in self.judges:
            judge.on_join(goal, self.facts)
        self.facts.licence = Licence(goal, self.facts.typed[goal], self.facts.now)

    # Time

    def advance(self, seconds: float) -> None:
        """Let time pass: the base follows the last command, and its sensors tell."""
        harness, facts = self.harness, self.facts
        for _ in range(round(seconds / TICK)):
            if LOST_BASE not in facts.conditions:  # else it goes on as it does
                facts.base = harness.twist
            self._sense(harness.now + TICK)
            self._drive()
            harness.advance(TICK)

    def _drive(self) -> None:
        """The driver of the last hand commands, ten times a second, and knows of no loss."""
        facts = self.facts
        facts.now = self.harness.now
        if facts.hand is not None and not facts.hand_lasts:
            facts.hand = None
            facts.is_held = self.harness.robot.is_running
        if self._hand and SILENT not in facts.conditions and self._ticks % WORD == 0:
            self._words += 1
            if facts.hand is not None:
                facts.word = facts.now
            self.word(self._words)

    def word(self, order: int, age: float = 0.0) -> None:
        """A command of the driver arrives that was sent `age` s ago."""
        name, _, ahead = ANNA
        sent = self.harness.now + ahead - age
        self.harness.step(DriveInput(self._hand, name, order, sent, BACK))

    def _sense(self, now: float) -> None:
        harness, base = self.harness, self.facts.base
        pose = harness.pose
        harness.pose = Pose(pose.x + TICK * base.linear, pose.y, pose.yaw)
        harness.step(OdometryInput(Odometry(now + self._shift, harness.pose, base)))
        self._ticks += 1
        if self._ticks % 2 == 0 and "no pose" not in self.facts.conditions:
            shared = SharedPose(harness.now, harness.pose, 0.02, 0.01, FRAME)
            harness.step(PoseInput(shared))
        if self._ticks % 10 == 0:
            self._told_charge = self._charge
            harness.step(ReadingsInput({"battery": self._charge}))

    def _scan(self, seq: int, now: float) -> Scan | None:
        if "no scans" in self.facts.conditions:
            return None
        scan = empty_scan(self.harness.platform, seq, now + self._shift, FAR)
        if OBSTACLE not in self.facts.conditions:
            return scan
        is_ahead = np.abs(scan.bearings) < OBSTACLE_HALF
        near = OBSTACLE_RANGE + 1e-6 * (seq % 100)  # a scan that repeats itself is a frozen one
        return replace(scan, ranges=np.where(is_ahead, near, scan.ranges))

    # Orders

    def order(
        self,
        verb: str,
        by: tuple[str, str, float] = ANNA,
        *,
        typed: float | None = None,
        is_for_all: bool = False,
        **fields: Any,
    ) -> None:
        """An order, typed now or at `typed`; its operator has looked at the robot just now."""
        harness, now = self.harness, self.harness.now
        name, clock, ahead = by
        at = now if typed is None else typed
        id = fields.pop("id", None) or self.new_id(verb)
        request = harness.request(
            verb,
            id=id,
            operator=name,
            age=now - at,
            clock=clock,
            issued=at + ahead,
            issued_at={harness.robot.id: at},
            **fields,
        )
        if is_for_all:
            request = msgspec.structs.replace(request, targets=None)
        self.facts.typed[id] = at
        self._kinds.setdefault(request.verb, []).append(id)
        self._deliver(request)

    def take(self, typed: float | None = None) -> None:
        """An operator takes the robot by hand, and commands from then on."""
        id = self.new_id("drive")
        self.order("drive", id=id, typed=typed)
        self._hand = id
        self._words = 0

    def release(self) -> None:
        """The driver releases the robot, and commands no more."""
        hand, self._hand = self._hand, ""
        self.order("drive", is_release=True, hand=hand)

    def late_words(self) -> None:
        """Commands of the driver arrive late, again, and as those of the hand before."""
        if self._hand:
            self.word(self._words)
            self.word(self._words + 1, LATE)

    def new_id(self, verb: str) -> str:
        """The id of a new order."""
        self._count += 1
        return f"{verb}{self._count}"

    def _deliver(self, request: Request) -> None:
        self._sent[request.id] = request
        if isinstance(request, Stops):
            self.facts.stop_told = max(self.facts.stop_told, self.facts.typed[request.id])
        self.harness.step(RequestInput(request))
        self.facts.delivered.add(request.id)

    def run(self, pattern: str = PATTERN, **fields: Any) -> None:
        """A run with a goal, as `swarmctl run` sends it."""
        id = self.new_id("run")
        goal = self.goal(id, pattern=pattern, seconds=fields.get("seconds"))
        self.order("run", id=id, pattern=pattern, goal=goal, **fields)

    def goal(self, id: str, **fields: Any) -> Goal:
        """A goal that is greater than the one that the robot shows."""
        held = self.harness.robot.goal
        generation = 1 if held is None else held.goal.generation + 1
        return Goal(generation=generation, issuer=ANNA[0], id=id, **fields)

    def before_the_last_stop(self) -> float:
        """A time just before the last stop was typed; OLD s ago without one."""
        last = self.facts.stop_told
        return self.harness.now - OLD if last == NEVER else last - MOMENT

    def copies(self) -> None:
        """The first and the last request of each verb, and report of the host, arrive again.

        A copy of an emergency stop comes by another robot, which says so.
        """
        for verb in ("run", "resume", "reload", "drive", "reset", "stop", "estop"):
            ids = self._kinds.get(verb, [])
            for id in dict.fromkeys((*ids[:1], *ids[-1:])):
                request = self._sent[id]
                age = self.harness.now - self.facts.typed[id]
                is_relayed = {"is_relayed": True} if isinstance(request, EstopRequest) else {}
                self._deliver(msgspec.structs.replace(request, age=age, **is_relayed))
        for reports in self._reports.values():
            for input in tuple(reports):
                self.harness.step(input)

    def find_goal(self, kind: str) -> None:
        """A peer holds a goal that may be joined: a new one, or one that is too old."""
        now, id = self.harness.now, self.new_id("goal")
        goal = self.goal(id, pattern=PATTERN, on_join="run", valid=VALID)
        last = max(self.facts.stop_told, self.facts.reset_acked)
        old = now - VALID - OLD if last == NEVER else last - MOMENT
        typed = now if kind == NEW else old
        self.facts.typed[id], self.facts.valid[id] = typed, VALID
        self.harness.step(GoalInput(goal, now - typed, True))

    # What happens

    def switch(self, name: str) -> bool:
        """Begin the condition `name`, or end it; True if it begins."""
        conditions = self.facts.conditions
        if name not in conditions:
            conditions[name] = self.harness.now
            return True
        self._ended(name, conditions.pop(name))
        return False

    def _ended(self, name: str, began: float) -> None:
        self.facts.now = self.harness.now
        for judge in self.judges:
            judge.on_end(name, began, self.facts)

    def driver(self) -> None:
        """The base is lost, or is back."""
        is_lost = self.switch(LOST_BASE)
        self.harness.step(DriverInput(not is_lost, "lost" if is_lost else "there"))

    def hazard(self, kind: str) -> None:
        """The base reports a hazard, or none any more. A person lifts it, or puts it down."""
        name = IN_HAND if kind in ENDS_RUN else "hazard"
        hazards = (Hazard(HazardKind(kind)),) if self.switch(name) else ()
        self.harness.step(HazardsInput(hazards))

    def host_dies(self) -> None:
        """The pattern host ends by itself."""
        self.harness.host_says(HostDied(0, "killed"))

    def host_hangs(self) -> None:
        """The pattern host takes no command any more, or does so again."""
        self.harness.is_hung = self.switch("hung host")

    def freeze(self) -> None:
        """The daemon stands still for FROZEN s; the base goes on meanwhile."""
        began = self.harness.now
        self.harness.advance(FROZEN, ticks=False)
        self._ended("freeze", began)

    def set_clock(self) -> None:
        """The clock by which drivers stamp what they measure is set ahead, or back."""
        if self._shift:
            self.facts.clock_back = self.harness.now
        self._shift = 0.0 if self._shift else CLOCK_STEP

    def battery(self) -> None:
        """The battery becomes low, or full again.

        A low battery ends the run if a reading has told that the battery was full before.
        """
        is_low, was_told = self._charge == FULL, self._told_charge == FULL
        self._charge = EMPTY if is_low else FULL
        if is_low:
            self.advance(LEAST_BATTERY_TIME + 1.0)
            if was_told:
                self._ended("battery", self.harness.now)

    def push(self) -> None:
        """New code is pushed with a new run: a present run ends, and one of the new code begins."""
        self.order("reload", pattern=PATTERN, is_rerun=True)


@dataclass(frozen=True)
class Action:
    """A row of `ACTIONS`. `settle`: s that follow it. `kinds`: forms of the action.

    `is_switch`: the second time in a sequence ends what the first time has begun, so that it has
    the same kind.
    """

    name: str
    text: str
    carry_out: Callable[[RobotWorld, str], object]
    settle: float = 0.3
    kinds: tuple[str, ...] = ()
    is_switch: bool = False


_ROWS = (
    Action("run", "an operator types a run", lambda world, kind: world.run()),
    Action("run_for", "a run of 0.5 s", lambda world, kind: world.run(seconds=END)),
    Action(
        "old_run",
        "a run arrives that was typed before the last stop",
        lambda world, kind: world.run(typed=world.before_the_last_stop()),
    ),
    Action(
        "stop",
        "an operator stops this robot",
        lambda world, kind: world.order("stop"),
    ),
    Action(
        "estop",
        "the other operator stops all robots, with a latch",
        lambda world, kind: world.order("estop", BOB, is_for_all=True),
    ),
    Action(
        "reset",
        "an operator resets the latches that the robot shows",
        lambda world, kind: world.order("reset", BOB, ids=tuple(world.harness.robot.latches)),
    ),
    Action(
        "resume",
        "an operator resumes the goal of the robot",
        lambda world, kind: world.order("resume"),
    ),
    Action(
        "copy",
        "the first and last request of each verb, and report of the host, arrive again",
        lambda world, kind: world.copies(),
    ),
    Action("take", "an operator takes the robot by hand", lambda world, kind: world.take()),
    Action(
        "old_take",
        "a hand is asked for that was typed before the last stop",
        lambda world, kind: world.take(world.before_the_last_stop()),
    ),
    Action(
        "silent",
        "the driver is silent; commands again",
        lambda world, kind: world.switch(SILENT),
        0.9,
    ),
    Action("late_word", "commands of the driver come late", lambda world, kind: world.late_words()),
    Action("release", "the driver releases the robot", lambda world, kind: world.release()),
    Action("driver", "the base is lost; back", lambda world, kind: world.driver(), 2.6),
    Action("host_dies", "the pattern host ends", lambda world, kind: world.host_dies()),
    Action("hangs", "the host hangs; goes on", lambda world, kind: world.host_hangs(), 1.4),
    Action("no_scans", "scans stop; come again", lambda world, kind: world.switch("no scans"), 3.2),
    Action("obstacle", "an obstacle near ahead; gone", lambda world, kind: world.switch(OBSTACLE)),
    Action("clock_set", "stamps of sensors jump", lambda world, kind: world.set_clock()),
    Action("freeze", "the daemon is frozen for 2 s", lambda world, kind: world.freeze()),
    Action(
        "raises", "a run of a pattern that raises", lambda world, kind: world.run("raiser"), 0.8
    ),
    Action("unknown", "a run of an unknown pattern", lambda world, kind: world.run("nobody")),
    Action(
        "hazard",
        "the base reports a hazard; none any more",
        lambda world, kind: world.hazard(kind),
        2.6,
        HAZARDS,
        is_switch=True,
    ),
    Action(
        "no_pose",
        "poses in the fence's frame stop; come again",
        lambda world, kind: world.switch("no pose"),
        3.0,
    ),
    Action("battery", "the battery is low; full", lambda world, kind: world.battery()),
    Action("push", "code is pushed, with a new run", lambda world, kind: world.push()),
    Action(
        "peer_goal",
        "a peer holds a goal to join, which is new, or too old",
        lambda world, kind: world.find_goal(kind),
        kinds=(NEW, "old"),
    ),
)


ACTIONS: Mapping[str, Action] = {row.name: row for row in _ROWS}
