"""The faults that are on in a world, and their effect where data pass."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from swarmd.core.angles import wrap
from swarmd.core.values import Array, Odometry, Platform, Pose, Scan, Twist
from swarmd.sim.world.faults import ActiveFault, FaultKind
from swarmd.sim.world.seeding import generator

Flight = tuple[float, float, list[int], int, str, Any]
"""A message in transit: time of arrival in s, rank, rows of the receivers, row of the sender, name
and value of any type. Of messages that arrive at one instant, those of lower rank arrive first."""


@dataclass(slots=True)
class ActiveFaults:
    """The faults that are on, of robots `ids` with `platforms` in the order of rows."""

    ids: Sequence[str]
    seed: int
    platforms: Sequence[Platform] = ()
    step: float = 0.0
    """s of a step of the world."""
    value_of: Callable[[Platform, str], float] = lambda platform, key: platform.body[key]
    """Of the body of a platform by key, as of `bodies.value`."""
    _active: dict[tuple[str, int], dict[str, ActiveFault]] = field(default_factory=dict)
    """By place and row, then by kind."""
    _chains: dict[int, tuple[Odometry, Pose]] = field(default_factory=dict)
    """The last true reading of each robot that has or had a fault of odometry, and its own pose."""
    _draws: dict[int, np.random.Generator] = field(default_factory=dict)

    def begin(self, kind: FaultKind, rows: Iterable[int], now: float) -> None:
        """Begin a fault of robots `rows` at `now` s."""
        for row in rows:
            rng = generator(self.seed, kind.text, self.ids[row])
            platform = self.platforms[row]
            body = partial(self.value_of, platform)
            fault = ActiveFault(kind, platform, body, rng, now, self.step)
            self._active.setdefault((kind.place, row), {})[kind.text] = fault

    def end(self, kind: FaultKind, rows: Iterable[int]) -> None:
        """End the fault of this kind, whatever its parameters, of robots `rows`."""
        for row in rows:
            active = self._active.get((kind.place, row), {})
            active.pop(kind.text, None)
            if not active:
                self._active.pop((kind.place, row), None)

    @property
    def have_effect(self) -> bool:
        """Whether a fault is on, or one of odometry has shifted a pose."""
        return bool(self._active or self._chains)

    def rows(self, place: str) -> list[int]:
        """The robots that have a fault at a place, in order."""
        return sorted(row for one, row in self._active if one == place) if self._active else []

    def texts(self) -> dict[str, str]:
        """The faults of each robot that has any, as `scan frozen, radio mute`."""
        found: dict[str, list[str]] = {}
        for (_, row), active in self._active.items():
            found.setdefault(self.ids[row], []).extend(active)
        return {robot: ", ".join(texts) for robot, texts in found.items()}

    def _at(self, place: str, row: int) -> Iterable[tuple[Any, ActiveFault]]:
        """The kinds that are on at a place of a robot, in the order of their begins."""
        return [(fault.kind, fault) for fault in self._active.get((place, row), {}).values()]

    def scan(self, row: int, scan: Scan) -> tuple[Scan | None, float]:
        """The scan that the lidar sends in place of `scan`, and its further delay in s."""
        seen: Scan | None = scan
        delay = 0.0
        for kind, fault in self._at("scan", row):
            seen = None if seen is None else kind.seen(seen, fault)
            delay += kind.delay
        return seen, delay

    def odometry(self, row: int, reading: Odometry) -> Odometry:
        """The reading that the odometry gives in place of `reading`."""
        if row not in self._chains and ("odometry", row) not in self._active:
            return reading
        last, own = self._chains.get(row, (reading, reading.pose))
        pose = reading.pose
        twist = reading.twist
        turn = wrap(pose.yaw - last.pose.yaw)
        # Ahead and to the left of the mean heading, as a complex number.
        way = complex(pose.x - last.pose.x, pose.y - last.pose.y)
        way *= cmath.rect(1.0, -last.pose.yaw - turn / 2.0)
        speeds = (twist.linear, twist.angular, twist.lateral)
        motion = np.array(((way.real, turn, way.imag), speeds))
        for kind, fault in self._at("odometry", row):
            motion = kind.measured(motion, reading.stamp - last.stamp, fault)
        (ahead, turn, left), speeds = motion.tolist()
        way = complex(ahead, left) * cmath.rect(1.0, own.yaw + turn / 2.0)
        own = Pose(own.x + way.real, own.y + way.imag, wrap(own.yaw + turn))
        self._chains[row] = reading, own
        return Odometry(reading.stamp, own, Twist(*speeds))

    def command(self, row: int, command: Array) -> Array:
        """The command (3,) that the base follows in this step; call it at each step."""
        for kind, fault in self._at("base", row):
            command = kind.followed(command, fault)
        return command

    def _delay(self, sender: int, receiver: int, draw: Callable[[], float]) -> float:
        """Seconds that a message takes longer by the faults of both robots; inf: it is lost."""
        ends = ((sender, True), (receiver, False))
        return math.fsum(
            kind.delay(draw, is_sender=is_sender)
            for row, is_sender in ends
            for kind, _ in self._at("radio", row)
        )

    def reaches(self, sender: int, receiver: int) -> bool:
        """False if a fault cuts all messages from one robot to another."""
        return math.isfinite(self._delay(sender, receiver, lambda: 1.0))

    def flights(self, flights: Sequence[Flight]) -> list[Flight]:
        """The flights that faults leave, those of a receiver in their order."""
        found: list[Flight] = []
        for at, rank, receivers, sender, name, item in flights:
            # The sender's own generator, so that the number of processes has no effect.
            if sender not in self._draws:
                self._draws[sender] = generator(self.seed, "fault of radio", self.ids[sender])
            for receiver in receivers:
                late = self._delay(sender, receiver, self._draws[sender].random)
                if math.isfinite(late):
                    found.append((at + late, rank, [receiver], sender, name, item))
        return found

    def charge(self, row: int, reading: Mapping[str, float]) -> Mapping[str, float]:
        """The reading of the battery, a share, in place of `reading`."""
        charges = [kind.charge for kind, _ in self._at("battery", row)]
        return dict.fromkeys(reading, charges[-1]) if charges else reading

    def pose(self, row: int, pose: Array, now: float) -> Array:
        """The pose (3,) that the tracker measures in place of `pose` at `now` s."""
        for kind, fault in self._at("pose", row):
            pose = kind.tracked(pose, now, fault)
        return pose
