"""What a pattern is: the base classes, and what a pattern may know of where it runs.

A pattern is arithmetic with memory: inputs in, outputs out. `inputs.now` is its clock and
`context.rng` its chance; it opens nothing, waits for nothing and runs in a process of its own.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Protocol

from numpy.random import Generator

from swarmd.core.errors import PluginError, named
from swarmd.core.values import Inputs, Outputs, Platform, Scalar, TouchZone, Twist, Value
from swarmd.kit.params import P, Params


class Make(Protocol):
    """How a combined pattern gets its parts; see `Context.make`."""

    def __call__(
        self, name: str, /, *, part: str = "", private: bool = False, **params: Value
    ) -> Pattern[Any]:
        """Another pattern with these parameters, the rest derived from the platform.

        `part` names it within this pattern (default: its own name). Its channels are those of the
        stand-alone pattern, so that both hear each other, unless it is `private`. PluginError if
        there is no such pattern; ConfigError if a parameter is wrong.
        """


def _no_parts(
    name: str, /, *, part: str = "", private: bool = False, **params: Value
) -> Pattern[Any]:
    raise PluginError(f"no pattern {name!r} here: this context can make no parts")


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """What a pattern may know of where it runs.

    `robot` is this robot's id; `rng` its only source of chance, seeded by whoever runs it;
    `make` other patterns as parts; `channel_prefix` is set for parts, which need not care.
    """

    robot: str
    platform: Platform
    rng: Generator
    make: Make = _no_parts
    channel_prefix: str = ""


class Pattern(ABC, Generic[P]):
    """Base of all patterns: one object per run, stepped at `rate` and on every new scan.

    Class attributes: `params_type`; `needs`, drawn from scan, odometry, neighbors,
    neighbors.distance, neighbors.bearing, neighbors.heading and reading:<name>; `channels`, by
    name the type of what is said there; `rate` in Hz; `is_symmetric`, the claim that mirrored
    inputs give mirrored commands, which `swarmd.testing.PatternContract` then checks; `touches`,
    where it must touch what is near, to push or to dock: it may as far as the robot's
    configuration grants it, and what its parts ask for does not count.
    """

    params_type: ClassVar[type[Params]] = Params
    needs: frozenset[str] = frozenset({"scan"})
    channels: Mapping[str, type] = {}
    rate: ClassVar[float] = 10.0
    is_symmetric: ClassVar[bool] = False
    touches: ClassVar[TouchZone | None] = None

    def __init__(self, params: P, context: Context) -> None:
        self.params = params
        self.context = context

    @classmethod
    def defaults(cls, platform: Platform) -> Mapping[str, Value]:
        """Defaults that follow from the platform, stronger than the ones declared."""
        return {}

    @abstractmethod
    def step(self, inputs: Inputs) -> Outputs:
        """One step: never blocks, reads and writes nothing but its own memory."""

    def update(self, params: P) -> None:
        """Take over changed parameters between two steps; the memory stays."""
        self.params = params


class MovementPattern(Pattern[P]):
    """A pattern that drives and says nothing."""

    @abstractmethod
    def drive(self, inputs: Inputs) -> Twist:
        """The wish, in the base frame; protection may overrule it and clips it to the limits."""

    def report(self) -> Mapping[str, Scalar]:
        """What members and traces show of it, after each step."""
        return {}

    def step(self, inputs: Inputs) -> Outputs:
        """What `drive` wishes; without the scan that it needs there is no wish."""
        if inputs.scan is None and "scan" in self.needs:
            return Outputs(report=self.report())
        twist = self.drive(inputs)
        if not isinstance(twist, Twist):
            hint = "is a return missing? " if twist is None else ""
            raise PluginError(f"drive gave {named(twist)}; {hint}wanted is a Twist")
        return Outputs(twist=twist, report=self.report())
