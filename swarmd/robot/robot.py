"""One robot without I/O: values and times in, `Actions` out.

Two shells drive it: the daemon and the lockstep simulator. Every method is O(1) and never waits.
`wake_at` gives the next deadline, at which `tick` must be called even between two ticks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from typing import Any

from msgspec.structs import astuple

from swarmd.core import events
from swarmd.core.clock import STALL_TIMEOUT
from swarmd.core.events import Input
from swarmd.core.goal import GoalRecord, HeldGoal
from swarmd.core.host_messages import Step, TrialDone
from swarmd.core.messages import Epoch, Latch, Motion, Reason, State, Status
from swarmd.core.values import Platform, Scalar, Scan, SharedPose
from swarmd.protection.decision import NO_PERMIT, Decision
from swarmd.protection.protection import Protection
from swarmd.robot.actions import Actions, Effects
from swarmd.robot.goal_handler import GoalHandler
from swarmd.robot.latches import LatchRecord
from swarmd.robot.message_limits import EventLimit
from swarmd.robot.pattern_run import ROUNDING
from swarmd.robot.requests import RequestHandler
from swarmd.robot.sensors import Sensors
from swarmd.robot.settings import RobotIdentity, RobotSettings
from swarmd.robot.state import MAX_HOLD_TIME, Lifecycle
from swarmd.robot.status import DutyCycle, make_status, status_reason

STATUS_PERIOD = 1.0
MAX_WHY = 200  # characters of the driver's text in the answer to a stop


class Robot:
    """Lifecycle, sensors, protection and status of one robot.

    `seed` makes the random choices of its patterns repeatable, `instance` identifies this life of
    the daemon, `now` is in s on a monotonic clock, `latches` and `goals` were written by an earlier
    instance.
    `revision`, `generation`: of the epoch and of the last pattern, to continue from.
    """

    def __init__(
        self,
        id: str,
        platform: Platform,
        settings: RobotSettings,
        *,
        seed: int,
        instance: str,
        now: float,
        latches: LatchRecord | None = None,
        goals: GoalRecord | None = None,
        revision: int = 0,
        generation: int = 0,
    ) -> None:
        self.id = id
        self.platform = platform
        self._last_tick = now
        # Quiet ticks: the first tick after an event finds until when nothing is due. Each event but
        # a quiet tick resets `_quiet_until`. An event that may change the lifecycle resets
        # `_due_at`, too. Odometry, neighbours, readings and messages reset neither.
        self._due_at = -math.inf  # s; before it only a step or the status can be due
        self._quiet_until = -math.inf  # s; before it nothing is due: a tick only decides
        self._is_off_command = False  # the base does not follow its commands
        self._hold: Reason | None = Reason.NO_SCAN  # that of the last event
        self._is_status_due = True  # the lifecycle may have changed since the last look at it
        self._settled: Actions  # those of the last event but a quiet tick
        self._sensors = Sensors(platform, settings.accepts, tells_pose=settings.tells_pose)
        self._protection = Protection(platform, f"{seed}/{id}")
        identity = RobotIdentity(id, platform, settings, seed, instance, self._protection.passage)
        self._lifecycle = Lifecycle(identity, latches, goals, now)
        self._lifecycle.revision = revision
        self._lifecycle.pattern_run.generation = generation
        self._events = EventLimit(self._lifecycle.log)
        self._machine, self._run = self._lifecycle.state_machine, self._lifecycle.pattern_run
        self._goals = GoalHandler(self._lifecycle)
        self._requests = RequestHandler(
            id, self._lifecycle, self._goals, self._protection, self._stop_text
        )
        self._duty = DutyCycle()
        self._published: tuple[object, ...] = ()
        self._published_at = -math.inf
        self.decided_at = -math.inf  # s; when protection decided last
        self.decision = self._decide(None, now)  # the last one

    # Present state

    @property
    def is_running(self) -> bool:
        """True in state running."""
        return self._lifecycle.is_running

    @property
    def state(self) -> State:
        """The state."""
        return self._machine.state

    @property
    def reason(self) -> Reason | None:
        """The one reason why the robot does not move; None while it moves."""
        return status_reason(self._lifecycle, self.decision)

    @property
    def epoch(self) -> Epoch:
        """The epoch that a request must quote to change the robot."""
        return self._lifecycle.epoch

    @property
    def generation(self) -> int:
        """How many patterns were loaded so far."""
        return self._lifecycle.pattern_run.generation

    @property
    def running_generation(self) -> int | None:
        """The generation of the pattern that runs or is being loaded; None without one."""
        run = self._lifecycle.pattern_run
        present = run.loading or run.running
        return None if present is None else present.generation

    @property
    def generations(self) -> tuple[int, ...]:
        """The generations of the patterns that run or are being loaded."""
        run = self._run
        return tuple(one.generation for one in (run.running, run.loading) if one is not None)

    @property
    def latches(self) -> Mapping[str, Latch]:
        """The emergency stops that hold the robot, by id."""
        return self._lifecycle.latches.held

    @property
    def cleared(self) -> Collection[str]:
        """The ids of emergency stops that were reset: their late copies do not latch again."""
        return self._lifecycle.latches.cleared

    @property
    def goal(self) -> HeldGoal | None:
        """The greatest goal that the robot has seen."""
        return self._lifecycle.goals.held

    @property
    def wished(self) -> float:
        """When the present run, or the next one, was asked for, in s; -inf if the robot stands."""
        wish = self._run.wish
        return -math.inf if wish is None else wish.at

    @property
    def reset_at(self) -> float:
        """When the robot was reset last, in s; -inf if it was not."""
        return self._requests.reset_at

    @property
    def goals(self) -> GoalRecord:
        """The goals and labels as they are kept on disk."""
        return self._lifecycle.goals.record()

    @property
    def labels(self) -> tuple[str, ...]:
        """The labels of the robot."""
        return self._lifecycle.goals.labels

    @property
    def report(self) -> Mapping[str, Scalar]:
        """The last report of the pattern."""
        return self._lifecycle.report

    @property
    def readings(self) -> Mapping[str, float]:
        """The present scalar sensors by name."""
        return self._sensors.readings

    def step(self, input: Input, now: float) -> Actions | None:
        """Take one input at `now`; the work of the shell, None if nothing changes for the shell."""
        return _HANDLERS[type(input)](self, input, now)

    @property
    def is_at_rest(self) -> bool:
        """True if only events change the state: no run, load or trial, and no answer due.

        False without the base: another node may drive it, and a stopped robot then sends zero.
        """
        is_due = self.is_running or self._lifecycle.due_at() < math.inf
        return self._sensors.is_driver_up and not is_due

    # Inputs from the driver and the network

    def _on_scan(self, one: events.ScanInput, now: float) -> Actions:
        effects = self._begin(now)
        effects.is_routine = True
        blind = self._sensors.blind_text
        restarts = self._sensors.scan_delay.restarts
        effects.is_new_scan = self._sensors.on_scan(one.scan, now)
        if self._sensors.scan_delay.restarts != restarts:
            self._log_restart(now)
        if self._sensors.blind_text != blind:
            text = self._sensors.blind_text or "all sectors return something again"
            self._lifecycle.log(f"scan: {text}", now)
        if effects.is_new_scan and self._sensors.scan is not None:
            self._protection.observe(self._sensors.scan, self._sensors.context(now))
            self._log_protection(now)
        return self._settle(effects)

    def _on_ranges(self, one: events.RangesInput, now: float) -> Actions:
        effects = self._begin(now)
        effects.is_routine = True
        self._sensors.on_ranges(one.scan, now)
        return self._settle(effects)

    def _on_odometry(self, one: events.OdometryInput, now: float) -> None:
        odometry, sensors, protection = one.odometry, self._sensors, self._protection
        restarts = sensors.scan_delay.restarts
        sensors.on_odometry(odometry, now)
        if sensors.scan_delay.restarts != restarts:
            self._log_restart(now)
        if sensors.odometry is odometry:
            protection.on_odometry(odometry)
            if protection.events:
                self._log_protection(now)
            text = protection.following.text
            if bool(text) != self._is_off_command:
                self._log_following(text, now)

    def _on_neighbors(self, one: events.NeighborsInput, now: float) -> None:
        self._sensors.on_neighbors(one.neighbors, now)

    def _on_peers(self, one: events.PeersInput, now: float) -> None:
        robots: dict[tuple[str, str], list[str]] = {}  # a swarm of one kind is one event
        for found in self._sensors.on_peers(one.bodies):
            robots.setdefault((found.kind, found.text), []).append(found.robot)
            self._due_at = self._quiet_until = -math.inf
        for (kind, text), names in robots.items():
            self._events.log(f"peers {kind}", f"peer {', '.join(names)}: {text}", now)
        self._events.advance(now)

    def _on_pose(self, one: events.PoseInput, now: float) -> None:
        self._sensors.on_pose(one.pose, now)

    def _on_place(self, one: events.PlaceInput, now: float) -> None:
        self._sensors.on_place(one.place, now)

    def pose_to_tell(self, now: float) -> tuple[SharedPose, float] | None:
        """The own pose in a shared frame and its age in s, if peers are to be told it."""
        return self._sensors.peers.pose_to_tell(now)

    def _on_readings(self, one: events.ReadingsInput, now: float) -> None:
        self._sensors.on_readings(one.readings)

    def _on_hazards(self, one: events.HazardsInput, now: float) -> Actions:
        effects, holds = self._begin(now), self._sensors.hazards
        before = holds.present
        holds.take(one.hazards, now)
        if before != holds.present:
            text = ", ".join(hazard.text for hazard in holds.present) or "none any more"
            self._events.log("hazards", f"hazards: {text}", now)
            self._events.advance(now)
        return self._settle(effects)

    def _on_message(self, one: events.MessageInput, now: float) -> None:
        """Take a message; ignored on a channel that the running pattern does not declare."""
        running = self._lifecycle.pattern_run.running
        channel = None if running is None else running.channel(one.channel)
        if channel is not None:
            self._sensors.on_message(one.sender, channel, one.value, now)

    def _on_driver(self, one: events.DriverInput, now: float) -> Actions:
        effects, sensors = self._begin(now), self._sensors
        if (one.is_up, one.hold) != (sensors.is_driver_up, sensors.driver_hold):
            self._lifecycle.log(f"driver: {one.text}", now)
        sensors.on_driver(one.is_up, one.text, hold=one.hold, gets_zero=one.gets_zero)
        return self._settle(effects)

    # Pattern host, operators and peers

    def _on_host(self, one: events.HostInput, now: float) -> Actions:
        effects = self._begin(now)
        if isinstance(one.event, TrialDone):
            self._requests.on_trial_done(one.event, effects)
        else:
            self._lifecycle.on_host(one.event, effects)
        if effects.is_new_run:
            self._sensors.forget_messages()
            self._duty = DutyCycle()
        return self._settle(effects)

    def _on_request(self, one: events.RequestInput, now: float) -> Actions:
        """Act on a request; its reply is in these actions or in those of a later host event."""
        effects = self._begin(now)
        self._requests.answer(one.request, effects)
        return self._settle(effects)

    def _on_provisional(self, one: events.ProvisionalInput, now: float) -> None:
        self._lifecycle.provisional = one.generations

    def _on_code(self, one: events.CodeInput, now: float) -> Actions:
        effects = self._begin(now)
        self._lifecycle.outdate_host(effects)
        return self._settle(effects)

    def _on_latches(self, one: events.LatchesInput, now: float) -> Actions:
        effects = self._begin(now)
        self._lifecycle.adopt_latches(one.latches, effects)
        return self._settle(effects)

    def _on_goal(self, one: events.GoalInput, now: float) -> Actions:
        effects = self._begin(now)
        self._goals.on_goal(one.goal, one.age, effects, may_join=one.may_join)
        return self._settle(effects)

    def _on_forget(self, one: events.ForgetInput, now: float) -> Actions:
        effects = self._begin(now)
        self._lifecycle.forget_goals(one.digests, effects)
        return self._settle(effects)

    def _on_lease(self, one: events.LeaseInput, now: float) -> None:
        self._lifecycle.goals.on_lease(one.goal, one.count, now)

    def _on_duplicate(self, one: events.DuplicateInput, now: float) -> Actions:
        effects = self._begin(now)
        self._lifecycle.on_duplicate(one.holder, effects)
        return self._settle(effects)

    def _on_network(self, one: events.NetworkInput, now: float) -> Actions:
        effects = self._begin(now)
        self._lifecycle.on_network_changed(one.text, effects)
        return self._settle(effects)

    def _on_roster(self, one: events.RosterInput, now: float) -> Actions:
        effects = self._begin(now)
        self._lifecycle.on_roster(one.text, effects, is_revoked=one.is_revoked)
        return self._settle(effects)

    def _on_leave(self, one: events.LeaveInput, now: float) -> Actions:
        effects = self._begin(now)
        self._lifecycle.stop(Reason.LEAVING, "", effects)
        return self._settle(effects)

    def _on_note(self, one: events.NoteInput, now: float) -> None:
        self._lifecycle.log(one.text, now)

    # Time

    def _tick(self, one: events.TickInput, now: float) -> Actions:
        """Check all deadlines: 20 times a second, at rest 10 times, and at `wake_at`."""
        if now >= self._quiet_until:
            self._look_ahead()
        is_quiet = now < self._quiet_until and now - self._last_tick <= STALL_TIMEOUT
        effects = None if is_quiet else self._begin(now)
        self._last_tick = now
        if self._machine.state is State.RUNNING:
            self._duty.decisions += 1
            self._duty.active += self.decision.is_active
        if effects is None:
            last = self._settled
            decision = self.decision = self._decide(None, now)
            return Actions(
                decision.safe,
                decision,
                last.requested_scan_seq,
                last.is_idle,
                last.is_stopped,
                True,
            )
        effects.is_tick = effects.is_routine = True
        return self._settle(effects)

    def wake_at(self, now: float) -> float | None:
        """The next deadline for which the robot must be woken between ticks; None without one.

        Deadlines of the pattern run, the run lease, the scans and the longest hold. Odometry,
        peers and hazards are checked at ticks.
        """
        lifecycle = self._lifecycle
        soonest = lifecycle.pattern_run.next_deadline(now)
        if lifecycle.is_running:
            lease_ends = lifecycle.goals.lease_ends
            if lease_ends is not None and now < lease_ends < soonest:
                soonest = lease_ends
            stale_at = self._sensors.stale_at()
            if stale_at is not None and now < stale_at + 1e-4 < soonest:
                soonest = stale_at + 1e-4
            since = lifecycle.hold_since
            if since is not None and now < since + MAX_HOLD_TIME < soonest:
                soonest = since + MAX_HOLD_TIME
        return soonest if soonest < math.inf else None

    def status(self, now: float) -> Status:
        """The status at `now`."""
        return make_status(
            self._lifecycle, self._sensors, self.decision, self._duty, now, self._protection
        )

    def motion(self, now: float) -> Motion | None:
        """How it moves, for viewers; None before the first odometry."""
        odometry = self._sensors.odometry
        if odometry is None:
            return None
        pose, decision = odometry.pose, self.decision
        return Motion(
            robot=self.id,
            at=now,
            x=pose.x,
            y=pose.y,
            yaw=math.remainder(pose.yaw, 2.0 * math.pi),
            requested=astuple(decision.requested),
            safe=astuple(decision.safe),
            is_active=decision.is_active,
            gap=decision.min_gap,
            rows=decision.rows[:3],
        )

    @property
    def scan(self) -> Scan | None:
        """The latest conditioned scan."""
        return self._sensors.scan

    def _begin(self, now: float) -> Effects:
        """Begin the effects of an event. After a stall of the loop the run ends first."""
        effects = Effects(now)
        late = now - self._last_tick
        if late > STALL_TIMEOUT:
            self._last_tick = now
            self._due_at = -math.inf
            self._lifecycle.stall(late, effects)
        return effects

    def _settle(self, effects: Effects) -> Actions:
        now, lifecycle, run = effects.now, self._lifecycle, self._run
        permit = NO_PERMIT if run.running is None else run.running.permit
        sensors = self._sensors
        sensors.permitted_delay = permit.scan_delay
        hold = sensors.hold(now)
        hazards = sensors.hazards.text(now) if hold is Reason.HAZARD else ""
        if sensors.hazards.present and sensors.hazards.ends_run:
            lifecycle.on_hazard(sensors.hazards.text(now), effects)
        if hold is not None or now >= self._due_at or not effects.is_routine:
            self._requests.advance(effects)
            hold = lifecycle.advance(hold, effects, hazards)
            self._is_status_due, self._due_at = True, -math.inf
        self._quiet_until, self._hold = -math.inf, hold
        decision = self.decision = self._decide(hold, now)
        machine = self._machine
        if run.restart_at is not None:
            self._restart(effects)
        if effects.host is None and machine.state is State.RUNNING:
            self._step(effects)
        # Replies go first: a status may wait for the tick, an emergency stop may not.
        is_looking = effects.is_tick or effects.is_latched
        has_status = is_looking and self._has_new_status(now)
        running, state = run.running, machine.state
        actions = self._settled = Actions(
            decision.safe,
            decision,
            -1 if running is None else running.requested.scan_seq,
            sensors.is_driver_up and state is State.IDLE,
            state is not State.IDLE and state is not State.RUNNING,
            latches=lifecycle.latches.record() if effects.is_latched else None,
            goals=lifecycle.goals.take_record(),
            trial=effects.trial,
            host=effects.host,
            messages=effects.messages,
            has_status=has_status,
            replies=effects.replies,
            failed_code=effects.failed_code,
            ended=effects.ended,
        )
        return actions

    def _look_ahead(self) -> None:
        """Find until when nothing is due if no event comes; a hold is looked at in each tick."""
        if self._hold is not None:
            return
        due = self._lifecycle.due_at()
        if self._machine.state is State.RUNNING:
            held_at = self._sensors.hold_due_at()
            due = held_at if held_at < due else due
        self._due_at = due - ROUNDING
        if not self._is_status_due:
            step_at, status_at = self._run.step_due_at(), self._published_at + STATUS_PERIOD
            due = step_at if step_at < due else due
            self._quiet_until = (status_at if status_at < due else due) - ROUNDING

    def _log_restart(self, now: float) -> None:
        text = "stamps of odometry or scan jumped: the scan delay is measured anew"
        self._events.log("stamps that jump", text, now)

    def _log_protection(self, now: float) -> None:
        events = self._protection.events
        while events:
            self._lifecycle.log(events.pop(0), now)

    def _log_following(self, text: str, now: float) -> None:
        self._is_off_command = bool(text)
        if text or self.is_running:
            self._events.log("following", text or "the base follows its commands again", now)
            self._events.advance(now)

    def _decide(self, hold: Reason | None, now: float) -> Decision:
        running, context = self._run.running, self._sensors.context(now)
        if running is None:
            decision = self._protection.decide(None, context, is_running=False, hold=hold)
        else:
            decision = self._protection.decide(
                running.requested.twist,
                context,
                is_running=self._machine.state is State.RUNNING,
                hold=hold,
                # Nothing is permitted under a hold, and a pattern that restarts is held.
                permit=running.permit if hold is None else NO_PERMIT,
            )
        self.decided_at = now
        return decision

    def _restart(self, effects: Effects) -> None:
        """Load a failed pattern again once its backoff is over."""
        run = self._lifecycle.pattern_run
        running = run.running
        if run.restart_at is None or effects.now < run.restart_at:
            return
        if running is not None and effects.host is None:
            self._lifecycle.start_run(
                running.pattern, running.params, effects, wish=running.wish, until=running.until
            )

    def _step(self, effects: Effects) -> None:
        run, now = self._run, effects.now
        if run.running is not None and run.may_step(now, effects.is_new_scan):
            inputs = self._sensors.inputs(now, run.stepping(now))
            effects.command_host(Step(run.running.generation, inputs))

    def _has_new_status(self, now: float) -> bool:
        """True if something that peers act on has changed, and after STATUS_PERIOD."""
        if not self._is_status_due and now < self._published_at + STATUS_PERIOD - ROUNDING:
            return False
        self._is_status_due = False
        lifecycle, machine = self._lifecycle, self._lifecycle.state_machine
        reason = status_reason(lifecycle, self.decision)
        if reason in (Reason.NO_REQUESTED_COMMAND, Reason.PROTECTION):
            reason = None  # these change with every scan
        running, loading = lifecycle.pattern_run.running, lifecycle.pattern_run.loading
        current = (
            machine.state,
            reason,
            machine.detail,
            lifecycle.revision,
            None if running is None else running.generation,
            None if running is None else running.values,
            None if loading is None else loading.generation,
            tuple(lifecycle.latches.held),
            self._sensors.is_driver_up,
            self._sensors.hazards.present,
        )
        if current == self._published and now - self._published_at < STATUS_PERIOD:
            return False
        self._published, self._published_at = current, now
        return True

    def _stop_text(self, now: float) -> str:
        """The text that acknowledges a stop: what was sent, and the measured speed with its age."""
        sensors = self._sensors
        why = sensors.driver_text[:MAX_WHY]
        if sensors.is_driver_up:
            sent = "commanded zero"
        elif sensors.gets_zero:
            sent = f"commanded zero; {why}"
        else:
            sent = f"nothing was sent: driver lost: {why}"
        odometry, age = sensors.odometry, sensors.odometry_age(now)
        if odometry is None or age is None:
            return f"{sent}; no odometry"
        twist = odometry.twist
        linear, angular = round(twist.linear, 2) + 0.0, round(twist.angular, 2) + 0.0  # no -0.00
        return f"{sent}; measured {linear:.2f} m/s, {angular:.2f} rad/s, {age:.1f} s ago"


_HANDLERS: Mapping[type[Input], Callable[[Robot, Any, float], Actions | None]] = {
    events.ScanInput: Robot._on_scan,
    events.RangesInput: Robot._on_ranges,
    events.OdometryInput: Robot._on_odometry,
    events.NeighborsInput: Robot._on_neighbors,
    events.PoseInput: Robot._on_pose,
    events.ReadingsInput: Robot._on_readings,
    events.HazardsInput: Robot._on_hazards,
    events.DriverInput: Robot._on_driver,
    events.MessageInput: Robot._on_message,
    events.PeersInput: Robot._on_peers,
    events.PlaceInput: Robot._on_place,
    events.LatchesInput: Robot._on_latches,
    events.GoalInput: Robot._on_goal,
    events.LeaseInput: Robot._on_lease,
    events.DuplicateInput: Robot._on_duplicate,
    events.HostInput: Robot._on_host,
    events.RequestInput: Robot._on_request,
    events.CodeInput: Robot._on_code,
    events.ProvisionalInput: Robot._on_provisional,
    events.ForgetInput: Robot._on_forget,
    events.NetworkInput: Robot._on_network,
    events.RosterInput: Robot._on_roster,
    events.LeaveInput: Robot._on_leave,
    events.NoteInput: Robot._on_note,
    events.TickInput: Robot._tick,
}
