"""Protection: the only path from a requested command to the command that the driver gets.

In every mode, `Protection` enforces the platform's limits and stops the robot under a hold. A
`Mode` (modes.py) judges the request, or what steering (`swarmd/robot/steering/`) asks in its place.
`robot/input_ages.py` decides when old scans or old odometry hold the robot.

A kernel (see `core/kernels.py`), since each input that can change the command passes it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.cython_shadow import fabs
from swarmd.core.messages import LimitingObstacle, NarrowestPassage, Reason
from swarmd.core.values import (
    ZERO,
    Array,
    Limits,
    Odometry,
    Platform,
    Scan,
    TouchZone,
    Twist,
    slowed,
)
from swarmd.robot.protection.assumption_monitor import AssumptionMonitor
from swarmd.robot.protection.decision import (
    NO_PERMIT,
    Clearance,
    CommandLayer,
    Decision,
    DecisionContext,
    LayerView,
    ModeDecision,
    Permit,
    Steered,
)
from swarmd.robot.protection.fence.fence import Fence
from swarmd.robot.protection.fence.fence_settings import FenceSettings
from swarmd.robot.protection.following import FollowingMonitor
from swarmd.robot.protection.footprint import Footprint, ScanGeometry
from swarmd.robot.protection.modes import is_barrier, make_mode, narrowest_passage
from swarmd.robot.protection.outline import Outline

if TYPE_CHECKING:
    from collections.abc import Collection

    from swarmd.robot.protection.modes import Mode

# m/s or rad/s: what rounding leaves of a zero command
_ZERO_TOLERANCE = 1e-9
_NO_POINTS = np.empty((0, 2))
# C names: to look up a name of the module takes a tenth of the time of a decision.
_zero = ZERO
_make_decision = Decision
_no_scan = Reason.NO_SCAN
_driver_lost = Reason.DRIVER_LOST


def _is_finite(twist: Twist) -> bool:
    """True if no speed of a Twist is NaN or infinite."""
    linear = twist.linear
    angular = twist.angular
    lateral = twist.lateral
    return linear * 0.0 + angular * 0.0 + lateral * 0.0 == 0.0  # NaN * 0 and inf * 0 are NaN


def _is_nearly_zero(twist: Twist) -> bool:
    """True if each speed of a Twist is zero, up to _ZERO_TOLERANCE."""
    linear = twist.linear
    angular = twist.angular
    lateral = twist.lateral
    return (
        fabs(linear) <= _ZERO_TOLERANCE
        and fabs(angular) <= _ZERO_TOLERANCE
        and fabs(lateral) <= _ZERO_TOLERANCE
    )


@cython.cclass
class Protection:
    """Decides on the safe command of one robot, in every state and mode.

    The stored state follows from the calls alone, so that a recording can be replayed.

    Attributes:
        events: texts that the caller has yet to log.
        following: the monitor of whether the base of a running robot follows the safe commands.
        moved_at: the time in s of the last safe command that was not zero; -inf without such one.
        mode_command: the last command of the mode, before a violated assumption reduces it.
    """

    events: list[str]
    following: FollowingMonitor
    moved_at: float
    mode_command: Twist
    _limits: Limits
    _mode: Mode
    _monitor: AssumptionMonitor | None
    _bounds: tuple[CommandLayer, ...]  # the layers that bound commands
    _is_bounded: bool  # a bound changed the last command that `_judge` gave
    _footprint: Footprint
    _outline: Outline | None  # of modes other than barrier
    _geometry: ScanGeometry
    _latency: float
    _has_walls: bool  # walls that have stood are assumed to stand on
    _is_running: bool
    _has_compared: bool  # `following` has had a reading since its reset
    _scan_seq: int  # of the last scan; -1 before the first
    _scan: Scan | None  # the last conditioned scan; None before the first
    _scan_points: Array | None  # (k, 2) returns of the scan within a reach; None: not computed yet
    # m from the outline to the nearest return of the last scan; None without one
    _min_gap: float | None
    _ring_context: DecisionContext | None  # the context of `_ring_points`
    _ring_points: Array | None  # (k, 2) returns of the ring, m in the base frame; None without one
    _safe: Twist  # the last safe command, which is in force until the next decision
    _requested: Twist | None
    _clipped_request: Twist  # `_requested` within the limits
    # The last decision without a hold. The decision is repeated for the same case in the same
    # context, in which each mode decides the same. A scan or odometry ends the context.
    _last_context: DecisionContext | None  # None: no decision may be repeated
    _last_case: tuple[Any, ...]  # of `decide`
    _last_decision: Decision

    def __init__(self, platform: Platform, layers: Collection[FenceSettings] = ()) -> None:
        self._limits = platform.limits
        self._bounds = tuple([Fence(layer, platform) for layer in layers])
        self._mode = make_mode(platform)
        self._footprint = Footprint(platform.footprint)
        self._geometry = ScanGeometry(platform.scan)
        # Of the modes only barrier assumes anything.
        self._monitor = AssumptionMonitor(platform) if is_barrier(self._mode) else None
        self._outline = None if is_barrier(self._mode) else Outline(platform)
        self.following = FollowingMonitor(platform)
        self._latency = platform.scan.latency
        self._has_walls = is_barrier(self._mode) and self._mode.has_walls
        self.events = []
        self._scan_seq = -1
        self.moved_at = -math.inf
        self._safe = ZERO
        self.mode_command = ZERO
        self._clipped_request = ZERO

    @property
    def passage(self) -> NarrowestPassage | None:
        """The narrowest widths that the mode lets the robot through; None except for `barrier`."""
        return narrowest_passage(self._mode)

    def clearance(self, speed: float) -> Clearance | None:
        """The free room that the mode needs to drive at `speed` m/s; None: it has no such bound."""
        return self._mode.clearance(speed)

    def hear(self, diagonal: float) -> None:
        """Take in the longest diagonal in m of the platforms of all peers; inf: not known."""
        if is_barrier(self._mode):
            self._mode.hear(diagonal)

    def observe(self, scan: Scan, context: DecisionContext) -> None:
        """Take in a conditioned scan."""
        self._scan_seq = scan.seq
        self._scan = scan
        self._last_context = None
        self._scan_points = None
        mode = self._mode
        geometry = self._geometry
        mode.observe(scan, geometry, context)
        if is_barrier(mode):  # which has looked at all returns
            self._min_gap = mode.min_gap
            moved = mode.moved_wall
            if moved is not None and self._monitor is not None and self._is_running:
                self.events.append(self._monitor.on_moved_wall(scan.stamp, moved))
            if self._has_walls and self._monitor is not None:
                self._monitor.end_wall_doubt(scan.stamp)
                mode.trust_walls(self._monitor.trusts_walls)
        elif self._outline is not None:
            self._min_gap = self._outline.min_gap(scan)
        if self._monitor is not None and self._is_running:
            ages = scan.ages  # numpy's max takes four times as long
            oldest = 0.0 if ages is None or not len(ages) else float(ages[ages.argmax()])
            delay = self._latency + context.scan_delay + oldest
            if text := self._monitor.on_scan(scan.stamp, self._min_gap, delay):
                self.events.append(text)

    def on_odometry(self, odometry: Odometry) -> None:
        """Take in a reading, which the monitors use."""
        if self._monitor is not None and (text := self._monitor.on_odometry(odometry)):
            self.events.append(text)
        if self._is_running:
            self._has_compared = True
            self.following.on_odometry(odometry)

    @property
    def findings(self) -> tuple[str, ...]:
        """The assumptions that were found violated, each with its evidence."""
        return () if self._monitor is None else self._monitor.findings

    @property
    def not_following(self) -> str:
        """A text on how the base differs from its commands, or responds late; empty if neither."""
        text = self.following.text
        return text if text or self._monitor is None else self._monitor.late

    def forget_findings(self, findings: Collection[str]) -> None:
        """End these findings: they do not slow the robot until the monitor raises them again."""
        if self._monitor is not None and is_barrier(self._mode):
            self._monitor.forget(findings)
            self._mode.trust_walls(self._monitor.trusts_walls)

    def decide(
        self,
        requested: Twist | None,
        context: DecisionContext,
        is_running: bool,
        hold: Reason | None,
        permit: Permit = NO_PERMIT,
        steered: Steered | None = None,
    ) -> Decision:
        """The safe command for a requested command, with its reasons.

        The command is exactly zero outside `running`, under any hold and before the first scan. The
        platform's limits apply to the request, so that a mode can rely on them, and to the result.

        Args:
            requested: the command of the pattern in m/s and rad/s; None: zero.
            context: the time, and the inputs with their ages.
            is_running: the robot is in the state `running`.
            hold: the reason of a hold, which zeroes the command; None without a hold.
            permit: what the pattern permits, of which protection reads its touch zone and speed.
            steered: what steering asks in place of the request; None: the request.
        """
        touch = permit.touch
        self._is_running = is_running
        self._take_ring(context)
        clipped = self.clip(requested)
        if is_running and hold is None and context.scan_age is None:
            hold = _no_scan
        # 1. Base and commands are not compared if the base need not follow: while the robot does
        # not run, if its driver is lost, or if an object in a touch zone may stop the base.
        if self._has_compared and (not is_running or hold is _driver_lost or touch is not None):
            self._has_compared = False
            self.following.reset()
        # 2. Decides zero outside `running` and under a hold.
        if not is_running or hold is not None:
            return self._decision(clipped, _zero, False, (), hold, context, steered)
        # 3. Steering may ask a candidate in place of the request. One that equals the request, but
        # is another object, is a replacement, too.
        candidate = clipped if steered is None else steered.twist
        is_replaced = candidate is not clipped
        # 4. For the same case in the same context each mode decides the same.
        is_recovering = steered is not None and steered.is_recovering
        speed = permit.speed
        case = clipped, candidate, is_replaced != 0, is_recovering, touch, speed
        if context is self._last_context and case == self._last_case:
            return self._last_decision
        # 5. The mode limits the candidate, within the bounds of layers and the speed of the run.
        mode_request = self._limits.clip(candidate) if is_replaced else candidate
        decision = self._judge(mode_request, context, touch, speed)
        twist = decision.twist
        is_active = is_replaced or decision.is_active
        if not _is_finite(twist):
            twist = _zero
            is_active = True
        # 6. Reports the decision, and stores it for step 4.
        reason = None
        if _is_nearly_zero(twist):
            reason = Reason.PROTECTION if is_active else Reason.NO_REQUESTED_COMMAND
        last = self._last_decision = self._decision(
            clipped, twist, is_active, decision.rows, reason, context, steered, self._is_bounded
        )
        self._last_context = context
        self._last_case = case
        return last

    def clip(self, requested: Twist | None) -> Twist:
        """The request (Twist or None) within the limits; zero without a finite request.

        Most requests are judged more than once, so the result is stored.
        """
        if requested is not self._requested:
            self._requested = requested
            self._clipped_request = _zero
            if requested is not None and _is_finite(requested):
                self._clipped_request = self._limits.clip(requested)
        return self._clipped_request

    def permitted(
        self, context: DecisionContext, touch: TouchZone | None, requested: Twist
    ) -> Twist:
        """What the mode would permit of any requested command in the situation of `context`."""
        return self._judge(self._limits.clip(requested), context, touch, None).twist

    def _judge(
        self, request: Twist, context: DecisionContext, touch: TouchZone | None, speed: float | None
    ) -> ModeDecision:
        """The decision of the mode within all bounds; sets `_is_bounded`.

        `speed`: the greatest of the run in m/s; None: no bound. It bounds as a layer does.
        A bound limits the request, and then the command of a mode that changed the request. The
        second limit reduces all speeds by one share: the result still satisfies the constraints of
        the mode, since these are convex and permit zero.
        """
        command = self._safe
        slow = request if speed is None else slowed(request, speed)
        asked = slow
        for bound in self._bounds:
            asked = bound.limit(asked, context, command)
        decision = self._mode.decide(asked, context, command, touch)
        twist = decision.twist
        if twist is not asked:
            for bound in self._bounds:
                twist = bound.limit(twist, context, command, is_even=True)
        self._is_bounded = asked is not slow or twist is not decision.twist
        bounded = twist if speed is None or twist is asked else slowed(twist, speed)
        is_changed = self._is_bounded or bounded is not twist
        return ModeDecision(bounded, True, decision.rows) if is_changed else decision

    def views(self, context: DecisionContext) -> list[LayerView | None]:
        """The place of the robot against each bound; None without a usable pose."""
        return [bound.view(context) for bound in self._bounds]

    def points(self, context: DecisionContext, reach: float) -> Array:
        """(k, 2) returns in m in the base frame: of scan and bounds within `reach` m, and the ring.

        The last scan's; `reach` is the same in each call.
        """
        if self._scan is None:
            return _NO_POINTS
        points = self._scan_points
        if points is None:  # up to 35 decisions a second ask, between two scans for the same points
            points = self._geometry.points(self._scan, reach)
            self._scan_points = points
        self._take_ring(context)
        if self._ring_points is not None:
            points = np.concatenate((points, self._ring_points))
        for bound in self._bounds:
            points = np.concatenate((points, bound.points(context, reach)))
        return points

    def _take_ring(self, context: DecisionContext) -> None:
        """Take in the ring's returns of a context."""
        if context is not self._ring_context:
            self._ring_points = context.near_points if context.near else None
            self._ring_context = context

    def _decision(
        self,
        clipped_request: Twist,
        twist: Twist,
        is_active: bool,
        rows: tuple[LimitingObstacle, ...],
        reason: Reason | None,
        context: DecisionContext,
        steered: Steered | None,
        is_bounded: bool = False,
    ) -> Decision:
        """The Decision for the command `twist` of the mode; tells the monitors the safe command.

        Clips the command, and reduces it to `speed_share` after a violated assumption.

        Args:
            clipped_request: the request within the limits, for the report.
            twist: the command of the mode in m/s and rad/s.
            is_active: the mode or steering changed the request.
            rows: the limiting obstacles.
            reason: why the command is zero; None if the robot moves.
            context: the time, and the ages of the inputs.
            steered: what steering asked, for the report; None: nothing.
            is_bounded: a layer changed the command.
        """
        # 1. Clips the command of the mode. To save time, the request and zero are not clipped: they
        # are within the limits.
        is_within_limits = twist is clipped_request or twist is _zero
        safe = twist if is_within_limits else self._limits.clip(twist)
        self.mode_command = safe
        # 2. Reduces the command to the share that the driver gets. A share of a permitted command
        # is permitted: the constraints of the mode are convex, and permit zero.
        monitor = self._monitor
        share = 1.0 if monitor is None else monitor.speed_share
        if share < 1.0:
            safe = Twist(share * safe.linear, share * safe.angular, share * safe.lateral)
        # 3. Tells the monitors, and stores the command.
        if monitor is not None and (text := monitor.on_command(safe)):
            self.events.append(text)
        self.following.on_command(safe)
        if safe is not _zero and (safe.linear != 0.0 or safe.angular != 0.0 or safe.lateral != 0.0):
            self.moved_at = context.now
        self._safe = safe
        # No earlier decision may be repeated, since its command is not `_safe` any more. `decide`
        # permits to repeat this decision, if it was made without a hold.
        self._last_context = None
        return _make_decision(
            self._mode.mode,
            clipped_request,
            safe,
            reason,
            is_active or share < 1.0,
            rows,
            self._least_gap(),
            context.scan_age,
            self._scan_seq,
            steered is not None and steered.is_recovering,
            share,
            None if steered is None else steered.avoided,
            is_bounded != 0,
        )

    def _least_gap(self) -> Any:
        """m from the outline to the nearest return of scan and ring; None without a return."""
        if self._ring_points is None:
            return self._min_gap
        ring_gap = float(self._footprint.gaps(self._ring_points).min())
        return ring_gap if self._min_gap is None else min(self._min_gap, ring_gap)


@cython.cclass
class ProtectionView:
    """What steering may read of the protection of its robot. It makes no decision.

    Each method is that of `Protection`.
    """

    _protection: Protection

    def __init__(self, protection: Protection) -> None:
        self._protection = protection

    @property
    def mode_command(self) -> Twist:
        """The last command of the mode."""
        return self._protection.mode_command

    def clearance(self, speed: float) -> Clearance | None:
        """The free room that the mode needs to drive at `speed` m/s; None: it has no such bound."""
        return self._protection.clearance(speed)

    def clip(self, requested: Twist | None) -> Twist:
        """The request within the limits; zero without a finite request."""
        return self._protection.clip(requested)

    def permitted(
        self, context: DecisionContext, touch: TouchZone | None, requested: Twist
    ) -> Twist:
        """What the mode would permit of any requested command in the situation of `context`."""
        return self._protection.permitted(context, touch, requested)

    def points(self, context: DecisionContext, reach: float) -> Array:
        """(k, 2) returns within `reach` m, in m in the base frame."""
        return self._protection.points(context, reach)
