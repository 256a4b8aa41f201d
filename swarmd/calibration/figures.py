"""The figures of a calibration, as the pattern reports and swarmctl reads them. No numpy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple, Self

PATTERN = "calibration"
DONE, REFUSED = "done", "refused"
"""Values of `state` in the report: measured, or ended without figures for the reason in `why`."""


class Figure(NamedTuple):
    """A measured value, its standard deviation from sample to sample, and the number of samples.

    `assumed`: the value in the platform file, or assumed by protection; NaN without such a value.
    `why`: why there is no measured value; empty if there is a value.
    """

    value: float = math.nan
    spread: float = math.nan
    samples: int = 0
    assumed: float = math.nan
    why: str = ""

    @property
    def is_measured(self) -> bool:
        """True if there is a value."""
        return not self.why

    def over(self, scale: Self) -> Self:
        """The figure divided by a scale, whose deviation is added to its own."""
        value = self.value / scale.value
        shares = self.spread / self.value, scale.spread / scale.value
        return self._replace(value=value, spread=value * math.hypot(*shares))

    @property
    def text(self) -> str:
        """The figure in a report, whose values are scalars; see `parse`."""
        if self.why:
            return f"- {self.assumed:.6g} {self.why}"
        return f"{self.value:.6g} {self.spread:.6g} {self.samples} {self.assumed:.6g}"

    @classmethod
    def parse(cls, text: str) -> Self:
        """The figure in a text of `text`; ValueError if the text is no figure."""
        first, *others = text.split(" ")
        if first == "-" and len(others) > 1:
            return cls(assumed=float(others[0]), why=" ".join(others[1:]))
        if len(others) != 3:
            raise ValueError(f"{text!r} is no figure")
        return cls(float(first), float(others[0]), int(others[1]), float(others[2]))


AXES = ("linear", "angular", "lateral")
"""The fields of a Twist, each of which drives measure. Only a base that moves sideways has the last
and its figures.
"""
NAMES: Mapping[str, tuple[str, str]] = {
    "braking_linear": ("braking, linear", "m/s2"),
    "braking_angular": ("braking, angular", "rad/s2"),
    "braking_lateral": ("braking, lateral", "m/s2"),
    "reaction_linear": ("reaction delay, linear", "s"),
    "reaction_angular": ("reaction delay, angular", "s"),
    "reaction_lateral": ("reaction delay, lateral", "s"),
    "odometry_age": ("age of odometry in use", "s"),
    "speed_linear": ("speed / commanded, linear", ""),
    "speed_angular": ("speed / commanded, angular", ""),
    "speed_lateral": ("speed / commanded, lateral", ""),
    "odometry_linear": ("odometry / scan, linear", ""),
    "odometry_angular": ("odometry / scan, angular", ""),
    "odometry_lateral": ("odometry / scan, lateral", ""),
    "scan_delay": ("scan delay", "s"),
}
"""The figures by their name in a report, with their title and unit."""


def names_of(moves_sideways: bool) -> tuple[str, ...]:
    """The names of the figures of a base, in the order of NAMES."""
    return tuple(name for name in NAMES if moves_sideways or not name.endswith(AXES[2]))
