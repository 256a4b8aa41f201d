"""Pictures of an environment's run, drawn as the frames of films."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from swarmd.sim.film.colours import Colouring, colouring_of
from swarmd.sim.film.film import Drawing
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
        self._swarm = swarm
        world = swarm.world
        scenario = swarm.scenario
        half = scenario.arena.length / 2.0 + _MARGIN
        wide = scenario.arena.width / 2.0 + _MARGIN
        self._builder = TraceBuilder(
            world.ids,
            world.platforms,
            meta_of(scenario, swarm.seed),
            movable_boxes=world.loose,
            box_shapes=world.loose_shapes,
        )
        trace, colouring = self._present()
        extent = Extent(-half, half, -wide, wide)
        self._drawing = Drawing(trace, colouring, SIZE, extent, scenario.fields)

    def picture(self) -> NDArray[np.uint8]:
        """The present state: (height, width, 3) uint8."""
        self._drawing.show(*self._present())
        return self._drawing.at(0.0).copy()

    def _present(self) -> tuple[Trace, Colouring]:
        """A trace of the present instant alone."""
        world = self._swarm.world
        swarm = self._swarm
        self._builder.clear()
        self._builder.add(world.time, world.poses(), swarm.commands, world.loose_poses())
        words = ["" if shell is None else str(shell.robot.state) for shell in swarm.shells]
        trace = replace(self._builder.trace(), state=np.array([words]))
        return trace, colouring_of(trace, "state")
