"""The scenes in which protection is evaluated: a family, a platform, a visibility, a mode.

Each is the mapping of a scenario and is checked like a user's file. Noise is `realistic`
throughout; the seed draws the start poses.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from msgspec import Struct, structs

from swarmd.core.errors import ConfigError, unknown
from swarmd.settings.platforms import load_platform
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import scenario_of

PLUGINS = Path(__file__).parent / "plugins"
ADVERSE = ("goals", "twists", "swap", "rush")
OWN = ("attraction", "dispersion", "random_walk", "drive")
RAM = "ram"
FAMILIES = (*ADVERSE, *OWN, RAM)
KINDS = ("burger", "waffle_pi", "jackal")
PLATFORMS = (*KINDS, "mixed")
VISIBILITIES = ("body", "real")
MODES = ("barrier", "reciprocal", "potential_field", "stop_zone", "off", "ghost")
RAMMERS = "rammers"
"""The group of ramming robots, and the prefix of their platform."""
DEV_SEEDS, ACCEPTANCE_SEEDS = range(100), range(2000, 10_000)
"""Seeds for development, and seeds with which nothing was chosen: those from 1000 on have been
looked at by now."""

_MIXED_SPEED = 0.4  # m/s: the speed that all robots of a mixed swarm assume of others
_MIXED_KEEP_OUT = 0.92  # m: keeps robots out of a Jackal's blind zone


class Room(Struct, frozen=True):
    """How many robots in a square of `side` m.

    Goals keep `inset` m from the walls and count within `reach` m; robots swap on a circle of
    `radius` m; no robot starts nearer than `clearance` m to anything.
    """

    robots: int
    side: float
    inset: float
    reach: float
    radius: float
    clearance: float


# A robot that is alone must be able to reach each goal: the potential field keeps obstacles 0.5 m
# (Jackal 1.2 m) away from the sensor, and the Jackal's lidar measures nothing within 0.8 m.
ROOMS: Mapping[str, Room] = {
    "burger": Room(10, 4.0, inset=0.4, reach=0.2, radius=1.5, clearance=0.2),
    "waffle_pi": Room(8, 5.0, inset=0.5, reach=0.25, radius=1.8, clearance=0.3),
    "jackal": Room(8, 12.0, inset=1.2, reach=0.4, radius=4.2, clearance=1.0),
    "mixed": Room(9, 10.0, inset=1.2, reach=0.4, radius=3.5, clearance=1.0),
}
SPARSE: Mapping[str, Room] = {
    "burger": structs.replace(ROOMS["burger"], robots=6, side=6.0),
    "waffle_pi": structs.replace(ROOMS["waffle_pi"], robots=6, side=7.5),
    "jackal": structs.replace(ROOMS["jackal"], robots=6, side=15.0),
    "mixed": structs.replace(ROOMS["mixed"], robots=6, side=13.0),
}
"""More room for a robot: 6 m2 for a Burger instead of 1.6 m2."""


class Scene(Struct, frozen=True, order=True):
    """One scene; `mode` applies to all but the ramming robots."""

    family: str
    platform: str
    visibility: str = "body"
    mode: str = "barrier"
    is_sparse: bool = False
    duration: float = 600.0

    @property
    def name(self) -> str:
        """Such as `goals-burger-body-barrier`."""
        words = (self.family, self.platform, self.visibility, self.mode)
        return "-".join((*words, "sparse") if self.is_sparse else words)

    @property
    def room(self) -> Room:
        """Where it happens, and how many take part."""
        return (SPARSE if self.is_sparse else ROOMS)[self.platform]

    @property
    def rammers(self) -> int:
        """How many of each kind ram the others: a third."""
        each = self.room.robots // len(kinds_of(self.platform))
        return each // 3 if self.family == RAM else 0

    @property
    def protected(self) -> int:
        """How many robots do not ram."""
        return self.room.robots - self.rammers * len(kinds_of(self.platform))


def scenario(scene: Scene) -> Scenario:
    """The scene as a scenario; ConfigError if there is no such scene."""
    for word, known in (
        ("family", FAMILIES),
        ("platform", PLATFORMS),
        ("visibility", VISIBILITIES),
        ("mode", MODES),
    ):
        if getattr(scene, word) not in known:
            fault = unknown(word, getattr(scene, word), known)
            raise ConfigError(f"scene {scene.name}: {fault}")
    room = scene.room
    starts: dict[str, Any] = {"layout": "random", "clearance": room.clearance}
    if scene.family == "swap":
        starts = {"layout": "ring", "radius": room.radius}
    return scenario_of(
        {
            "name": scene.name,
            "duration": scene.duration,
            "trace_rate": 20.0,
            "lidar_visibility": scene.visibility,
            "realism": "realistic",
            "arena": {"size": [room.side, room.side]},
            "fields": [
                {"kind": "linear", "name": "x", "slope": 1.0},
                {"kind": "linear", "name": "y", "slope": 1.0, "direction_deg": 90.0},
            ],
            "plugin_dir": str(PLUGINS),
            # Not all of a mixed swarm see each other.
            "radio": {
                "range_and_bearing": scene.platform == "mixed" and scene.visibility == "real"
            },
            "accepts_faster": [f"{RAMMERS}-{kind}" for kind in kinds_of(scene.platform)],
            "platforms": _platforms(scene),
            "groups": _groups(scene),
            "start": starts,
        }
    )


def kinds_of(platform: str) -> tuple[str, ...]:
    """The kinds of robots in a scene's swarm."""
    return KINDS if platform == "mixed" else (platform,)


def _platforms(scene: Scene) -> dict[str, dict[str, Any]]:
    barrier: dict[str, Any] = {"unseen_extent": 0.0} if scene.visibility == "body" else {}
    if scene.platform == "mixed":
        barrier |= {"others_speed": _MIXED_SPEED}
        barrier |= {"keep_out": _MIXED_KEEP_OUT} if scene.visibility == "body" else {}
    if scene.mode == "reciprocal":
        barrier |= {"responsibility": "reciprocal", "margin": 0.08}
    mode = {"reciprocal": "barrier", "ghost": "off"}.get(scene.mode, scene.mode)
    found: dict[str, dict[str, Any]] = {}
    for kind in kinds_of(scene.platform):
        own: dict[str, Any] = {"extends": kind, "protection": {"mode": mode}}
        if barrier:
            own["protection"]["barrier"] = barrier
        if scene.mode == "ghost":
            own["body"] = {"solid": 0}
        found[kind] = own
        if scene.family == RAM:
            found[f"{RAMMERS}-{kind}"] = {"extends": kind, "protection": {"mode": "off"}}
    return found


def _groups(scene: Scene) -> dict[str, dict[str, Any]]:
    kinds = kinds_of(scene.platform)
    count = scene.room.robots // len(kinds)
    groups: dict[str, dict[str, Any]] = {}
    pattern, parameters = _task(scene)
    for kind in kinds:
        groups[kind] = {
            "platform": kind,
            "count": count - scene.rammers,
            "prefix": kind.partition("_")[0],
            "pattern": pattern,
            "parameters": parameters,
        }
        if scene.rammers:
            barrier = load_platform(kind).protection["barrier"]
            speed = _MIXED_SPEED if scene.platform == "mixed" else barrier["others_speed"]
            groups[f"{RAMMERS}-{kind}"] = {
                "platform": f"{RAMMERS}-{kind}",
                "count": scene.rammers,
                "pattern": "ram",
                "parameters": {"surface_speed": float(speed)},
            }
    return groups


def _task(scene: Scene) -> tuple[str, dict[str, Any]]:
    """Pattern and parameters of the robots that do not ram."""
    room = scene.room
    size = room.side - 2.0 * room.inset
    where = {"length": size, "width": size, "reach": room.reach}
    tasks: Mapping[str, tuple[str, dict[str, Any]]] = {
        "goals": ("goals", where),
        RAM: ("goals", where),
        "swap": ("goals", {"choice": "opposite", "reach": room.reach}),
        "rush": ("goals", {"choice": "centre"}),
        "twists": ("random_twists", {}),
    }
    return tasks.get(scene.family, (scene.family, {}))
