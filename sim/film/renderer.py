"""Frames of a run by MuJoCo's renderer, without a display."""

from __future__ import annotations

import math
import os
import sys
import threading
from contextlib import suppress
from importlib import import_module
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from swarmd.core.closing import Closing
from swarmd.core.errors import ConfigError, PluginError, SwarmError
from swarmd.core.values import Array
from swarmd.sim.film.colours import Colouring
from swarmd.sim.film.stage import Stage
from swarmd.sim.plots.scene import Extent
from swarmd.sim.trace import Trace, poses_at

Camera = Literal["top", "perspective"]
BACKENDS = ("egl", "osmesa")
_FOVY = 40.0  # degrees, of the perspective camera, as the next two
_ELEVATION = -48.0
_AZIMUTH = 90.0
_MARGIN = 1.03
_HOUSING = 0.62  # how dark a lidar is beside the body
_TRAIL_STEPS = 24  # segments of a trail
_MAX_TRAILS = 4000  # segments of all trails


class Renderer(Closing):
    """Draws a run at any time into arrays (height, width, 3) of uint8."""

    def __init__(self, trace: Trace, stage: Stage, colouring: Colouring, camera: Camera) -> None:
        """PluginError if no way of rendering without a display is installed."""
        self.stage = stage
        self.width, self.height = size = stage.size
        self.show(trace, colouring)
        model = self.stage.model
        self._data = mujoco.MjData(model)
        self._camera = mujoco.MjvCamera()
        self._high = _aim(self._camera, model, self.stage.extent, size, camera)
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:4] = 0, 1, 1, 1  # without collision shapes
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + _MAX_TRAILS + 100)
        self._gl, self._thread = gl_context(*size), threading.current_thread()
        self._make_current()
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)

    def close(self) -> None:
        """Free the context of OpenGL, in another thread as far as that thread can."""
        with suppress(SwarmError):  # in another thread the context cannot be made current
            self._make_current()
            self._context.free()
        self._gl.free()

    @property
    def scale(self) -> float | None:
        """Pixels of 1 m from above; None in perspective, where there is no such number."""
        return None if self._high is None else self.height / self._high

    def pixels(self, time: float) -> Array:
        """(n, 2) where the robots are at `time` in s in a frame from above; NaN without a pose."""
        extent, scale = self.stage.extent, self.scale or math.nan
        middle = (extent.left + extent.right) / 2.0, (extent.bottom + extent.top) / 2.0
        away = poses_at(self._t, self._trace.pose, time)[:, :2] - middle
        found: Array = np.array([self.width, self.height]) / 2.0 + scale * away * (1.0, -1.0)
        return found

    def show(self, trace: Trace, colouring: Colouring) -> None:
        """Draw this trace from now on: other instants of the same robots in the same arena."""
        self._trace, self._colouring = trace, colouring
        self._t = trace.t - trace.t[0]

    def frame(self, time: float, trail: float = 0.0) -> NDArray[np.uint8]:
        """Render the run at `time` in s from its start; returns pixels (height, width, 3).

        `trail`: s of the path that is drawn behind each robot. ConfigError if the calling thread is
        not the thread that made the renderer.
        """
        self._make_current()  # another renderer may have been at work
        instant = self._place(time)
        model = self.stage.model
        data = self._data
        scene = self._scene
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        all_geoms = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, all_geoms, scene)
        if trail > 0.0:
            self._add_trails(instant, time, trail)
        rect = mujoco.MjrRect(0, 0, self.width, self.height)
        mujoco.mjr_render(rect, scene, self._context)
        picture = np.empty((self.height, self.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(picture, None, rect, self._context)
        return picture[::-1]

    def _make_current(self) -> None:
        try:
            self._gl.make_current()
        except Exception as error:  # libraries raise what they like
            thread = threading.current_thread()
            if thread is self._thread:
                what = type(error).__name__
                raise PluginError(f"OpenGL cannot render here any more ({what})") from error
            raise ConfigError(
                f"thread {thread.name} cannot render with the OpenGL of thread"
                f" {self._thread.name}; render in that thread alone, or make a renderer or"
                " environment in each thread"
            ) from error

    def _place(self, time: float) -> int:
        """Move and colour robots and boxes for `time` in s; hide those without a pose then.

        Returns the index of the latest instant of the trace.
        """
        trace = self._trace
        model = self.stage.model
        n = len(trace.ids)
        poses = poses_at(self._t, trace.pose, time)
        instant = max(int(np.searchsorted(self._t, time + 1e-9, side="right")) - 1, 0)
        has_pose = _are_known(poses)
        # `qpos`: x, y and yaw of each robot, then of each movable box.
        self._data.qpos[: 3 * n] = np.where(has_pose[:, None], poses, 0.0).ravel()
        colours = self._colouring.rgb[instant] / 255.0
        model.geom_rgba[self.stage.bodies, :3] = colours
        model.geom_rgba[self.stage.housings, :3] = _HOUSING * colours
        for parts, is_visible in zip(self.stage.parts, has_pose.tolist(), strict=True):
            model.geom_rgba[parts, 3] = float(is_visible)
        if trace.box_pose is not None:
            boxes = poses_at(self._t, trace.box_pose, time)
            box_has_pose = _are_known(boxes)
            self._data.qpos[3 * n :] = np.where(box_has_pose[:, None], boxes, 0.0).ravel()
            model.geom_rgba[self.stage.boxes, 3] = box_has_pose
        return instant

    def _add_trails(self, instant: int, time: float, seconds: float) -> None:
        """Add lines on the floor along the positions of the last `seconds` before `time`.

        `instant`: the index of the latest instant of the trace.
        """
        first = int(np.searchsorted(self._t, time - seconds))
        n = len(self._trace.ids)
        steps = min(_TRAIL_STEPS, _MAX_TRAILS // max(n, 1), instant - first)
        if steps < 1:
            return
        instants = np.linspace(first, instant, steps + 1).astype(int)
        positions = self._trace.pose[instants, :, :2]
        scene, line = self._scene, mujoco.mjtGeom.mjGEOM_LINE
        for robot in range(n):
            colour = np.append(self._colouring.rgb[instant, robot] / 255.0, 0.7).astype(np.float32)
            for a, b in zip(positions[:-1, robot], positions[1:, robot], strict=True):
                if scene.ngeom >= scene.maxgeom or not np.isfinite((a, b)).all():
                    continue
                geom = scene.geoms[scene.ngeom]
                mujoco.mjv_initGeom(geom, line, np.zeros(3), np.zeros(3), np.eye(3).ravel(), colour)
                mujoco.mjv_connector(geom, line, 3.0, np.append(a, 0.005), np.append(b, 0.005))
                geom.emission = 0.4
                scene.ngeom += 1


def _aim(
    camera: mujoco.MjvCamera,
    model: mujoco.MjModel,
    extent: Extent,
    size: tuple[int, int],
    kind: Camera,
) -> float | None:
    """Point the camera so that `extent` fills a frame of `size` pixels (width, height).

    `kind`: "top" is an orthographic view from above, "perspective" a view from the side. Returns
    the height of the frame in m; None in perspective, where a frame has no such height.
    """
    width, height = size
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = (extent.left + extent.right) / 2.0, (extent.bottom + extent.top) / 2.0, 0.0
    longest = max(extent.width, extent.height)
    # MuJoCo draws what is between znear and zfar from the camera, both in units of `stat.extent`.
    model.stat.extent = longest
    model.vis.map.znear, model.vis.map.zfar = 0.01, 50.0
    if kind == "top":
        camera.azimuth = 90.0
        camera.elevation = -90.0
        camera.distance = 2.0 * longest
        camera.orthographic = 1
        model.vis.global_.orthographic = 1
        frame_height = _MARGIN * max(extent.height, extent.width * height / width)
        model.vis.global_.fovy = frame_height  # in m for an orthographic camera
        return frame_height
    camera.azimuth, camera.elevation = _AZIMUTH, _ELEVATION
    model.vis.global_.fovy = _FOVY
    camera.distance = _distance(extent, math.tan(math.radians(_FOVY) / 2.0), width / height)
    return None


def _distance(extent: Extent, tangent: float, aspect: float) -> float:
    """The smallest distance in m from which all corners of the extent are in the picture."""
    x, y = extent.width / 2.0, extent.height / 2.0
    corners = np.array([[u * x, v * y, z] for u in (-1, 1) for v in (-1, 1) for z in (0.0, 0.2)])
    a, e = math.radians(_AZIMUTH), math.radians(_ELEVATION)
    ahead = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([math.sin(a), -math.cos(a), 0.0])
    above = np.cross(right, ahead)
    wide = np.abs(corners @ right) / (tangent * aspect) - corners @ ahead
    tall = np.abs(corners @ above) / tangent - corners @ ahead
    return _MARGIN * float(max(wide.max(), tall.max()))


def gl_context(width: int, height: int) -> Any:
    """An OpenGL context without a display: that of $MUJOCO_GL, else EGL, else OSMesa.

    ConfigError for another $MUJOCO_GL, PluginError with what to install if no renderer works.
    """
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    if wanted and wanted not in BACKENDS:
        raise ConfigError(f"MUJOCO_GL={wanted}: films need {' or '.join(BACKENDS)}; unset it")
    problems = []
    for name in (wanted,) if wanted else BACKENDS:
        try:
            context = import_module(f"mujoco.{name}").GLContext(width, height)
            os.environ["MUJOCO_GL"] = name  # where MuJoCo looks for the functions of OpenGL
            return context
        except Exception as error:  # libraries raise what they like
            problems.append(f"{name}: {' '.join(str(error).split())[:120]}")
            _forget_opengl()
    raise PluginError(
        f"MuJoCo cannot render here ({'; '.join(problems)}); install Mesa:"
        " apt install libegl1 libgl1-mesa-dri, or libosmesa6; and: pip install 'swarmd[film]'"
    )


def _forget_opengl() -> None:
    """Unload PyOpenGL, which is bound to one platform when it is first imported."""
    os.environ.pop("PYOPENGL_PLATFORM", None)
    for name in [n for n in sys.modules if n.split(".")[0] == "OpenGL" or n == "mujoco.egl"]:
        with suppress(KeyError):
            del sys.modules[name]


def _are_known(poses: Array) -> NDArray[np.bool_]:
    """Which of the poses (k, 3) hold no NaN."""
    return np.asarray(np.isfinite(poses).all(axis=1))
