"""Protection: the only path from a requested command to the command that the driver gets.

`Protection` enforces limits and holds, whatever the mode; an `Arbiter` implements one mode. The
holds of old scans and odometry are found in `robot/sensors.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Protocol, TypeGuard

import numpy as np

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.kernels import load_kernel
from swarmd.core.messages import NarrowestPassage, Reason
from swarmd.core.values import ZERO, Array, Odometry, Platform, Scan, TouchZone, Twist
from swarmd.protection.avoidance import Avoidance
from swarmd.protection.decision import (
    NO_PERMIT,
    Avoided,
    Decision,
    DecisionContext,
    ModeDecision,
    Permit,
)
from swarmd.protection.footprint import Footprint, ScanGeometry
from swarmd.protection.modes import Off, PotentialField, StopZone
from swarmd.protection.recovery import NO_OTHERS, Clearance, Others, Recovery
from swarmd.protection.tracks import Tracker

if TYPE_CHECKING:
    from swarmd.protection.assumption_monitor import AssumptionMonitor
    from swarmd.protection.barrier import Barrier
    from swarmd.protection.following import FollowingMonitor
else:
    AssumptionMonitor = load_kernel("swarmd.protection.assumption_monitor").AssumptionMonitor
    FollowingMonitor = load_kernel("swarmd.protection.following").FollowingMonitor

_CORRIDOR_SPEED_SHARE = 0.95  # of the linear limit: the speed that a recovery corridor must allow
_STOPPED = ModeDecision(ZERO, is_active=False)
_ZERO_TOLERANCE = 1e-9  # m/s or rad/s: what rounding leaves of a zero command
_NO_POINTS = np.empty((0, 2))


class Arbiter(Protocol):
    """One protection mode. `Protection` calls it only when no hold forbids motion."""

    mode: str

    def clearance(self, speed: float) -> Clearance | None:
        """The room that driving at `speed` m/s takes; None if the mode never blocks a robot."""

    def observe(self, scan: Scan, geometry: ScanGeometry, context: DecisionContext) -> None:
        """Take in a new scan; the mode computes its geometry here, once per scan."""

    def decide(
        self, requested: Twist, context: DecisionContext, *, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """The safe command for a requested one within the limits; the context has a scan age.

        Asked again for the same command in the same context, a mode decides the same.

        `command` is the present safe command, `touch` the zone in which contact is granted.
        """


def make_barrier(platform: Platform) -> Barrier:
    """The arbiter of mode `barrier`, compiled or interpreted."""
    barrier: Barrier = load_kernel("swarmd.protection.barrier").Barrier(platform)
    return barrier


MODES: Mapping[str, Callable[[Platform], Arbiter]] = MappingProxyType(
    {"barrier": make_barrier, "potential_field": PotentialField, "stop_zone": StopZone, "off": Off}
)
"""The arbiter of each mode."""


def narrowest_passage(arbiter: Arbiter) -> NarrowestPassage | None:
    """What mode `barrier` lets the robot through; None for the other modes."""
    return arbiter.narrowest_passage() if _is_barrier(arbiter) else None


def _is_barrier(arbiter: Arbiter) -> TypeGuard[Barrier]:
    return arbiter.mode == "barrier"


def make_arbiter(platform: Platform) -> Arbiter:
    """The arbiter of the mode in the platform file; ConfigError if there is no such mode."""
    mode = str(platform.protection.get("mode", "barrier"))
    if mode not in MODES:
        raise ConfigError(f"platform {platform.name}: {unknown('protection mode', mode, MODES)}")
    return MODES[mode](platform)


class Protection:
    """Decides on the safe command of one robot; never off. Its state comes from its calls alone.

    `seed` decides the side on which recovery passes an obstacle. `events`: what the caller has yet
    to log. `following`: whether the base of a running robot follows the safe commands.
    """

    def __init__(self, platform: Platform, seed: str = "") -> None:
        self._limits = platform.limits
        self._arbiter = make_arbiter(platform)
        self._footprint = Footprint(platform.footprint)
        self._geometry = ScanGeometry(platform.scan)
        # Of the modes only barrier assumes anything.
        self._monitor = AssumptionMonitor(platform) if _is_barrier(self._arbiter) else None
        self.following = FollowingMonitor(platform)
        self._latency = platform.scan.latency
        self._is_running = False
        self.events: list[str] = []
        self._scan_seq = -1
        self._min_gap: float | None = None
        self._scan: Scan | None = None
        self._near = _NO_POINTS  # returns of the ring, m in the base frame
        self._safe = ZERO
        self._allowed = ZERO  # the safe command before `speed_share`
        self._requested: Twist | None = None
        self._wanted = ZERO  # `_requested` within the limits
        # The last decision without a hold is given again for the same case in the same context,
        # which a scan or odometry ends: no mode decides anything else then.
        self._context: DecisionContext | None = None
        self._case: tuple[object, ...] = ()
        self._last: Decision
        clearance = self._arbiter.clearance(_CORRIDOR_SPEED_SHARE * platform.limits.linear)
        self._recovery: Recovery | None = None
        is_avoiding = platform.protection.get("avoidance", "none") == "orca"
        if clearance is not None:
            self._recovery = Recovery(clearance, platform.limits, seed)
        self._avoidance: Avoidance | None = None
        if clearance is not None and is_avoiding:
            self._avoidance = Avoidance(clearance, platform.limits)
            self._tracker = Tracker(platform)

    @property
    def passage(self) -> NarrowestPassage | None:
        """The widths that the mode lets the robot through; None for a mode without one."""
        return narrowest_passage(self._arbiter)

    def observe(self, scan: Scan, context: DecisionContext) -> None:
        """Take in a conditioned scan."""
        self._scan_seq, self._scan, self._context = scan.seq, scan, None
        arbiter, geometry = self._arbiter, self._geometry
        arbiter.observe(scan, geometry, context)
        if _is_barrier(arbiter):  # which has looked at all returns
            self._min_gap = arbiter.min_gap
        else:
            self._min_gap = self._footprint.min_gap(scan, geometry)
        if self._avoidance is not None:
            self._tracker.observe(scan, context)
        if self._monitor is not None and self._is_running:
            ages = scan.ages  # numpy's max takes four times as long
            oldest = 0.0 if ages is None or not len(ages) else float(ages[ages.argmax()])
            delay = self._latency + context.scan_delay + oldest
            if text := self._monitor.on_scan(scan.stamp, self._min_gap, delay):
                self.events.append(text)

    def on_odometry(self, odometry: Odometry) -> None:
        """Compare what mode barrier assumes of the base with its measured motion."""
        if self._monitor is not None and (text := self._monitor.on_odometry(odometry)):
            self.events.append(text)
        if self._is_running:
            self.following.on_odometry(odometry)
        if self._avoidance is not None:
            self._tracker.on_odometry(odometry)

    @property
    def findings(self) -> tuple[str, ...]:
        """The assumptions that were found violated, each with its evidence."""
        return () if self._monitor is None else self._monitor.findings

    def forget_findings(self, findings: Collection[str]) -> None:
        """End these findings: they do not slow the robot until the monitor raises them again."""
        if self._monitor is not None:
            self._monitor.forget(findings)

    def decide(
        self,
        requested: Twist | None,
        context: DecisionContext,
        *,
        is_running: bool,
        hold: Reason | None,
        permit: Permit = NO_PERMIT,
    ) -> Decision:
        """The safe command for a requested one (None: zero), with its reasons.

        Exactly zero outside `running`, under any hold and before the first scan. The limits apply
        to the requested command, so that an arbiter can rely on them, and to the result.
        """
        recovery, self._is_running = self._recovery, is_running
        if requested is not self._requested:  # most are judged more than once
            self._requested, self._wanted = requested, ZERO
            if requested is not None and requested.is_finite:
                self._wanted = self._limits.clip(requested)
        wanted = judged = self._wanted
        self._near = context.near_points if context.near else _NO_POINTS
        if is_running and hold is None and context.scan_age is None:
            hold = Reason.NO_SCAN
        if not is_running or hold is Reason.DRIVER_LOST or permit.touch is not None:
            self.following.reset()  # what a robot may touch may stop it
        if not is_running or hold is not None:
            if recovery is not None:
                recovery.reset()
            if self._avoidance is not None:
                self._avoidance.reset()
            return self._decision(wanted, _STOPPED, hold, context)
        if recovery is not None and permit.may_recover:
            passing, others = self._passing(wanted, context)

            def allows(twist: Twist) -> Twist:
                one, touch = self._limits.clip(twist), permit.touch
                return self._arbiter.decide(one, context, command=self._safe, touch=touch).twist

            judged = recovery.replacement(
                passing, self._allowed, context, self._points, others, allows
            )
        is_recovering = recovery is not None and recovery.is_active
        case = wanted, judged, judged is wanted, is_recovering, permit.touch
        if context is self._context and case == self._case:
            return self._last
        decision = self._arbiter.decide(
            judged if judged is wanted else self._limits.clip(judged),
            context,
            command=self._safe,
            touch=permit.touch,
        )
        if decision.twist is not wanted and not decision.twist.is_finite:
            decision = ModeDecision(ZERO, is_active=True, rows=decision.rows)
        elif judged is not wanted:
            decision = ModeDecision(decision.twist, is_active=True, rows=decision.rows)
        reason, twist, least = None, decision.twist, _ZERO_TOLERANCE
        if (
            abs(twist.linear) <= least
            and abs(twist.angular) <= least
            and abs(twist.lateral) <= least
        ):
            reason = Reason.PROTECTION if decision.is_active else Reason.NO_REQUESTED_COMMAND
        last = self._last = self._decision(wanted, decision, reason, context)
        self._context, self._case = context, case
        return last

    def _passing(self, wanted: Twist, context: DecisionContext) -> tuple[Twist, Others]:
        """The command that leads past others; `wanted` if nothing is in its way."""
        avoidance, recovery = self._avoidance, self._recovery
        if avoidance is None or recovery is None:
            return wanted, NO_OTHERS
        if recovery.has_taken_over:
            avoidance.avoiding = None
            return wanted, NO_OTHERS
        around = self._tracker.surroundings(context)
        passing = avoidance.command(wanted, self._allowed, context.now, around)
        return passing, Others(wanted, avoidance.are_near, avoidance.avoiding is not None)

    def _points(self) -> Array:
        """(k, 2) returns of the scan within the lookahead, and of the ring, base frame, m."""
        if self._scan is None or self._recovery is None:
            return _NO_POINTS
        points = self._geometry.points(self._scan, self._recovery.lookahead)
        return np.concatenate((points, self._near)) if len(self._near) else points

    def _decision(
        self, wanted: Twist, decision: ModeDecision, reason: Reason | None, context: DecisionContext
    ) -> Decision:
        twist, recovery = decision.twist, self._recovery
        safe = self._allowed = twist if twist is wanted else self._limits.clip(twist)
        share, monitor = 1.0, self._monitor
        if monitor is not None:
            share = monitor.speed_share
            if share < 1.0:  # the constraints are convex and hold for zero, so also for a share
                safe = Twist(share * safe.linear, share * safe.angular, share * safe.lateral)
            if text := monitor.on_command(safe):
                self.events.append(text)
        self.following.on_command(safe)
        self._safe, self._context = safe, None
        gap = self._min_gap
        if len(self._near):
            beside = float(self._footprint.gaps(self._near).min())
            gap = beside if gap is None else min(gap, beside)
        return Decision(
            self._arbiter.mode,
            wanted,
            safe,
            reason,
            decision.is_active or share < 1.0,
            decision.rows,
            gap,
            context.scan_age,
            self._scan_seq,
            recovery is not None and recovery.is_active,
            share,
            self._avoided(),
        )

    def _avoided(self) -> Avoided | None:
        """What avoidance leads the robot past in this decision."""
        track = None if self._avoidance is None else self._avoidance.avoiding
        if track is None:
            return None
        return Avoided(math.atan2(track.y, track.x), math.hypot(track.x, track.y))
