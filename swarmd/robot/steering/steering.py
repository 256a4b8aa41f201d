"""Steering: asks protection for another command where the request leads nowhere.

Right of way, avoidance and recovery may replace a request by a candidate, one after the other.
The robot hands the candidate to protection, which judges it like any request. So steering may be
wrong: it cannot weaken protection, and protection imports nothing of it.

A kernel (see `core/kernels.py`), since each request passes it.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

from swarmd.core import cython_shadow as cython
from swarmd.core.avoided import Avoided
from swarmd.core.messages import Reason
from swarmd.core.values import Odometry, Platform, Scan, TouchZone, Twist
from swarmd.robot.protection.decision import NO_PERMIT, DecisionContext, Permit, Steered
from swarmd.robot.steering.avoidance import Avoidance
from swarmd.robot.steering.recovery import NO_OTHERS, Allows, Others, Points, Recovery
from swarmd.robot.steering.right_of_way import RightOfWay
from swarmd.robot.steering.tracks import ScanReturns, Track, Tracker

if TYPE_CHECKING:
    from swarmd.robot.protection.protection import ProtectionView

_partial = partial  # a C name, found at once
_CORRIDOR_SPEED_SHARE = 0.95  # of the linear limit: the speed that a recovery corridor must allow


@cython.cclass
class Steering:
    """Gives what protection is asked for one robot. A mode without clearances is not steered.

    The stored state follows from the calls alone, so that a recording can be replayed. `seed` seeds
    the random choices of recovery and right of way.
    """

    _protection: ProtectionView
    _offset: Any
    _recovery: Recovery | None  # None: this robot is not steered, and has none of the other parts
    _is_recovering: bool
    _may_recover: bool  # recovery or avoidance has decided since the last hold
    _avoidance: Avoidance
    _tracker: Tracker
    must_track: bool  # kin needs tracks
    _avoids: bool  # as the platform says
    _is_avoiding: bool  # as the permit says
    _has_avoided: bool  # right of way may know openings
    _odometry: Odometry | None  # the last reading; None without one
    _right_of_way: RightOfWay

    def __init__(self, platform: Platform, protection: ProtectionView, seed: str = "") -> None:
        self._protection = protection
        self._offset = platform.scan.offset
        clearance = protection.clearance(_CORRIDOR_SPEED_SHARE * platform.limits.linear)
        if clearance is not None:
            self._recovery = Recovery(clearance, platform.limits, seed)
            self._avoids = platform.protection.get("avoidance", "none") == "orca"
            self._avoidance = Avoidance(clearance, platform.limits)
            returns = ScanReturns()
            self._tracker = Tracker(platform, returns)
            self._right_of_way = RightOfWay(clearance, platform.limits, seed, returns)

    def observe(self, scan: Scan, context: DecisionContext) -> None:
        """Take in a conditioned scan."""
        if self._is_avoiding:
            # Right of way reads the tracks of its last command, which the next scan changes.
            self._right_of_way.observe(scan, self._offset, context)
        if self._is_tracking():
            self._tracker.observe(scan, context)

    def on_odometry(self, odometry: Odometry) -> None:
        """Take in a reading: tracks and right of way use it."""
        if self._is_tracking():
            self._tracker.on_odometry(odometry)
        self._odometry = odometry
        if self._has_avoided:  # a hold may end avoidance for a while
            self._right_of_way.on_odometry(odometry)

    def tracks(self, context: DecisionContext) -> tuple[Track, ...] | None:
        """The tracked objects; None while nothing is tracked."""
        return self._tracker.surroundings(context).tracks if self._is_tracking() else None

    def _is_tracking(self) -> bool:
        return self._is_avoiding or (self.must_track and self._recovery is not None)

    def steer(
        self,
        requested: Twist | None,
        context: DecisionContext,
        is_running: bool,
        hold: Reason | None,
        permit: Permit = NO_PERMIT,
    ) -> Steered | None:
        """What steering asks of protection in place of the request; None: the request itself.

        Arguments as those of `Protection.decide`; `permit` says what of steering the pattern
        permits.
        """
        recovery: Recovery | None = self._recovery
        if recovery is None:
            return None
        # A hold of a running robot comes without the pattern's permit, so such a hold leaves
        # avoidance as it is.
        if hold is None or not is_running:
            self._switch_avoidance(is_running, permit)
        if not is_running:
            recovery.set_down()
        clipped = candidate = self._protection.clip(requested)
        may_move = is_running and hold is None and context.scan_age is not None
        if not (may_move and permit.may_recover):
            self._end_recovery(recovery)
        else:
            candidate = self._candidate(recovery, clipped, context, permit.touch)
        if not (self._is_avoiding or self._is_recovering or candidate is not clipped):
            return None
        return Steered(
            candidate,
            self._is_recovering != 0,
            self._avoided(context) if self._is_avoiding else None,
        )

    def _switch_avoidance(self, is_running: bool, permit: Permit) -> None:
        """Switch avoidance on or off by the permit."""
        is_avoiding = (
            is_running
            and permit.may_recover
            and (self._avoids if permit.avoids is None else permit.avoids)
        )
        if is_avoiding == self._is_avoiding:
            return
        self._is_avoiding = is_avoiding
        if not self._has_avoided and self._odometry is not None:
            self._right_of_way.on_odometry(self._odometry)
        self._has_avoided = True
        self._tracker.reset()  # objects have moved meanwhile
        self._avoidance.reset()
        self._right_of_way.reset()

    def _end_recovery(self, recovery: Recovery) -> None:
        """Reset recovery, avoidance and right of way, if they have decided since the last hold."""
        if self._may_recover:
            self._may_recover = False
            self._is_recovering = False
            recovery.reset()
            self._avoidance.reset()
            self._right_of_way.reset()

    def _candidate(
        self, recovery: Recovery, clipped: Twist, context: DecisionContext, touch: TouchZone | None
    ) -> Twist:
        """The command by which right of way, avoidance or recovery replaces a clipped request.

        The result is the object `clipped` if the request is not replaced.
        """
        self._may_recover = True
        allows = _partial(self._protection.permitted, context, touch)
        points = _partial(self._protection.points, context, recovery.lookahead)
        passing_request, others = self._pass_others(recovery, clipped, context, allows, points)
        candidate = recovery.replacement(
            passing_request, self._protection.mode_command, context, points, others, allows
        )
        self._is_recovering = recovery.is_active
        return candidate

    def _pass_others(
        self,
        recovery: Recovery,
        requested: Twist,
        context: DecisionContext,
        allows: Allows,
        points: Points,
    ) -> tuple[Twist, Others]:
        """The command that leads past openings and moving objects, and `Others` for recovery.

        The command is `requested` if no opening and no object is in the way. `Others` tells
        recovery what right of way and avoidance have done. Right of way decides first. Avoidance
        then decides, unless right of way is in a state that settles the command, or a recovery is
        under way. `allows` gives what protection permits of any request, `points` the returns.
        """
        if not self._is_avoiding:
            return requested, NO_OTHERS
        around = self._tracker.surroundings(context)
        requested = self._right_of_way.command(requested, context, around, allows, points)
        if self._right_of_way.is_settled:
            self._avoidance.avoiding = None
            return requested, Others(requested, is_settled=True)
        if recovery.has_taken_over:
            self._avoidance.avoiding = None
            return requested, NO_OTHERS
        passing = self._avoidance.command(
            requested, self._protection.mode_command, context.now, around
        )
        return passing, Others(
            requested, self._avoidance.are_near, self._avoidance.avoiding is not None
        )

    def _avoided(self, context: DecisionContext) -> Avoided | None:
        """The track or the opening because of which the command was replaced; None without."""
        track = self._avoidance.avoiding
        if track is None:
            return None if self._is_recovering else self._right_of_way.passed(context)
        return Avoided(math.atan2(track.y, track.x), math.hypot(track.x, track.y))
