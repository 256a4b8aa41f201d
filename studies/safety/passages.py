"""Doors and corridors: robots that swap sides through an opening in a wall.

Each group starts in rows on its side and drives to the mirrored place and back. The straight way of
every robot leads through the middle of the opening.
"""

from __future__ import annotations

from typing import Any

from msgspec import Struct

from studies.safety.scenes import PLUGINS, protected
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import scenario_of

_SIDE = 4.0  # m, of the arena
_WALL = 0.02  # m, thickness of the wall of a door
_SPACING = 0.6  # m between the starts of neighbours


class Passage(Struct, frozen=True):
    """An opening of `width` m in a wall across the arena, `length` m deep: a door or a corridor.

    `left` and `right`: the number of robots on each side. `platform` with `barrier` settings that
    replace those of its file and one of the modes of scenes; the lidars see whole bodies or, with
    `visibility` real, what is in their plane.
    """

    width: float
    length: float = _WALL
    left: int = 1
    right: int = 0
    platform: str = "burger"
    visibility: str = "body"
    mode: str = "barrier"
    duration: float = 200.0
    recovery: bool = True
    barrier: dict[str, float] | None = None


def passage_scenario(passage: Passage) -> Scenario:
    """The scenario of robots that swap sides through a passage."""
    depth = 0.5 * (_SIDE - passage.width)
    middle = 0.5 * (passage.width + depth)
    walls = [{"at": [0.0, side * middle], "size": [passage.length, depth]} for side in (1.0, -1.0)]
    start = 0.5 * passage.length + 0.7
    barrier: dict[str, Any] = {"unseen_extent": 0.0} if passage.visibility == "body" else {}
    barrier |= passage.barrier or {}
    own = protected(passage.platform, passage.mode, barrier)
    return scenario_of(
        {
            "name": "passage",
            "duration": passage.duration,
            "trace_rate": 20.0,
            "lidar_visibility": passage.visibility,
            "realism": "realistic",
            "arena": {"size": [passage.length + _SIDE, _SIDE], "boxes": walls},
            "fields": [
                {"kind": "linear", "name": "x", "slope": 1.0},
                {"kind": "linear", "name": "y", "slope": 1.0, "direction_deg": 90.0},
            ],
            "plugin_dir": str(PLUGINS),
            "platforms": {passage.platform: own},
            "groups": {
                name: {
                    "platform": passage.platform,
                    "count": count,
                    "prefix": name,
                    "pattern": "goals",
                    "parameters": {
                        "choice": "opposite",
                        "reach": 0.2,
                        "recovery": passage.recovery,
                    },
                    "start": {"layout": "list", "poses": _poses(-side * start, count)},
                }
                for name, count, side in (
                    ("left", passage.left, 1.0),
                    ("right", passage.right, -1.0),
                )
                if count
            },
        }
    )


def _poses(x: float, count: int) -> list[list[float]]:
    """Poses in rows of two, the first near the opening, that face it."""
    heading = 0.0 if x < 0.0 else 180.0
    away = _SPACING if x > 0.0 else -_SPACING
    if count == 1:
        return [[x, 0.0, heading]]
    return [[x + away * (i // 2), _SPACING * (i % 2 - 0.5), heading] for i in range(count)]
