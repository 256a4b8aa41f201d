"""The MuJoCo model of a film: the world of a run with a floor, light and visible robots.

Walls are drawn low, so that they hide nothing. On each robot a white bar marks the front. Robots
that would be too small to recognise are drawn larger than they are. Shadows are off, since MuJoCo's
shadows on a large floor are full of specks.
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
_TIME_STEP = 0.01  # s, of the model; a film makes no step
_ASSUMED = "waffle_pi"
"""The platform whose heights stand in for those of an unknown platform."""


@dataclass(frozen=True, slots=True)
class Stage:
    """The MuJoCo model of a film, and which of its geoms (by index) are parts of which robot."""

    model: mujoco.MjModel
    size: tuple[int, int]  # width and height of frames in pixels
    extent: Extent  # the part of the world that frames show
    bodies: NDArray[np.int64]  # the geom of each robot's body, which has the robot's colour
    housings: NDArray[np.int64]  # the geom of each robot's lidar housing, in a darker colour
    parts: tuple[NDArray[np.int64], ...]  # all visible geoms, by robot
    boxes: NDArray[np.int64]  # the geom of each movable box
    factor: float  # how many times larger than they are robots are drawn
    reach: float  # m: the largest distance of a drawn part from the axle of its robot
    assumed: tuple[str, ...]  # platforms whose heights are not known here


def stage_of(
    trace: Trace,
    size: tuple[int, int],
    platforms: Mapping[str, Platform] = MappingProxyType({}),
    fields: Sequence[Field] = (),
    extent: Extent | None = None,
) -> Stage:
    """Build the MuJoCo model that shows a run in frames of `size` pixels (width, height).

    `platforms`: the platforms of the scenario, by name. `fields`: the scalar fields of the
    scenario; only the colours of floor fields are shown. `extent`: the part of the world that
    frames show; None: all places of the run. ConfigError if the trace does not name its arena.
    """
    # 1. The world of the run, with marks on the robots.
    arena_text = str(trace.meta.get("arena", ""))
    if not arena_text:
        raise ConfigError("the trace names no arena, so that it cannot be filmed")
    arena = parse_arena(arena_text)
    platform_of, assumed = _platforms_of(trace, platforms)
    robots = {
        robot: platform_of[name] for robot, name in zip(trace.ids, trace.platforms, strict=True)
    }
    spec = bodies.build_spec(robots, arena, _TIME_STEP)
    for robot, platform in robots.items():
        _add_marks(spec.body(f"robot/{robot}"), robot, platform)
    extent = extent or extent_of(trace)
    _add_floor(spec, extent)
    _add_coloured_floor(spec, arena, fields)
    spec.visual.global_.offwidth, spec.visual.global_.offheight = size
    spec.visual.quality.offsamples = 4
    model = spec.compile()
    _set_colours_and_heights(model)

    # 2. Robots that would be too small are enlarged.
    parts = tuple(_parts_of(model, robot) for robot in robots)
    factor = _enlargement(trace, extent, size)
    for geoms in parts:
        model.geom_size[geoms] *= factor
        model.geom_pos[geoms] *= factor  # relative to the axle
    return Stage(
        model=model,
        size=size,
        extent=extent,
        bodies=np.array([model.geom(f"{robot}/body").id for robot in robots]),
        housings=np.array([model.geom(f"{robot}/housing").id for robot in robots]),
        parts=parts,
        factor=factor,
        reach=factor * max(map(radius, trace.footprints.values())),
        boxes=np.array([model.geom(f"box/{n}").id for n in trace.movable_boxes], dtype=np.int64),
        assumed=tuple(sorted(assumed)),
    )


def _platforms_of(
    trace: Trace, platforms: Mapping[str, Platform]
) -> tuple[dict[str, Platform], list[str]]:
    """The platforms of a run by name, and the names of platforms that are unknown here.

    `platforms`: those of the scenario. An unknown platform is _ASSUMED with its own footprint.
    """
    platform_of: dict[str, Platform] = {}
    assumed: list[str] = []
    for name, footprint in trace.footprints.items():
        try:
            platform_of[name] = platforms.get(name) or load_platform(name)
        except ConfigError:
            assumed.append(name)
            stand_in = load_platform(_ASSUMED)
            platform_of[name] = replace(stand_in, name=name, footprint=footprint)
    return platform_of, assumed


def _parts_of(model: mujoco.MjModel, robot: str) -> NDArray[np.int64]:
    """The indices of all visible geoms of a robot, whose names begin with the robot's name."""
    names = [model.geom(geom).name for geom in range(model.ngeom)]
    return np.array([geom for geom, name in enumerate(names) if name.startswith(f"{robot}/")])


def _add_marks(body: mujoco.MjsBody, robot: str, platform: Platform) -> None:
    """Add a white bar along the front and two dark wheels at the axle to the body of a robot.

    The bar lies on the top. Its place and size are shares of the footprint's length and width.
    """
    (left, right), (back, front) = _sides(platform.footprint)  # m, in the base frame
    height = bodies.value(platform, "height")
    length, width = front - back, left - right
    body.add_geom(
        name=f"{robot}/front",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[front - 0.14 * length, (left + right) / 2.0, height],
        size=[0.07 * length, 0.34 * width, 0.006],
        rgba=_WHITE,
        contype=0,
        conaffinity=0,
        group=bodies.BODY,
    )
    wheel_radius = min(0.3 * length, 0.45 * height)
    for name, y in (("left", left), ("right", right)):
        body.add_geom(
            name=f"{robot}/{name}",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            pos=[0.0, y, wheel_radius],
            size=[wheel_radius, 0.06 * width, 0.0],
            quat=[np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0],  # the cylinder's axis along y
            rgba=_DARK,
            contype=0,
            conaffinity=0,
            group=bodies.BODY,
        )


def _sides(footprint: Array) -> tuple[tuple[float, float], tuple[float, float]]:
    (back, right), (front, left) = footprint.min(axis=0), footprint.max(axis=0)
    return (float(left), float(right)), (float(back), float(front))


def _add_floor(spec: mujoco.MjSpec, extent: Extent) -> None:
    """Add an infinite floor with a grid of 1 m, which also shows outside of the walls, and light.

    The light comes from the side, so that the tops and sides of bodies differ.
    """
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
        size=[0.0, 0.0, 1.0],  # 0: infinite in x and y
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


def _add_coloured_floor(spec: mujoco.MjSpec, arena: Arena, fields: Sequence[Field]) -> None:
    """Add the floor that the scenario's fields give, as a texture within the walls, if any."""
    pixels = floor_pixels(fields, (arena.length, arena.width))  # (rows, columns, 3), or None
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
        pos=[0.0, 0.0, 0.002],  # just above the grid
        size=[arena.length / 2.0, arena.width / 2.0, 1.0],
        material="picture",
        group=bodies.FIXED,
        contype=0,
        conaffinity=0,
    )


def _set_colours_and_heights(model: mujoco.MjModel) -> None:
    """Set the colours and heights of walls and obstacles of the arena in the model."""
    for geom in range(model.ngeom):
        name, group = model.geom(geom).name, int(model.geom_group[geom])
        if group == bodies.FIXED and not name.startswith("floor"):
            is_wall = name.startswith(("wall/", "segment/"))
            model.geom_rgba[geom] = _BROWN if model.geom_bodyid[geom] else _GREY
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE:  # an item
                model.geom_pos[geom][2] = model.geom_size[geom][0]
                continue
            half = (_WALL if is_wall else _OBSTACLE) / 2.0
            is_pole = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER
            model.geom_size[geom][1 if is_pole else 2] = half
            model.geom_pos[geom][2] = half


def _enlargement(trace: Trace, extent: Extent, size: tuple[int, int]) -> float:
    """The factor by which robots are drawn larger than they are, from 1 to _MOST.

    The smallest robot shall have MIN_PIXELS in a frame of 720 lines.
    """
    width, height = size
    scale = min(width / extent.width, height / extent.height)  # pixels per m, about
    robot_pixels = 2.0 * scale * min(map(radius, trace.footprints.values()))
    wanted_pixels = max(MIN_PIXELS * height / 720.0, _LEAST_PIXELS)
    return float(min(max(wanted_pixels / robot_pixels, 1.0), _MOST))
