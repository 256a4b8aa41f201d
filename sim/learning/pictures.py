"""Pictures of an environment's run, by the renderer of films."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from swarmd.sim.film.colours import Colouring, colouring_of
from swarmd.sim.film.renderer import Renderer
from swarmd.sim.film.stage import stage_of
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.plots.scene import Extent
from swarmd.sim.scenarios.simulation import meta_of
from swarmd.sim.trace import Trace, TraceBuilder

SIZE = (640, 480)
"""Width and height in pixels."""
_MARGIN = 0.2  # m around the arena


class Pictures:
    """The present state of one run from above: the whole arena, robots coloured by their state."""

    def __init__(self, swarm: Lockstep) -> None:
        """PluginError if no way of rendering without a display is installed."""
        self._swarm = swarm
        world, scenario = swarm.world, swarm.scenario
        half, wide = scenario.arena.length / 2.0 + _MARGIN, scenario.arena.width / 2.0 + _MARGIN
        self._builder = TraceBuilder(
            world.ids,
            world.platforms,
            meta_of(scenario, swarm.seed),
            movable_boxes=world.loose,
            box_shapes=world.loose_shapes,
        )
        trace, colouring = self._present()
        platforms = {platform.name: platform for platform in world.platforms}
        extent = Extent(-half, half, -wide, wide)
        stage = stage_of(trace, SIZE, platforms, scenario.fields, extent)
        self._renderer = Renderer(trace, stage, colouring, "top")

    def picture(self) -> NDArray[np.uint8]:
        """The present state: (height, width, 3) uint8."""
        self._renderer.show(*self._present())
        return np.ascontiguousarray(self._renderer.frame(0.0))

    def close(self) -> None:
        """Free the renderer."""
        self._renderer.close()

    def _present(self) -> tuple[Trace, Colouring]:
        """A trace of the present instant alone."""
        world, swarm = self._swarm.world, self._swarm
        self._builder.clear()
        self._builder.add(world.time, world.poses(), swarm.commands, world.loose_poses())
        words = ["" if shell is None else str(shell.robot.state) for shell in swarm.shells]
        trace = replace(self._builder.trace(), state=np.array([words]))
        return trace, colouring_of(trace, "state")
