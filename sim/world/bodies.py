"""The MuJoCo model of a world: walls, boxes, poles, and a planar body per robot and movable box.

A planar body slides along the world's x and y, and turns about the vertical through its AXLE
CENTRE, which is also its centre of mass. Measured: a planar body costs 4 to 7 times less than a
body with wheels, and follows commands better. Bodies collide as their footprints, extruded to one
common height, since all stand on one floor. A robot of a platform with `body: {solid: 0}` is a
ghost: other robots pass through the ghost, but the ghost collides with walls and boxes.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array, Heights, Platform
from swarmd.sim.world.arena import Arena, Box, Item

COLLISION, BODY, HOUSING, FIXED = range(4)
"""Geom groups: collision shapes; visible bodies and lidar housings at true height; the arena."""
SOLID_BIT = 1
GHOST_BIT = 2
"""Bits of collision types: solid robots collide with solid robots and the arena, ghosts with the
arena alone."""
ARENA_TYPE = SOLID_BIT | GHOST_BIT
"""The type of walls and boxes, which collide with all bodies."""

_BOX = mujoco.mjtGeom.mjGEOM_BOX
_CYLINDER = mujoco.mjtGeom.mjGEOM_CYLINDER
_HEIGHT = 0.5
# By default MuJoCo reserves memory for constraints of each joint with each other joint: 40 GB for
# 10,000 robots, which use 4 MB, or 36 MB of it with 3,000. The sizes below are reserved instead;
# reserved memory costs nothing until it is used.
_MANY = 1000  # robots
_MEMORY = 200_000  # bytes for each robot
_PAIR_MEMORY = 16  # bytes for each pair
# With few fixed shapes MuJoCo tests each robot with all of them faster than with a tree of shapes.
# A step of 30 robots takes 13 us, not 17, and 27 us both ways with 64 shapes. Contacts are equal.
_FEW_SHAPES = 40
_WALL = 0.1
# Impedance of dry friction: with the default of 0.9 a pushed box at rest creeps by 1 mm/s.
_STIFF = [0.9999, 0.9999, 0.001, 0.5, 2.0]


def build_model(robots: Mapping[str, Platform], arena: Arena, dt: float) -> mujoco.MjModel:
    """The compiled model; body i owns qpos and qvel 3i to 3i + 2: x, y, yaw.

    The robots come first, then the arena's movable boxes, then its pucks. Bodies are `robot/ID` and
    `box-body/NAME`.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = dt
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.gravity = [0.0, 0.0, 0.0]
    if len(robots) > _MANY:
        spec.memory = _MEMORY * len(robots) + _PAIR_MEMORY * len(robots) ** 2
    _add_arena(spec, arena)
    if len(arena.fixed) + len(arena.poles) < _FEW_SHAPES:
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
    for robot, platform in robots.items():
        body = _add_planar(spec, f"robot/{robot}", value(platform, "mass"), inertia(platform))
        _add_shapes(body, robot, platform)
    for name, box in arena.movable_boxes:
        _add_movable_box(spec, name, box)
    for item in arena.items:
        _add_item(spec, item)
    return spec.compile()


def _add_arena(spec: mujoco.MjSpec, arena: Arena) -> None:
    x = arena.length / 2.0
    y = arena.width / 2.0
    half = _WALL / 2.0
    for name, pos, size in (
        ("wall/west", (-x - half, 0.0), (half, y + _WALL)),
        ("wall/east", (x + half, 0.0), (half, y + _WALL)),
        ("wall/south", (0.0, -y - half), (x + _WALL, half)),
        ("wall/north", (0.0, y + half), (x + _WALL, half)),
    ):
        _add_box(spec.worldbody, name, pos, size)
    for name, box in arena.fixed:
        size = (box.length / 2.0, box.width / 2.0)
        geom = _add_box(spec.worldbody, name, (box.x, box.y), size)
        geom.quat = [np.cos(box.yaw / 2.0), 0.0, 0.0, np.sin(box.yaw / 2.0)]
    for index, pole in enumerate(arena.poles):
        shape = (pole.radius, _HEIGHT / 2.0, 0.0)
        _add_solid(spec.worldbody, f"pole/{index}", _CYLINDER, (pole.x, pole.y), shape)


def _add_box(
    body: mujoco.MjsBody, name: str, pos: tuple[float, float], size: tuple[float, float]
) -> mujoco.MjsGeom:
    return _add_solid(body, name, _BOX, pos, (*size, _HEIGHT / 2.0))


def _add_solid(
    body: mujoco.MjsBody,
    name: str,
    kind: mujoco.mjtGeom,
    pos: tuple[float, float],
    size: tuple[float, float, float],
) -> mujoco.MjsGeom:
    return body.add_geom(
        name=name,
        type=kind,
        pos=[*pos, _HEIGHT / 2.0],
        size=size,
        group=FIXED,
        condim=1,
        contype=ARENA_TYPE,
        conaffinity=SOLID_BIT,
    )


def _add_movable_box(spec: mujoco.MjSpec, name: str, box: Box) -> None:
    body = _add_planar(spec, f"box-body/{name}", box.mass or 0.0, moment(box))
    for joint in body.joints:
        joint.solimp_friction = _STIFF
    _add_box(body, f"box/{name}", (0.0, 0.0), (box.length / 2.0, box.width / 2.0))


def _add_item(spec: mujoco.MjSpec, item: Item) -> None:
    """A sphere, the cheapest shape to collide: in the plane of all centres it is a disc."""
    mass = item.mass or 1.0
    radius = item.size / 2.0
    body = _add_planar(spec, f"box-body/{item.name}", mass, mass * radius**2 / 2.0)
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE
    _add_solid(body, f"box/{item.name}", sphere, (0.0, 0.0), (radius, 0.0, 0.0))


def _add_planar(spec: mujoco.MjSpec, name: str, mass: float, inert: float) -> mujoco.MjsBody:
    body = spec.worldbody.add_body(name=name)
    body.explicitinertial = True
    body.mass = mass
    body.ipos = [0.0, 0.0, 0.0]
    body.inertia = [inert] * 3
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    for axis, kind, direction in (
        ("x", slide, [1.0, 0.0, 0.0]),
        ("y", slide, [0.0, 1.0, 0.0]),
        ("yaw", hinge, [0.0, 0.0, 1.0]),
    ):
        body.add_joint(name=f"{name}/{axis}", type=kind, axis=direction)
    return body


def _add_shapes(body: mujoco.MjsBody, robot: str, platform: Platform) -> None:
    """Add the geoms of a robot: the collision shape, and the visible body and lidar housing."""
    low, high = _rectangle(platform)
    x, y = (low + high) / 2.0
    half_x, half_y = (high - low) / 2.0
    # A ghost (not solid) collides with the arena alone. Contacts have no friction (condim 1).
    contype, conaffinity = (SOLID_BIT, SOLID_BIT) if is_solid(platform) else (0, GHOST_BIT)
    body.add_geom(
        name=robot,
        type=_BOX,
        pos=[x, y, _HEIGHT / 2.0],
        size=[half_x, half_y, _HEIGHT / 2.0],
        group=COLLISION,
        condim=1,
        contype=contype,
        conaffinity=conaffinity,
    )
    # The visible shapes have true heights and collide with nothing. The housing is the target of
    # other lidars.
    body_top = value(platform, "height")
    housing_top = heights(platform).highest
    body.add_geom(
        name=f"{robot}/body",
        type=_BOX,
        pos=[x, y, body_top / 2.0],
        size=[half_x, half_y, body_top / 2.0],
        group=BODY,
        condim=1,
        contype=0,
        conaffinity=0,
    )
    body.add_geom(
        name=f"{robot}/housing",
        type=_CYLINDER,
        pos=[*platform.scan.offset, (body_top + housing_top) / 2.0],
        size=[value(platform, "target_radius"), (housing_top - body_top) / 2.0, 0.0],
        group=HOUSING,
        contype=0,
        conaffinity=0,
    )


def inertia(platform: Platform) -> float:
    """The moment of inertia in kg m2 about the vertical, as of a uniform plate."""
    low, high = _rectangle(platform)
    length, width = high - low
    return float(value(platform, "mass") * (length**2 + width**2) / 12.0)


def moment(box: Box) -> float:
    """The moment of inertia in kg m2 of a movable box about the vertical, as of a uniform plate."""
    return (box.mass or 0.0) * (box.length**2 + box.width**2) / 12.0


def value(platform: Platform, key: str) -> float:
    """A positive number of the platform's `body` section; else ConfigError."""
    number = platform.body.get(key, 0.0)
    if number > 0.0:
        return float(number)
    raise ConfigError(
        f"platform {platform.name}: body.{key} is {platform.body.get(key)}; to be simulated it"
        " must be greater than 0"
    )


def heights(platform: Platform) -> Heights:
    """The heights of the platform; ConfigError if they are not known."""
    if platform.heights is None:
        raise ConfigError(
            f"platform {platform.name}: heights is missing; to be simulated it must hold"
            " scan_plane, lowest and highest in m"
        )
    return platform.heights


def is_solid(platform: Platform) -> bool:
    """True unless other robots pass through it; ConfigError if `body.solid` is not 0 or 1."""
    solid = platform.body.get("solid", 1.0)
    if solid not in (0.0, 1.0):
        raise ConfigError(
            f"platform {platform.name}: body.solid is {solid:g}; expected 1, or 0 for a robot that"
            " others pass through"
        )
    return solid == 1.0


def _rectangle(platform: Platform) -> tuple[Array, Array]:
    corners = platform.footprint
    low = corners.min(axis=0)
    high = corners.max(axis=0)
    if len(corners) == 4 and np.isin(corners, (low, high)).all():
        return low, high
    raise ConfigError(
        f"platform {platform.name}: footprint is not a rectangle along x and y; the simulation"
        " needs one"
    )
