"""The settings of a robot: one record, which everything that has settings of robots carries whole.

The keys of swarm.yaml and of a scenario contain these keys. The robot of a daemon, of lockstep, of
a live world and of a replay gets the record as it is, and the head of a recording holds it. So a
new setting is a field here, the code that uses the field, and its page.

This module imports no numpy: swarmctl reads swarm.yaml, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Annotated, TypeAlias

from msgspec import Meta, Struct

from swarmd.core.bounds import BoundedScalar
from swarmd.core.low_battery import LowBatterySettings
from swarmd.kit.touch_config import TouchGrants
from swarmd.robot.protection.fence.fence_settings import FenceSettings

if TYPE_CHECKING:
    from swarmd.core.host_messages import Layers
    from swarmd.core.values import Platform
    from swarmd.robot.protection.fence.fence_pose import FencePose

PlatformName = Annotated[str, Meta(min_length=1, max_length=63)]
PlatformGrants = list[PlatformName] | dict[PlatformName, Annotated[str, Meta(max_length=256)]]
"""Platforms that are accepted, perhaps each with the reason."""
Parameters = dict[str, dict[str, BoundedScalar | None]]
"""Parameters by pattern and name."""
Fault: TypeAlias = tuple[tuple[str | int, ...], str]
_MAX_SOURCE_LENGTH = 64  # of a source in a status


class RobotSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The settings of a robot beside its platform.

    - `touch`: by pattern, the zone in which the pattern may touch obstacles.
    - `accepts_unseen`: platforms that the lidars of other robots do not see, since the rays pass
      above or below. Without this key a robot stands while it does not know where such a peer is;
      with the key it drives, and may collide with the peer.
    - `accepts_faster`: platforms that are faster than the barrier of other robots assumes. Without
      this key a robot stands while it has such a peer. Both keys: a list of platforms, or reasons
      by platform.
    - `fence`: the area in a shared frame that robots do not leave.
    - `on_low_battery`: what a running robot does when its battery is low. None: nothing.
    """

    touch: TouchGrants = {}
    accepts_unseen: PlatformGrants = []
    accepts_faster: PlatformGrants = []
    fence: FenceSettings | None = None
    on_low_battery: LowBatterySettings | None = None

    @classmethod
    def of(cls, keys: object) -> RobotSettings:
        """The settings among the attributes of `keys`, such as the keys of a whole file."""
        return cls(**{name: getattr(keys, name) for name in cls.__struct_fields__})

    def faults(self) -> Iterator[Fault]:
        """The faults of each section: the path of the key, and a text that follows it."""
        for key in self.__struct_fields__:
            section = getattr(self, key)
            if isinstance(section, Struct) and hasattr(section, "faults"):
                yield from (((key, *keys), text) for keys, text in section.faults())

    @property
    def layers(self) -> dict[str, FenceSettings]:
        """The settings of the layers of protection that bound commands, by key."""
        return {} if self.fence is None else {"fence": self.fence}

    def anchors(self, timeout: float) -> FencePose | None:
        """What finds the pose that layers need; None without such a layer.

        `timeout`: the age in s beyond which a pose is not used.
        """
        from swarmd.robot.protection.fence.fence_pose import FencePose  # it imports numpy

        return None if self.fence is None else FencePose(self.fence, timeout)

    def misfits(self, platform: Platform) -> Iterator[Fault]:
        """The faults, as of `faults`, that robots of this platform alone have."""
        from swarmd.robot.protection.fence.fence import fence_fault  # it imports numpy

        if self.fence is not None and (text := fence_fault(self.fence, platform)):
            yield ("fence",), text


class PatternParameters(Struct, frozen=True, kw_only=True):
    """The configured parameters of one robot's patterns, in layers, the weakest first.

    - `base`: layers that always apply, each with its source, such as `platform`.
    - `labels`: by label; each applies while the robot has the label, the last label strongest.
    - `own`: of this robot alone.
    """

    base: tuple[tuple[str, Parameters], ...] = ()
    labels: dict[str, Parameters] = {}
    own: Parameters = {}

    def layers(self, pattern: str, labels: Iterable[str]) -> Layers:
        """The layers of a pattern for a robot with `labels`, by source; empty ones are left out."""
        labelled = (
            (f"label {name}"[:_MAX_SOURCE_LENGTH], self.labels.get(name, {})) for name in labels
        )
        return tuple(
            (source, values)
            for source, parameters in (*self.base, *labelled, ("robot", self.own))
            if (values := parameters.get(pattern))
        )
