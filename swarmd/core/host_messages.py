"""What the guardian and its pattern host tell each other, by values.

Each carries the generation it was made for; those of another generation are dropped.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from msgspec import Struct

from swarmd.core.values import Inputs, Outputs, Platform, Scalar, TouchZone, Value

Layers = tuple[tuple[str, Mapping[str, Value]], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Load:
    """Load a pattern. `layers`: parameters by source, weakest first, above its defaults.

    `is_fresh`: in a new host, since the present one hangs. `until`: conditions of which any ends
    the run, as `swarmd.kit.conditions` reads them.
    """

    generation: int
    pattern: str
    layers: Layers
    robot: str
    platform: Platform
    seed: int
    is_fresh: bool = False
    until: tuple[str, ...] = ()


class Step(Struct, frozen=True, eq=False):
    """Step the loaded pattern once."""

    generation: int
    inputs: Inputs


@dataclass(frozen=True, slots=True, eq=False)
class SetParams:
    """Change parameters of the loaded pattern between two steps."""

    generation: int
    request: str
    values: Mapping[str, Value]


@dataclass(frozen=True, slots=True)
class KillHost:
    """End the host; a fresh one is started for the next Load."""

    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class StartTrial:
    """Load a pattern in a new process beside the host, only to see whether that can be done.

    `load.generation` numbers the trial. Nothing of it is stepped, and its process ends with it.
    """

    load: Load


@dataclass(frozen=True, slots=True)
class CancelTrial:
    """End the trial that is under way; nothing more is told of it."""

    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """The pattern is loaded and will be stepped. `params`: name -> (value, source).

    `touches`: where it asks to touch what is near. `took`: seconds that loading took.
    """

    generation: int
    rate: float
    channels: frozenset[str]
    params: Mapping[str, tuple[Scalar | None, str]]
    touches: TouchZone | None = None
    took: float = 0.0


@dataclass(frozen=True, slots=True)
class LoadRefused:
    """The pattern cannot be loaded on this robot, or not with these parameters."""

    generation: int
    text: str


class Stepped(Struct, frozen=True, eq=False):
    """One step's outputs. `scan_seq`: the scan the step used, -1 for none."""

    generation: int
    outputs: Outputs
    scan_seq: int
    dropped: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class ParamsSet:
    """The answer to SetParams: all parameters now in force; none if it was refused.

    `text`: why it was refused, or a note for the operator.
    """

    generation: int
    request: str
    text: str
    params: Mapping[str, tuple[Scalar | None, str]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class PatternFailed:
    """A step raised; the pattern is not to be stepped again."""

    generation: int
    text: str


@dataclass(frozen=True, slots=True)
class HostDied:
    """The host has ended, whatever it was doing."""

    generation: int
    text: str


@dataclass(frozen=True, slots=True)
class TrialDone:
    """How a trial went: `text` is empty if the pattern can be loaded, else it says why not."""

    generation: int
    text: str


HostCommand = Load | Step | SetParams | KillHost | StartTrial | CancelTrial
HostEvent = Loaded | LoadRefused | Stepped | ParamsSet | PatternFailed | HostDied | TrialDone
