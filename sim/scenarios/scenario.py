"""A scenario: a complete, checked description of a run except its seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from swarmd.core.host_messages import Layers
from swarmd.core.values import Array, Platform, Scalar, TouchZone
from swarmd.protection.compatibility import ACCEPTS_NONE, Accepts
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.item_kind import ItemKind
from swarmd.sim.world.radio import RadioSettings
from swarmd.sim.world.realism import Realism
from swarmd.sim.world.scalar_fields import Field

if TYPE_CHECKING:
    from swarmd.sim.world.lidar import Visibility  # it imports MuJoCo

Action = Literal[
    "run",
    "stop",
    "estop",
    "reset",
    "join",
    "leave",
    "kill",
    "place",
    "remove",
    "fields",
    "param",
]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScheduledEvent:
    """An action at `at` s of simulation.

    On `robots` for run (with `pattern`, `parameters` and perhaps `seconds` and `until`), param
    (`parameters`), stop, estop, reset, join, leave and kill; to the box `box` for place (at
    `pose` x, y in m, yaw in rad); to the box `box`, or to `robots` if it is empty, for remove; for
    fields, `fields` take the place of all fields with their names.
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
    fields: tuple[Field, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scenario:
    """A run except its seed.

    `robots`: platform by id, in the order of ids, which is that of a trace's rows; the order of a
    file has no effect. `starts(seed)` gives start poses (n, 3) x, y in m and yaw in rad;
    ConfigError without room. `groups`: ids by group name. `absent`: ids without a daemon until a
    join event; their bases stand at their start poses. `layers(robot, pattern)` are the configured
    parameters, below those of a run; `touch[robot]` are the touch zones of patterns. `accepts`: the
    peers that robots accept. `notes`: a line for each pair of platforms that fits only by what the
    scenario says. `events` in order of time. `pseudo_reality`: the bounds by key within which each
    seed draws. `effective` is the complete configuration in plain values after all overrides:
    `scenario_of(effective)` gives the same scenario.
    """

    name: str
    description: str
    duration: float
    robots: Mapping[str, Platform]
    groups: Mapping[str, tuple[str, ...]]
    starts: Callable[[int], Array]
    arena: Arena
    fields: tuple[Field, ...]
    items: tuple[ItemKind, ...] = ()
    realism: Realism
    visibility: Visibility
    radio: RadioSettings
    layers: Callable[[str, str], Layers]
    events: tuple[ScheduledEvent, ...]
    absent: frozenset[str] = frozenset()
    touch: Mapping[str, Mapping[str, TouchZone]] = field(default_factory=dict)
    accepts: Accepts = ACCEPTS_NONE
    notes: tuple[str, ...] = ()
    trace_rate: float = 10.0
    plugin_dir: Path | None = None
    pseudo_reality: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    effective: Mapping[str, Any] = field(default_factory=dict)
