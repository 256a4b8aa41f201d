"""The figures of a calibration, as the pattern reports and swarmctl reads them. No numpy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple, Self

PATTERN = "calibration"
DONE = "done"
REFUSED = "refused"
"""Values of `state` in the report: measured, or ended without figures for the reason in `why`."""
NOT_FREE = "is not free"
"""In `why`: the floor was not as it was asked for, which says nothing about the robot."""


class Figure(NamedTuple):
    """A value that a calibration has measured, or the reason why it could not measure the value."""

    value: float = math.nan  # NaN if not measured
    spread: float = math.nan  # standard deviation from sample to sample
    samples: int = 0  # their number
    assumed: float = math.nan  # by the platform file or by protection; NaN without such a value
    why: str = ""  # why there is no measured value; empty if there is a value

    @property
    def is_measured(self) -> bool:
        """True if there is a value."""
        return not self.why

    def over(self, scale: Self) -> Self:
        """The figure divided by a scale; the relative deviations are added in quadrature.

        Not measured with a scale of 0.
        """
        if not scale.value:
            return self._replace(why="odometry shows no way")
        value = self.value / scale.value
        spread = math.hypot(self.spread, value * scale.spread) / abs(scale.value)
        return self._replace(value=value, spread=spread)

    @property
    def text(self) -> str:
        """The figure as a text of a report, whose values are scalars; `parse` reads this text."""
        if self.why:
            return f"- {self.assumed:.6g} {self.why}"
        return f"{self.value:.6g} {self.spread:.6g} {self.samples} {self.assumed:.6g}"

    @classmethod
    def parse(cls, text: str) -> Self:
        """The figure in a text of `text`; ValueError if the text is no figure."""
        parts = text.split(" ")
        if parts[0] == "-" and len(parts) > 2:
            return cls(assumed=float(parts[1]), why=" ".join(parts[2:]))
        if len(parts) != 4:
            raise ValueError(f"{text!r} is no figure")
        value, spread, samples, assumed = parts
        return cls(float(value), float(spread), int(samples), float(assumed))


class SweepFigure(NamedTuple):
    """The measured order of a sensor's rays, or the reason why it could not be measured."""

    value: str = ""  # of `scan.sweep` of a platform file, as YAML; empty: not measured
    samples: int = 0  # scans
    why: str = ""

    @property
    def text(self) -> str:
        """The figure as a text of a report; `parse` reads this text."""
        return f"{self.samples} {self.value or self.why}"

    @classmethod
    def parse(cls, text: str) -> Self:
        """The figure in a text of `text`; ValueError if the text is no figure."""
        samples, _, words = text.partition(" ")
        return cls(words, int(samples)) if int(samples) else cls(why=words)


SWEEP = "sweep"
"""The name of the `SweepFigure` in a report, which only a platform with an unknown sweep gets."""

AXES = ("linear", "angular", "lateral")
"""The fields of a Twist that drives measure; lateral only for a base that moves sideways."""
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
