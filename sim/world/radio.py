"""Who hears whom, and when: range, line of sight, loss, delay and jitter."""

from __future__ import annotations

from msgspec import Struct


class RadioSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the radio between robots is like."""
