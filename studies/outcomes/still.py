"""The control of outcomes: the same runs with robots that never move.

A row that these robots pass does not show that the pattern moves its robots well. The pattern runs,
senses and sends as ever; the bases take no command.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import date
from unittest.mock import patch
from warnings import catch_warnings, simplefilter

from studies import point_swarm
from studies.outcomes.catalog import MODULES
from studies.outcomes.outcome import Outcome
from swarmd.core.values import Array, Twist
from swarmd.sim.lockstep import lockstep
from swarmd.sim.scenarios import simulation
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.world.world import World

HEAD = ("pattern", "row", "wanted", "robots that never move")
HARM = "contacts"
"""The row of a bound on harm, which robots that never move pass by its nature."""


@dataclass(slots=True)
class Motion:
    """Whether the bases that never move were asked to move."""

    is_asked: bool = False


@dataclass(frozen=True, slots=True)
class Control:
    """The outcomes of a pattern whose robots never move."""

    pattern: str
    outcomes: tuple[Outcome, ...]
    has_motion: bool  # False: the pattern asks for no motion, so its rows measure none

    @property
    def judged(self) -> tuple[Outcome, ...]:
        """The rows without bounds on harm."""
        return tuple(outcome for outcome in self.outcomes if outcome.what != HARM)

    @property
    def passed(self) -> tuple[Outcome, ...]:
        """The judged rows that are reached."""
        return tuple(outcome for outcome in self.judged if outcome.is_reached)

    @property
    def rows(self) -> list[str]:
        """The rows of a table with the columns HEAD."""
        return [f"| `{o.pattern}` | {o.what} | {o.wanted} | {o.shown} |" for o in self.passed]


def report(patterns: Sequence[str], seeds: int, jobs: int) -> str:
    """Markdown: the rows that robots that never move pass too; `jobs` patterns at a time."""
    controls = point_swarm.each(control_of, [(name, seeds) for name in patterns], jobs)
    moving = [control for control in controls if control.has_motion]
    judged = sum(len(control.judged) for control in moving)
    passed = sum(len(control.passed) for control in moving)
    resting = ", ".join(f"`{c.pattern}`" for c in controls if not c.has_motion)
    lines = [f"| {' | '.join(HEAD)} |", "|---" * len(HEAD) + "|"]
    lines += [row for control in moving for row in control.rows]
    lines += ["", f"{passed} of {judged} rows of {len(moving)} patterns, without rows of contacts."]
    lines += [f"No robot is asked to move in the runs of {resting}."] * bool(resting)
    lines += [f"Made on {date.today().isoformat()} with seeds 0 to {seeds - 1}."]
    return "\n".join(lines)


def control_of(given: tuple[str, int]) -> Control:
    """The outcomes of a pattern over so many seeds, in this process, if its robots never move.

    A quotient by a path of 0 m is NaN, which no bound accepts.
    """
    pattern, seeds = given
    with still_robots(pattern) as motion, catch_warnings():
        simplefilter("ignore", RuntimeWarning)
        outcomes = MODULES[pattern].outcomes(range(seeds))
    return Control(pattern, tuple(outcomes), motion.is_asked)


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
        patch.object(lockstep, "world_of", still_world),
        patch.object(point_swarm, "obeyed", still_point),
    ):
        yield motion
