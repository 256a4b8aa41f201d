"""How far a simulated body is from an ideal one: noise, bias, drop-outs, delays."""

from __future__ import annotations

from msgspec import Struct


class Realism(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All imperfections; the presets are IDEAL and REALISTIC."""


IDEAL = Realism()
REALISTIC = Realism()
