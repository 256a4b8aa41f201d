"""One demo on a running fleet: carry out its events, stop all robots, and summarize the run.

The demo commands the robots as any operator does, through `swarmd.network.operator`. The true
state of the world is for the view and the summary alone.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from swarmd.core.clock import boottime
from swarmd.core.errors import NetworkError
from swarmd.core.messages import State, Status
from swarmd.network.operator import Operator
from swarmd.network.outcome import Outcome
from swarmd.sim.live.fleet import Fleet
from swarmd.sim.live.link import WorldView
from swarmd.sim.live.live_timeline import LiveTimeline
from swarmd.sim.live.starting import (
    Started,
    await_robots,
    joined,
    start_pattern,
    statuses_of,
    why_not,
)
from swarmd.sim.live.state import WorldState
from swarmd.sim.live.summary import Summary, mean_duty, numbers_of, problems_of
from swarmd.sim.live.trace_from_statuses import StatusLog
from swarmd.sim.scenarios.scenario import ScheduledEvent
from swarmd.sim.trace import load_trace
from swarmd.view.scene import Area, Scene

STATUS_PERIOD = 0.5  # s between two rounds of statuses: what a terminal can show without much load
STATUS_TIMEOUT = 3.0  # s for the statuses at the start and the end, which decide about problems
WORLD_TIMEOUT = 5.0  # s without a state, after which the world counts as lost
MIN_MOVE = 1e-3  # m or rad


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoSettings:
    """What to do in `seconds` of simulated time.

    `events` in order of time; `pattern` and `platform` name in a line what runs, and on what.
    """

    events: tuple[ScheduledEvent, ...]
    seconds: float
    pattern: str
    platform: str


class WorldWatcher:
    """The newest state of the world, handed over from the network's thread."""

    def __init__(self, world: WorldView, timeout: float = WORLD_TIMEOUT) -> None:
        self._timeout = timeout
        self._changed = threading.Condition()
        self._state: WorldState | None = None
        self._start: WorldState | None = None
        self._moved: set[str] = set()
        self.all_moved_at: float | None = None
        world.watch(self._take)

    def begin(self, start: WorldState) -> None:
        """Note from here on which robots have moved."""
        with self._changed:
            self._start, self._moved, self.all_moved_at = start, set(), None

    def wait(self, since: float = -1.0) -> WorldState:
        """A state later than simulated time `since`; NetworkError after `timeout` s without one."""

        def later() -> WorldState | None:
            return self._state if self._state is not None and self._state.time > since else None

        with self._changed:
            state = self._changed.wait_for(later, self._timeout)
        if state is None:
            raise NetworkError(f"the world has sent no state for {self._timeout:g} s")
        return state

    def _take(self, state: WorldState) -> None:
        with self._changed:
            self._state = state
            if self._start is not None and self.all_moved_at is None:
                self._moved |= _moved(self._start, state)
                if len(self._moved) == len(state.ids):
                    self.all_moved_at = boottime()
            self._changed.notify_all()


class DemoRun:
    """One demo. `on_scene` is called about twice a second."""

    def __init__(
        self,
        settings: DemoSettings,
        fleet: Fleet,
        operator: Operator,
        world: WorldView,
        on_scene: Callable[[Scene], None],
    ) -> None:
        self._settings, self._fleet, self._operator = settings, fleet, operator
        self._world, self._on_scene = world, on_scene
        self._watcher = WorldWatcher(world)
        self._robots = tuple(fleet.spec.robots)
        self._log = StatusLog()

    def perform(self, trace: Path, began: float) -> Summary:
        """Run all events from start to end; `began` is when the command did (boot time)."""
        view = await_robots(self._operator, self._fleet)
        wall_start = time.monotonic()
        start = self._world.ask("start").state
        self._watcher.begin(start)
        first, later = _split(self._settings.events)
        started = joined(start_pattern(self._operator, view, run) for run in first)
        self._timeline = LiveTimeline(later, self._fleet, self._operator, self._world)
        before = statuses_of(self._operator.members(timeout=STATUS_TIMEOUT))
        self._follow(before, start.time)
        wall = time.monotonic() - wall_start
        after = statuses_of(self._operator.members(timeout=STATUS_TIMEOUT))
        end = self._world.ask("finish").state
        stopped = self._timeline.send_stop("stop", self._fleet.robots)
        return self._summary(trace, began, end.recorded / wall, started, before, after, stopped)

    def _follow(self, statuses: dict[str, Status], since: float) -> None:
        """Carry out events and show the robots until the world has recorded enough.

        An older state than that at `since` s may count a recording of before the start.
        """
        state = self._watcher.wait(since=since)
        next_round = 0.0
        while state.is_recording and state.recorded < self._settings.seconds:
            self._timeline.apply(state.recorded)
            self._log.add_present(state.recorded, self._fleet.robots)
            if time.monotonic() >= next_round:
                self._fleet.check()
                statuses = statuses_of(self._operator.members(timeout=STATUS_PERIOD))
                self._log.add(state.recorded, statuses)
                self._on_scene(self._scene(state, statuses))
                next_round = time.monotonic() + STATUS_PERIOD
            try:
                state = self._watcher.wait(since=state.time)
            except NetworkError:
                self._fleet.check()  # names the cause, if the world's process has ended
                raise

    def _scene(self, state: WorldState, statuses: Mapping[str, Status]) -> Scene:
        settings = self._settings
        return Scene(
            title=(
                f"{settings.pattern}, {len(self._robots)} {settings.platform}:"
                f" {state.recorded:.0f} of {settings.seconds:.0f} s,"
                f" {state.real_time_factor:.2f} times real time, contacts {state.contacts}"
            ),
            area=Area(state.arena),
            poses=dict(zip(state.ids, state.poses, strict=True)),
            statuses=statuses,
            footer=f"In another terminal: SWARM={self._fleet.spec.swarm} swarmctl members",
        )

    def _summary(
        self,
        trace_path: Path,
        began: float,
        real_time_factor: float,
        started: Started,
        before: Mapping[str, Status],
        after: Mapping[str, Status],
        stopped: Outcome,
    ) -> Summary:
        spec, trace = self._fleet.spec, self._log.merged_into(load_trace(trace_path))
        trace.save(trace_path)
        platforms = {platform.name: platform for platform in spec.platforms().values()}
        numbers = numbers_of(trace, platforms, mean_duty(after), real_time_factor)
        done = self._timeline.done
        changed = {robot for event in done for robot in event.robots}
        steady = [robot for robot in started.robots if robot not in changed]
        problems = [f"{name} did not start: {text}" for name, text in started.missing.items()]
        problems += problems_of(steady, before, after, numbers.contacts)
        problems += [f"{one.action} at {one.at:g} s: {one.problem}" for one in done if one.problem]
        faulted = [name for name in sorted(changed & after.keys()) if _is_faulted(after[name])]
        problems += [f"{name} ended faulted: {after[name].detail}" for name in faulted]
        if stopped.exit_code:
            problems.append(why_not("stop", stopped))
        moved = self._watcher.all_moved_at
        return Summary(
            pattern=self._settings.pattern,
            platform=self._settings.platform,
            robots=self._robots,
            late=started.late,
            arena=spec.arena,
            layout=spec.layout,
            seed=spec.seed,
            seconds_to_moving=None if moved is None else round(moved - began, 2),
            kernels=" / ".join(sorted({status.kernels for status in after.values()})) or "-",
            numbers=numbers,
            problems=tuple(problems),
            scenario=spec.scenario.scenario.name if spec.scenario else "",
            events=tuple(done),
            reports={name: dict(status.report) for name, status in after.items()},
            readings={name: dict(status.readings) for name, status in after.items()},
        )


def _split(
    events: Sequence[ScheduledEvent],
) -> tuple[Sequence[ScheduledEvent], Sequence[ScheduledEvent]]:
    """The runs with which a demo begins, and the events after them."""
    count = next(
        (i for i, event in enumerate(events) if event.at > 0.0 or event.action != "run"),
        len(events),
    )
    return events[:count], events[count:]


def _is_faulted(status: Status) -> bool:
    return status.state is State.FAULTED


def _moved(start: WorldState, now: WorldState) -> set[str]:
    before = dict(zip(start.ids, start.poses, strict=True))
    return {
        robot
        for robot, one in zip(now.ids, now.poses, strict=True)
        if any(abs(a - b) > MIN_MOVE for a, b in zip(one, before[robot], strict=True))
    }
