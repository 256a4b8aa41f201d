"""One robot in simulated time: the pure robot with an inline pattern, without I/O or sleep.

::

    harness = RobotHarness("waffle_pi")
    harness.advance(1.0)
    harness.applied("run", pattern="drive")
    harness.advance(2.0)
    assert harness.twist.linear > 0.0
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import version
from typing import Any

import numpy as np
from msgspec.structs import replace

from swarmd.core.clock import TICK
from swarmd.core.errors import UnknownPatternError, unknown
from swarmd.core.events import (
    TICK_INPUT,
    DriverInput,
    GoalInput,
    HostInput,
    Input,
    OdometryInput,
    ProvisionalInput,
    RequestInput,
    ScanInput,
    TickInput,
)
from swarmd.core.goal import Goal, GoalRecord
from swarmd.core.host_messages import HostCommand, HostEvent, KillHost
from swarmd.core.kernels import describe_kernels
from swarmd.core.low_battery import LowBatterySettings
from swarmd.core.messages import Code, Epoch, Reply, Status
from swarmd.core.values import ZERO, Odometry, Pose, Scan, Twist
from swarmd.core.verbs import (
    VERBS,
    Request,
)
from swarmd.kit.behavior import Pattern
from swarmd.kit.touch_config import TouchGrants
from swarmd.pattern_host.executor import PatternExecutor
from swarmd.pattern_host.runner import InlineRunner
from swarmd.robot.actions import Actions, FailedCode
from swarmd.robot.kin.kin_maker import KinMaker
from swarmd.robot.latches import LatchRecord
from swarmd.robot.protection.fence.fence_settings import FenceSettings
from swarmd.robot.robot import Robot
from swarmd.robot.setup import EarlierLives, RobotSetup
from swarmd.robot.steering.steering import Steering
from swarmd.settings.robot_settings import RobotSettings
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import empty_scan

ScanSource = Callable[[int, float], Scan | None]
_platform = cache(load_platform)  # each story has a robot of its own
_version = cache(version)  # which parses the metadata of the package


def acted(robot: Robot, input: Input, now: float) -> Actions:
    """The actions of an input that always has some."""
    actions = robot.step(input, now)
    assert actions is not None
    return actions


def moved(pose: Pose, twist: Twist, period: float) -> Pose:
    """The pose after `period` s with this twist."""
    ahead, aside = period * twist.linear, period * twist.lateral
    yaw = pose.yaw + 0.5 * period * twist.angular
    return Pose(
        pose.x + ahead * math.cos(yaw) - aside * math.sin(yaw),
        pose.y + ahead * math.sin(yaw) + aside * math.cos(yaw),
        math.remainder(pose.yaw + period * twist.angular, math.tau),
    )


class RobotHarness:
    """A robot whose sensors deliver at their nominal rates while `advance` runs.

    `scans(seq, now)` gives each scan (None: no scan). A test may replace it, `odometry` and
    `is_hung` (the pattern host does not answer) at any time. `twist` is the last safe command,
    `commands` holds all of them as (time, twist).
    `take`: steps the robot, such as the `step` of a recorder.
    """

    def __init__(
        self,
        platform: str = "waffle_pi",
        patterns: Mapping[str, type[Pattern[Any]]] | None = None,
        *,
        latches: LatchRecord | None = None,
        goals: GoalRecord | None = None,
        instance: str = "boot1",
        touch: TouchGrants | None = None,
        fence: FenceSettings | None = None,
        on_low_battery: LowBatterySettings | None = None,
        make: Callable[..., Robot] = Robot,
        take: Callable[[Robot, Input, float], Actions | None] = Robot.step,
        is_provisional: Callable[[int], bool] = lambda generation: False,
    ) -> None:
        self.platform = _platform(platform)
        self.now = 1000.0
        self.twist = ZERO
        self.commands: list[tuple[float, Twist]] = []
        self.replies: list[Reply] = []
        self.written: list[LatchRecord] = []
        self.record = goals or GoalRecord()
        self.sent: list[HostCommand] = []
        self.messages: list[tuple[str, object]] = []
        self.failed_code: list[FailedCode] = []
        self.ended: list[str] = []
        self.scans: ScanSource = lambda seq, now: empty_scan(self.platform, seq, now)
        self.odometry: Twist | None = ZERO
        self.pose = Pose()
        self.is_hung = False
        self._patterns = dict(patterns or {})
        self._runner = InlineRunner(lambda: PatternExecutor(self._find))
        self._take, self._is_provisional = take, is_provisional
        self._ticks = 0
        self._requests = 0
        self.robot = make(
            "tb3-01",
            self.platform,
            RobotSetup(
                driver="story",
                version=_version("swarmd"),
                kernels=describe_kernels(),
                settings=RobotSettings(
                    touch=touch or {}, fence=fence, on_low_battery=on_low_battery
                ),
            ),
            make_steering=Steering,
            make_kin=KinMaker(),
            seed=1,
            instance=instance,
            now=self.now,
            earlier=EarlierLives(latches, goals),
        )
        self.step(DriverInput(True, "there"))

    @property
    def status(self) -> Status:
        """The present status."""
        return self.robot.status(self.now)

    @property
    def epoch(self) -> Epoch:
        """The present epoch."""
        return self.status.epoch

    def advance(self, seconds: float, *, ticks: bool = True) -> None:
        """Let time pass: 20 ticks per second, scans at the sensor's rate, odometry at each tick.

        Without `ticks` the daemon is frozen meanwhile.
        """
        if not ticks:
            self.now += seconds
            return
        per_scan = max(round(1.0 / (self.platform.scan.rate * TICK)), 1)
        for _ in range(round(seconds / TICK)):
            begin, self.now = self.now, round(self.now + TICK, 9)  # as a clock that counts ns
            wake_at = self.robot.wake_at(begin)
            while wake_at is not None and wake_at < self.now:
                woken = math.ceil(1e9 * wake_at) / 1e9
                self.step(TICK_INPUT, woken)
                wake_at = self.robot.wake_at(woken)
            self._ticks += 1
            if self.odometry is not None:
                self.pose = moved(self.pose, self.odometry, TICK)
                measured = Odometry(self.now, self.pose, self.odometry)
                self.step(OdometryInput(measured))
            if self._ticks % per_scan == 0:
                self.scan(self.scans(self._ticks // per_scan, self.now))
            self.step(TICK_INPUT)

    def step(self, input: Input, now: float | None = None) -> None:
        """An input arrives, now or at `now`; the work of the shell that follows is done."""
        at = self.now if now is None else now
        if isinstance(input, TickInput | HostInput):
            current = tuple(filter(self._is_provisional, self.robot.generations))
            self._take(self.robot, ProvisionalInput(current), at)
        actions = self._take(self.robot, input, at)
        self.check_run()
        if actions is not None:
            self.carry_out(actions, at)

    def check_run(self) -> None:
        """The robot has a run exactly in state running: `RequestHandler.on_param` asks for both."""
        assert (self.robot._run.running is not None) is self.robot.is_running

    def scan(self, scan: Scan | None) -> None:
        """A scan arrives now."""
        if scan is not None:
            self.step(ScanInput(scan))

    def request(self, verb: str, epoch: Epoch | None = None, **args: Any) -> Request:
        """A request that targets this robot at the given epoch (None: the present one)."""
        self._requests += 1
        operator = args.pop("operator", "alice")
        request: Request = VERBS[verb].asked(
            id=args.pop("id", f"r{self._requests}"),
            operator=operator,
            targets={self.robot.id: epoch or self.epoch},
            **args,
        )
        return request

    def send(self, request: Request) -> Reply | None:
        """Send a request; returns its reply, None if it follows later."""
        before = len(self.replies)
        self.step(RequestInput(request))
        answers = [reply for reply in self.replies[before:] if reply.id == request.id]
        return answers[-1] if answers else None

    def answer(self, request: Request) -> Reply:
        """Send a request; returns its reply, which must come at once."""
        reply = self.send(request)
        assert reply is not None
        return reply

    def ask(self, verb: str, **args: Any) -> Reply | None:
        """Send a request with the present epoch; returns its reply, None if it follows later."""
        return self.send(self.request(verb, **args))

    def applied(self, verb: str, **args: Any) -> Reply:
        """The reply to a request with the present epoch, which must be applied at once."""
        return self._replied(Code.APPLIED, verb, **args)

    def refused(self, verb: str, **args: Any) -> Reply:
        """The reply to a request with the present epoch, which must be refused at once."""
        return self._replied(Code.REFUSED, verb, **args)

    def _replied(self, code: Code, verb: str, **args: Any) -> Reply:
        reply = self.ask(verb, **args)
        assert reply is not None
        assert reply.code is code, reply.text
        return reply

    def reply_to(self, request: Request) -> Reply:
        """The reply to an earlier request, which must have come."""
        return next(reply for reply in self.replies if reply.id == request.id)

    def is_answered(self, request: Request) -> bool:
        """True once the reply to an earlier request has come."""
        return any(reply.id == request.id for reply in self.replies)

    def find(self, goal: Goal, age: float | None = 0.0, *, may_join: bool = True) -> None:
        """A peer holds this goal, set `age` s ago; `may_join`: what others hold is known, too."""
        self.step(GoalInput(goal, age, may_join))

    def install(self, name: str, pattern: type[Pattern[Any]]) -> None:
        """Let pattern hosts find one more pattern."""
        self._patterns[name] = pattern

    def host_says(self, event: HostEvent) -> None:
        """An event of the pattern host arrives now."""
        self.step(HostInput(event))

    def host_answers(self, command: HostCommand) -> None:
        """The pattern host answers a command, also a late one."""
        event = self._runner.send(command)
        assert event is not None
        self.host_says(event)

    def carry_out(self, actions: Actions, now: float | None = None) -> None:
        """Do the work of the shell, in this process."""
        self.twist = actions.twist
        self.commands.append((self.now if now is None else now, actions.twist))
        self.replies.extend(actions.replies)
        self.messages.extend(actions.messages.items())
        if actions.failed_code is not None:
            self.failed_code.append(actions.failed_code)
        if actions.latches is not None:
            self.written.append(actions.latches)
        if actions.goals is not None:
            self.record = actions.goals
        if actions.ended:
            self.ended.append(actions.ended)
        events: list[HostEvent | None] = []
        for command in (actions.trial, actions.host):
            if command is not None:
                self.sent.append(command)
                if not self.is_hung or isinstance(command, KillHost):
                    events.append(self._runner.send(command))
        for event in events:
            if event is not None:
                self.step(HostInput(event), now)

    def nan_scan(self, share: float, *, sector: tuple[float, float] | None = None) -> ScanSource:
        """A source whose scans lack a share of single rays, or the sector (rad, from and to)."""
        rng = np.random.default_rng(0)

        def source(seq: int, now: float) -> Scan:
            scan = empty_scan(self.platform, seq, now, 2.0)
            unknown = rng.random(len(scan.ranges)) < share
            if sector is not None:
                unknown = (scan.bearings >= sector[0]) & (scan.bearings < sector[1])
            return replace(scan, ranges=np.where(unknown, np.nan, scan.ranges))

        return source

    def _find(self, name: str) -> type[Pattern[Any]]:
        if name not in self._patterns:
            raise UnknownPatternError(unknown("pattern", name, self._patterns))
        return self._patterns[name]
