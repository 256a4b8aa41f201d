"""Messages between the daemon and its pattern host.

The tagged structs cross the socket (`swarmd.pattern_host.wire`). Each message carries the
generation of its run; messages of another generation are dropped.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from msgspec import Meta, Struct

from swarmd.core.errors import (
    ChangedCodeError,
    MissingSensorError,
    ParameterError,
    UnknownPatternError,
)
from swarmd.core.messages import Refusal
from swarmd.core.values import Inputs, Outputs, Platform, Scalar, TouchZone, Value

MAX_SCAN_DELAY = 0.5
"""The largest `scan_delay` of a pattern: seconds by which scans may arrive later than the
platform's latency."""

Layers = tuple[tuple[str, Mapping[str, Value]], ...]
ParamSources = Mapping[str, tuple[Scalar | None, str]]
"""Parameters by name: the value, and the layer that it comes from."""

REQUEST_LAYER = "request"
"""The source of parameters that came with a request: the strongest of `Load.layers`."""


class Load(Struct, frozen=True, eq=False, array_like=True, tag="load"):
    """Load a pattern."""

    generation: int
    pattern: str
    layers: Layers  # parameters by source, weakest first, above the pattern's defaults
    robot: str
    platform: Platform
    seed: int
    is_fresh: bool = False  # load in a new host, because the present host hangs
    # The first of these conditions to hold ends the run (`swarmd.kit.conditions`).
    until: tuple[str, ...] = ()
    # By pattern (module:Class or path, whether that is a file); the runner fills the mapping in.
    origins: Mapping[str, tuple[str, bool]] = {}
    is_restart: bool = False  # of a pattern that failed, with the code that it ran
    digests: Mapping[str, bytes] = {}  # the SHA-256 of the code of pushed patterns, by pattern


class Step(Struct, frozen=True, eq=False, array_like=True, tag="step"):
    """Step the loaded pattern once."""

    generation: int
    inputs: Inputs


class SetParams(Struct, frozen=True, eq=False, array_like=True, tag="set"):
    """Change parameters of the loaded pattern between two steps."""

    generation: int
    request: str
    values: Mapping[str, Value]


class KillHost(Struct, frozen=True):
    """End the host; the next Load starts a fresh one."""


class StartTrial(Struct, frozen=True, eq=False):
    """Load a pattern in a new process beside the host, to test whether the code can be loaded.

    `load.generation` numbers the trial. The pattern is not stepped, and its process ends with the
    trial.
    """

    load: Load


class CancelTrial(Struct, frozen=True):
    """End the trial under way; no TrialDone follows."""


class Loaded(Struct, frozen=True, eq=False, array_like=True, tag="loaded"):
    """The pattern is loaded and can be stepped."""

    generation: int
    rate: Annotated[float, Meta(ge=0.1, le=1000.0)]  # steps per second
    channels: frozenset[str]
    params: ParamSources
    touches: TouchZone | None = None  # the zone in which the pattern asks to touch obstacles
    took: Annotated[float, Meta(ge=0.0, le=1e6)] = 0.0  # s that the load took
    note: str = ""  # requested speeds that the base cannot reach
    # The pattern is not held while scans are late, beyond the platform's latency, by at most this
    # time in s.
    scan_delay: Annotated[float, Meta(ge=0.0, le=MAX_SCAN_DELAY)] = 0.0
    needs_places: bool = False  # the pattern, or the end of its run, needs the places of peers


class LoadRefused(Struct, frozen=True, array_like=True, tag="refused"):
    """The pattern cannot be loaded on this robot, or not with these parameters.

    `parameter`: the name of the parameter that is wrong, if one is.
    """

    generation: int
    text: str
    refusal: Refusal = Refusal.PATTERN_FAILED
    parameter: str = ""


class Stepped(Struct, frozen=True, eq=False, array_like=True, tag="stepped"):
    """Outputs of one step. `scan_seq`: the scan that the step used, -1 without a scan.

    `dropped`: count of received messages left out because their value lacks the channel's type.
    """

    generation: int
    outputs: Outputs
    scan_seq: Annotated[int, Meta(ge=-1, le=2**53)]
    dropped: Annotated[int, Meta(ge=0, le=10_000)] = 0


class ParamsSet(Struct, frozen=True, eq=False, array_like=True, tag="params"):
    """Answer to SetParams: all parameters now in force; empty if the change was refused.

    `text`: the reason of the refusal, or a note for the operator.
    """

    generation: int
    request: str
    text: str
    params: ParamSources = {}


class PatternFailed(Struct, frozen=True, array_like=True, tag="failed"):
    """A step raised; the pattern must not be stepped again."""

    generation: int
    text: str


class HostDied(Struct, frozen=True, array_like=True, tag="died"):
    """The host process has ended by itself."""

    generation: int
    text: str


class TrialDone(Struct, frozen=True, array_like=True, tag="trial"):
    """Result of a trial: `text` is empty if the pattern could be loaded, else the reason."""

    generation: int
    text: str
    refusal: Refusal = Refusal.PATTERN_FAILED


# What crosses the socket; the daemon's runner answers the others itself.
SentCommand = Load | Step | SetParams
SentEvent = Loaded | LoadRefused | Stepped | ParamsSet | PatternFailed

HostCommand = SentCommand | KillHost | StartTrial | CancelTrial
HostEvent = SentEvent | HostDied | TrialDone


def refusal_of(error: Exception) -> Refusal:
    """The refusal code for an error in the load of a pattern."""
    if isinstance(error, ParameterError):
        return Refusal.INVALID_PARAMETER
    if isinstance(error, UnknownPatternError):
        return Refusal.UNKNOWN_PATTERN
    if isinstance(error, MissingSensorError):
        return Refusal.MISSING_SENSOR
    if isinstance(error, ChangedCodeError):
        return Refusal.CHANGED_CODE
    return Refusal.PATTERN_FAILED
