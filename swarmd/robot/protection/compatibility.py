"""Whether a robot's lidar sees a peer, and whether protection assumes the peer's speed. Pure.

Protection avoids what the scan shows, and assumes that others move at most at `others_speed`. A
peer below or above the scan plane is not in the scan. A peer with a higher `surface_speed` comes
nearer than protection computes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

import msgspec

from swarmd.core.clock import TICK
from swarmd.core.messages import Body, PeerFinding
from swarmd.core.values import Platform
from swarmd.robot.protection.binding_range import BindingRange
from swarmd.robot.protection.footprint import radius_of
from swarmd.robot.protection.settings import BarrierSettings


@dataclass(frozen=True, slots=True)
class Accepts:
    """Platforms that a configuration accepts as peers, each with the reason (perhaps empty)."""

    unseen: Mapping[str, str] = field(default_factory=dict)
    faster: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, unseen: Iterable[str], faster: Iterable[str]) -> Accepts:
        """From lists of platforms, or from reasons by platform."""
        return cls(_with_reasons(unseen), _with_reasons(faster))


ACCEPTS_NONE = Accepts()


def body_of(platform: Platform) -> Body:
    """The `Body` that a robot of this platform sends to its peers."""
    barrier = barrier_settings(platform)
    speed = fastest_corner(platform)
    if barrier is not None:
        speed = BindingRange(platform, barrier, TICK).surface
    heights = platform.heights
    return Body(
        platform=platform.name[:63],
        surface_speed=speed,
        radius=radius_of(platform),
        scan_plane=None if heights is None else heights.scan_plane,
        lowest=None if heights is None else heights.lowest,
        highest=None if heights is None else heights.highest,
    )


def fastest_corner(platform: Platform) -> float:
    """The highest speed in m/s of a corner of the footprint within the limits."""
    limits = platform.limits
    return max(
        math.hypot(
            limits.linear + limits.angular * abs(y), limits.lateral + limits.angular * abs(x)
        )
        for x, y in platform.footprint.tolist()
    )


def sees(own: Body, peer: Body) -> bool | None:
    """True if the own scan plane cuts the peer's body; None if a height is not known."""
    if own.scan_plane is None or peer.lowest is None or peer.highest is None:
        return None
    return peer.lowest <= own.scan_plane <= peer.highest


def longest_diagonal(bodies: Iterable[Body | None]) -> float:
    """A bound in m of the longest diagonal of the outlines of peers; 0 without a peer.

    An outline lies within its radius around the axle. inf if a peer tells nothing of its body.
    """
    return max((math.inf if body is None else 2.0 * body.radius for body in bodies), default=0.0)


def assumed_speed(platform: Platform) -> float | None:
    """The speed of others in m/s that protection assumes; None except in mode `barrier`."""
    barrier = barrier_settings(platform)
    return None if barrier is None else barrier.others_speed


def barrier_settings(platform: Platform) -> BarrierSettings | None:
    """The settings of the barrier; None in another mode."""
    is_barrier = platform.protection.get("mode", "barrier") == "barrier"
    given = platform.protection.get("barrier") if is_barrier else None
    return None if given is None else msgspec.convert(given, BarrierSettings)


def findings(
    own: Body, others_speed: float | None, robot: str, peer: Body | None, accepts: Accepts
) -> Iterator[PeerFinding]:
    """Reasons why this robot does not fit its peer `robot`; none if both fit.

    `robot`: the name of the peer. `peer`: the body that the peer sent; None: the peer sent none.
    `others_speed`: m/s, what the protection of this robot assumes.
    """
    if peer is None:
        text = "tells nothing of its body, as an older version: whether it is seen is not known"
        yield PeerFinding(robot=robot, kind="unknown", text=text, holds=False)
        return
    is_seen = sees(own, peer)
    if is_seen is None:
        missing = own.platform if own.scan_plane is None else peer.platform
        text = f"whether it is seen is not known: platform {missing} has no heights"
        yield PeerFinding(robot=robot, kind="unknown", text=text, holds=False)
    elif not is_seen:
        text = unseen_text(own, peer)
        yield _granted(robot, "unseen", text, accepts.unseen.get(peer.platform))
    if others_speed is not None and peer.surface_speed > others_speed:
        text = faster_text(peer, others_speed)
        yield _granted(robot, "faster", text, accepts.faster.get(peer.platform))


def unseen_text(own: Body, peer: Body) -> str:
    """Why the own scan plane misses the peer."""
    assert own.scan_plane is not None
    assert peer.lowest is not None
    assert peer.highest is not None
    way, where = ("over", peer.highest) if own.scan_plane > peer.highest else ("under", peer.lowest)
    return (
        f"{peer.platform} is not seen: the scan plane at {own.scan_plane:.3f} m passes {way} it"
        f" ({where:.3f} m)"
    )


def faster_text(peer: Body, others_speed: float) -> str:
    """By how much the peer is faster than assumed."""
    return (
        f"{peer.platform} is faster than assumed: surface_speed {peer.surface_speed:.2f} m/s,"
        f" others_speed here {others_speed:.2f} m/s"
    )


def _granted(
    robot: str, kind: Literal["unseen", "faster"], text: str, reason: str | None
) -> PeerFinding:
    """A finding that holds the robot unless the configuration accepts the peer.

    `reason`: why the configuration accepts the peer; empty: accepted without a reason; None: not
    accepted.
    """
    if reason is None:
        text += f"; see accepts_{kind}"
    else:
        text += f"; accepted: {reason}" if reason else "; accepted"
    return PeerFinding(robot=robot, kind=kind, text=text, holds=reason is None)


def _with_reasons(platforms: Iterable[str]) -> dict[str, str]:
    return dict(platforms) if isinstance(platforms, Mapping) else dict.fromkeys(platforms, "")
