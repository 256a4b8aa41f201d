"""The control of outcomes: the same runs with robots that never move.

A row that these robots pass does not show that the pattern moves its robots well. The pattern runs,
senses and sends as ever; the bases take no command.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from unittest.mock import patch
from warnings import catch_warnings, simplefilter

from studies import point_swarm
from studies.outcomes.catalog import MODULES
from studies.outcomes.outcome import Outcome
from swarmd.core.values import Array, Twist
from swarmd.sim.experiments.run_list import unlisted
from swarmd.sim.lockstep import lockstep
from swarmd.sim.scenarios import simulation
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.world.world import World


@dataclass(slots=True)
class Motion:
    """Whether the bases that never move were asked to move."""

    is_asked: bool = False


def control_of(pattern: str, seeds: int = 3) -> list[Outcome]:
    """The outcomes of a pattern over so many seeds, in this process, if its robots never move.

    No outcome if the pattern asks no robot to move: then its rows measure no motion. A quotient by
    a path of 0 m is NaN, which no bound accepts.
    """
    with still_robots(pattern) as motion, catch_warnings():
        simplefilter("ignore", RuntimeWarning)
        outcomes: list[Outcome] = MODULES[pattern].outcomes(range(seeds))
    return outcomes if motion.is_asked else []


@contextmanager
def still_robots(pattern: str) -> Iterator[Motion]:
    """While it is open, robots that run `pattern` in simulations of this process never move.

    Robots of other patterns move, such as a control's random walkers. Boxes that others push move,
    too.
    """
    motion, make_world, obeyed = Motion(), simulation.world_of, point_swarm.obeyed

    def still_world(scenario: Scenario, seed: int) -> World:
        world = make_world(scenario, seed)
        still = {name for e in scenario.events if e.pattern == pattern for name in e.robots}
        rows = [row for row, name in enumerate(world.ids) if name in still]
        put = world.set_commands

        def set_commands(twists: Array) -> None:
            motion.is_asked |= bool(twists[rows].any())
            commands = twists.copy()
            commands[rows] = 0.0
            put(commands)

        world.set_commands = set_commands  # type: ignore[method-assign]  # of this world alone
        return world

    def still_point(
        name: str, twist: Twist | None, limits: tuple[float, float]
    ) -> tuple[float, float]:
        speeds = obeyed(name, twist, limits)
        if name != pattern:
            return speeds
        motion.is_asked |= speeds != (0.0, 0.0)
        return 0.0, 0.0

    with (
        unlisted(),
        patch.object(lockstep, "world_of", still_world),
        # A worker has the world of other robots: this process does the runs.
        patch("swarmd.sim.experiments.simulate.has_workers", lambda: False),
        patch.object(point_swarm, "obeyed", still_point),
    ):
        yield motion
