"""A live simulated world on the page: true positions, walls and boxes, and the fleet's states."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from swarmd.core.values import Array
from swarmd.operator.session.operator import Operator
from swarmd.operator.view.live import Describe, LiveSource
from swarmd.operator.view.source import ShownRobot, link_of
from swarmd.sim.live.fleet import Fleet
from swarmd.sim.live.link import WorldView
from swarmd.sim.live.state import WorldState
from swarmd.sim.view.shown import links_within, shown_arena
from swarmd.sim.world.arena import parse_arena


class WorldSource(LiveSource):
    """A running world as a `Source` (operator/view/source.py), with positions of the world, not
    odometry."""

    kind = "world"

    def __init__(
        self,
        operator: Operator,
        patterns: Sequence[str],
        fleet: Fleet,
        world: WorldView,
        describe: Describe | None = None,
    ) -> None:
        super().__init__(operator, patterns, describe)
        spec = fleet.spec
        scenario = None if spec.live is None else spec.live.scenario
        arena = parse_arena(spec.arena) if scenario is None else scenario.arena
        self.arena = shown_arena(arena, () if scenario is None else scenario.fields)
        self._shapes = {name: box.shape for name, box in arena.movable_boxes}
        self._shapes |= {item.name: item.shape for item in arena.items}
        self._radio_range = spec.radio_range if scenario is None else scenario.radio.range
        self._state: WorldState | None = None
        self.link = link_of(spec.platforms().values())
        for name, kind in spec.platforms().items():
            self._platforms[kind.name] = kind
            self._index[name] = len(self._robots)
            shown = ShownRobot(name, self._index[name], kind.name, kind.footprint)
            self._robots.append(shown)
        world.watch(self._on_state)

    def frame(self) -> tuple[float, Array]:
        """The simulated time and the true poses."""
        state = self._state
        if state is None:
            return 0.0, np.zeros((0, 4))
        rows = [
            (self._index[name], *pose)
            for name, pose in zip(state.ids, state.poses, strict=True)
            if name in self._index
        ]
        return state.time, np.array(rows, dtype=np.float64).reshape(-1, 4)

    def rows(self) -> Mapping[str, Mapping[str, Any]]:
        """The last status of each robot, and what it touches; `at` in simulated time."""
        touched: dict[str, str] = {}
        now = 0.0 if self._state is None else self._state.time
        for a, b in () if self._state is None else self._state.touching:
            touched[a] = b
            touched[b] = a
        return {
            name: {
                **row,
                "touches": touched.get(name, ""),
                **({"at": round(row["at"] + now - time.monotonic())} if "at" in row else {}),
            }
            for name, row in super().rows().items()
        }

    def detail(self, name: str) -> Mapping[str, Any] | None:
        """As of a live swarm, with the faults of the robot that are on."""
        found = super().detail(name)
        faults = "" if self._state is None else self._state.faults.get(name, "")
        if found is None or not faults:
            return found
        return {**found, "sections": [["Simulation", [("faults", faults)]], *found["sections"]]}

    def boxes(self) -> Sequence[tuple[Array, Sequence[float]]]:
        """The movable boxes in the arena."""
        boxes = {} if self._state is None else self._state.boxes
        return [(self._shapes[name], pose) for name, pose in boxes.items() if name in self._shapes]

    def links(self) -> Sequence[tuple[int, int]]:
        """Robots within the range of the radio; empty if each hears all."""
        _, places = self.frame()
        if self._radio_range is None:
            return ()
        return links_within(self._radio_range, places[:, 0], places[:, 1:3])

    def _on_state(self, state: WorldState) -> None:
        self._state = state
