"""The protection modes. `potential_field`, `stop_zone` and `off` are implemented here.

Mode `barrier`, the default, is in barrier.py. robot/input_ages.py decides on holds of old scans.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Protocol, TypeGuard

import msgspec
import numpy as np

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.messages import LimitingObstacle, NarrowestPassage
from swarmd.core.values import ZERO, Array, Platform, Scan, TouchZone, Twist
from swarmd.robot.protection.barrier import Barrier
from swarmd.robot.protection.decision import Clearance, DecisionContext, ModeDecision
from swarmd.robot.protection.footprint import Footprint, ScanGeometry
from swarmd.robot.protection.settings import SLOW_SHARE, StopZoneSettings
from swarmd.robot.sensing.potential_field import field_twist, potential_field

_LEAST_LENGTH = 1e-9  # of a field: a shorter one has no direction


class Mode(Protocol):
    """One protection mode. `Protection` calls it only when no hold forbids motion."""

    mode: str

    def clearance(self, speed: float) -> Clearance | None:
        """The room that driving at `speed` m/s takes; None if the mode never blocks a robot."""

    def observe(self, scan: Scan, geometry: ScanGeometry, context: DecisionContext) -> None:
        """Take in a new scan; the mode computes its geometry here, once per scan."""

    def decide(
        self, requested: Twist, context: DecisionContext, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """The safe command for a requested command.

        For the same command in the same context, a mode always decides the same.

        `requested`: within the limits. `context`: has a scan age. `command`: the safe command in
        force. `touch`: the zone in which contact is granted; None: no contact.
        """


class Off:
    """Passes every requested command. Simulated robots only: a daemon refuses it for others."""

    mode = "off"

    def __init__(self, platform: Platform) -> None:
        """The mode has no settings."""

    def clearance(self, speed: float) -> None:
        """The mode never blocks a robot."""

    def observe(self, scan: Scan, geometry: ScanGeometry, context: DecisionContext) -> None:
        """Scans have no effect."""

    def decide(
        self, requested: Twist, context: DecisionContext, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """The requested command."""
        return ModeDecision(requested, is_active=False)


class PotentialField:
    """The hardware protection layer of the paper: evades near obstacles, without any guarantee.

    Source: Kaiser et al., ICRA 2022, section III. If there are more than `rays` returns within
    `threshold` m of the lidar, a repulsive potential field drives the robot at full speed, in place
    of the pattern's command.

    This mode differs from the source in three ways. A return below range_min counts as a return at
    range_min; in the source, as no return. Protection clips the command to the limits. The returns
    of a ring of range sensors make a second field of the same weight, without forward bias. A
    single return of a ring is enough, since such returns are rare and near.
    """

    mode = "potential_field"

    def __init__(self, platform: Platform) -> None:
        settings = platform.protection
        self._limits = platform.limits
        self._threshold = float(settings["threshold"])
        self._rays = int(settings["rays"])
        self._forward_bias = float(settings["forward_bias"])
        self._vector: Array | None = None
        self._evasion: Twist | None = None

    def clearance(self, speed: float) -> None:
        """The mode never blocks a robot."""

    def observe(self, scan: Scan, geometry: ScanGeometry, context: DecisionContext) -> None:
        """Compute the evading command, or None if nothing is near."""
        field = potential_field(
            scan.ranges,
            scan.bearings,
            range_max=self._threshold,
            range_min=scan.range_min,
            bias=self._forward_bias,
            ray_threshold=self._rays,
        )
        self._vector = None
        self._evasion = None
        if not field.is_alone:
            self._vector = field.vector
            self._evasion = self._twist(field.vector)

    def decide(
        self, requested: Twist, context: DecisionContext, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """The evading command if there is one, else the requested command."""
        evasion = self._evasion_of_ring(context.near_points) if context.near else self._evasion
        if evasion is None:
            return ModeDecision(requested, is_active=False)
        return ModeDecision(evasion, is_active=True)

    def _evasion_of_ring(self, points: Array) -> Twist | None:
        """The evading command for returns (k, 2) of the ring, and for those of the scan."""
        field = potential_field(
            np.hypot(*points.T),
            np.arctan2(points[:, 1], points[:, 0]),
            range_max=self._threshold,
            range_min=0.0,
            bias=0.0,
            ray_threshold=0,
        )
        if field.is_alone:
            return self._evasion
        vectors = [field.vector] if self._vector is None else [field.vector, self._vector]
        lengths = [max(float(np.hypot(*vector)), _LEAST_LENGTH) for vector in vectors]
        shares = [vector / length for vector, length in zip(vectors, lengths, strict=True)]
        return self._twist(np.sum(shares, axis=0))

    def _twist(self, vector: Array) -> Twist:
        return field_twist(vector, self._limits.linear, self._limits.angular)


class StopZone:
    """Stops within `stop` m of the outline, and slows down within `slow` m.

    After the collision monitor of navigation stacks (Macenski et al., "The Marathon 2", IROS 2020).
    The mode does not know where the robot is going, so it slows or stops all motion alike. A robot
    cannot leave a stop zone by itself: the requested command is never reversed.
    """

    mode = "stop_zone"

    def __init__(self, platform: Platform) -> None:
        self._settings = msgspec.convert(platform.protection["stop_zone"], StopZoneSettings)
        self._outline = Footprint(platform.footprint)
        self._limit = platform.limits.linear
        self._nearest: tuple[float, float] | None = None

    def clearance(self, speed: float) -> Clearance:
        """The room that keeps both zones free."""
        front = self._outline.corners[:, 0].max()
        half = np.abs(self._outline.corners[:, 1]).max()
        slow = self._settings.slow
        return Clearance(float(front) + slow, float(half) + slow)

    def observe(self, scan: Scan, geometry: ScanGeometry, context: DecisionContext) -> None:
        """Find the nearest return."""
        self._nearest = self._outline.nearest(scan, geometry)

    def decide(
        self, requested: Twist, context: DecisionContext, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """The requested command, a share of it, or zero."""
        settings = self._settings
        nearest = self._nearest
        if context.near:
            beside = self._outline.nearest_point(context.near_points)
            nearest = beside if nearest is None else min(nearest, beside)
        if nearest is None or requested.is_zero:
            return ModeDecision(requested, is_active=False)
        gap, bearing = nearest
        if gap <= settings.stop:
            return ModeDecision(ZERO, is_active=True, rows=(LimitingObstacle(bearing, gap, 0.0),))
        if gap > settings.slow:
            return ModeDecision(requested, is_active=False)
        twist = Twist(
            SLOW_SHARE * requested.linear,
            SLOW_SHARE * requested.angular,
            SLOW_SHARE * requested.lateral,
        )
        return ModeDecision(
            twist, is_active=True, rows=(LimitingObstacle(bearing, gap, SLOW_SHARE * self._limit),)
        )


MODES: Mapping[str, Callable[[Platform], Mode]] = MappingProxyType(
    {"barrier": Barrier, "potential_field": PotentialField, "stop_zone": StopZone, "off": Off}
)
"""The class of each mode."""


def narrowest_passage(mode: Mode) -> NarrowestPassage | None:
    """What mode `barrier` lets the robot through; None for the other modes."""
    return mode.narrowest_passage() if is_barrier(mode) else None


def is_barrier(mode: Mode) -> TypeGuard[Barrier]:
    """True for the mode `barrier`."""
    return mode.mode == "barrier"


def make_mode(platform: Platform) -> Mode:
    """The mode in the platform file; ConfigError if there is no such mode."""
    mode = str(platform.protection.get("mode", "barrier"))
    if mode not in MODES:
        raise ConfigError(f"platform {platform.name}: {unknown('protection mode', mode, MODES)}")
    return MODES[mode](platform)
