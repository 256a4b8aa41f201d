"""One demo on a running fleet: start a pattern, follow it to its end, stop it, sum it up.

The demo commands the robots as any operator does, through `swarmd.network.operator`. The true
state of the world is for the view and the summary alone.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from swarmd.core.clock import boottime
from swarmd.core.errors import ConfigError, NetworkError, SwarmError
from swarmd.core.messages import Code, Presence, RunRequest, State, Status
from swarmd.network.discovery import MembersView
from swarmd.network.operator import Operator
from swarmd.network.outcome import Outcome
from swarmd.settings.platforms import load_platform
from swarmd.sim.live.fleet import Fleet
from swarmd.sim.live.link import WorldView
from swarmd.sim.live.state import WorldState
from swarmd.sim.live.summary import Summary, mean_duty, numbers_of, problems_of
from swarmd.sim.live.trace_from_statuses import StatusLog
from swarmd.sim.trace import load_trace
from swarmd.view.scene import Area, Scene

STATUS_PERIOD = 0.5  # s between two rounds of statuses: what a terminal can show without much load
STATUS_TIMEOUT = 3.0  # s for the statuses at the start and the end, which decide about problems
WORLD_TIMEOUT = 5.0  # s without a state, after which the world counts as lost
# s between two rounds while robots start. Without a pause the rounds take up to half a second of
# processor time from seven daemons that start on two cores.
UP_PERIOD = 0.02
UP_TIMEOUT, UP_TIMEOUT_EACH = 20.0, 1.0  # s, and s more per robot: slow machines, cold disks
# Twelve Burgers on a busy machine: four needed more than the 3 s in which a pattern must load.
RUN_ATTEMPTS = 3
MIN_MOVE = 1e-3  # m or rad


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoSettings:
    """Which pattern to run, with its parameters, for `seconds` of simulated time."""

    pattern: str
    params: Mapping[str, Any]
    seconds: float
    platform: str


@dataclass(frozen=True, slots=True)
class Started:
    """The robots that run the pattern; of these `late` needed more than one request.

    `missing`: why each other robot does not run it.
    """

    robots: tuple[str, ...]
    late: tuple[str, ...]
    missing: Mapping[str, str]


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


def await_robots(operator: Operator, fleet: Fleet) -> MembersView:
    """The swarm once each robot has answered and reaches its base, or when the time is up.

    SwarmError if a process ends meanwhile, NetworkError if no robot is up in time.
    """
    robots = fleet.spec.robots
    timeout = UP_TIMEOUT + UP_TIMEOUT_EACH * len(robots)
    deadline = time.monotonic() + timeout
    while True:
        fleet.check()
        view = operator.members()
        up = {name for name, status in statuses_of(view).items() if status.health.driver_up}
        is_over = time.monotonic() > deadline
        if up.issuperset(robots) or (up and is_over):
            return view
        if is_over:
            raise NetworkError(f"no robot is up after {timeout:.0f} s (logs: {fleet.spec.folder})")
        time.sleep(UP_PERIOD)


def statuses_of(view: MembersView) -> dict[str, Status]:
    """The statuses of the robots that are alive and have answered."""
    return {
        name: member.status
        for name, member in view.members.items()
        if member.presence is Presence.ALIVE and member.status is not None
    }


def start_pattern(
    operator: Operator, view: MembersView, robots: Iterable[str], settings: DemoSettings
) -> Started:
    """Run the pattern on the robots; each that fails or does not answer is asked again.

    ConfigError if all refuse, SwarmError if none runs it after the last attempt.
    """
    values = dict(settings.params)
    waiting = tuple(robots)
    started: set[str] = set()
    late: set[str] = set()
    for attempt in range(RUN_ATTEMPTS):
        if attempt:
            view = operator.members()
            # The acknowledgement may have been late or lost, and the robot runs all the same.
            running = {
                name
                for name, one in statuses_of(view).items()
                if one.state is State.RUNNING and one.pattern == settings.pattern
            }
            late |= running.intersection(waiting)
            waiting = tuple(name for name in waiting if name not in late)
        outcome = operator.request(
            RunRequest, view.epochs(waiting), pattern=settings.pattern, params=values
        )
        if not attempt and len(outcome.refused) == len(waiting):
            raise ConfigError(_why("run", outcome))
        (late if attempt else started).update(outcome.applied)
        waiting = tuple(name for name in waiting if name not in outcome.applied)
        if not waiting:
            break
    started |= late
    if not started:
        raise SwarmError(_why("run", outcome))
    return Started(tuple(sorted(started)), tuple(sorted(late)), _texts(outcome))


def _texts(outcome: Outcome) -> dict[str, str]:
    """Why each robot did not apply a request."""
    texts = {
        name: reply.text or reply.code.value
        for name, reply in outcome.replies.items()
        if reply.code is not Code.APPLIED
    }
    return texts | dict.fromkeys(outcome.missing, "no answer")


def _why(verb: str, outcome: Outcome) -> str:
    """The outcome in one line, with each text once."""
    by_text: dict[str, list[str]] = {}
    for name, text in sorted(_texts(outcome).items()):
        by_text.setdefault(text, []).append(name)
    reasons = [f"{', '.join(names)}: {text}" for text, names in by_text.items()]
    return "; ".join([f"{verb}: {outcome.line}", *reasons])


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
        """Run the pattern from start to end; `began` is when the command did (boot time)."""
        view = await_robots(self._operator, self._fleet)
        wall_start = time.monotonic()
        self._watcher.begin(self._world.ask("start").state)
        started = start_pattern(self._operator, view, self._robots, self._settings)
        before = statuses_of(self._operator.members(timeout=STATUS_TIMEOUT))
        self._follow(before)
        wall = time.monotonic() - wall_start
        after = statuses_of(self._operator.members(timeout=STATUS_TIMEOUT))
        end = self._world.ask("finish").state
        stopped = self._operator.send_stop("stop")
        return self._summary(trace, began, end.recorded / wall, started, before, after, stopped)

    def _follow(self, statuses: dict[str, Status]) -> None:
        """Show the robots until the world has recorded enough."""
        state = self._watcher.wait()
        next_round = 0.0
        while state.is_recording and state.recorded < self._settings.seconds:
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
        kinds = map(load_platform, set(spec.robots.values()))
        platforms = {kind.name: kind for kind in kinds}
        numbers = numbers_of(trace, platforms, mean_duty(after), real_time_factor)
        problems = [f"{name} did not start: {text}" for name, text in started.missing.items()]
        problems += problems_of(started.robots, before, after, numbers.contacts)
        if stopped.exit_code:
            problems.append(_why("stop", stopped))
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
        )


def _moved(start: WorldState, now: WorldState) -> set[str]:
    return {
        robot
        for robot, one, other in zip(now.ids, start.poses, now.poses, strict=True)
        if any(abs(a - b) > MIN_MOVE for a, b in zip(one, other, strict=True))
    }
