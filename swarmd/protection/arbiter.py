"""What every protection mode implements, and how a mode is made from a platform.

The fail-safe front: the one way from a wish to a driver's command, whatever the mode.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Protocol

import numpy as np
from msgspec.structs import replace

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Array, Platform, Scan, TouchZone, Twist
from swarmd.protection.barrier import Barrier
from swarmd.protection.decision import NO_PERMIT, Decision, DecisionContext, ModeDecision, Permit
from swarmd.protection.footprint import Footprint, Sight
from swarmd.protection.modes import Off, PotentialField, StopZone
from swarmd.protection.recovery import Clearance, Recovery


class Arbiter(Protocol):
    """One mode. It is asked only when the fail-safe front has found nothing that forbids motion."""

    mode: str

    def clearance(self, speed: float) -> Clearance | None:
        """The room that it takes to drive at `speed` m/s unhindered; None: it never blocks."""

    def observe(self, scan: Scan, sight: Sight, moment: DecisionContext) -> None:
        """Take in a new scan: all its geometry, once. `sight` says where its rays end."""

    def decide(
        self, requested: Twist, moment: DecisionContext, *, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """The safe command for a wish within limits; the moment has a scan.

        `command` is the one in force. `touch`: where the running pattern may touch what is near.
        """


MODES: Mapping[str, Callable[[Platform], Arbiter]] = MappingProxyType(
    {
        "barrier": Barrier,
        "potential_field": PotentialField,
        "stop_zone": StopZone,
        "off": Off,
    }
)
"""How the arbiter of each mode is made."""


def make_arbiter(platform: Platform) -> Arbiter:
    """The mode that the platform's file names; ConfigError if there is none such."""
    mode = str(platform.protection.get("mode", "barrier"))
    if mode not in MODES:
        raise ConfigError(f"platform {platform.name}: {unknown('protection mode', mode, MODES)}")
    return MODES[mode](platform)


_EASE = 0.95  # of the top speed is what a way must allow to be led along it
_STAND = ModeDecision(ZERO, is_active=False)
_NOTHING = 1e-9  # m/s or rad/s: what rounding leaves of a command to stand


class Protection:
    """Decides on every scan, every wish and every tick; never off, pure but for what it has seen.

    `seed` decides to which sides it leads around what is in the way.
    """

    def __init__(self, platform: Platform, seed: str = "") -> None:
        self._platform = platform
        self._arbiter = make_arbiter(platform)
        self._footprint = Footprint(platform.footprint)
        self._sight = Sight(platform.scan)
        self._scan_seq = -1
        self._min_gap: float | None = None
        self._scan: Scan | None = None
        self._safe = ZERO
        clearance = self._arbiter.clearance(_EASE * platform.limits.linear)
        self._recovery = None if clearance is None else Recovery(clearance, platform.limits, seed)

    @property
    def mode(self) -> str:
        """The mode's name."""
        return self._arbiter.mode

    def observe(self, scan: Scan, moment: DecisionContext) -> None:
        """Take in a conditioned scan: its geometry is computed here, once."""
        self._scan_seq, self._scan = scan.seq, scan
        self._min_gap = self._footprint.min_gap(scan, self._sight)
        self._arbiter.observe(scan, self._sight, moment)

    def decide(
        self,
        requested: Twist | None,
        moment: DecisionContext,
        *,
        is_running: bool,
        hold: Reason | None,
        permit: Permit = NO_PERMIT,
    ) -> Decision:
        """The safe command for a wish (None: stands), with its grounds.

        Exactly zero outside `running`, under any hold and before the first scan. The limits are
        applied to the wish, so that an arbiter can rely on them, and to what it gives back.
        """
        limits = self._platform.limits
        wanted = limits.clip(requested) if requested is not None and requested.is_finite else ZERO
        if is_running and hold is None and moment.scan_age is None:
            hold = Reason.NO_SCAN
        if not is_running or hold is not None:
            if self._recovery is not None:
                self._recovery.reset()
            return self._decision(wanted, _STAND, hold, moment)
        asked = wanted
        if self._recovery is not None and permit.may_recover:
            asked = limits.clip(self._recovery.instead(wanted, self._safe, moment, self._points))
        decision = self._arbiter.decide(asked, moment, command=self._safe, touch=permit.touch)
        if decision.twist is not wanted and not decision.twist.is_finite:
            decision = ModeDecision(ZERO, is_active=True, rows=decision.rows)
        elif asked is not wanted:
            decision = replace(decision, is_active=True)
        reason = None
        if _stands(decision.twist):
            reason = Reason.PROTECTION if decision.is_active else Reason.NO_REQUESTED_COMMAND
        return self._decision(wanted, decision, reason, moment)

    def _points(self) -> Array:
        """(k, 2) what the last scan shows of the ways around, in the base frame in m."""
        if self._scan is None or self._recovery is None:
            return np.empty((0, 2))
        return self._sight.points(self._scan, self._recovery.sight)

    def _decision(
        self,
        requested: Twist,
        decision: ModeDecision,
        reason: Reason | None,
        moment: DecisionContext,
    ) -> Decision:
        self._safe = self._platform.limits.clip(decision.twist)
        return Decision(
            mode=self._arbiter.mode,
            requested=requested,
            safe=self._safe,
            reason=reason,
            is_active=decision.is_active,
            rows=decision.rows,
            min_gap=self._min_gap,
            scan_age=moment.scan_age,
            scan_seq=self._scan_seq,
            is_recovering=self._recovery is not None and self._recovery.is_leading,
        )


def _stands(twist: Twist) -> bool:
    return max(abs(twist.linear), abs(twist.angular), abs(twist.lateral)) <= _NOTHING
