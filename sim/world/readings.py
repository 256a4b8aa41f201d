"""Scalar fields in the plane, such as light, that robots sample where they stand."""

from __future__ import annotations

from msgspec import Struct


class Field(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One scalar field."""

    name: str
