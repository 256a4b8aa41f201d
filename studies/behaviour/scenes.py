"""The scenes of the ledger: each pattern's own scenario, and parts that change how robots drive."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 10.0
SEED = 1


class Scene(msgspec.Struct, frozen=True):
    """A scenario with overrides, of which a part is simulated."""

    scenario: str | dict[str, Any]
    """The name of a scenario, or its contents."""
    set: dict[str, Any] = {}
    """Overrides by dotted key."""
    seconds: float = SECONDS
    """The simulated part; events behind it do not happen."""


_AT_REST = frozenset(
    {
        *("best_of_n", "cross_inhibition", "firefly_synchronization", "hop_gradient"),
        *("majority_rule", "response_threshold", "trimmed_consensus", "voter_model"),
    }
)
"""Patterns whose scenarios have 25 robots that stand: a second of these takes 0.1 s."""


def _patterns() -> dict[str, Scene]:
    """The own scenario of each pattern, by its name."""
    names = sorted(path.parent.name for path in ROOT.glob("patterns/*/scenario.yaml"))
    return {
        name: Scene(name, seconds=SECONDS / 2.0 if name in _AT_REST else SECONDS) for name in names
    }


def _walkers(**more: Any) -> dict[str, Any]:
    """Three Burgers that walk randomly in a small arena."""
    return {
        "arena": {"size": [3.0, 3.0]},
        "groups": {"tb3": {"platform": "burger", "count": 3, "pattern": "random_walk"}},
        "start": {"layout": "grid", "spacing": 0.8},
        **more,
    }


_FENCE = {
    "frame": "world",
    "polygon": [[-1.3, -1.3], [1.3, -1.3], [1.3, 1.3], [-1.3, 1.3]],
    "keep_out": [[[0.6, 0.6], [1.0, 0.6], [1.0, 1.0]]],
}
_FAULTS = (
    {"scan": "noise", "sd": 0.05},
    {"scan": "late", "delay": 0.2},
    {"odometry": "scale", "factor": 1.2},
    {"base": "weak_brakes", "linear": 0.5},
    {"base": "late", "seconds": 0.2},
)
"""One after the other, for 1.5 s each."""


_CORRIDOR = {
    "arena.boxes": [{"at": [0.0, side * 1.1725], "size": [0.6, 2.0]} for side in (1.0, -1.0)],
    "platforms.burger.protection.barrier.walls_stand": None,
}
"""A corridor of 2.5 bodies, 0.6 m long; no wall is assumed to stand."""


def _mode(mode: str) -> Scene:
    platform = {"extends": "burger", "protection": {"mode": mode}}
    return Scene(_walkers(platforms={"burger": platform}))


SCENES: Mapping[str, Scene] = MappingProxyType(
    {
        **_patterns(),
        "protection barrier": _mode("barrier"),
        "protection potential_field": _mode("potential_field"),
        "protection off": _mode("off"),
        "fence": Scene(_walkers(fence=_FENCE)),
        "walls that stand": Scene("doorway"),
        "two that meet in a corridor": Scene("doorway", _CORRIDOR, seconds=30.0),
        "faults": Scene(
            _walkers(
                events=[
                    {"at": 1.0 + 1.5 * number, "fault": fault, "robots": "all", "for": 1.5}
                    for number, fault in enumerate(_FAULTS)
                ]
            )
        ),
        "robots that join, leave and stop": Scene(
            _walkers(
                events=[
                    {"at": 2.0, "leave": "tb3-01"},
                    {"at": 4.0, "estop": "all"},
                    {"at": 5.0, "reset": "all"},
                    {"at": 5.5, "run": "attraction"},
                    {"at": 7.0, "kill": "tb3-02"},
                ]
            )
        ),
        "mission search_gather_decide_disperse": Scene("search_gather_decide_disperse"),
        "mission patrol_without_leader": Scene("patrol_without_leader"),
        "without kin": Scene("paper_exp1_hardware_free", {"groups.all.parameters.kin": False}),
        "kin": Scene("paper_exp1_hardware_free", {"groups.all.parameters.kin": True}),
        "mixed platforms": Scene("mixed_real", seconds=5.0),
        "a base that moves sideways": Scene(
            _walkers(groups={"xl": {"platform": "rosbot_xl", "count": 2, "pattern": "random_walk"}})
        ),
    }
)
