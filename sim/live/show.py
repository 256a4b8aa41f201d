"""A demo's course: wait for the fleet, run a pattern, watch it to its end, stop it, sum it up.

It works the robots as any operator does, through `swarmd.network.operator`; the world's truth is
for the view and the summary alone.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from swarmd.core.clock import boottime
from swarmd.core.errors import ConfigError, NetworkError, SwarmError
from swarmd.core.messages import Condition, Status
from swarmd.network.discovery import MembersView
from swarmd.network.operator import Operator
from swarmd.network.outcome import Outcome
from swarmd.settings.platforms import load_platform
from swarmd.sim.live.fleet import Fleet
from swarmd.sim.live.link import WorldView
from swarmd.sim.live.state import WorldState
from swarmd.sim.live.summary import Summary, duties, mean_duty, numbers_of, problems_of
from swarmd.sim.live.trace_from_statuses import StatusLog
from swarmd.sim.live.view import Scene
from swarmd.sim.trace import load_trace

LOOK = 0.5  # s between two looks at the robots: what a terminal can show without much load
PATIENT = 3.0  # s for the two looks that decide whether all went well
SILENT = 5.0  # s after which a world that says nothing counts as lost
STARTING = 20.0  # s, and ...
STARTING_EACH = 1.0  # ... s more for each robot: slow machines, cold disks
MOVED = 1e-3  # m or rad


@dataclass(frozen=True, slots=True, kw_only=True)
class Play:
    """What is to be shown: a pattern with its parameters, for `seconds` of simulated time."""

    pattern: str
    params: Mapping[str, Any]
    seconds: float
    platform: str


class Watch:
    """The newest state of the world, handed over from the network's thread."""

    def __init__(self, world: WorldView) -> None:
        self._news = threading.Condition()
        self._state: WorldState | None = None
        self._start: WorldState | None = None
        self._moved: set[str] = set()
        self.all_moved_at: float | None = None
        world.watch(self._take)

    def begin(self, start: WorldState) -> None:
        """From here on note who has moved."""
        with self._news:
            self._start, self._moved, self.all_moved_at = start, set(), None

    def wait(self, since: float = -1.0) -> WorldState:
        """A state later than simulated time `since`; NetworkError if the world has gone silent."""
        with self._news:
            if self._news.wait_for(lambda: self._is_later(since), SILENT):
                assert self._state is not None
                return self._state
        raise NetworkError(f"the world has said nothing for {SILENT:.0f} s")

    def _is_later(self, since: float) -> bool:
        return self._state is not None and self._state.time > since

    def _take(self, state: WorldState) -> None:
        with self._news:
            self._state = state
            if self._start is not None and self.all_moved_at is None:
                self._moved |= _moved(self._start, state)
                if len(self._moved) == len(state.ids):
                    self.all_moved_at = boottime()
            self._news.notify_all()


def await_up(operator: Operator, fleet: Fleet, robots: Sequence[str]) -> MembersView:
    """Everyone's view once each robot has answered and has its body in reach.

    SwarmError if a process ends meanwhile, NetworkError if the time is up.
    """
    seconds = STARTING + STARTING_EACH * len(robots)
    limit = time.monotonic() + seconds
    while True:
        fleet.check()
        view = operator.members()
        statuses = statuses_of(view)
        waiting = [r for r in robots if r not in statuses or not statuses[r].health.driver_up]
        if not waiting:
            return view
        if time.monotonic() > limit:
            raise NetworkError(
                f"no sign of {', '.join(waiting)} after {seconds:.0f} s (logs: {fleet.spec.folder})"
            )


def statuses_of(view: MembersView) -> dict[str, Status]:
    """The statuses of those that are alive and have answered, by robot."""
    return {
        name: member.status
        for name, member in view.members.items()
        if member.condition is Condition.ALIVE and member.status is not None
    }


class Show:
    """One demo on a running fleet. `on_scene` is called about twice a second."""

    def __init__(
        self,
        play: Play,
        fleet: Fleet,
        operator: Operator,
        world: WorldView,
        on_scene: Callable[[Scene], None],
    ) -> None:
        self._play, self._fleet, self._operator = play, fleet, operator
        self._world, self._on_scene = world, on_scene
        self._watch = Watch(world)
        self._robots = tuple(fleet.spec.robots)
        self._statements = StatusLog()

    def perform(self, trace: Path, began: float) -> Summary:
        """Run the pattern from start to end; `began` is when the command did (boot time)."""
        view = await_up(self._operator, self._fleet, self._robots)
        started = time.monotonic()
        start = self._world.ask("start").state
        self._watch.begin(start)
        self._run(view)
        before = statuses_of(self._operator.members(timeout=PATIENT))
        self._look_on(before)
        wall = time.monotonic() - started
        after = statuses_of(self._operator.members(timeout=PATIENT))
        end = self._world.ask("finish").state
        stopped = self._operator.halt("stop")
        return self._summary(trace, began, end.recorded / wall, before, after, stopped)

    def _run(self, view: MembersView) -> None:
        args = {"pattern": self._play.pattern, "params": dict(self._play.params)}
        outcome = self._operator.request("run", view.epochs(self._robots), args)
        if len(outcome.applied) == len(self._robots):
            return
        texts = [f"{r}: {reply.text}" for r, reply in outcome.replies.items() if reply.text]
        why = f"run: {outcome.line}" + (f"; {texts[0]}" if texts else "")
        raise ConfigError(why) if len(outcome.refused) == len(self._robots) else SwarmError(why)

    def _look_on(self, statuses: dict[str, Status]) -> None:
        """Show the robots until the world has recorded enough."""
        state = self._watch.wait()
        next_look = 0.0
        while state.is_recording and state.recorded < self._play.seconds:
            if time.monotonic() >= next_look:
                self._fleet.check()
                statuses = statuses_of(self._operator.members(timeout=LOOK))
                self._statements.hear(state.recorded, statuses)
                self._on_scene(self._scene(state, statuses))
                next_look = time.monotonic() + LOOK
            try:
                state = self._watch.wait(since=state.time)
            except NetworkError:
                self._fleet.check()  # it knows better why, if the world has ended
                raise

    def _scene(self, state: WorldState, statuses: Mapping[str, Status]) -> Scene:
        return Scene(
            title=(
                f"{self._play.pattern}, {len(self._robots)} {self._play.platform}:"
                f" {state.recorded:.0f} of {self._play.seconds:.0f} s,"
                f" {state.real_time_factor:.2f} times real time, contacts {state.contacts}"
            ),
            arena=state.arena,
            poses=dict(zip(state.ids, state.poses, strict=True)),
            statuses=statuses,
            footer=f"In another terminal: SWARM={self._fleet.spec.swarm} swarmctl members",
        )

    def _summary(
        self,
        trace_path: Path,
        began: float,
        real_time_factor: float,
        before: Mapping[str, Status],
        after: Mapping[str, Status],
        stopped: Outcome,
    ) -> Summary:
        spec, trace = self._fleet.spec, self._statements.brought_into(load_trace(trace_path))
        trace.save(trace_path)
        kinds = map(load_platform, set(spec.robots.values()))
        platforms = {kind.name: kind for kind in kinds}
        numbers = numbers_of(trace, platforms, mean_duty(after), real_time_factor)
        problems = problems_of(self._robots, before, after, numbers.contacts)
        if stopped.exit_code:
            problems = (*problems, f"stop: {stopped.line}")
        moved = self._watch.all_moved_at
        return Summary(
            pattern=self._play.pattern,
            platform=self._play.platform,
            robots=self._robots,
            arena=spec.arena,
            layout=spec.layout,
            seed=spec.seed,
            seconds_to_moving=None if moved is None else round(moved - began, 2),
            numbers=numbers,
            duty=duties(after),
            problems=problems,
        )


def _moved(start: WorldState, now: WorldState) -> set[str]:
    return {
        robot
        for robot, one, other in zip(now.ids, start.poses, now.poses, strict=True)
        if any(abs(a - b) > MOVED for a, b in zip(one, other, strict=True))
    }
