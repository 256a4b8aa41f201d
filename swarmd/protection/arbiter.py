"""Protection: the only path from a requested command to the command that the driver gets.

In every mode, `Protection` enforces the platform's limits and stops the robot under a hold. An
`Arbiter` (modes.py) implements one mode. `robot/input_ages.py` decides when old scans or old
odometry hold the robot.

A kernel (see `core/kernels.py`), since each input that can change the command passes it. Other
modules import `Protection` from protection.py, compiled or interpreted.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from swarmd.core.kernels import load_kernel
from swarmd.core.messages import NarrowestPassage, Reason
from swarmd.core.values import ZERO, Array, Odometry, Platform, Scan, Twist
from swarmd.protection.avoidance import Avoidance
from swarmd.protection.decision import (
    NO_PERMIT,
    Avoided,
    Decision,
    DecisionContext,
    ModeDecision,
    Permit,
)
from swarmd.protection.fence import Fence, FenceView
from swarmd.protection.fence_settings import FenceSettings
from swarmd.protection.footprint import Footprint, ScanGeometry
from swarmd.protection.modes import is_barrier, make_arbiter, narrowest_passage
from swarmd.protection.recovery import NO_OTHERS, Allows, Others, Recovery
from swarmd.protection.right_of_way import RightOfWay

if TYPE_CHECKING:  # Cython reads this import, CPython the other
    from collections.abc import Collection

    import cython

    from swarmd.protection.tracks import Track
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import fabs
else:
    from swarmd.core.cython_shadow import fabs

_CORRIDOR_SPEED_SHARE = 0.95  # of the linear limit: the speed that a recovery corridor must allow
# m/s or rad/s: what rounding leaves of a zero command
_ZERO_TOLERANCE = cython.declare(cython.double, 1e-9)
_NO_POINTS = np.empty((0, 2))
# C names: to look up a name of the module takes a tenth of the time of a decision.
_zero = cython.declare(object, ZERO)
_make_decision = cython.declare(object, Decision)
_no_scan = cython.declare(object, Reason.NO_SCAN)
_driver_lost = cython.declare(object, Reason.DRIVER_LOST)


@cython.cfunc
def _is_finite(twist) -> cython.bint:
    """True if no speed of a Twist is NaN or infinite."""
    linear: cython.double = twist.linear
    angular: cython.double = twist.angular
    lateral: cython.double = twist.lateral
    return linear * 0.0 + angular * 0.0 + lateral * 0.0 == 0.0  # NaN * 0 and inf * 0 are NaN


@cython.cfunc
def _is_nearly_zero(twist) -> cython.bint:
    """True if each speed of a Twist is zero, up to _ZERO_TOLERANCE."""
    linear: cython.double = twist.linear
    angular: cython.double = twist.angular
    lateral: cython.double = twist.lateral
    return (
        fabs(linear) <= _ZERO_TOLERANCE
        and fabs(angular) <= _ZERO_TOLERANCE
        and fabs(lateral) <= _ZERO_TOLERANCE
    )


@cython.cclass
class Protection:
    """Decides on the safe command of one robot, in every state and mode.

    The stored state follows from the calls alone, so that a recording can be replayed. `seed` seeds
    the random choices of recovery and right of way.

    Attributes:
        events: texts that the caller has yet to log.
        following: the monitor of whether the base of a running robot follows the safe commands.
        moved_at: the time in s of the last safe command that was not zero; -inf without such one.
    """

    events = cython.declare(list, visibility="readonly")
    following = cython.declare(object, visibility="readonly")
    moved_at = cython.declare(cython.double, visibility="readonly")
    _limits: object
    _arbiter = cython.declare(object, visibility="public")
    _monitor = cython.declare(object, visibility="public")
    _fence: object  # None without a fence
    _footprint: object
    _geometry: object
    _recovery: object
    _is_recovering: cython.bint
    _may_recover: cython.bint  # recovery or avoidance has decided since the last hold
    _avoidance: object
    _tracker = cython.declare(object, visibility="public")
    _avoids: cython.bint  # as the platform says
    _is_avoiding: cython.bint  # as the permit says
    _has_avoided: cython.bint  # right of way may know openings
    _odometry: object  # the last reading; None without one
    _right_of_way: object
    _latency: cython.double
    _has_walls: cython.bint  # walls that have stood are assumed to stand on
    _is_running: cython.bint
    _has_compared: cython.bint  # `following` has had a reading since its reset
    _scan_seq: cython.Py_ssize_t  # of the last scan; -1 before the first
    _scan: object  # the last conditioned scan; None before the first
    _scan_points: object  # (k, 2) returns of the scan within the lookahead; None: not computed yet
    _min_gap: object  # m from the outline to the nearest return of the last scan; None without one
    _points_context: object  # the context of the present decision
    _ring_points: object  # (k, 2) returns of the ring, m in the base frame; None without one
    _safe: object  # the last safe command, which is in force until the next decision
    _mode_command: object  # the safe command before `speed_share`
    _requested: object
    _clipped_request: object  # `_requested` within the limits
    # The last decision without a hold. The decision is repeated for the same case in the same
    # context, in which each mode decides the same. A scan or odometry ends the context.
    _last_context: object  # None: no decision may be repeated
    _last_case: tuple  # of `decide`
    _last_decision: object

    def __init__(
        self, platform: Platform, seed: str = "", fence: FenceSettings | None = None
    ) -> None:
        self._limits = platform.limits
        self._fence = None if fence is None else Fence(fence, platform)
        self._arbiter = make_arbiter(platform)
        self._footprint = Footprint(platform.footprint)
        self._geometry = ScanGeometry(platform.scan)
        monitors = load_kernel("swarmd.protection.assumption_monitor")
        # Of the modes only barrier assumes anything.
        self._monitor = monitors.AssumptionMonitor(platform) if is_barrier(self._arbiter) else None
        self.following = load_kernel("swarmd.protection.following").FollowingMonitor(platform)
        self._latency = platform.scan.latency
        self._has_walls = is_barrier(self._arbiter) and self._arbiter.has_walls
        self.events, self._scan_seq, self.moved_at = [], -1, -math.inf
        self._safe = self._mode_command = self._clipped_request = ZERO
        self._is_recovering = False
        clearance = self._arbiter.clearance(_CORRIDOR_SPEED_SHARE * platform.limits.linear)
        if clearance is not None:
            self._recovery = Recovery(clearance, platform.limits, seed)
            self._avoids = platform.protection.get("avoidance", "none") == "orca"
            self._is_avoiding = False
            self._avoidance = Avoidance(clearance, platform.limits)
            self._tracker = load_kernel("swarmd.protection.tracks").Tracker(platform)
            self._right_of_way = RightOfWay(clearance, platform.limits, seed)

    @property
    def passage(self) -> NarrowestPassage | None:
        """The narrowest widths that the mode lets the robot through; None except for `barrier`."""
        return narrowest_passage(self._arbiter)

    def observe(self, scan: Scan, context: DecisionContext) -> None:
        """Take in a conditioned scan."""
        self._scan_seq, self._scan, self._last_context = scan.seq, scan, None
        self._scan_points = None
        arbiter, geometry = self._arbiter, self._geometry
        arbiter.observe(scan, geometry, context)
        if is_barrier(arbiter):  # which has looked at all returns
            self._min_gap = arbiter.min_gap
            moved = arbiter.moved_wall
            if moved is not None and self._is_running:
                self.events.append(self._monitor.on_moved_wall(scan.stamp, moved))
            if self._has_walls:
                self._monitor.end_wall_doubt(scan.stamp)
                arbiter.trust_walls(self._monitor.trusts_walls)
        else:
            self._min_gap = self._footprint.min_gap(scan, geometry)
        if self._is_avoiding:
            # Right of way reads the tracks of its last command, which the next scan changes.
            self._right_of_way.observe(scan, self._geometry.offset, context)
            self._tracker.observe(scan, context)
        if self._monitor is not None and self._is_running:
            ages = scan.ages  # numpy's max takes four times as long
            oldest = 0.0 if ages is None or not len(ages) else float(ages[ages.argmax()])
            delay = self._latency + context.scan_delay + oldest
            if text := self._monitor.on_scan(scan.stamp, self._min_gap, delay):
                self.events.append(text)

    def on_odometry(self, odometry: Odometry) -> None:
        """Take in a reading: monitors, tracks and right of way use it."""
        if self._monitor is not None:
            text = self._monitor.on_odometry(odometry)
            if text:
                self.events.append(text)
        if self._is_running:
            self._has_compared = True
            self.following.on_odometry(odometry)
        if self._is_avoiding:
            self._tracker.on_odometry(odometry)
        self._odometry = odometry
        if self._has_avoided:  # a hold may end avoidance for a while
            self._right_of_way.on_odometry(odometry)

    def tracks(self, context: DecisionContext) -> tuple[Track, ...] | None:
        """The tracks that avoidance uses; None while avoidance is off."""
        return self._tracker.surroundings(context).tracks if self._is_avoiding else None

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
        if self._monitor is not None:
            self._monitor.forget(findings)
            self._arbiter.trust_walls(self._monitor.trusts_walls)

    def decide(
        self,
        requested: Twist | None,
        context: DecisionContext,
        is_running: cython.bint,
        hold: Reason | None,
        permit: Permit = NO_PERMIT,
    ) -> Decision:
        """The safe command for a requested command, with its reasons.

        The command is exactly zero outside `running`, under any hold and before the first scan. The
        platform's limits apply to the request, so that a mode can rely on them, and to the result.

        Args:
            requested: the command of the pattern in m/s and rad/s; None: zero.
            context: the time, and the inputs with their ages.
            is_running: the robot is in the state `running`.
            hold: the reason of a hold, which zeroes the command; None without a hold.
            permit: whether the pattern permits recovery and avoidance, and its touch zone.
        """
        touch, self._is_running = permit.touch, is_running
        self._ring_points = context.near_points if context.near else None
        self._points_context = context
        # 1. A hold of a running robot comes without the pattern's permit, so such a hold leaves
        # avoidance as it is.
        if hold is None or not is_running:
            self._switch_avoidance(is_running, permit)
        clipped = self._clip(requested)
        if is_running and hold is None and context.scan_age is None:
            hold = _no_scan
        # 2. Base and commands are not compared if the base need not follow: while the robot does
        # not run, if its driver is lost, or if an object in a touch zone may stop the base.
        if self._has_compared and (not is_running or hold is _driver_lost or touch is not None):
            self._has_compared = False
            self.following.reset()
        # 3. Decides zero outside `running` and under a hold.
        if not is_running or hold is not None:
            self._end_recovery()
            return self._decision(clipped, _zero, False, (), hold, context)
        # 4. Right of way, avoidance and recovery may replace the request by a candidate; without
        # `may_recover` the pattern permits none of them. A candidate that equals the request, but
        # is another object, is a replacement, too.
        candidate = clipped
        if self._recovery is not None and permit.may_recover:
            candidate = self._replacement(clipped, context, touch)
        is_replaced: cython.bint = candidate is not clipped
        # 5. For the same case in the same context each mode decides the same.
        case = clipped, candidate, is_replaced != 0, self._is_recovering, touch
        if context is self._last_context and case == self._last_case:
            return self._last_decision
        # 6. The mode limits the candidate, within the fence.
        mode_request = self._limits.clip(candidate) if is_replaced else candidate
        is_fenced: cython.bint = False
        if self._fence is not None:
            decision, is_fenced = self._fenced(mode_request, context, touch)
        else:
            decision = self._arbiter.decide(mode_request, context, self._safe, touch)
        twist = decision.twist
        is_active: cython.bint = is_replaced or decision.is_active
        if not _is_finite(twist):
            twist, is_active = _zero, True
        # 7. Reports the decision, and stores it for step 5.
        reason = None
        if _is_nearly_zero(twist):
            reason = Reason.PROTECTION if is_active else Reason.NO_REQUESTED_COMMAND
        last = self._last_decision = self._decision(
            clipped, twist, is_active, decision.rows, reason, context, is_fenced
        )
        self._last_context, self._last_case = context, case
        return last

    @cython.cfunc
    def _switch_avoidance(self, is_running: cython.bint, permit):
        """Switch avoidance on or off by the permit; a mode without recovery has no avoidance."""
        if self._recovery is None:
            return
        may_avoid = self._avoids if permit.avoids is None else permit.avoids
        is_avoiding: cython.bint = is_running and permit.may_recover and may_avoid
        if is_avoiding == self._is_avoiding:
            return
        self._is_avoiding = is_avoiding
        if not self._has_avoided and self._odometry is not None:
            self._right_of_way.on_odometry(self._odometry)
        self._has_avoided = True
        self._tracker.reset()  # objects have moved meanwhile
        self._avoidance.reset()
        self._right_of_way.reset()

    @cython.cfunc
    def _clip(self, requested):
        """The request within the limits; zero without a finite request.

        Most requests are judged more than once, so the result is stored.
        """
        if requested is not self._requested:
            self._requested, self._clipped_request = requested, _zero
            if requested is not None and requested.is_finite:
                self._clipped_request = self._limits.clip(requested)
        return self._clipped_request

    @cython.cfunc
    def _end_recovery(self):
        """Reset recovery, avoidance and right of way, if they have decided since the last hold."""
        if self._may_recover:
            self._may_recover = self._is_recovering = False
            self._recovery.reset()
            self._avoidance.reset()
            self._right_of_way.reset()

    @cython.cfunc
    def _replacement(self, clipped, context, touch):
        """The command by which right of way, avoidance or recovery replaces a clipped request.

        The result is the object `clipped` if the request is not replaced.
        """
        recovery = self._recovery
        self._may_recover = True
        safe_for = partial(self._safe_for, context, touch)
        passing_request, others = self._pass_others(clipped, context, safe_for)
        if self._has_walls:  # recovery waits longer while near walls are about to have stood
            patience = self._arbiter.wall_patience(context.now)
            if patience > 0.0:
                others = replace(others, patience=patience)
        candidate = recovery.replacement(
            passing_request, self._mode_command, context, self._points, others, safe_for
        )
        self._is_recovering = recovery.is_active
        return candidate

    def _safe_for(self, context, touch, requested):
        """The command of the mode for any requested command in the present situation."""
        if self._fence is not None:
            decision, _ = self._fenced(self._limits.clip(requested), context, touch)
            return decision.twist
        return self._arbiter.decide(self._limits.clip(requested), context, self._safe, touch).twist

    def _fenced(self, request, context, touch):
        """The decision of the mode within the fence, and whether the fence changed a command.

        The fence limits the request, and then the command of a mode that changed the request. The
        second limit reduces all speeds by one share: the result still satisfies the constraints of
        the mode, since these are convex and permit zero.
        """
        fence, command = self._fence, self._safe
        asked = fence.limit(request, context, command)
        decision = self._arbiter.decide(asked, context, command, touch)
        twist = decision.twist
        if twist is not asked:
            twist = fence.limit(twist, context, command, is_even=True)
        if asked is request and twist is decision.twist:
            return decision, False
        return ModeDecision(twist, True, decision.rows), True

    def fence_view(self, context: DecisionContext) -> FenceView | None:
        """The place of the robot against its fence; None without a fence or a usable pose."""
        return None if self._fence is None else self._fence.view(context)

    def _pass_others(
        self, requested: Twist, context: DecisionContext, safe_for: Allows
    ) -> tuple[Twist, Others]:
        """The command that leads past openings and moving objects, and `Others` for recovery.

        The command is `requested` if no opening and no object is in the way. `Others` tells
        recovery what right of way and avoidance have done. Right of way decides first. Avoidance
        then decides, unless right of way is in a state that settles the command, or a recovery is
        under way. `safe_for` gives the command of the mode for any request.
        """
        avoidance, recovery = self._avoidance, self._recovery
        if not self._is_avoiding:
            return requested, NO_OTHERS
        around = self._tracker.surroundings(context)
        right_of_way = self._right_of_way
        requested = right_of_way.command(requested, context, around, safe_for, self._points)
        if right_of_way.is_settled:
            avoidance.avoiding = None
            return requested, Others(requested, is_settled=True)
        if recovery.has_taken_over:
            avoidance.avoiding = None
            return requested, NO_OTHERS
        passing = avoidance.command(requested, self._mode_command, context.now, around)
        return passing, Others(requested, avoidance.are_near, avoidance.avoiding is not None)

    def _points(self) -> Array:
        """(k, 2) returns in m in the base frame: of the scan within the lookahead, and the ring."""
        if self._scan is None or self._recovery is None:
            return _NO_POINTS
        points = self._scan_points
        if points is None:  # up to 35 decisions a second ask, between two scans for the same points
            points = self._geometry.points(self._scan, self._recovery.lookahead)
            self._scan_points = points
        if self._ring_points is not None:
            points = np.concatenate((points, self._ring_points))
        if self._fence is not None:  # recovery takes the fence for a wall
            fence = self._fence.points(self._points_context, self._recovery.lookahead)
            points = np.concatenate((points, fence))
        return points

    @cython.cfunc
    def _decision(
        self,
        clipped_request: object,
        twist: object,
        is_active: cython.bint,
        rows: tuple,
        reason: object,
        context: object,
        is_fenced: cython.bint = False,
    ):
        """The Decision for the command `twist` of the mode; tells the monitors the safe command.

        Clips the command, and reduces it to `speed_share` after a violated assumption.

        Args:
            clipped_request: the request within the limits, for the report.
            twist: the command of the mode in m/s and rad/s.
            is_active: the mode or a replacement changed the request.
            rows: the limiting obstacles.
            reason: why the command is zero; None if the robot moves.
            context: the time, and the ages of the inputs.
            is_fenced: the fence changed the command.
        """
        # 1. Clips the command of the mode. To save time, the request and zero are not clipped: they
        # are within the limits.
        is_within_limits: cython.bint = twist is clipped_request or twist is _zero
        safe = twist if is_within_limits else self._limits.clip(twist)
        self._mode_command = safe
        # 2. Reduces the command to the share that the driver gets. A share of a permitted command
        # is permitted: the constraints of the mode are convex, and permit zero.
        monitor = self._monitor
        share: cython.double = 1.0 if monitor is None else monitor.speed_share
        if share < 1.0:
            safe = Twist(share * safe.linear, share * safe.angular, share * safe.lateral)
        # 3. Tells the monitors, and stores the command.
        if monitor is not None:
            text = monitor.on_command(safe)
            if text:
                self.events.append(text)
        self.following.on_command(safe)
        if safe is not _zero and (safe.linear != 0.0 or safe.angular != 0.0 or safe.lateral != 0.0):
            self.moved_at = context.now
        self._safe = safe
        # No earlier decision may be repeated, since its command is not `_safe` any more. `decide`
        # permits to repeat this decision, if it was made without a hold.
        self._last_context = None
        return _make_decision(
            self._arbiter.mode,
            clipped_request,
            safe,
            reason,
            is_active or share < 1.0,
            rows,
            self._least_gap(),
            context.scan_age,
            self._scan_seq,
            self._is_recovering,
            share,
            self._avoided(context) if self._is_avoiding else None,
            is_fenced != 0,
        )

    @cython.cfunc
    def _least_gap(self):
        """m from the outline to the nearest return of scan and ring; None without a return."""
        if self._ring_points is None:
            return self._min_gap
        ring_gap = float(self._footprint.gaps(self._ring_points).min())
        return ring_gap if self._min_gap is None else min(self._min_gap, ring_gap)

    def _avoided(self, context: DecisionContext) -> Avoided | None:
        """The track or the opening because of which the command was replaced; None without."""
        track = self._avoidance.avoiding
        if track is None:
            return None if self._is_recovering else self._right_of_way.passed(context)
        return Avoided(math.atan2(track.y, track.x), math.hypot(track.x, track.y))
