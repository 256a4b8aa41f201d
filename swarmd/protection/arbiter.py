"""Protection: the only path from a requested command to the command that the driver gets.

`Protection` enforces limits and holds in every mode. An `Arbiter` (modes.py) implements one mode.
`robot/input_ages.py` decides on the holds of old scans and old odometry.

A kernel (see `core/kernels.py`), since each input that can change the command passes it. Other
modules import `Protection` from protection.py, compiled or interpreted.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from swarmd.core.kernels import load_kernel
from swarmd.core.messages import NarrowestPassage, Reason
from swarmd.core.values import ZERO, Array, Odometry, Platform, Scan, Twist
from swarmd.protection.avoidance import Avoidance
from swarmd.protection.decision import NO_PERMIT, Avoided, Decision, DecisionContext, Permit
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
_decision = cython.declare(object, Decision)
_no_scan = cython.declare(object, Reason.NO_SCAN)
_driver_lost = cython.declare(object, Reason.DRIVER_LOST)


@cython.cclass
class Protection:
    """Decides on the safe command of one robot; never off. Its state comes from its calls alone.

    `seed` seeds the random choices of recovery and right of way. Attributes:
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
    _footprint: object
    _geometry: object
    _recovery: object
    _is_recovering: cython.bint
    _may_recover: cython.bint  # recovery or avoidance has decided since the last hold
    _avoidance: object
    _tracker = cython.declare(object, visibility="public")
    _avoids: cython.bint  # as the platform says
    _is_avoiding: cython.bint  # as the permit says
    _right_of_way: object
    _latency: cython.double
    _is_running: cython.bint
    _is_followed: cython.bint  # `following` has had a reading since its reset
    _scan_seq: cython.Py_ssize_t
    _scan: object
    _min_gap: object
    _near: object  # (k, 2) returns of the ring, m in the base frame; None without one
    _safe: object
    _allowed: object  # the safe command before `speed_share`
    _requested: object
    _wanted: object  # `_requested` within the limits
    # The last decision without a hold. The decision is repeated for the same case (`_case`) in the
    # same context, in which each mode decides the same. A scan or odometry ends the context.
    _context: object
    _case: tuple
    _last: object

    def __init__(self, platform: Platform, seed: str = "") -> None:
        self._limits = platform.limits
        self._arbiter = make_arbiter(platform)
        self._footprint = Footprint(platform.footprint)
        self._geometry = ScanGeometry(platform.scan)
        monitors = load_kernel("swarmd.protection.assumption_monitor")
        # Of the modes only barrier assumes anything.
        self._monitor = monitors.AssumptionMonitor(platform) if is_barrier(self._arbiter) else None
        self.following = load_kernel("swarmd.protection.following").FollowingMonitor(platform)
        self._latency = platform.scan.latency
        self.events, self._scan_seq, self.moved_at = [], -1, -math.inf
        self._safe = self._allowed = self._wanted = ZERO
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
        self._scan_seq, self._scan, self._context = scan.seq, scan, None
        arbiter, geometry = self._arbiter, self._geometry
        arbiter.observe(scan, geometry, context)
        if is_barrier(arbiter):  # which has looked at all returns
            self._min_gap = arbiter.min_gap
        else:
            self._min_gap = self._footprint.min_gap(scan, geometry)
        if self._is_avoiding:
            self._tracker.observe(scan, context)
            self._right_of_way.observe(scan, self._geometry.offset, context)
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
            self._is_followed = True
            self.following.on_odometry(odometry)
        if self._is_avoiding:
            self._tracker.on_odometry(odometry)
        if self._recovery is not None:  # a hold may end avoidance for a while
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

    def decide(
        self,
        requested: Twist | None,
        context: DecisionContext,
        is_running: cython.bint,
        hold: Reason | None,
        permit: Permit = NO_PERMIT,
    ) -> Decision:
        """The safe command for a requested one (None: zero), with its reasons.

        Exactly zero outside `running`, under any hold and before the first scan. The limits apply
        to the requested command, so that an arbiter can rely on them, and to the result.
        """
        recovery, touch, self._is_running = self._recovery, permit.touch, is_running
        # Switch avoidance on or off. A hold has no permit; avoidance then stays as it was.
        if recovery is not None and (hold is None or not is_running):
            avoids = self._avoids if permit.avoids is None else permit.avoids
            is_avoiding: cython.bint = is_running and permit.may_recover and avoids
            if is_avoiding != self._is_avoiding:
                self._is_avoiding = is_avoiding
                self._tracker.reset()  # objects have moved meanwhile
                self._avoidance.reset()
                self._right_of_way.reset()
        # Clip the request. Most requests are judged more than once, so the result is kept.
        if requested is not self._requested:
            self._requested, self._wanted = requested, _zero
            if requested is not None and requested.is_finite:
                self._wanted = self._limits.clip(requested)
        wanted = judged = self._wanted
        self._near = context.near_points if context.near else None
        # Decide zero outside `running` and under a hold.
        if is_running and hold is None and context.scan_age is None:
            hold = _no_scan
        if self._is_followed and (not is_running or hold is _driver_lost or touch is not None):
            self._is_followed = False
            self.following.reset()  # an object that the robot may touch may stop the robot
        if not is_running or hold is not None:
            if self._may_recover:
                self._may_recover = self._is_recovering = False
                recovery.reset()
                self._avoidance.reset()
                self._right_of_way.reset()
            return self._decision(wanted, _zero, False, (), hold, context)
        # Let right of way, avoidance and recovery replace the request.
        if recovery is not None and permit.may_recover:
            self._may_recover = True
            allows = partial(self._safe_for, context, touch)
            passing, others = self._passing(wanted, context, allows)
            judged = recovery.replacement(
                passing, self._allowed, context, self._points, others, allows
            )
            self._is_recovering = recovery.is_active
        if context is self._context:
            case = wanted, judged, judged is wanted, self._is_recovering, touch
            if case == self._case:
                return self._last
        # Let the mode judge the request.
        asked = judged if judged is wanted else self._limits.clip(judged)
        decision = self._arbiter.decide(asked, context, self._safe, touch)
        twist = decision.twist
        is_active: cython.bint = judged is not wanted or decision.is_active
        linear: cython.double = twist.linear
        angular: cython.double = twist.angular
        lateral: cython.double = twist.lateral
        if linear * 0.0 + angular * 0.0 + lateral * 0.0 != 0.0:  # NaN or infinite
            twist, is_active = _zero, True
            linear = angular = lateral = 0.0
        reason = None
        if (
            fabs(linear) <= _ZERO_TOLERANCE
            and fabs(angular) <= _ZERO_TOLERANCE
            and fabs(lateral) <= _ZERO_TOLERANCE
        ):
            reason = Reason.PROTECTION if is_active else Reason.NO_REQUESTED_COMMAND
        last = self._last = self._decision(wanted, twist, is_active, decision.rows, reason, context)
        self._context = context
        self._case = wanted, judged, judged is wanted, self._is_recovering, touch
        return last

    def _safe_for(self, context, touch, requested):
        """The command that the mode allows for a requested one."""
        return self._arbiter.decide(self._limits.clip(requested), context, self._safe, touch).twist

    def _passing(
        self, wanted: Twist, context: DecisionContext, allows: Allows
    ) -> tuple[Twist, Others]:
        """The command that leads past openings and moving objects; else `wanted`.

        Also what recovery must know about other objects.
        """
        avoidance, recovery = self._avoidance, self._recovery
        if not self._is_avoiding:
            return wanted, NO_OTHERS
        around = self._tracker.surroundings(context)
        way = self._right_of_way
        wanted = way.command(wanted, context, around, allows, self._points)
        if way.is_settled:
            avoidance.avoiding = None
            return wanted, Others(wanted, is_settled=True)
        if recovery.has_taken_over:
            avoidance.avoiding = None
            return wanted, NO_OTHERS
        passing = avoidance.command(wanted, self._allowed, context.now, around)
        return passing, Others(wanted, avoidance.are_near, avoidance.avoiding is not None)

    def _points(self) -> Array:
        """(k, 2) returns in m in the base frame: of the scan within the lookahead, and the ring."""
        if self._scan is None or self._recovery is None:
            return _NO_POINTS
        points = self._geometry.points(self._scan, self._recovery.lookahead)
        return points if self._near is None else np.concatenate((points, self._near))

    @cython.cfunc
    def _decision(
        self,
        wanted: object,
        twist: object,
        is_active: cython.bint,
        rows: tuple,
        reason: object,
        context: object,
    ):
        monitor, safe = self._monitor, twist
        if twist is not wanted and twist is not _zero:
            safe = self._limits.clip(twist)
        self._allowed = safe
        share: cython.double = 1.0
        if monitor is not None:
            share = monitor.speed_share
            if share < 1.0:  # the constraints are convex and hold for zero, so also for a share
                safe = Twist(share * safe.linear, share * safe.angular, share * safe.lateral)
            text = monitor.on_command(safe)
            if text:
                self.events.append(text)
        self.following.on_command(safe)
        if safe is not _zero and not safe.is_zero:
            self.moved_at = context.now
        self._safe, self._context = safe, None
        gap = self._min_gap
        if self._near is not None:
            beside = float(self._footprint.gaps(self._near).min())
            gap = beside if gap is None else min(gap, beside)
        return _decision(
            self._arbiter.mode,
            wanted,
            safe,
            reason,
            is_active or share < 1.0,
            rows,
            gap,
            context.scan_age,
            self._scan_seq,
            self._is_recovering,
            share,
            self._avoided(context) if self._is_avoiding else None,
        )

    def _avoided(self, context: DecisionContext) -> Avoided | None:
        """The track or the opening because of which the command was replaced; None without."""
        track = self._avoidance.avoiding
        if track is None:
            return None if self._is_recovering else self._right_of_way.passed(context)
        return Avoided(math.atan2(track.y, track.x), math.hypot(track.x, track.y))
