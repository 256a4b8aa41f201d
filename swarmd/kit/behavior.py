"""The base classes of patterns, and the context in which a pattern runs.

A pattern is arithmetic with memory: inputs in, outputs out. `inputs.now` is its only clock and
`context.rng` its only source of chance. It opens nothing, waits for nothing, and runs in a process
of its own.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Protocol

from numpy.random import Generator

from swarmd.core.errors import PluginError
from swarmd.core.values import (
    OPTION_INPUTS,
    Inputs,
    Outputs,
    Platform,
    Scalar,
    TouchZone,
    Twist,
    Value,
)
from swarmd.kit.params import P, Params, derived_defaults


class Make(Protocol):
    """Makes the parts of a combined pattern; the type of `Context.make`."""

    def __call__(
        self, name: str, /, *, part: str = "", private: bool = False, **params: Value
    ) -> Pattern[Any]:
        """Make a part: the pattern `name` with `params`; the platform gives all other parameters.

        `part` names the part within this pattern (default: `name`). A part shares its message
        channels with the stand-alone pattern, unless the part is `private`. PluginError if there is
        no such pattern, ConfigError if a parameter is wrong.
        """


def _no_parts(
    name: str, /, *, part: str = "", private: bool = False, **params: Value
) -> Pattern[Any]:
    raise PluginError(f"no pattern {name!r} here: this context makes no parts")


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """The robot and platform on which a pattern runs, and the tools of the pattern.

    - `robot`: the id of this robot, as `Neighbor.id` and `Message.sender` have it on other robots.
    - `platform`: what the robot is: its `limits`, `footprint`, `scan`, `provides` and more.
    - `rng`: the seeded random generator, the only source of chance.
    - `make`: makes another pattern as a part, for a `CombinedPattern`.
    - `channel_prefix`: what `CombinedPattern` puts before the channels of a part; else empty.
    """

    robot: str
    platform: Platform
    rng: Generator
    make: Make = _no_parts
    channel_prefix: str = ""


class Pattern(ABC, Generic[P]):
    """Base of all patterns: one object per run, stepped at `rate` and on every new scan.

    Class attributes:

    - `params_type`: the struct of its parameters.
    - `group`: the heading under which lists of patterns have it, such as gather or search.
    - `needs`: what the robot must have: fields of `Inputs`, such as scan, odometry and neighbors;
      neighbors.distance, neighbors.bearing, neighbors.heading, gripper and reading:<name>.
    - `uses_places`: it needs no places of neighbors, but uses them where the robot learns them by
      the motion of its peers.
    - `channels`: its message channels, each with the type of its values.
    - `rate`: steps a second.
    - `report_units`: the units of reported numbers, by their keys; views and metrics show them.
    - `is_symmetric`: mirrored inputs give mirrored commands, as PatternContract checks.
    - `touches`: the zone in which the robot must touch obstacles, to push or to dock. The robot's
      configuration must grant the zone. `touches` of a part has no effect.
    - `scan_delay`: s, at most 0.5. The robot is not held while scans come up to this time later
      than `scan.latency`, also if its platform allows less. Protection adds the measured delay to
      the age of scans, so the robot keeps larger gaps. Made for patterns that measure the delay.
      `scan_delay` of a part, or of a pushed pattern (sent by an operator), has no effect.
    """

    params_type: ClassVar[type[Params]] = Params
    group: ClassVar[str] = ""
    needs: frozenset[str] = frozenset({"scan"})
    uses_places: bool = False
    channels: Mapping[str, type] = {}
    rate: ClassVar[float] = 10.0
    report_units: ClassVar[Mapping[str, str]] = {}
    is_symmetric: ClassVar[bool] = False
    touches: ClassVar[TouchZone | None] = None
    scan_delay: ClassVar[float] = 0.0

    def __init__(self, params: P, context: Context) -> None:
        self.params = params
        self.context = context

    @classmethod
    def defaults(cls, platform: Platform) -> Mapping[str, Value]:
        """Defaults that derive from the platform: those of `about`; override to declare others."""
        return derived_defaults(cls.params_type, platform)

    @abstractmethod
    def step(self, inputs: Inputs) -> Outputs:
        """One step. It must not block, and may change only its own memory."""

    def update(self, params: P) -> None:
        """Apply changed parameters between two steps; the memory stays."""
        self.params = params


class MovementPattern(Pattern[P]):
    """A pattern that drives and sends no messages."""

    @abstractmethod
    def drive(self, inputs: Inputs) -> Twist:
        """The requested command, in the base frame; protection limits or replaces it."""

    def report(self) -> Mapping[str, Scalar]:
        """Values that members and traces show after each step."""
        return {}

    def step(self, inputs: Inputs) -> Outputs:
        """The command of `drive`; no command while a scan or reading that it needs is missing."""
        for word in self.needs:
            if inputs.scan is None if word == "scan" else _is_missing(word, inputs):
                return Outputs(report=self.report())
        twist = self.drive(inputs)
        if twist is None:  # valid outputs, but the author forgot something; any other type is not
            raise PluginError("drive gave None; is a return missing? expected a Twist")
        return Outputs(twist=twist, report=self.report())


_OPTIONAL = frozenset({"ranges", "pose", *OPTION_INPUTS})


def _is_missing(word: str, inputs: Inputs) -> bool:
    """True if the reading, ring, pose or input of an option that `word` names is missing."""
    if word in _OPTIONAL:
        return getattr(inputs, word) is None
    kind, _, name = word.partition(":")
    return kind == "reading" and name not in inputs.readings
