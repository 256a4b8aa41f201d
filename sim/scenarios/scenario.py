"""A scenario: a complete, checked description of a run except its seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from swarmd.core.values import Array, Platform, Scalar
from swarmd.settings.robot_settings import PatternParameters, RobotSettings
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.faults import FaultKind
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
    "fault",
    "mend",
]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScheduledEvent:
    """An action at `at` s of simulation.

    - run: on `robots`, with `pattern` and `parameters`, and optionally `seconds` and `until`.
    - param: on `robots`, with `parameters`.
    - stop, estop, reset, join, leave, kill: on `robots`.
    - place: on the box `box`, at `pose` (x, y in m, yaw in rad).
    - remove: on the box `box`, or on `robots` without a box.
    - fields: the fields in `fields` replace the fields of the same names.
    - fault, mend: `fault` begins or ends on `robots`.
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
    fault: FaultKind | None = None

    @property
    def text(self) -> str:
        """The action with its pattern, box or fault, such as `fault scan frozen`."""
        more = self.pattern or self.box or (self.fault.text if self.fault else "")
        return f"{self.action} {more}".rstrip()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scenario:
    """A run except its seed."""

    name: str
    description: str
    duration: float  # s
    # Platform by id, in the order of ids, which is that of a trace's rows: the order of a file has
    # no effect.
    robots: Mapping[str, Platform]
    groups: Mapping[str, tuple[str, ...]]  # ids by group name
    # Start poses (n, 3) x, y in m and yaw in rad by seed; ConfigError without room.
    starts: Callable[[int], Array]
    arena: Arena
    fields: tuple[Field, ...]
    items: tuple[ItemKind, ...] = ()
    realism: Realism
    visibility: Visibility
    radio: RadioSettings
    # By robot, the configured parameters of its patterns, below those of a run.
    parameters: Mapping[str, PatternParameters] = field(default_factory=dict)
    settings: Mapping[str, RobotSettings] = field(default_factory=dict)  # by robot
    events: tuple[ScheduledEvent, ...]  # in order of time
    # Ids without a daemon until a join event; their bases stand at their start poses.
    absent: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()  # a line for each pair of platforms that fits only by exceptions
    trace_rate: float = 10.0
    plugin_dir: Path | None = None
    # The bounds by key within which each seed draws.
    pseudo_reality: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    # The complete configuration in plain values after all overrides: `scenario_of(effective)` gives
    # the same scenario.
    effective: Mapping[str, Any] = field(default_factory=dict)
