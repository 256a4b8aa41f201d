"""The radio between robots: range, line of sight, loss, delay and jitter."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct, structs

from swarmd.core.angles import wrap
from swarmd.core.errors import ConfigError
from swarmd.core.values import KIN, PLACES_BY_POSE, Array, Neighbor, Platform
from swarmd.sim.world.active_faults import ActiveFaults, Flight
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.delay_queue import DelayQueue
from swarmd.sim.world.exchanged_poses import ExchangedPoses
from swarmd.sim.world.geometry import Indices
from swarmd.sim.world.line_of_sight import LineOfSight
from swarmd.sim.world.seeding import generator

Seconds = Annotated[float, Meta(ge=0.0, le=60.0)]
Arrival = tuple[int, int, str, Any]

NEIGHBORS_RATE = 2.0
"""Hz at which a robot learns its neighbors without range and bearing."""
_BEARINGS_RATE = 10.0  # the same with range-and-bearing boards, or with poses in a shared frame

# Errors of range-and-bearing boards: our choice, of the order that their makers report.
_DISTANCE_SD = 0.02  # m
_DISTANCE_SHARE = 0.02
_ANGLE_SD = math.radians(2.0)


class RadioSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The radio between robots.

    - `neighborhood`: robots hear `all` robots, or robots within `range` m.
    - `line_of_sight`: boxes, inner walls and poles between two robots block the radio.
    - `loss`: the share of messages that a receiver misses.
    - `delay`: s from sending to receiving.
    - `jitter`: the delay varies uniformly by up to this time in s, up and down.
    - `range_and_bearing`: the hardware also senses where the neighbors are.
    - `places`: `shared`: robots compute where their neighbors are, from poses in a shared frame
      that they send each other.
    """

    neighborhood: Literal["all", "range"] = "all"
    range: Annotated[float, Meta(ge=0.01, le=100_000.0)] | None = None
    line_of_sight: bool = False
    loss: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    delay: Seconds = 0.0
    jitter: Seconds = 0.0
    range_and_bearing: bool = False
    places: Literal["shared"] | None = None

    @property
    def has_places(self) -> bool:
        """True if robots know where their neighbors are."""
        return self.range_and_bearing or self.places is not None


def check_radio(settings: RadioSettings) -> None:
    """Raise ConfigError if the settings contradict each other."""
    if settings.neighborhood == "range" and settings.range is None:
        raise ConfigError("radio.range is missing; neighborhood: range wants one in m")
    if settings.neighborhood == "all" and settings.range is not None:
        raise ConfigError(
            f"radio.range is {settings.range:g}, but radio.neighborhood is all, which has none;"
            " set neighborhood: range, or range: null"
        )
    if settings.range_and_bearing and settings.places is not None:
        raise ConfigError(
            "radio.places is shared beside radio.range_and_bearing, which precedes it; set one of"
            " them (range_and_bearing: false, or places: null)"
        )
    if settings.jitter > settings.delay:
        raise ConfigError(
            f"radio.jitter is {settings.jitter:g}; expected at most radio.delay"
            f" ({settings.delay:g}): nothing arrives before it is sent"
        )


def needs_radio(settings: RadioSettings) -> bool:
    """True if messages may be lost, delayed or out of range, so that a radio must be simulated."""
    return structs.replace(settings, range_and_bearing=False, places=None) != RadioSettings()


def neighbors_rate(settings: RadioSettings) -> float:
    """Hz at which a robot learns its neighbors."""
    return _BEARINGS_RATE if settings.has_places else NEIGHBORS_RATE


def with_bearings(platform: Platform) -> Platform:
    """The platform of a robot that knows where its neighbors are."""
    return replace(platform, provides=(platform.provides | PLACES_BY_POSE) - {KIN})


class Radio:
    """The radio of a swarm; equal seeds and equal calls give equal results.

    Arguments of the methods: `poses` (n, 3) of all robots, x, y in m and yaw in rad.
    `movable_boxes` (boxes, corners, 2): in m, NaN for a box outside the arena; used only with
    line_of_sight. No robot is its own neighbor.
    """

    def __init__(
        self, settings: RadioSettings, ids: Sequence[str], arena: Arena, *, seed: int
    ) -> None:
        """`ids` (n,) in the order of rows; ConfigError if the settings contradict each other."""
        check_radio(settings)
        self.settings = settings
        self._ids = tuple(ids)
        self._reach = math.inf if settings.range is None else settings.range
        self._sight = LineOfSight(arena) if settings.line_of_sight else None
        self._rank_rngs = [generator(seed, "rank", robot) for robot in ids]
        self._ranks: dict[int, tuple[float, float]] = {}  # by row: s of the last sending, its rank
        self._loss_rngs = [generator(seed, "radio", robot) for robot in ids]
        self._bearing_rngs = [generator(seed, "bearings", robot) for robot in ids]
        self._poses = None if settings.places is None else ExchangedPoses(ids, seed=seed)
        self._plain = [Neighbor(robot, 0.0) for robot in ids]
        self._in_flight: DelayQueue[tuple[list[int], int, str, Any]] = DelayQueue()
        self._all_others: dict[int, tuple[Neighbor, ...]] = {}
        self._all_rows: dict[int, Indices] = {}  # of the others
        self.faults = ActiveFaults(ids, seed)
        """Without any; the caller may set those of its world."""

    def measure_poses(self, rows: Iterable[int], poses: Array, now: float) -> None:
        """With `places`, measure the poses of robots `rows` in the shared frame at `now` s."""
        if self._poses is not None:
            self._poses.measure(rows, poses, now, self.faults.pose)

    def neighbors(
        self, row: int, poses: Array, movable_boxes: Array | None = None, *, now: float = 0.0
    ) -> tuple[Neighbor, ...]:
        """The neighbors of robot `row`, with their positions as the settings say.

        `now`: s, from which the ages of poses in a shared frame count (`measure_poses`).
        """
        found = self._neighbors(row, poses, movable_boxes, now)
        if not self.faults.rows("radio"):
            return found
        rows = {robot: index for index, robot in enumerate(self._ids)}
        return tuple(one for one in found if self.faults.reaches(rows[one.id], row))

    def _neighbors(
        self, row: int, poses: Array, movable_boxes: Array | None, now: float
    ) -> tuple[Neighbor, ...]:
        hears_all = math.isinf(self._reach) and self._sight is None
        if hears_all and not self.settings.has_places:
            return self._others(row)
        neighbors = self.hearers(row, poses, movable_boxes)
        if self._poses is not None:
            return self._poses.neighbors(row, neighbors.tolist(), now)
        if not self.settings.range_and_bearing:
            return tuple(self._plain[i] for i in neighbors.tolist())
        sensed = self._sense(row, neighbors, poses).tolist()
        return tuple(
            Neighbor(self._ids[i], 0.0, distance, wrap(bearing), wrap(heading))
            for i, (distance, bearing, heading) in zip(neighbors.tolist(), sensed, strict=True)
        )

    def _others(self, row: int) -> tuple[Neighbor, ...]:
        """All robots except `row`, as one cached tuple."""
        if row not in self._all_others:
            self._all_others[row] = (*self._plain[:row], *self._plain[row + 1 :])
        return self._all_others[row]

    def hearers(self, row: int, poses: Array, movable_boxes: Array | None = None) -> Indices:
        """The rows (k,) in radio contact with robot `row`, in order; the relation is symmetric."""
        if math.isinf(self._reach):
            if row not in self._all_rows:
                self._all_rows[row] = np.delete(np.arange(len(self._ids)), row)
            neighbors = self._all_rows[row]
        else:
            away = poses[:, :2] - poses[row, :2]
            is_near = np.hypot(away[:, 0], away[:, 1]) <= self._reach
            is_near[row] = False
            neighbors = np.flatnonzero(is_near)
        if self._sight is not None and len(neighbors):
            here = np.broadcast_to(poses[row, :2], (len(neighbors), 2))
            neighbors = neighbors[self._sight.is_clear(here, poses[neighbors, :2], movable_boxes)]
        return neighbors

    def send(
        self,
        row: int,
        name: str,
        value: Any,
        now: float,
        poses: Array,
        movable_boxes: Array | None = None,
    ) -> list[Flight]:
        """The flights of `value` on channel `name`, sent at `now` s by robot `row`.

        A flight is a message in transit, which arrives at all its receivers at one time. Without
        jitter all receivers share a flight; with jitter each receiver has a flight of its own. Hand
        the flights to `carry`. The receivers are the present neighbors of the sender, except those
        that miss the message by random loss.
        """
        # The sender's own generator: the messages of other robots do not change the losses.
        settings = self.settings
        rng = self._loss_rngs[row]
        receivers = self.hearers(row, poses, movable_boxes)
        if settings.loss > 0.0:
            receivers = receivers[rng.random(len(receivers)) >= settings.loss]
        rows = receivers.tolist()
        arrival = now + settings.delay
        rank = self._rank(row, now)
        if settings.jitter > 0.0:
            jitter = rng.uniform(-settings.jitter, settings.jitter, len(rows)).tolist()
            flights = [
                (arrival + offset, rank, [receiver], row, name, value)
                for offset, receiver in zip(jitter, rows, strict=True)
            ]
        else:
            flights = [(arrival, rank, rows, row, name, value)] if rows else []
        return self.faults.flights(flights) if self.faults.rows("radio") else flights

    def _rank(self, row: int, now: float) -> float:
        """The random rank of a sender at `now` s, which orders messages that arrive at one instant.

        All messages that a sender sends at one instant have one rank, so they stay in order.
        """
        last_sent, rank = self._ranks.get(row, (None, 0.0))
        if last_sent != now:
            rank = float(self._rank_rngs[row].random())
            self._ranks[row] = now, rank
        return rank

    def carry(
        self, flights: Iterable[Flight], own: Callable[[list[int]], list[int]] = lambda rows: rows
    ) -> None:
        """Put flights in transit; the flights of a sender must be in the order of sending.

        `own`: selects the receivers that this process simulates; by default all.
        """
        for at, rank, hearers, row, name, value in flights:
            self._in_flight.put(at, (own(hearers), row, name, value), rank)

    def due(self, now: float) -> list[tuple[list[int], int, str, Any]]:
        """Remove and return the messages that arrived by `now` s: (receivers, sender, name, value).

        Sorted by time of arrival, then by rank, then by order of sending.
        """
        return self._in_flight.due(now)

    def arrived(self, now: float) -> list[Arrival]:
        """As `due`, but by receiver: (receiver, sender, name, value), in the order of receivers."""
        return [
            (hearer, sender, name, value)
            for hearers, sender, name, value in self.due(now)
            for hearer in hearers
        ]

    def _sense(self, row: int, neighbors: Indices, poses: Array) -> Array:
        """Distance, bearing and heading (k, 3) of robots `neighbors` from robot `row`."""
        x, y = (poses[neighbors, :2] - poses[row, :2]).T
        yaw = poses[row, 2]
        off = self._bearing_rngs[row].standard_normal((len(neighbors), 3))
        distance = np.hypot(x, y)
        measured = distance + off[:, 0] * (_DISTANCE_SD + _DISTANCE_SHARE * distance)
        bearing = np.arctan2(y, x) - yaw + off[:, 1] * _ANGLE_SD
        heading = poses[neighbors, 2] - yaw + off[:, 2] * _ANGLE_SD
        return np.stack((np.maximum(measured, 0.0), bearing, heading), axis=-1)
