"""What the arbiter can be told, by a platform's file alone: these structs are its schema."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

Length = Annotated[float, Meta(ge=0.0, le=10.0)]
Speed = Annotated[float, Meta(gt=0.0, le=20.0)]
Braking = Annotated[float, Meta(gt=0.0, le=100.0)]
Mode = Literal["barrier", "potential_field", "stop_zone", "off"]


class PotentialFieldSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Mode `potential_field`: threshold in m from the sensor; more than `rays` trigger it."""

    threshold: Annotated[float, Meta(gt=0.0, le=1000.0)]
    rays: Annotated[int, Meta(ge=0, le=10_000)]
    forward_bias: Annotated[float, Meta(ge=0.0, le=100.0)]


class BarrierSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Mode `barrier`: what it assumes of others and of this base. Lengths in m, speeds in m/s.

    others_speed: the fastest that any point of another body's surface moves. unseen_extent: how
    far other bodies reach beyond what the scan plane meets of them. margin: what is kept free
    beside, for noise. braking_linear (m/s2) and braking_angular (rad/s2): what the base can do at
    least. surface_speed: what no corner of this robot exceeds while something is within
    `envelope_within` of its outline; None: others_speed, and as far as rows can bind.
    responsibility: passive (others may come at others_speed) or reciprocal (each gives way by
    half). keep_out: the radius of a circle around the sensor in which nothing may come, for one
    that is blind nearby; None: no such circle.
    """

    others_speed: Speed
    unseen_extent: Length
    margin: Length = 0.03
    braking_linear: Braking = 1.0
    braking_angular: Braking = 3.0
    surface_speed: Speed | None = None
    envelope_within: Length | None = None
    responsibility: Literal["passive", "reciprocal"] = "passive"
    keep_out: Length | None = None


class StopZoneSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Mode `stop_zone`: gaps in m within which it stops, or slows down to a share of the wish."""

    stop: Length = 0.10
    slow: Length = 0.25
    slow_share: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.3
