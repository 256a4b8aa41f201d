"""One demo on a running fleet: carry out its events, stop all robots, and summarize the run.

The demo commands the robots as an operator does, through `swarmd.operator.session.operator`. It
uses the true state of the world only for the live view and the summary.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from swarmd.core.clock import boottime
from swarmd.core.errors import NetworkError, SwarmError
from swarmd.core.messages import State, Status
from swarmd.core.processes import noted_signals
from swarmd.core.verbs import ParamRequest, ResetRequest, RunRequest
from swarmd.operator.session.operator import Operator, StopVerb
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.view.scene import Area, Scene
from swarmd.sim.live import starting
from swarmd.sim.live.fleet import WORLD, Fleet
from swarmd.sim.live.link import WorldView
from swarmd.sim.live.recording import StatusLog
from swarmd.sim.live.state import WorldState
from swarmd.sim.live.summary import METRICS, DemoSummary, DoneEvent, all_moved_after, problems_of
from swarmd.sim.metrics.catalog import measure
from swarmd.sim.scenarios.scenario import ScheduledEvent
from swarmd.sim.trace import load_trace
from swarmd.sim.world.faults import FaultKind

STATUS_PERIOD = 0.5  # s between two rounds of statuses: what a terminal can show without much load
STATUS_TIMEOUT = 3.0  # s for the statuses at the start and the end, which decide about problems
WORLD_TIMEOUT = 5.0  # s without a state, after which the world counts as lost


class LiveTimeline:
    """Events in order of time, carried out when due or as soon as the earlier ones are done."""

    def __init__(
        self, events: Sequence[ScheduledEvent], fleet: Fleet, operator: Operator, world: WorldView
    ) -> None:
        self._events = list(events)
        self._fleet = fleet
        self._operator = operator
        self._world = world
        self.done: list[DoneEvent] = []

    def apply(self, now: float) -> None:
        """Carry out the events that are due at `now` s of the recording."""
        while self._events and self._events[0].at <= now:
            event = self._events.pop(0)
            try:
                self._carry_out(event)
                problem = ""
            except SwarmError as error:
                problem = str(error)
            self.done.append(DoneEvent(event.at, now, event.text, event.robots, problem))

    def send_stop(self, verb: StopVerb, robots: Sequence[str]) -> Outcome:
        """Stop or estop robots; swarm-wide if `robots` are all robots of the fleet."""
        if set(robots) == set(self._fleet.spec.robots):
            return self._operator.send_stop(verb)
        return self._operator.send_stop(verb, select=lambda known: robots, names=robots)

    def _carry_out(self, event: ScheduledEvent) -> None:
        """Carry out one event; SwarmError if a robot refuses the request or does not answer.

        Requests go only to robots of the event whose daemons run.
        """
        running = set(self._fleet.robots)
        with_daemon = tuple(robot for robot in event.robots if robot in running)
        match event.action:
            case "place":
                assert event.pose is not None  # checked when the scenario was read
                self._world.place(event.box, event.pose)
            case "fault" | "mend" if event.fault is not None:
                self._change_fault(event.fault, event.robots, is_on=event.action == "fault")
            case "remove" if event.box:
                self._world.remove(event.box)
            case "fields":
                self._world.change_fields(event.fields)
            case "join":
                for robot in event.robots:
                    if robot not in with_daemon:
                        self._fleet.start_daemon(robot)
                starting.await_robots(self._operator, self._fleet)
            case "leave" | "kill":
                self._end_daemons(with_daemon, in_order=event.action == "leave")
            case "remove":
                self._end_daemons(with_daemon, in_order=False)
                for robot in event.robots:
                    self._world.take_out(robot)
            case "stop" | "estop":
                _check(event.action, self.send_stop(event.action, with_daemon))
            case _:
                self._request(event, with_daemon)

    def _change_fault(self, fault: FaultKind, robots: Sequence[str], *, is_on: bool) -> None:
        if fault.carried_by != "daemon":
            self._world.change_fault(fault.plain, robots, is_on=is_on)
            return
        for robot in robots:
            self._fleet.halt_daemon(robot, is_on=is_on)

    def _end_daemons(self, robots: Sequence[str], *, in_order: bool) -> None:
        for robot in robots:
            self._fleet.end_daemon(robot, in_order=in_order)

    def _request(self, event: ScheduledEvent, robots: tuple[str, ...]) -> None:
        operator = self._operator
        view = operator.members()
        epochs = view.epochs(robots)
        if event.action == "run":
            outcome = operator.request(RunRequest, epochs, **starting.run_fields(event))
        elif event.action == "param":
            outcome = operator.request(ParamRequest, epochs, params=dict(event.parameters))
        else:
            ids = tuple(sorted(view.latches(robots)))
            outcome = operator.request(ResetRequest, epochs, ids=ids)
        _check(event.action, outcome)


def _check(verb: str, outcome: Outcome) -> None:
    if outcome.exit_code:
        raise SwarmError(starting.why_not(verb, outcome))


class WorldWatcher:
    """The newest state of the simulated world, which a Zenoh thread hands over."""

    def __init__(self, world: WorldView, timeout: float = WORLD_TIMEOUT) -> None:
        self._timeout = timeout
        self._changed = threading.Condition()
        self._state: WorldState | None = None
        world.watch(self._take)

    def wait(self, since: float = -1.0) -> WorldState:
        """Wait for a state whose simulated time is later than `since` s, and return it.

        NetworkError if no such state comes within the timeout.
        """

        with self._changed:
            state = self._changed.wait_for(
                lambda: self._state if self._state and self._state.time > since else None,
                self._timeout,
            )
        if state is None:
            raise NetworkError(f"the world has sent no state for {self._timeout:g} s")
        return state

    def _take(self, state: WorldState) -> None:
        with self._changed:
            self._state = state
            self._changed.notify_all()


class DemoRun:
    """One demo of `seconds` s of simulation; `events` in order of time.

    `on_scene` is called about twice a second.
    """

    def __init__(
        self,
        events: Sequence[ScheduledEvent],
        seconds: float,
        fleet: Fleet,
        operator: Operator,
        world: WorldView,
        on_scene: Callable[[Scene], None],
    ) -> None:
        self._events = events
        self._seconds = seconds
        patterns = dict.fromkeys(event.pattern for event in events if event.pattern)
        self._pattern = "+".join(patterns) or "no pattern"
        platforms = dict.fromkeys(Path(name).stem for name in fleet.spec.robots.values())
        self._platform = "+".join(platforms)
        self._fleet = fleet
        self._operator = operator
        self._world = world
        self._on_scene = on_scene
        self._watcher = WorldWatcher(world)
        self._robots = tuple(fleet.spec.robots)
        self._log = StatusLog()
        self._signals: list[int] = []  # that have ended the run early

    def perform(
        self, trace: Path, began: float, tell: Callable[[str], object] | None = None
    ) -> DemoSummary:
        """Run all events from start to end, and return the summary of the demo.

        `trace`: the file that the world writes at the end. `began`: when the user's command
        started, in s on the clock since boot. `tell` is called with progress lines while robots
        start.
        """
        # 1. Robots are up; the recording starts; the first patterns run.
        view = starting.await_robots(self._operator, self._fleet, tell)
        recording_began = boottime()
        start = self._world.ask("start").state
        idle = starting.statuses_of(view)
        first_runs, later_events = _split(self._events)
        missing: dict[str, str] = {}
        for run in first_runs:
            missing |= starting.start_pattern(self._operator, view, run)

        # 2. Events, until the recording is complete.
        self._timeline = LiveTimeline(later_events, self._fleet, self._operator, self._world)
        before = starting.statuses_of(self._operator.members(timeout=STATUS_TIMEOUT))
        try:
            self._follow(before, start.time)
            faults = [f"{signal.Signals(one).name} ended the run early" for one in self._signals]
        except SwarmError as error:
            self._fleet.check(WORLD)  # without the world there is no summary
            faults = [str(error)]
        real_s = boottime() - recording_began
        end = self._world.ask("finish").state  # it records on after an early end

        # 3. The end: statuses, and a stop of all robots.
        after = starting.statuses_of(self._operator.members(timeout=STATUS_TIMEOUT))
        stop_outcome = self._timeline.send_stop("stop", self._fleet.robots)
        if stop_outcome.exit_code:
            faults.append(starting.why_not("stop", stop_outcome))
        faults += [f"{name} did not start: {text}" for name, text in missing.items()]
        started = [robot for run in first_runs for robot in run.robots if robot not in missing]
        delay = recording_began - began
        return self._summary(
            trace, delay, end.recorded / real_s, started, (idle, before, after), faults
        )

    def _follow(self, statuses: dict[str, Status], since: float) -> None:
        """Carry out events and show the robots until the recording is complete or a signal comes.

        `statuses`: of the robots at the start. `since`: the simulated time in s of the start;
        states with an earlier time are ignored, since they may belong to an earlier recording.
        """
        state = self._watcher.wait(since=since)
        next_query = 0.0
        with noted_signals(signal.SIGINT, signal.SIGTERM, signal.SIGHUP) as self._signals:
            while not self._signals and state.is_recording and state.recorded < self._seconds:
                self._timeline.apply(state.recorded)
                self._log.add_present(state.recorded, self._fleet.robots)
                if time.monotonic() >= next_query:
                    self._fleet.check()
                    statuses = starting.statuses_of(self._operator.members(timeout=STATUS_PERIOD))
                    self._log.add(state.recorded, statuses)
                    self._on_scene(self._scene(state, statuses))
                    next_query = time.monotonic() + STATUS_PERIOD
                try:
                    state = self._watcher.wait(since=state.time)
                except NetworkError:
                    self._fleet.check()  # an error that names the cause, if the world has ended
                    raise

    def _scene(self, state: WorldState, statuses: Mapping[str, Status]) -> Scene:
        return Scene(
            title=(
                f"{self._pattern}, {len(self._robots)} {self._platform}:"
                f" {state.recorded:.0f} of {self._seconds:.0f} s,"
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
        delay: float,
        real_time_factor: float,
        started: Sequence[str],
        statuses: tuple[Mapping[str, Status], Mapping[str, Status], Mapping[str, Status]],
        faults: list[str],
    ) -> DemoSummary:
        """The summary of the demo; adds states and reports of robots to the trace file.

        `delay`: s from the start of the user's command to that of the recording. `started`: the
        robots that run the first patterns. `statuses`: before the run, at its start, and at the
        end. `faults`: problems of the start and the end of the run.
        """
        spec = self._fleet.spec
        *_, after = statuses
        trace = self._log.merged_into(load_trace(trace_path))
        if spec.live is None:  # a scenario's events name its patterns
            trace = replace(trace, meta={**trace.meta, "pattern": self._pattern})
        try:
            trace.save(trace_path)
        except OSError as error:  # a full disk: the trace of the world alone is kept
            why = error.strerror or error
            faults = [*faults, f"the trace has no states and reports of robots: {why}"]
        reported = [f"report:{key}.mean_end" for key in trace.report]
        reported += [f"reading:{key}.mean_end" for key in trace.readings]
        metrics = measure(trace, [*METRICS, *reported])
        problems = faults + self._problems(started, statuses, int(metrics["robot_contacts"] or 0))
        moving = all_moved_after(trace)
        return DemoSummary(
            pattern=self._pattern,
            platform=self._platform,
            robots=self._robots,
            arena=spec.arena,
            layout=spec.layout,
            seed=spec.seed,
            seconds_to_moving=moving and round(delay + moving / real_time_factor, 2),
            # Whether protection runs compiled or interpreted, as each daemon states.
            kernels=" / ".join(sorted({status.kernels for status in after.values()})) or "-",
            seconds=trace.duration,
            real_time_factor=real_time_factor,
            metrics=metrics,
            problems=tuple(problems),
            signal=next(iter(self._signals), 0),
            scenario=spec.live.scenario.name if spec.live else "",
            events=tuple(self._timeline.done),
        )

    def _problems(
        self,
        started: Sequence[str],
        statuses: tuple[Mapping[str, Status], Mapping[str, Status], Mapping[str, Status]],
        contacts: int,
    ) -> list[str]:
        """The problems of robots and of events, each as a line.

        A robot of an event may have been stopped by the event, or have lost its daemon. So for the
        robots of events only a fault is a problem.
        """
        events = self._timeline.done
        *_, after = statuses
        robots_of_events = {robot for event in events for robot in event.robots}
        other_robots = [robot for robot in started if robot not in robots_of_events]
        problems = [*problems_of(other_robots, *statuses, contacts)]
        problems += [f"{e.action} at {e.at:g} s: {e.problem}" for e in events if e.problem]
        problems += [
            f"{name} ended faulted: {after[name].detail}"
            for name in sorted(robots_of_events & after.keys())
            if after[name].state is State.FAULTED
        ]
        return problems


def _split(
    events: Sequence[ScheduledEvent],
) -> tuple[Sequence[ScheduledEvent], Sequence[ScheduledEvent]]:
    """The runs with which a demo begins, and the events after them."""
    count = next(
        (i for i, event in enumerate(events) if event.at > 0.0 or event.action != "run"),
        len(events),
    )
    return events[:count], events[count:]
