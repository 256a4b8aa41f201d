"""The MuJoCo model of a film: the world of a run with a floor, light and visible robots.

Walls are drawn low, so that they hide nothing. On each robot a white bar marks the front. Robots
that would be too small to recognise are drawn larger than they are. There are no shadows: on a
large floor MuJoCo's shadows are full of specks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import mujoco
import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array, Platform
from swarmd.settings.platforms import load_platform
from swarmd.sim.plots.scene import Extent, extent_of
from swarmd.sim.trace import Trace
from swarmd.sim.world import bodies
from swarmd.sim.world.arena import Arena, parse_arena
from swarmd.sim.world.floor import floor_pixels
from swarmd.sim.world.geometry import radius
from swarmd.sim.world.scalar_fields import Field

_WALL, _OBSTACLE = 0.08, 0.25  # heights in m
_PALE = (0.91, 0.92, 0.93, 1.0)
_GREY = (0.45, 0.48, 0.52, 1.0)
_BROWN = (0.77, 0.61, 0.42, 1.0)
_DARK = (0.13, 0.14, 0.16, 1.0)
_WHITE = (1.0, 1.0, 1.0, 1.0)
MIN_PIXELS = 32.0
"""The least length of a robot in pixels in a frame of 720 lines."""
_LEAST_PIXELS = 20.0  # the least length of a robot in pixels in any frame
_MOST = 2.0  # the largest enlargement of a robot
_ASSUMED = "waffle_pi"
"""The platform whose heights stand in for those of an unknown platform."""


@dataclass(frozen=True, slots=True)
class Stage:
    """A compiled model of a run for films, with the indices of its geoms."""

    model: mujoco.MjModel
    size: tuple[int, int]  # width and height of a frame in pixels
    extent: Extent  # the part of the world in a frame
    bodies: NDArray[np.int64]  # (n,) a geom of each robot that has the robot's colour
    housings: NDArray[np.int64]  # (n,) the geoms of the lidar housings, in a darker colour
    parts: tuple[NDArray[np.int64], ...]  # all visible geoms of each robot
    boxes: NDArray[np.int64]  # (m,) the geoms of the movable boxes
    factor: float  # robots are drawn this many times larger than they are
    assumed: tuple[str, ...]  # platforms whose heights are unknown, and assumed


def stage_of(
    trace: Trace,
    size: tuple[int, int],
    platforms: Mapping[str, Platform] = MappingProxyType({}),
    fields: Sequence[Field] = (),
    extent: Extent | None = None,
) -> Stage:
    """The stage of a run for frames of `size` pixels; ConfigError if the arena is not known.

    `platforms`: the scenario's platforms by name. `fields`: the scenario's fields, of which a floor
    is shown. `extent`: the part of the world to show; None: the part that the run has used.
    """
    text = str(trace.meta.get("arena", ""))
    if not text:
        raise ConfigError("the trace names no arena, so that it cannot be filmed")
    arena = parse_arena(text)
    assumed: list[str] = []
    platform_of = {
        name: platforms.get(name) or _platform(name, footprint, assumed)
        for name, footprint in trace.footprints.items()
    }
    robots = {i: platform_of[p] for i, p in zip(trace.ids, trace.platforms, strict=True)}
    spec = bodies.build_spec(robots, arena, 0.01)
    for robot, platform in robots.items():
        _add_marks(spec.body(f"robot/{robot}"), robot, platform)
    extent = extent or extent_of(trace)
    _add_floor(spec, extent)
    _add_picture(spec, arena, fields)
    spec.visual.global_.offwidth, spec.visual.global_.offheight = size
    spec.visual.quality.offsamples = 4
    model = spec.compile()
    _paint(model)
    factor = _enlargement(trace, extent, size)
    geoms = [model.geom(g).name for g in range(model.ngeom)]
    parts = tuple(
        np.array([g for g, name in enumerate(geoms) if name.startswith(f"{robot}/")])
        for robot in robots
    )
    for own in parts:
        model.geom_size[own] *= factor
        model.geom_pos[own] *= factor
    return Stage(
        model=model,
        size=size,
        extent=extent,
        bodies=np.array([model.geom(f"{robot}/body").id for robot in robots]),
        housings=np.array([model.geom(f"{robot}/housing").id for robot in robots]),
        parts=parts,
        factor=factor,
        boxes=np.array([model.geom(f"box/{n}").id for n in trace.movable_boxes], dtype=np.int64),
        assumed=tuple(sorted(assumed)),
    )


def _platform(name: str, footprint: Array, assumed: list[str]) -> Platform:
    """The platform of a name; for an unknown name, one with assumed heights and this footprint.

    Adds an unknown name to `assumed`.
    """
    try:
        return load_platform(name)
    except ConfigError:
        assumed.append(name)
        return replace(load_platform(_ASSUMED), name=name, footprint=footprint)


def _add_marks(body: mujoco.MjsBody, robot: str, platform: Platform) -> None:
    """A white bar along the front, and dark wheels at the axle."""
    (left, right), (back, front) = _sides(platform.footprint)
    height = bodies.value(platform, "height")
    length, width = front - back, left - right
    box, cylinder = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
    body.add_geom(
        name=f"{robot}/front",
        type=box,
        pos=[front - 0.14 * length, (left + right) / 2.0, height],
        size=[0.07 * length, 0.34 * width, 0.006],
        rgba=_WHITE,
        contype=0,
        conaffinity=0,
        group=bodies.BODY,
    )
    wheel = min(0.3 * length, 0.45 * height)
    for name, y in (("left", left), ("right", right)):
        body.add_geom(
            name=f"{robot}/{name}",
            type=cylinder,
            pos=[0.0, y, wheel],
            size=[wheel, 0.06 * width, 0.0],
            quat=[np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0],
            rgba=_DARK,
            contype=0,
            conaffinity=0,
            group=bodies.BODY,
        )


def _sides(footprint: Array) -> tuple[tuple[float, float], tuple[float, float]]:
    (back, right), (front, left) = footprint.min(axis=0), footprint.max(axis=0)
    return (float(left), float(right)), (float(back), float(front))


def _add_floor(spec: mujoco.MjSpec, extent: Extent) -> None:
    """A floor beyond the walls, with a grid of 1 m, and light from the side."""
    spec.add_texture(
        name="grid",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=_PALE[:3],
        rgb2=_PALE[:3],
        markrgb=[0.80, 0.82, 0.84],
        width=256,
        height=256,
    )
    material = spec.add_material(name="floor", texuniform=True, texrepeat=[1.0, 1.0])
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "grid"
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 1.0],  # without end
        material="floor",
        group=bodies.FIXED,
        contype=0,
        conaffinity=0,
    )
    spec.visual.headlight.ambient = [0.62] * 3
    spec.visual.headlight.diffuse = [0.08] * 3
    spec.visual.headlight.specular = [0.0] * 3
    middle = [(extent.left + extent.right) / 2.0, (extent.bottom + extent.top) / 2.0]
    spec.worldbody.add_light(
        pos=[*middle, 4.0],
        dir=[0.25, 0.35, -1.0],
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        diffuse=[0.32] * 3,
        specular=[0.0] * 3,
        castshadow=False,
    )


def _add_picture(spec: mujoco.MjSpec, arena: Arena, fields: Sequence[Field]) -> None:
    """The scenario's own floor within the walls, if it has one."""
    pixels = floor_pixels(fields, (arena.length, arena.width))
    if pixels is None:
        return
    spec.add_texture(
        name="picture",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        data=pixels.ravel().tolist(),
        nchannel=3,
        width=pixels.shape[1],
        height=pixels.shape[0],
    )
    material = spec.add_material(name="picture", texuniform=False)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "picture"
    spec.worldbody.add_geom(
        name="floor/picture",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=[0.0, 0.0, 0.002],
        size=[arena.length / 2.0, arena.width / 2.0, 1.0],
        material="picture",
        group=bodies.FIXED,
        contype=0,
        conaffinity=0,
    )


def _paint(model: mujoco.MjModel) -> None:
    """Colours of the arena; what is only for collisions is hidden."""
    for geom in range(model.ngeom):
        name, group = model.geom(geom).name, int(model.geom_group[geom])
        if group == bodies.FIXED and not name.startswith("floor"):
            is_wall = name.startswith(("wall/", "segment/"))
            model.geom_rgba[geom] = _BROWN if _is_movable(model, geom) else _GREY
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE:  # an item
                model.geom_pos[geom][2] = model.geom_size[geom][0]
                continue
            half = (_WALL if is_wall else _OBSTACLE) / 2.0
            is_pole = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER
            model.geom_size[geom][1 if is_pole else 2] = half
            model.geom_pos[geom][2] = half


def _enlargement(trace: Trace, extent: Extent, size: tuple[int, int]) -> float:
    """How many times larger robots are drawn: the smallest has MIN_PIXELS, at most _MOST."""
    width, height = size
    scale = min(width / extent.width, height / extent.height)  # pixels per m, about
    pixels = 2.0 * scale * min(map(radius, trace.footprints.values()))
    least = max(MIN_PIXELS * height / 720.0, _LEAST_PIXELS)
    return float(min(max(least / pixels, 1.0), _MOST))


def _is_movable(model: mujoco.MjModel, geom: int) -> bool:
    return int(model.geom_bodyid[geom]) != 0
