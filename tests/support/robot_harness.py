"""A robot's life told in simulated time: the pure robot with an inline pattern, no I/O, no sleep.

::

    story = Story("waffle_pi")
    story.advance(1.0)
    story.ask("run", pattern="drive")
    story.advance(2.0)
    assert story.twist.linear > 0.0
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from swarmd.core.errors import UnknownPatternError, unknown
from swarmd.core.host_messages import HostCommand, HostEvent, KillHost
from swarmd.core.messages import REQUEST_TYPES, Epoch, ForgetRequest, Reply, Request, Status
from swarmd.core.values import ZERO, Odometry, Pose, Scan, TouchZone, Twist
from swarmd.kit.behavior import Pattern
from swarmd.pattern_host.executor import PatternExecutor
from swarmd.pattern_host.runner import InlineRunner
from swarmd.robot.actions import Actions
from swarmd.robot.latches import LatchRecord
from swarmd.robot.robot import TICK, Robot
from swarmd.robot.status import RobotSettings
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import empty_scan

ScanSource = Callable[[int, float], Scan | None]


class RobotHarness:
    """A robot with its senses fed at their nominal rates for as long as `advance` is told.

    `scans(seq, now)` gives each sweep (None: none comes); set it, `odometry`, `is_hung` (the
    pattern's host answers nothing) or `is_driver_silent` at any time. `twist` is the last safe
    command, `commands` all of them as (time, twist).
    """

    def __init__(
        self,
        platform: str = "waffle_pi",
        patterns: Mapping[str, type[Pattern[Any]]] | None = None,
        *,
        latches: LatchRecord | None = None,
        instance: str = "boot1",
        touch: Mapping[str, TouchZone] | None = None,
    ) -> None:
        self.platform = load_platform(platform)
        self.now = 1000.0
        self.twist = ZERO
        self.commands: list[tuple[float, Twist]] = []
        self.replies: list[Reply] = []
        self.written: list[LatchRecord] = []
        self.sent: list[HostCommand] = []
        self.messages: list[tuple[str, object]] = []
        self.scans: ScanSource = lambda seq, now: empty_scan(self.platform, seq, now)
        self.odometry: Twist | None = ZERO
        self.is_hung = False
        self._patterns = dict(patterns or {})
        self._runner = InlineRunner(lambda: PatternExecutor(self._find))
        self._ticks = 0
        self._requests = 0
        self.robot = Robot(
            "tb3-01",
            self.platform,
            RobotSettings(driver="story", layers=lambda name: (), touch=touch or {}),
            seed=1,
            instance=instance,
            now=self.now,
            latches=latches,
        )
        self.carry_out(self.robot.on_driver(True, "there", self.now))

    @property
    def status(self) -> Status:
        """What the robot says of itself now."""
        return self.robot.status(self.now)

    @property
    def epoch(self) -> Epoch:
        """What an operator sees now."""
        return self.status.epoch

    def advance(self, seconds: float, *, ticks: bool = True) -> None:
        """Let time pass: 20 ticks a second, sweeps at the sensor's rate, odometry with each tick.

        Without `ticks` nothing happens meanwhile: the guardian is frozen.
        """
        if not ticks:
            self.now += seconds
            return
        per_scan = max(round(1.0 / (self.platform.scan.rate * TICK)), 1)
        for _ in range(round(seconds / TICK)):
            begin, self.now = self.now, self.now + TICK
            wake_at = self.robot.wake_at(begin)
            while wake_at is not None and wake_at < self.now:
                self.carry_out(self.robot.tick(wake_at), wake_at)
                wake_at = self.robot.wake_at(wake_at)
            self._ticks += 1
            if self.odometry is not None:
                measured = Odometry(self.now, Pose(), self.odometry)
                self.robot.on_odometry(measured, self.now)
            if self._ticks % per_scan == 0:
                self.scan(self.scans(self._ticks // per_scan, self.now))
            self.carry_out(self.robot.tick(self.now))

    def scan(self, scan: Scan | None) -> None:
        """A sweep arrives now."""
        if scan is not None:
            self.carry_out(self.robot.on_scan(scan, self.now))

    def request(self, verb: str, epoch: Epoch | None = None, **args: Any) -> Request:
        """A request that names this robot at the given epoch (None: the present one)."""
        self._requests += 1
        operator = args.pop("operator", "alice")
        request = REQUEST_TYPES[verb](
            id=args.pop("id", f"r{self._requests}"),
            operator=operator,
            targets={self.robot.id: epoch or self.epoch},
            **args,
        )
        assert not isinstance(request, ForgetRequest)
        return request

    def send(self, request: Request) -> Reply | None:
        """The robot gets the request; its answer, unless it follows later."""
        before = len(self.replies)
        self.carry_out(self.robot.on_request(request, self.now))
        answers = [reply for reply in self.replies[before:] if reply.id == request.id]
        return answers[-1] if answers else None

    def ask(self, verb: str, **args: Any) -> Reply | None:
        """An operator who has just looked asks for `verb`."""
        return self.send(self.request(verb, **args))

    def host_says(self, event: HostEvent) -> None:
        """An answer of the pattern host arrives now."""
        self.carry_out(self.robot.on_host(event, self.now))

    def carry_out(self, actions: Actions, now: float | None = None) -> None:
        """What the shell does, without anything outside."""
        self.twist = actions.twist
        self.commands.append((self.now if now is None else now, actions.twist))
        self.replies.extend(actions.replies)
        self.messages.extend(actions.messages.items())
        if actions.latches is not None:
            self.written.append(actions.latches)
        for command in (actions.trial, actions.host):
            if command is not None:
                self.sent.append(command)
                if not self.is_hung or isinstance(command, KillHost):
                    self._runner.send(command)
        for event in list(self._runner.events()):
            self.carry_out(self.robot.on_host(event, self.now if now is None else now), now)

    def nan_scan(self, share: float, *, sector: tuple[float, float] | None = None) -> ScanSource:
        """A source whose sweeps lack a share of single rays, or the sector (rad, from and to)."""
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
