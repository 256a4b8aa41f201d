"""The scenes in which protection is evaluated: a family, a platform, a visibility, a mode.

Each is the mapping of a scenario and is checked like a user's file. Realism is `realistic`, with
rolling scans, except for what a family changes; the seed draws the start poses. A new cell of the
evidence is one entry of `FAMILIES`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct, structs

from swarmd.core.errors import ConfigError, unknown
from swarmd.robot.protection.walls.walls_settings import LEAST_LENGTH_WITH_FOOT
from swarmd.settings.platforms import load_platform
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import scenario_of

PLUGINS = Path(__file__).parent / "plugins"
MIXED = ("burger", "waffle_pi", "jackal")
"""The kinds of robots in a mixed swarm."""
KINDS = (*MIXED, "turtlebot4", "rosbot_xl")
TURTLEBOTS = ("burger", "waffle_pi")
CREEPING = (*TURTLEBOTS, "turtlebot4", "rosbot_xl")
"""The kinds of robots that creep out beside a wall: without `keep_out` or a ring."""
PLATFORMS = (*KINDS, "mixed")
VISIBILITIES = ("body", "real")
MODES = (
    "barrier",
    "orca",
    "walls_stand",
    "walls_foot",
    "potential_field",
    "stop_zone",
    "off",
    "ghost",
)
_WALLS = ("walls_stand", "walls_foot")
ATTACKERS = "attackers"
"""The group of attacking robots, and the prefix of their platform."""
DEV_SEEDS, ACCEPTANCE_SEEDS = range(100), range(2000, 10_000)
"""Seeds for development, and seeds with which nothing was chosen: those from 1000 on have been
looked at by now."""

_LEAST_WALL = 0.5  # m, the default of `walls_stand.length`
_FOOT = 0.05  # m, `walls_stand.foot` of mode `walls_foot`, or `unseen_extent` if it is less
_MIXED_SPEED = 0.4  # m/s: the speed that all robots of a mixed swarm assume of others
_MIXED_KEEP_OUT = 0.92  # m: keeps robots out of a Jackal's blind zone


class Movers(Struct, frozen=True, kw_only=True):
    """Rectangles that attack by moving off from where they have stood, and back again.

    places: poses, x and y as shares of half the side of the room, and the heading in degrees.
    depth, width: m ahead and across. is_hinged: the right end of the rectangle is its axle.
    rests, moves: s. ahead, aside, turning: which part of the body's speed; a turning end has it.
    """

    places: Sequence[tuple[float, float, float]]
    depth: float
    width: float
    rests: float
    moves: float
    is_hinged: bool = False
    ahead: float = 0.0
    aside: float = 0.0
    turning: float = 0.0

    @property
    def footprint(self) -> list[list[float]]:
        """The corners in m, counter-clockwise."""
        x, low = 0.5 * self.depth, 0.0 if self.is_hinged else -0.5 * self.width
        high = low + self.width
        return [[-x, low], [x, low], [x, high], [-x, high]]


class Family(Struct, frozen=True, kw_only=True):
    """One kind of scene: what the protected robots do, who attacks them, and what is worse.

    pattern, parameters: of the protected robots; goals get the place of their arena.
    attack: how a third of the robots attacks (`plugins/attack.py`); empty: no attackers.
    movers: what attacks in place of that third.
    speed: that of the attackers' surfaces, as a multiple of `others_speed`.
    lidar, actuation: values over realism `realistic`. door: width of the opening of an inner wall
    through the middle, in bodies. poles: their radii in m. tells: whether attackers tell Jackals
    where they are. is_own: a pattern of the project, which avoids others. is_claimed: whether the
    claim of docs/safety.md covers it. beside: the protected robots start in pairs along the walls,
    so many m from the wall and from each other: nearer than a robot that does not creep leaves; 0:
    they start anywhere.
    """

    pattern: str = "goals"
    parameters: Mapping[str, Any] = {}
    attack: str = ""
    movers: Movers | None = None
    speed: float = 1.0
    lidar: Mapping[str, float] = {}
    actuation: Mapping[str, float] = {}
    door: float = 0.0
    poles: tuple[float, ...] = ()
    tells: bool = True
    is_own: bool = False
    is_claimed: bool = True
    beside: float = 0.0
    platforms: tuple[str, ...] = PLATFORMS
    visibilities: tuple[str, ...] = VISIBILITIES


_OPPOSITE = {"choice": "opposite"}
_THIN = (0.01, 0.02, 0.03)
_UNTOLD: Mapping[str, Any] = {
    "tells": False,
    "is_claimed": False,
    "platforms": ("jackal",),
    "visibilities": ("real",),
}
# Burgers, nose to tail and side by side: 14 cm deep, 17.8 cm wide.
_BODY = {"depth": 0.14, "width": 0.178, "rests": 15.0, "ahead": 1.0}


def _movers(**values: Any) -> dict[str, Any]:
    """A family of Burgers among movers, with full visibility."""
    return {
        "attack": "move_off",
        "movers": Movers(**values),
        "platforms": ("burger",),
        "visibilities": ("body",),
    }


def _line(count: int, pitch: float, heading: float) -> Sequence[tuple[float, float, float]]:
    """Places `pitch` m apart in a line along x, in a room of 4 m."""
    first = -0.5 * pitch * (count - 1)
    return [((first + pitch * i) / 2.0, -0.4, heading) for i in range(count)]


_SIDES = (0.0, 90.0, 180.0, -90.0)  # degrees, headings away from the four walls


def _at_walls(inset: float, along: float = 0.0) -> Sequence[tuple[float, float, float]]:
    """Places `inset` m from the middle of each wall and `along` m beside, in a room of 4 m."""
    places = []
    for side in _SIDES:
        cos, sin = np.cos(np.radians(side)), np.sin(np.radians(side))
        x, y = inset - 2.0, along
        places.append((float(cos * x - sin * y) / 2.0, float(sin * x + cos * y) / 2.0, side))
    return places


FAMILIES: Mapping[str, Family] = {
    "goals": Family(),
    "twists": Family(pattern="random_twists"),
    "swap": Family(parameters=_OPPOSITE),
    "rush": Family(parameters={"choice": "centre"}),
    "misuse": Family(pattern="misuse"),
    "doors": Family(parameters=_OPPOSITE, door=2.0, platforms=KINDS),
    "poles": Family(poles=_THIN * 4, platforms=TURTLEBOTS),
    "attraction": Family(pattern="attraction", is_own=True),
    "dispersion": Family(pattern="dispersion", is_own=True),
    "random_walk": Family(pattern="random_walk", is_own=True),
    "drive": Family(pattern="drive", is_own=True),
    "ram": Family(attack="ram"),
    "lead": Family(attack="lead"),
    "behind": Family(attack="behind"),
    "corner": Family(attack="corner"),
    "flank": Family(attack="flank"),
    "spin": Family(attack="spin"),
    "flank_twists": Family(pattern="random_twists", attack="flank"),
    "misuse_lead": Family(pattern="misuse", attack="lead"),
    "dropout_10": Family(attack="lead", lidar={"dropout": 0.1}, platforms=TURTLEBOTS),
    "dropout_30": Family(attack="lead", lidar={"dropout": 0.3}, platforms=TURTLEBOTS),
    "late_100": Family(attack="lead", lidar={"delay": 0.1}),
    "late_200": Family(attack="lead", lidar={"delay": 0.2}),
    "jitter_100": Family(attack="lead", lidar={"jitter": 0.1}),
    "ram_fast": Family(attack="ram", speed=1.5, is_claimed=False),
    "lead_fast": Family(attack="lead", speed=1.5, is_claimed=False),
    "behind_untold": Family(attack="behind", **_UNTOLD),
    "flank_untold": Family(attack="flank", **_UNTOLD),
    "weak_brakes": Family(
        attack="lead",
        actuation={"linear_acceleration": 0.7, "angular_acceleration": 2.1},
        is_claimed=False,
    ),
    # Robots that creep: two side by side at a wall, alone and from attackers.
    "creep_pairs": Family(pattern="random_twists", beside=0.05, platforms=CREEPING),
    "creep_ram": Family(pattern="random_twists", attack="ram", beside=0.05, platforms=CREEPING),
    "creep_flank": Family(pattern="random_twists", attack="flank", beside=0.05, platforms=CREEPING),
    # What protection may take for a wall, or for a part of one.
    "beside_wall": Family(
        **_movers(places=_at_walls(0.09), **{**_BODY, "rests": 4.0}, moves=3.0),
    ),
    "box_along_wall": Family(
        **_movers(places=_at_walls(0.16), depth=0.3, width=0.3, rests=4.0, moves=3.0, aside=1.0)
    ),
    "train": Family(**_movers(places=_line(6, 0.19, 0.0), **_BODY, moves=3.0)),
    "rank": Family(**_movers(places=_line(5, 0.228, 90.0), **_BODY, moves=4.0)),
    "train_close": Family(
        **_movers(places=_line(6, 0.15, 0.0), **_BODY, moves=3.0), is_claimed=False
    ),
    "rank_close": Family(
        **_movers(places=_line(5, 0.188, 90.0), **_BODY, moves=4.0), is_claimed=False
    ),
    "plates": Family(
        **_movers(
            places=[(-0.4, 0.0, 0.0), (0.4, 0.3, 90.0), (0.2, -0.5, 180.0)],
            depth=0.04,
            width=0.8,
            rests=4.0,
            moves=2.0,
            ahead=1.0,
        ),
        is_claimed=False,
    ),
    "panel": Family(
        **_movers(places=[(0.0, 0.0, 0.0)], depth=0.04, width=0.3, rests=4.0, moves=3.0, ahead=1.0),
        door=1.8,
        is_claimed=False,
    ),
    "leaf": Family(
        **_movers(
            places=[(0.0, -0.19, 0.0)],
            depth=0.04,
            width=0.76,
            rests=4.0,
            moves=4.0,
            is_hinged=True,
            turning=1.0,
        ),
        door=4.6,
        is_claimed=False,
    ),
    "sliding_door": Family(
        **_movers(
            places=[(0.02, 0.0, 0.0)], depth=0.04, width=0.8, rests=4.0, moves=3.0, aside=1.0
        ),
        door=4.4,
        is_claimed=False,
    ),
}
"""Each entry is a cell of the evidence, for each of its platforms and each visibility."""


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
    "turtlebot4": Room(8, 5.5, inset=0.6, reach=0.25, radius=2.0, clearance=0.3),
    "rosbot_xl": Room(8, 8.0, inset=0.7, reach=0.3, radius=3.0, clearance=0.5),
    "mixed": Room(9, 10.0, inset=1.2, reach=0.4, radius=3.5, clearance=1.0),
}
SPARSE: Mapping[str, Room] = {
    "burger": structs.replace(ROOMS["burger"], robots=6, side=6.0),
    "waffle_pi": structs.replace(ROOMS["waffle_pi"], robots=6, side=7.5),
    "jackal": structs.replace(ROOMS["jackal"], robots=6, side=15.0),
    "turtlebot4": structs.replace(ROOMS["turtlebot4"], robots=6, side=8.25),
    "rosbot_xl": structs.replace(ROOMS["rosbot_xl"], robots=6, side=11.0),
    "mixed": structs.replace(ROOMS["mixed"], robots=6, side=13.0),
}
"""More room for a robot: 6 m2 for a Burger instead of 1.6 m2."""


class Scene(Struct, frozen=True, order=True):
    """One scene; `mode` applies to all but the attackers."""

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
    def is_told(self) -> bool:
        """Whether robots tell where they are by range and bearing.

        Lidars of mixed swarms look over each other, and an attacker that follows a Jackal within
        its blind zone gives no return.
        """
        is_followed = self.platform == "jackal" and bool(self.of.attack) and self.of.tells
        return self.visibility == "real" and (self.platform == "mixed" or is_followed)

    @property
    def of(self) -> Family:
        """The family; ConfigError if there is none of this name."""
        if self.family not in FAMILIES:
            raise ConfigError(f"scene {self.name}: {unknown('family', self.family, FAMILIES)}")
        return FAMILIES[self.family]

    @property
    def attackers(self) -> int:
        """How many of each kind attack the others: a third, or the movers."""
        if self.of.movers is not None:
            return len(self.of.movers.places)
        each = self.room.robots // len(kinds_of(self.platform))
        return each // 3 if self.of.attack else 0

    @property
    def protected(self) -> int:
        """How many robots do not attack."""
        return self.room.robots - self.attackers * len(kinds_of(self.platform))


def scenario(scene: Scene) -> Scenario:
    """The scene as a scenario; ConfigError if there is no such scene."""
    family = scene.of
    for word, known in (
        ("platform", family.platforms),
        ("visibility", family.visibilities),
        ("mode", MODES),
    ):
        if getattr(scene, word) not in known:
            fault = unknown(word, getattr(scene, word), known)
            raise ConfigError(f"scene {scene.name}: {fault}")
    room = scene.room
    starts: dict[str, Any] = {"layout": "random", "clearance": room.clearance}
    if scene.family == "swap":
        starts = {"layout": "ring", "radius": room.radius}
    grants = {f"{ATTACKERS}-{kind}": "an attacker" for kind in kinds_of(scene.platform)}
    return scenario_of(
        {
            "name": scene.name,
            "duration": scene.duration,
            "trace_rate": 20.0,
            "lidar_visibility": scene.visibility,
            "realism": {"lidar": dict(family.lidar), "actuation": dict(family.actuation)},
            "radio": {"range_and_bearing": scene.is_told},
            "arena": _arena(scene),
            "fields": [
                {"kind": "linear", "name": "x", "slope": 1.0},
                {"kind": "linear", "name": "y", "slope": 1.0, "direction_deg": 90.0},
            ],
            "plugin_dir": str(PLUGINS),
            "platforms": _platforms(scene),
            "groups": _groups(scene),
            "start": starts,
            **({"accepts_faster": grants, "accepts_unseen": grants} if family.attack else {}),
        }
    )


def _arena(scene: Scene) -> dict[str, Any]:
    """The walls of a scene, a wall with an opening in its middle, and poles on two circles."""
    family, side = scene.of, scene.room.side
    arena: dict[str, Any] = {"size": [side, side]}
    if family.door:
        body = float(np.ptp(load_platform(scene.platform).footprint[:, 1]))
        half = family.door * body / 2.0
        arena["segments"] = [
            {"from": [0.0, sign * half], "to": [0.0, sign * side / 2.0]} for sign in (-1.0, 1.0)
        ]
    if family.poles:
        places = np.linspace(0.0, 2.0 * np.pi, len(family.poles), endpoint=False)
        away = side * np.resize((0.2, 0.35), len(places))
        arena["poles"] = [
            {"at": [float(d * np.cos(a)), float(d * np.sin(a))], "radius": radius}
            for a, d, radius in zip(places, away, family.poles, strict=True)
        ]
    return arena


def kinds_of(platform: str) -> tuple[str, ...]:
    """The kinds of robots in a scene's swarm."""
    return MIXED if platform == "mixed" else (platform,)


def _platforms(scene: Scene) -> dict[str, dict[str, Any]]:
    barrier: dict[str, Any] = {"unseen_extent": 0.0} if scene.visibility == "body" else {}
    if scene.mode in _WALLS:
        barrier |= {"walls_stand": _walls_stand(kinds_of(scene.platform), scene.mode, barrier)}
    if scene.platform == "mixed":
        barrier |= {"others_speed": _MIXED_SPEED}
        barrier |= {} if scene.is_told else {"keep_out": _MIXED_KEEP_OUT}
    found: dict[str, dict[str, Any]] = {}
    for kind in kinds_of(scene.platform):
        found[kind] = protected(kind, scene.mode, barrier)
        if scene.of.attack:
            attacker = _attacker(kind, attack_speed(scene, kind))
            if scene.of.movers is not None:
                attacker["footprint"] = scene.of.movers.footprint
            found[f"{ATTACKERS}-{kind}"] = attacker
    return found


def _walls_stand(kinds: Iterable[str], mode: str, barrier: Mapping[str, Any]) -> dict[str, float]:
    """The declaration that walls stand: these are longer than any of these kinds of robots.

    With mode `walls_foot` they are at least as long as a `foot` needs, and stick out by _FOOT m at
    most. `barrier`: further settings of all kinds.
    """
    platforms = [load_platform(kind) for kind in kinds]
    extents = [np.hypot(*np.ptp(platform.footprint, axis=0)) for platform in platforms]
    length = max(_LEAST_WALL, 1.1 * float(max(extents)))
    if mode != "walls_foot":
        return {"length": length}
    settings = [{**platform.protection["barrier"], **barrier} for platform in platforms]
    foot = min(_FOOT, *(float(one["unseen_extent"]) for one in settings))
    return {"length": max(LEAST_LENGTH_WITH_FOOT, length), "foot": foot}


def protected(kind: str, mode: str, barrier: Mapping[str, Any]) -> dict[str, Any]:
    """A platform under one of MODES, with these settings of the barrier.

    orca: the barrier with avoidance. walls_stand: the same, and walls that have stood are assumed
    to stand. walls_foot: the same, with a `foot`. ghost: no protection, and a body that others pass
    through.
    """
    avoiding = ("orca", *_WALLS)
    of_mode = "barrier" if mode in avoiding else "off" if mode == "ghost" else mode
    protection: dict[str, Any] = {"mode": of_mode}
    protection["avoidance"] = "orca" if mode in avoiding else "none"
    walls = {"walls_stand": _walls_stand((kind,), mode, barrier)} if mode in _WALLS else {}
    if barrier or walls:
        protection["barrier"] = {**walls, **barrier}
    found: dict[str, Any] = {"extends": kind, "protection": protection}
    if mode == "ghost":
        found["body"] = {"solid": 0}
        found["scan"] = {"near": "reported"}  # a robot around the lidar hides what was seen
    return found


def attack_speed(scene: Scene, kind: str) -> float:
    """The speed in m/s of the surfaces of the attackers of one kind."""
    assumed = load_platform(kind).protection["barrier"]["others_speed"]
    return scene.of.speed * float(_MIXED_SPEED if scene.platform == "mixed" else assumed)


def _attacker(kind: str, speed: float) -> dict[str, Any]:
    """The body of `kind`, which moves in any direction at `speed` and sees all that is near."""
    return {
        "extends": kind,
        "limits": {"linear": speed, "lateral": speed},
        "scan": {"rate": 20.0, "range_min": 0.05, "near": "reported"},
        "protection": {"mode": "off"},
    }


def _groups(scene: Scene) -> dict[str, dict[str, Any]]:
    kinds = kinds_of(scene.platform)
    count = scene.room.robots // len(kinds)
    groups: dict[str, dict[str, Any]] = {}
    for kind in kinds:
        groups[kind] = {
            "platform": kind,
            "count": count - scene.attackers,
            "prefix": kind.partition("_")[0],
            "pattern": scene.of.pattern,
            "parameters": _parameters(scene),
        }
        if scene.of.beside:
            poses = _pairs(scene, kind, count - scene.attackers)
            groups[kind]["start"] = {"layout": "list", "poses": poses}
        if scene.attackers:
            groups[f"{ATTACKERS}-{kind}"] = {
                "platform": f"{ATTACKERS}-{kind}",
                "count": scene.attackers,
                **_attack(scene, attack_speed(scene, kind)),
            }
    return groups


def _pairs(scene: Scene, kind: str, count: int) -> list[list[float]]:
    """Poses of robots in pairs along the walls, nose to tail, from one wall to the next."""
    rear, front = np.sort(load_platform(kind).footprint[:, 0])[[0, -1]]
    left = float(load_platform(kind).footprint[:, 1].max())
    half = 0.5 * scene.room.side
    beside = scene.of.beside
    length = float(front - rear)
    poses = []
    for robot in range(count):
        pair, second = divmod(robot, 2)
        wall = pair % len(_SIDES)
        row = pair // len(_SIDES)
        along = (0.5 - second) * (length + beside) + 3.0 * row * length
        cos = np.cos(np.radians(_SIDES[wall]))
        sin = np.sin(np.radians(_SIDES[wall]))
        x = half - beside - left
        y = along - 0.5 * float(front + rear)
        poses.append([float(cos * x - sin * y), float(sin * x + cos * y), _SIDES[wall] - 90.0])
    return poses


def _attack(scene: Scene, speed: float) -> dict[str, Any]:
    """Pattern, parameters and starts of attackers that move at `speed` m/s."""
    movers = scene.of.movers
    if movers is None:
        return {"pattern": "attack", "parameters": {"speed": speed, "way": scene.of.attack}}
    half = 0.5 * scene.room.side
    turning = movers.turning * speed / movers.width
    return {
        "pattern": "move_off",
        "parameters": {
            "rests": movers.rests,
            "moves": movers.moves,
            "linear": movers.ahead * speed,
            "lateral": movers.aside * speed,
            "angular": turning,
        },
        "start": {
            "layout": "list",
            "poses": [[half * x, half * y, heading] for x, y, heading in movers.places],
        },
    }


def _parameters(scene: Scene) -> dict[str, Any]:
    """The parameters of the robots that do not attack."""
    room, family = scene.room, scene.of
    if family.pattern != "goals":
        return dict(family.parameters)
    size = room.side - 2.0 * room.inset
    return {"length": size, "width": size, "reach": room.reach, **family.parameters}
