"""A scenario: everything about a run but its seed, checked and complete."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from swarmd.core.host_messages import Layers
from swarmd.core.values import Array, Platform, Scalar, TouchZone
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.lidar import Visibility
from swarmd.sim.world.radio import RadioSettings
from swarmd.sim.world.realism import Realism
from swarmd.sim.world.scalar_fields import Field

Action = Literal[
    "run", "stop", "estop", "reset", "join", "leave", "kill", "place", "remove", "param"
]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScheduledEvent:
    """What happens at `at` s of simulation.

    To `robots` for run (with `pattern`, `parameters` and perhaps `seconds` and `until`), param
    (`parameters`), stop, estop, reset, join, leave and kill; to the box `box` for place (at
    `pose` x, y in m, yaw in rad); to the box `box`, or to `robots` if it is empty, for remove.
    """

    at: float
    action: Action
    robots: tuple[str, ...] = ()
    pattern: str = ""
    parameters: Mapping[str, Scalar | None] = field(default_factory=dict)
    seconds: float | None = None
    until: tuple[str, ...] = ()
    box: str = ""
    pose: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scenario:
    """A run but for its seed.

    `robots`: platform by id, in the order of a trace's rows. `starts(seed)` gives start poses
    (n, 3) x, y in m and yaw in rad; ConfigError if they cannot be. `groups`: ids by group name.
    `absent`: ids whose daemon is not there until an event lets it join; their bodies stand at
    their start poses. `layers(robot, pattern)` are the parameters configured beside those of a
    run, `touch[robot]` where which pattern may touch what is near. `events` in order of time.
    `effective` is the configuration in plain values, complete and after all overrides:
    `scenario_of(effective)` is the same scenario again.
    """

    name: str
    description: str
    duration: float
    robots: Mapping[str, Platform]
    groups: Mapping[str, tuple[str, ...]]
    starts: Callable[[int], Array]
    arena: Arena
    fields: tuple[Field, ...]
    realism: Realism
    visibility: Visibility
    radio: RadioSettings
    layers: Callable[[str, str], Layers]
    events: tuple[ScheduledEvent, ...]
    absent: frozenset[str] = frozenset()
    touch: Mapping[str, Mapping[str, TouchZone]] = field(default_factory=dict)
    trace_rate: float = 10.0
    plugin_dir: Path | None = None
    effective: Mapping[str, Any] = field(default_factory=dict)
