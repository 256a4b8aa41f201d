"""The fail-safe front: the one way from a wish to a driver's command, whatever the mode."""

from __future__ import annotations

from swarmd.messages import Reason
from swarmd.protection.arbiter import make_arbiter
from swarmd.protection.footprint import Footprint, Sight
from swarmd.protection.moment import NO_PERMIT, Moment, Permit
from swarmd.protection.verdict import Decision, Verdict
from swarmd.values import ZERO, Odometry, Platform, Scan, Twist


class Protection:
    """Decides on every scan, every wish and every tick; never off, pure but for the last scan."""

    def __init__(self, platform: Platform) -> None:
        self._platform = platform
        self._arbiter = make_arbiter(platform)
        self._footprint = Footprint(platform.footprint)
        self._sight = Sight(platform.scan)
        self._scan_seq = -1
        self._min_gap: float | None = None

    @property
    def mode(self) -> str:
        """The mode's name."""
        return self._arbiter.mode

    def observe(self, scan: Scan, odometry: Odometry | None) -> None:
        """Take in a conditioned scan: its geometry is computed here, once."""
        self._scan_seq = scan.seq
        self._min_gap = self._footprint.min_gap(scan, self._sight)
        self._arbiter.observe(scan, self._sight, odometry)

    def decide(
        self,
        wish: Twist | None,
        moment: Moment,
        *,
        is_running: bool,
        hold: Reason | None,
        permit: Permit = NO_PERMIT,
    ) -> Verdict:
        """The safe command for a wish (None: stands), with its grounds.

        Exactly zero outside `running`, under any hold and before the first scan. The limits are
        applied to the wish, so that an arbiter can rely on them, and to what it gives back.
        """
        limits = self._platform.limits
        wanted = limits.clip(wish) if wish is not None and wish.is_finite else ZERO
        if not is_running or hold is not None:
            return self._verdict(wanted, Decision(ZERO, is_active=False), hold, moment)
        if moment.scan_age is None:
            decision = Decision(ZERO, is_active=False)
            return self._verdict(wanted, decision, Reason.NO_SCAN, moment)
        decision = self._arbiter.decide(wanted, moment, permit.touch)
        if decision.twist is not wanted and not decision.twist.is_finite:
            decision = Decision(ZERO, is_active=True, rows=decision.rows)
        reason = None
        if decision.twist.is_zero:
            reason = Reason.PROTECTION if decision.is_active else Reason.NO_WISH
        return self._verdict(wanted, decision, reason, moment)

    def _verdict(
        self, wish: Twist, decision: Decision, reason: Reason | None, moment: Moment
    ) -> Verdict:
        return Verdict(
            mode=self._arbiter.mode,
            wish=wish,
            safe=self._platform.limits.clip(decision.twist),
            reason=reason,
            is_active=decision.is_active,
            rows=decision.rows,
            min_gap=self._min_gap,
            scan_age=moment.scan_age,
            scan_seq=self._scan_seq,
        )
