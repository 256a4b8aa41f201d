"""The settings `on_low_battery`: when a battery is low, and what the robot does then. No numpy."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from msgspec import Meta, Struct

from swarmd.core.bounds import ParamValues
from swarmd.core.errors import ConfigError
from swarmd.core.keys import check_id

READING = "battery"
"""The reading of the charge: a share, 0 empty to 1 full."""
_RECOVERY = 0.1  # the charge must rise by this share, unless `recovered` is given

_Share = Annotated[float, Meta(gt=0.0, le=1.0)]


class LowBatterySettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a running robot does when its battery is low: its run ends, and a pattern may follow.

    - `below`: the battery is low once its charge, a share of a full battery, is below this value.
    - `recovered`: a low battery stays low until it has this charge; None: `below` plus 0.1. If
      `recovered` is near `below`, a charge that varies is low several times, and ends several runs.
    - `pattern`: the pattern that a robot with a low battery runs; None: the robot stands.
    - `params`: parameters of `pattern`.
    - `seconds`: the longest time of the run of `pattern`.
    """

    below: _Share
    recovered: _Share | None = None
    pattern: str | None = None
    params: ParamValues = {}
    seconds: Annotated[float, Meta(gt=0.0, le=1e7)] = 120.0

    @property
    def until(self) -> float:
        """The charge from which on the battery is no longer low."""
        return self.below + _RECOVERY if self.recovered is None else self.recovered

    def faults(self) -> Iterator[tuple[tuple[str, ...], str]]:
        """The keys of each fault, with its text."""
        if self.until <= self.below or self.until > 1.0:
            text = f"is {self.until:g}; expected more than below ({self.below:g}), and at most 1"
            yield ("recovered",), text
        if self.pattern is not None:
            try:
                check_id(self.pattern, "the pattern")
            except ConfigError as error:
                yield ("pattern",), f"is {self.pattern!r}: {error}"
