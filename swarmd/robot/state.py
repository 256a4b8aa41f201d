"""All that changes the state of one robot: the lifecycle, which fires triggers. Pure.

Each method of `Lifecycle` adds the effects of one event to `Effects`; requests and goals call these
methods. `state_machine.py` has the transitions; only `StateMachine.apply` changes the state. Every
trigger is fired in this file:

| trigger     | cause                                                  | reason               |
|-------------|--------------------------------------------------------|----------------------|
| RUN         | the pattern host reports Loaded                        | none                 |
| FINISH      | a step returns `done`; the seconds of the run are over | finished             |
| STOP        | a stop request; a reload of the running pattern        | operator, reloaded   |
|             | the daemon leaves                                      | leaving              |
|             | a greater goal; a load that peers run is refused       | superseded           |
|             | the run lease ends                                     | lease_ended          |
|             | the battery is low while the robot runs or loads       | low_battery          |
|             | a roster without this robot                            | roster_changed       |
| HOLD_LASTED | a hold has lasted for MAX_HOLD_TIME                    | the hold             |
| LOAD_FAILED | a load fails or times out; a restart is refused        | load_failed          |
| STALL       | the daemon's loop was late by STALL_TIMEOUT, unless    | loop_stalled         |
|             | the robot is idle and loads and tries nothing          |                      |
| HAZARD      | a wheel drop, or the base is lifted, while the robot   | hazard               |
|             | runs or loads                                          |                      |
| NETWORK     | the network that the daemon speaks on has changed      | network_changed      |
|             | the daemon takes a roster                              | roster_changed       |
| ESTOP       | an estop request; the latch of a peer; a latch on disk | estop                |
| FAULT       | too many failures of a pattern; a second robot has     | pattern_quarantined  |
|             | the same id                                            | duplicate_id         |
| RESET       | a reset request after which no latch is held           | reset                |

Only the trigger RUN leads to `running`, and never from `estopped` or `faulted`. Loads that end in
RUN come from the requests `run` and `resume`, a reload with a new run, a goal with `on_join: run`,
the restart of a failed pattern, and a battery that becomes low during a run: the pattern of the
setting `on_low_battery` replaces that run.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from msgspec import structs

from swarmd.core import host_messages
from swarmd.core.goal import Goal, GoalRecord, GoalState
from swarmd.core.low_battery import LowBatterySettings
from swarmd.core.messages import MAX_EVENTS, Code, Epoch, Latch, LoggedEvent, Reason, Reply, State
from swarmd.core.refusal import Refusal
from swarmd.core.values import Scalar, TouchZone
from swarmd.core.verbs import (
    MAX_LATE,
    ReloadRequest,
    Request,
    ResumeRequest,
    RunRequest,
    shortened,
)
from swarmd.kit.touch import effective_zone, granted_zones
from swarmd.robot.actions import FailedCode
from swarmd.robot.goals import Goals
from swarmd.robot.issue_time import IssueTime, KnownStops
from swarmd.robot.latches import Latches, LatchRecord
from swarmd.robot.low_battery import LowBattery
from swarmd.robot.message_limits import Outbox
from swarmd.robot.pattern_load import Loading, PendingParams, Trial, Wish, load_command
from swarmd.robot.pattern_run import PatternRun
from swarmd.robot.protection.decision import Permit
from swarmd.robot.setup import RobotIdentity
from swarmd.robot.state_machine import StateMachine, Trigger
from swarmd.robot.timeouts import (
    FAULTS_BEFORE_QUARANTINE,
    LOAD_TIMEOUT,
    MAX_HOLD_TIME,
    ROUNDING,
    STEP_TIMEOUT,
)

if TYPE_CHECKING:
    from swarmd.core.events import DriveInput
    from swarmd.robot.effects import Effects
    from swarmd.robot.hand import Hand


MAX_TEXT = 300  # characters
# The load of a next run that was already requested continues; a load has a timeout of its own.
_ENDS_RUN_ALONE = frozenset({Trigger.FINISH, Trigger.HOLD_LASTED})
_BARS_GOALS = frozenset({Reason.OPERATOR, Reason.ESTOP, Reason.RESET, Reason.LOW_BATTERY})
_KEEPS_HAND = frozenset({Trigger.FINISH, Trigger.LOAD_FAILED})
_ENDS_TRIAL = frozenset({Trigger.STOP, Trigger.ESTOP, Trigger.STALL, Trigger.NETWORK})


class Lifecycle:
    """State, pattern and latches of one robot. Times are in s and come with `effects`."""

    def __init__(
        self,
        identity: RobotIdentity,
        latches: LatchRecord | None,
        goals: GoalRecord | None,
        now: float,
    ) -> None:
        """Begin idle, or estopped if a latch on disk holds the robot.

        `latches`, `goals`: the records on disk of earlier daemon processes, None without a file.
        """
        self.identity = identity
        self.born = now  # s; for the uptime
        self.state_machine = StateMachine(now)
        self.pattern_run = PatternRun()
        self.latches = Latches(latches, now)  # the emergency stops that hold the robot
        self.goals = Goals(identity.robot, identity.setup.labels, goals, now)
        self.stops = KnownStops()
        if (
            goals is not None and goals.stood is not None
        ):  # the robot was stopped in an earlier life
            self.stops.note(IssueTime(goals.stood), "someone before its daemon started")
        self.outbox = Outbox()  # limits the messages of the pattern
        # The count of changes of this robot. A request quotes the epoch (instance and revision)
        # that the operator saw; once the revision has changed, the request is refused.
        self.revision = 0
        self.changed_by = "no one yet"  # the cause of the last change of `revision`, as text
        self.duplicate: str | None = None  # another daemon process that uses this robot's id
        self.revoked = ""  # why this robot no longer belongs to its swarm; empty if it belongs
        self.report: Mapping[str, Scalar] = {}  # the values that the pattern reported last
        self.events: deque[LoggedEvent] = deque(maxlen=MAX_EVENTS)
        self.params_request: PendingParams | None = None  # the request that waits for the pattern
        self.trial: Trial | None = None  # the present trial of new code
        self.ignored_commands = 0  # of hands: late, repeated, or of nobody who drives
        self.hold_since = math.inf  # s, own clock, of the present hold; inf without a hold
        self.wrong_type_count = 0  # messages with a value of an undeclared type
        # The generations (numbers) of the loads whose code is provisional: pushed by an operator,
        # and not yet proved by 60 s of runs without a fault.
        self.provisional: tuple[int, ...] = ()
        self.battery = LowBattery()
        # Why the base is lost or must not move, for the answer to a run; empty if it may move.
        self.base_fault = f"held: {Reason.DRIVER_LOST}: not connected yet"
        self._last_fault_text = ""  # the last failure of the pattern, as text
        self._load_command: host_messages.Load | None = None  # the last command to load a pattern
        if self.latches.held:
            text = shortened(self.latches.text, MAX_TEXT)
            self.state_machine.apply(Trigger.ESTOP, Reason.ESTOP, text, now)

    @property
    def is_running(self) -> bool:
        """True in state running."""
        return self.state_machine.state is State.RUNNING

    @property
    def is_driven(self) -> bool:
        """True while an operator drives the robot by hand."""
        hand = self.pattern_run.hand
        return hand is not None and hand.is_driving

    @property
    def has_lost_hand(self) -> bool:
        """True while a hand that was lost holds the run."""
        hand = self.pattern_run.hand
        return hand is not None and not hand.is_driving

    @property
    def epoch(self) -> Epoch:
        """The epoch that a request must quote to change this robot."""
        return Epoch(self.identity.instance, self.revision)

    def log(self, text: str, now: float) -> None:
        """Record an event for `describe`."""
        event = LoggedEvent(at=max(now - self.born, 0.0), text=shortened(text, MAX_TEXT))
        self.events.append(event)

    def applied(
        self, effects: Effects, request: Request, text: str, *, is_moving: bool = False
    ) -> None:
        """Acknowledge a request; the reply carries the epoch that follows from it."""
        self._reply(effects, request, Code.APPLIED, None, text, is_moving=is_moving)

    def fail(self, effects: Effects, request: Request, refusal: Refusal, text: str) -> None:
        """Reply that an accepted request could not be carried out."""
        self._reply(effects, request, Code.FAILED, refusal, text)

    def refuse(self, effects: Effects, request: Request, refusal: Refusal, text: str) -> None:
        """Refuse a request.

        What refuses it may end. So that no late copy of it starts a run then, such a refusal also
        makes requests stale that quote an earlier epoch; `changed_by` stays.
        """
        self.revision += refusal in (Refusal.BUSY, Refusal.NO_GOAL)
        self._reply(effects, request, Code.REFUSED, refusal, text)

    def _reply(
        self,
        effects: Effects,
        request: Request,
        code: Code,
        refusal: Refusal | None,
        text: str,
        *,
        is_moving: bool = False,
    ) -> None:
        answer = Reply(
            id=request.id,
            robot=self.identity.robot,
            code=code,
            refusal=refusal,
            text=shortened(text, MAX_TEXT),
            epoch=self.epoch,
            is_moving=is_moving,
        )
        effects.replies = (*effects.replies, answer)

    def raise_revision(self, by: str) -> None:
        """Raise the revision: requests that quote an earlier epoch are refused from now on."""
        self.revision += 1
        self.changed_by = by[:MAX_TEXT]

    # Events of the pattern host

    def on_host(self, event: host_messages.HostEvent, effects: Effects) -> None:
        """Act on an event of the host other than Stepped; ignores events of other generations."""
        run = self.pattern_run
        is_loading = run.loading is not None and event.generation == run.loading.generation
        is_running = run.running is not None and event.generation == run.running.generation
        if isinstance(event, host_messages.Loaded) and is_loading:
            self._on_loaded(event, effects)
        elif isinstance(event, host_messages.LoadRefused) and is_loading:
            self._on_load_refused(event, effects)
        elif isinstance(event, host_messages.ParamsSet):
            self._on_params_set(event, effects)
        elif isinstance(event, host_messages.PatternFailed) and is_running:
            self.fault(event.text, effects)
        elif isinstance(event, host_messages.PatternFailed) and is_loading:
            self.fail_load(event.text, effects)
        elif isinstance(event, host_messages.HostDied):
            self._on_host_died(event.text, effects)

    def _on_loaded(self, event: host_messages.Loaded, effects: Effects) -> None:
        """Run the loaded pattern, or keep the event until the start time of the run."""
        run = self.pattern_run
        loading = run.loading
        assert loading is not None
        late = 0.0 if loading.start_at is None else effects.now - loading.start_at + ROUNDING
        if late > MAX_LATE:
            self._end_late_load(late, effects)
        elif late < 0.0:
            run.awaiting_since = math.inf
            run.loading = replace(loading, loaded=event)
        else:
            self._begin_run(event, effects)

    def _end_late_load(self, late: float, effects: Effects) -> None:
        loading = self.pattern_run.loading
        self.pattern_run.loading = None
        effects.command_host(host_messages.KillHost())
        assert loading is not None
        text = f"{loading.pattern} was loaded {late:.1f} s after the time at which it was to start"
        if loading.request is not None:
            self.refuse(effects, loading.request, Refusal.TOO_LATE, text)
        self._end(Trigger.LOAD_FAILED, Reason.LOAD_FAILED, text, effects)

    def _begin_run(self, event: host_messages.Loaded, effects: Effects) -> None:
        """Enter state running with the pattern that the host has loaded.

        A restart after a failure continues the failed run; any other load begins a new run. In both
        cases the pattern gets a new permit. A permit lists what protection may allow this pattern,
        such as a touch zone, or scans that are later than the platform permits (`scan_delay`).
        """
        now = effects.now
        loading = self.pattern_run.ready(event, now)  # sets `pattern_run.running`, too
        self.hold_since = math.inf
        self.state_machine.apply(Trigger.RUN, None, "", now)
        if loading.is_restart:
            self.log(f"{loading.pattern} restarted", now)
        else:
            self._on_new_run(loading, event.note, effects)
        _give_permit(self, loading, event, now)

    def _on_new_run(self, loading: Loading, note: str, effects: Effects) -> None:
        """Tell the goals of the new run, and answer its request; `note`: remark of the host."""
        now = effects.now
        effects.is_new_run = True
        hand = self.pattern_run.hand
        if hand is not None and loading.wish.at > hand.lost_at:
            self.take_hand(None)
        self.report = {}
        self.goals.on_running(
            loading.goal,
            loading.pattern,
            now - loading.wish.at,
            now,
            is_resumed=not isinstance(loading.request, RunRequest),
        )
        remarks = (f"runs {loading.pattern}", note, self.battery.remark, self.base_fault)
        text = "; ".join(filter(None, remarks))
        if loading.request is None:
            self.log(text, now)
        else:
            self.applied(effects, loading.request, text)

    def _on_load_refused(self, event: host_messages.LoadRefused, effects: Effects) -> None:
        text = event.text
        loading = self.pattern_run.loading
        self.pattern_run.loading = None
        if loading is None or loading.request is None:
            if loading is not None and loading.wish.is_own:  # the state is stopped before and after
                self.log(f"{loading.pattern} is not loaded: {text}", effects.now)
            self._end(Trigger.LOAD_FAILED, Reason.LOAD_FAILED, text, effects)
            is_unknown = event.refusal is Refusal.UNKNOWN_PATTERN
            if loading is not None and loading.goal is not None and is_unknown:
                self.goals.await_code(loading.generation)
            return
        self.refuse(effects, loading.request, event.refusal, text)
        # Peers run the goal that this robot cannot load: the present run of this robot ends.
        if self.goals.state is GoalState.LOADING:
            self.goals.on_end(f"not loaded: {text}")
            if self.is_running and loading.goal is not None:
                self.stop(Reason.SUPERSEDED, f"by {loading.goal.text}", effects)
        if (
            self._load_command is not None and self._load_command.is_fresh
        ):  # the load ended the running host
            self.fault("its host was replaced", effects)

    def on_stepped(self, event: host_messages.Stepped, effects: Effects) -> None:
        """Act on the answer to a step; an answer of another generation only frees the host."""
        run = self.pattern_run
        running = run.running
        if running is None or event.generation != running.generation:
            if event.generation == run.stepped_generation:
                run.awaiting_since = math.inf
            return
        run.stepped(event.outputs, event.scan_seq, effects.now)
        self.wrong_type_count += event.dropped
        twist = event.outputs.twist
        if twist is not None and not twist.is_finite:
            self.fault("its twist is not finite", effects)
            return
        outputs = event.outputs
        self.report = outputs.report
        effects.grip = outputs.grip
        if outputs.messages:
            passed = self.outbox.take(outputs.messages, running.channels, effects.now)
            effects.messages = {running.full_name(name): value for name, value in passed.items()}
        if outputs.done is not None:
            self._end(Trigger.FINISH, Reason.FINISHED, outputs.done, effects)
        else:
            effects.is_routine = True

    def _on_params_set(self, event: host_messages.ParamsSet, effects: Effects) -> None:
        if self.params_request is None or self.params_request.request.id != event.request:
            return
        request = self.params_request.request
        self.params_request = None
        running = self.pattern_run.running
        if not event.params or running is None:
            refusal = Refusal.INVALID_PARAMETER if event.text else Refusal.NOT_RUNNING
            self.refuse(effects, request, refusal, event.text or "no pattern is running")
            return
        running.values = event.params
        permit = running.permit
        running.permit = _permit(event.params, permit.touch, permit.scan_delay, permit.speed)
        running.params = {**running.params, **request.params}
        names = ", ".join(request.params)
        self.goals.note(f"param set by {request.operator}: {names}"[:MAX_TEXT])
        self.applied(effects, request, event.text or "set")

    def _on_host_died(self, text: str, effects: Effects) -> None:
        self.pattern_run.awaiting_since = math.inf
        loading = self.pattern_run.loading
        if loading is not None and not loading.is_restart:
            self.fail_load(text, effects)
        elif self.is_running and self.pattern_run.restart_at == math.inf:
            self.fault(text, effects)

    # Failures of a pattern

    def fault(self, text: str, effects: Effects) -> None:
        """Restart the running pattern in a fresh host after its failure, or quarantine the pattern.

        A pattern of provisional (just pushed) code is never restarted: its first failure
        quarantines it, and the daemon returns to the version before.
        """
        run = self.pattern_run
        running = run.running
        loading = run.loading
        if running is None or not self.is_running:
            return
        effects.command_host(host_messages.KillHost())
        self._last_fault_text = text
        self.log(f"{running.pattern} failed: {text}", effects.now)
        # The killed host was loading a requested next run, too: that load fails and ends the run.
        if loading is not None and loading.request is not None:
            self.fail_load(text, effects)
        elif self._is_provisional(running.generation, text, effects):
            run.fault(effects.now)
            detail = f"{running.pattern} failed while it was provisional: {text}"
            self._end(Trigger.FAULT, Reason.QUARANTINED, detail, effects)
        elif not run.fault(effects.now):
            self.hold_since = math.inf  # the restart is a new hold, with its full MAX_HOLD_TIME
        else:
            detail = f"{running.pattern} failed {FAULTS_BEFORE_QUARANTINE} times, last: {text}"
            self._end(Trigger.FAULT, Reason.QUARANTINED, detail, effects)

    def _is_provisional(self, generation: int, text: str, effects: Effects) -> bool:
        """True if the load `generation` loaded provisional code; then notes the failure `text`.

        `effects` takes the failure, by which the daemon returns to the version before.
        """
        is_provisional = generation in self.provisional
        if is_provisional:
            effects.failed_code = FailedCode(generation, text)
        return is_provisional

    def fail_load(self, text: str, effects: Effects) -> None:
        """End a failed load and its host."""
        loading = self.pattern_run.loading
        self.pattern_run.loading = None
        effects.command_host(host_messages.KillHost())
        if loading is None:
            return
        self.log(f"{loading.pattern} was not loaded: {text}", effects.now)
        self._is_provisional(loading.generation, text, effects)
        detail = f"{loading.pattern}: {text}"
        if loading.request is not None:
            self.fail(effects, loading.request, Refusal.PATTERN_FAILED, detail)
        self._end(Trigger.LOAD_FAILED, Reason.LOAD_FAILED, detail, effects)

    def _end(
        self,
        trigger: Trigger,
        reason: Reason,
        detail: str,
        effects: Effects,
        *,
        keeps_load: bool = False,
        keeps_hand: bool = False,
    ) -> None:
        """End the run and the load, if any, and fire a trigger; the run is not stepped any more.

        Exception: a load that an operator requested continues if `keeps_load` is True, and after a
        trigger of `_ENDS_RUN_ALONE`, such as the end of the run's time. A request whose load, trial
        or change of parameters ends here is refused as `overtaken`.
        """
        loading = self.pattern_run.loading
        is_requested = loading is not None and loading.request is not None
        continues_load = keeps_load or trigger in _ENDS_RUN_ALONE
        if is_requested and continues_load:
            self.pattern_run.end_running()
        else:
            self._end_run_and_load(reason, detail, effects)
        if trigger in _ENDS_TRIAL:
            text = f"{reason} while the new code was being tried"
            self.end_trial(Refusal.OVERTAKEN, text, effects)
        if self.params_request is not None:
            request = self.params_request.request
            self.params_request = None
            text = f"{reason} before the pattern answered"
            self.refuse(effects, request, Refusal.OVERTAKEN, text)
        self._leave_state(trigger, reason, detail, effects, keeps_hand=keeps_hand)

    def _end_run_and_load(self, reason: Reason, detail: str, effects: Effects) -> None:
        """End the run, and the load with its host; refuse the request that waits for the load."""
        loading = self.pattern_run.loading
        if loading is not None:
            effects.command_host(host_messages.KillHost())
            if loading.request is not None:
                text = f"{reason} while it was being loaded"
                text = shortened(f"{text}: {detail}" if detail else text, MAX_TEXT)
                self.refuse(effects, loading.request, Refusal.OVERTAKEN, text)
        self.pattern_run.end()

    def _leave_state(
        self,
        trigger: Trigger,
        reason: Reason,
        detail: str,
        effects: Effects,
        *,
        keeps_hand: bool,
    ) -> None:
        """Change the state by `trigger`, and tell goals, log and shell of the end of the run."""
        self.hold_since = math.inf  # no hold: a hold is a reason for which a running robot stands
        state_before = self.state_machine.state
        was_running = self.is_running
        self.state_machine.apply(trigger, reason, shortened(detail, MAX_TEXT), effects.now)
        end_text = f"{self.state_machine.state} ({reason}) {detail}".rstrip()
        if reason is Reason.LEAVING:  # the record on disk goes on to know of the hand
            self.pattern_run.hand = None
        elif not keeps_hand:
            self._end_hand(trigger, end_text, effects)
        if reason is not Reason.LEAVING:  # when the daemon ends, the robot keeps its goal
            self.goals.on_end(shortened(end_text, MAX_TEXT))
        if reason in _BARS_GOALS:  # the robot joins no goal that was set before now
            self.goals.bar(effects.now)
        if self.state_machine.state is not state_before:
            self.log(end_text, effects.now)
        if was_running:
            effects.ended = shortened(end_text, MAX_TEXT)

    def _end_hand(self, trigger: Trigger, text: str, effects: Effects) -> None:
        """End the hand, unless the run ended by itself; a lost one if nothing is left to hold."""
        run = self.pattern_run
        hand = run.hand
        if hand is None:
            return
        if hand.is_driving:
            is_over = trigger not in _KEEPS_HAND
        else:
            is_over = run.running is None and run.loading is None
        if is_over:
            self.drop_hand(text, effects)

    def drop_hand(self, text: str, effects: Effects) -> None:
        """End the hand, for the reason `text`; state and run stay."""
        hand = self.pattern_run.hand
        if hand is not None:
            self.log(f"no longer driven by {hand.driver}: {text}", effects.now)
            self.take_hand(None)

    def take_hand(self, hand: Hand | None) -> None:
        """Put the robot in a hand, in place of the one before; None: in no hand."""
        self.pattern_run.hand = hand
        self.goals.on_hand(is_there=hand is not None)

    def stop(
        self,
        reason: Reason,
        detail: str,
        effects: Effects,
        *,
        keeps_load: bool = False,
        keeps_hand: bool = False,
    ) -> None:
        """End the run; state stopped. `keeps_load`: the load of a requested run continues.

        `keeps_hand`: a hand stays, since another run takes the place of this run beneath it.
        """
        self._end(
            Trigger.STOP, reason, detail, effects, keeps_load=keeps_load, keeps_hand=keeps_hand
        )

    def reset(self, detail: str, effects: Effects) -> None:
        """Become idle; the caller has cleared the latches."""
        self._end(Trigger.RESET, Reason.RESET, detail, effects)

    def end_trial(self, refusal: Refusal, text: str, effects: Effects) -> None:
        """End the present trial, if any, and refuse its request; the running pattern continues."""
        trial = self.trial
        self.trial = None
        if trial is not None:
            effects.trial = host_messages.CancelTrial()
            self.log(f"{trial.request.pattern} not reloaded: {text}", effects.now)
            self.refuse(effects, trial.request, refusal, text)

    # Operators, peers and the machine

    def restart_failed(self, effects: Effects) -> None:
        """Load a failed pattern again once its backoff is over."""
        run = self.pattern_run
        running = run.running
        if effects.now < run.restart_at:
            return
        if running is not None and effects.host is None:
            self.start_run(
                running.pattern,
                running.params,
                effects,
                wish=running.wish,
                until=running.until,
                is_restart=True,
                speed=running.permit.speed,
            )

    def start_run(
        self,
        pattern: str,
        params: Mapping[str, Scalar | None],
        effects: Effects,
        *,
        wish: Wish,
        seconds: float | None = None,
        until: tuple[str, ...] = (),
        request: RunRequest | ReloadRequest | ResumeRequest | None = None,
        goal: Goal | None = None,
        start_at: float | None = None,
        is_fresh: bool = False,
        is_restart: bool = False,
        speed: float | None = None,
    ) -> None:
        """Command the pattern host to load a pattern; the run begins once the host has loaded it.

        `wish`: when and by whom the run was requested. `seconds`: the longest time of the run, None
        without a limit. `until`: conditions; the first that holds ends the run. `request`: the
        request that is answered when the run begins, or refused if the load fails. `goal`: the goal
        of the run. `start_at`: the run does not begin before this time, s on the own clock.
        `is_fresh`: load in a new host process; also done if the present host has outdated code.
        `is_restart`: the failed pattern of the present run is loaded again. `speed`: the greatest
        speed of the run in m/s, None for that of the robot.
        """
        run = self.pattern_run
        run.generation += 1
        run.loading = Loading(
            generation=run.generation,
            pattern=pattern,
            params=params,
            seconds=seconds,
            since=effects.now,
            request=request,
            wish=wish,
            until=until,
            goal=goal,
            start_at=start_at,
            is_restart=is_restart,
            speed=speed,
        )
        run.restart_at = math.inf  # this load replaces a restart that was planned
        self._load_command = structs.replace(
            load_command(self.identity, self.goals.labels, run.generation, pattern, params),
            is_fresh=is_fresh or run.is_outdated,
            until=until,
            is_restart=is_restart,
        )
        effects.command_host(self._load_command)
        run.is_outdated = False

    def on_drive(self, one: DriveInput, now: float) -> bool:
        """Take in a command of who drives the robot by hand; False if it is ignored."""
        hand = self.pattern_run.hand
        is_heard = hand is not None and hand.hear(one, now)
        self.ignored_commands += not is_heard
        return is_heard

    def outdate_host(self, effects: Effects) -> None:
        """Make the next load use a fresh host; the running pattern continues."""
        run = self.pattern_run
        if run.running is None and run.loading is None:
            effects.command_host(host_messages.KillHost())
        else:
            run.is_outdated = True

    def latch(self, latch_id: str, latch: Latch, effects: Effects) -> None:
        """Add a latch and stop, in every state."""
        effects.is_latched = True
        if self.latches.add(latch_id, latch, effects.now):
            self.raise_revision(f"{latch.issuer} (estop)")
        elif self.state_machine.state is State.ESTOPPED:
            return  # a copy of a held latch: a trial that began after the first copy continues
        self._end(Trigger.ESTOP, Reason.ESTOP, self.latches.text, effects)

    def adopt_latches(self, latches: Mapping[str, Latch], effects: Effects) -> None:
        """Adopt the swarm-wide latches of a peer, except latches that were reset here."""
        new = self.latches.adopt(latches, effects.now)
        if not new:
            return
        effects.is_latched = True
        self.stops.note(IssueTime(effects.now), latches[new[0]].issuer)
        self.raise_revision(f"{latches[new[0]].issuer} (estop)")
        self._end(Trigger.ESTOP, Reason.ESTOP, self.latches.text, effects)

    def stall(self, late: float, effects: Effects) -> None:
        """Act on a stall: the loop of the daemon did not run for `late` s. End the run.

        Requests that quote an earlier epoch are refused from now on. An idle robot without a load
        or trial stays idle: there is nothing to end, and stalls are frequent while the daemon
        starts on a busy computer.
        """
        self.raise_revision(f"a stall of {late:.1f} s")
        detail = f"the daemon did not run for {late:.1f} s"
        run = self.pattern_run
        is_busy = run.loading is not None or self.trial is not None or run.hand is not None
        if self.state_machine.state is State.IDLE and not is_busy:
            self.log(detail, effects.now)
            return
        self._end(Trigger.STALL, Reason.LOOP_STALLED, detail, effects)

    def on_hazard(self, text: str, effects: Effects) -> None:
        """End run, load and hand after a wheel drop or a lift (a person holds the robot).

        Requests that quote an earlier epoch are refused from now on, and the robot joins no goal
        that was set before.
        """
        run = self.pattern_run
        if run.running is None and run.loading is None and run.hand is None:
            return
        self.raise_revision(f"a hazard: {text}")
        self._end(Trigger.HAZARD, Reason.HAZARD, text, effects)
        self.goals.bar(effects.now)

    def on_battery(self, settings: LowBatterySettings, effects: Effects) -> None:
        """Act on a battery that has become low, or log that the battery is no longer low.

        A low battery ends the run or the load, and the robot joins no goal that was set before.
        """
        battery = self.battery
        now = effects.now
        if not battery.is_low:
            self.log(f"the battery is no longer low{battery.charge_text}", now)
            return
        text = f"the battery is below {settings.below:g}{battery.charge_text}"
        running = self.pattern_run.running
        loading = self.pattern_run.loading
        if running is not None and loading is None and running.wish.is_own:
            return  # the run of `on_low_battery` goes on: the charge rose and fell again meanwhile
        if running is None and loading is None:
            self.log(text, now)
            self.goals.on_end(text)
            self.goals.bar(now)  # the robot joins no goal that was set before
            return
        _end_for_low_battery(self, settings, text, effects)

    def on_network_changed(self, text: str, effects: Effects) -> None:
        """After a change of the daemon's network: end the run, make earlier epochs stale."""
        self.raise_revision("a change of the network")
        self.log(f"network: {text}", effects.now)
        self._end(Trigger.NETWORK, Reason.NETWORK_CHANGED, text, effects)

    def on_roster(self, text: str, effects: Effects, *, is_revoked: bool) -> None:
        """After a new roster: end the run. A revoked robot refuses runs from then on."""
        self.revoked = text if is_revoked else ""
        self.raise_revision("a change of the roster")
        self.log(f"roster: {text}", effects.now)
        trigger = Trigger.STOP if is_revoked else Trigger.NETWORK
        self._end(trigger, Reason.ROSTER_CHANGED, text, effects)

    def on_duplicate(self, holder: str | None, effects: Effects) -> None:
        """Take in the instance that uses the same robot id; None after that instance has left."""
        if holder is not None and holder != self.duplicate:
            self.raise_revision("a second robot of this name")
            detail = f"this id is also held by {holder}"
            self._end(Trigger.FAULT, Reason.DUPLICATE_ID, detail, effects)
        self.duplicate = holder

    # Time

    def advance(self, hold: Reason | None, effects: Effects, hold_text: str = "") -> Reason | None:
        """Act on all deadlines that have passed at `effects.now`.

        A hold is a present reason for which a running robot stands. `hold`: the hold of the
        sensors, None without one. `hold_text`: the detail of this hold, used if the hold ends the
        run. Returns the hold of the sensors, else of the pattern, else of a lost hand; None without
        a hold, or if neither a run nor a hand is there. A robot that is driven by hand is held by
        its sensors alone.
        """
        now = effects.now
        self._advance_hand(effects)
        self._advance_load(effects)
        self._advance_answers(effects)
        running = self.pattern_run.running
        if not self.is_running or running is None:
            return hold if self.is_driven else None
        if now >= running.finish_at:
            self._end(Trigger.FINISH, Reason.FINISHED, "its seconds are over", effects)
            return hold if self.is_driven else None
        lease_ends_at = self.goals.lease_ends
        own_goal = self.goals.own
        if lease_ends_at is not None and own_goal is not None and now >= lease_ends_at:
            _end_lease(self, own_goal.goal, effects)
            return None
        present = self._present_hold(hold, effects, hold_text)
        if self.is_driven:
            return hold
        if present is None and self.has_lost_hand:
            return Reason.HAND_LOST
        return present

    def _advance_hand(self, effects: Effects) -> None:
        """Lose the hand whose driver was not heard in time."""
        run = self.pattern_run
        hand = run.hand
        if hand is None or effects.now < hand.due_at:
            return
        hand.lose(effects.now)
        # Starts that were asked for before are stale: nothing late ends the hold.
        self.raise_revision(f"the loss of the hand of {hand.driver}")
        self.goals.bar(effects.now)
        self.log(f"the hand of {hand.driver} {hand.lost_text}", effects.now)
        if run.running is None and run.loading is None:
            self.take_hand(None)

    def _advance_load(self, effects: Effects) -> None:
        """Begin the run of a loaded pattern at `start_at`; end a load that takes too long."""
        loading = self.pattern_run.loading
        now = effects.now
        if loading is None:
            return
        if loading.loaded is None:
            if now - loading.since >= LOAD_TIMEOUT:
                self.fail_load(f"loading took more than {LOAD_TIMEOUT:.0f} s", effects)
        # A timer that wakes at `start_at` may be early by a rounding error.
        elif loading.start_at is None or now >= loading.start_at - ROUNDING:
            self._on_loaded(loading.loaded, effects)

    def _advance_answers(self, effects: Effects) -> None:
        """End a host that does not answer a step; fail a parameter request without an answer."""
        run = self.pattern_run
        now = effects.now
        if now - run.awaiting_since >= STEP_TIMEOUT:
            run.awaiting_since = math.inf
            self._end_silent_host(effects)
        pending = self.params_request
        if pending is not None and now - pending.since >= LOAD_TIMEOUT:
            self.params_request = None
            text = "the pattern did not answer"
            self.fail(effects, pending.request, Refusal.PATTERN_FAILED, text)

    def _end_silent_host(self, effects: Effects) -> None:
        """End a host that hangs in a step; a load that waits for this host gets a fresh host."""
        run = self.pattern_run
        text = f"gave no answer for {STEP_TIMEOUT:.0f} s"
        if run.loading is None or self._load_command is None:
            effects.command_host(host_messages.KillHost())
            self.fault(text, effects)
            return
        self.log(f"the pattern before {run.loading.pattern} {text}", effects.now)
        run.loading = replace(run.loading, since=effects.now)
        effects.command_host(structs.replace(self._load_command, is_fresh=True))

    def _present_hold(self, hold: Reason | None, effects: Effects, hold_text: str) -> Reason | None:
        """The hold of the sensors, else of the pattern. Ends the run after MAX_HOLD_TIME."""
        if hold is None and self.pattern_run.is_restarting:
            hold = Reason.PATTERN_RESTARTING
        if hold is None and self.pattern_run.is_expired(effects.now):
            hold = Reason.COMMAND_EXPIRED
        is_switching = hold is Reason.COMMAND_EXPIRED and self.pattern_run.loading is not None
        if hold is None or is_switching:  # a load has a timeout of its own
            self.hold_since = math.inf
        elif self.hold_since == math.inf:
            self.hold_since = effects.now
        elif effects.now - self.hold_since >= MAX_HOLD_TIME:
            text = hold_text or f"for {MAX_HOLD_TIME:.0f} s"
            if hold is Reason.PATTERN_RESTARTING:
                text += f", last: {self._last_fault_text}"
            self._end(Trigger.HOLD_LASTED, hold, text, effects)
            return None
        return hold


def _give_permit(
    lifecycle: Lifecycle, loading: Loading, event: host_messages.Loaded, now: float
) -> None:
    """Set the permit of the running pattern, until the pattern is loaded again.

    A pattern may want a touch zone (`event.touches`): a part of the outline that may touch objects.
    The permit contains as much of this zone as the operator granted the pattern.
    """
    running = lifecycle.pattern_run.running
    assert running is not None
    pattern = loading.pattern
    granted = granted_zones(lifecycle.identity.setup.settings.touch).get(pattern)
    zone, zone_text = effective_zone(pattern, event.touches, granted)
    running.permit = _permit(event.params, zone, event.scan_delay, loading.speed)
    if zone_text:
        lifecycle.log(f"{pattern} {zone_text}", now)
    if event.scan_delay > 0.0:
        delay_text = f"goes on with scans up to {event.scan_delay:.2f} s later than declared"
        lifecycle.log(f"{pattern} {delay_text}", now)


def _end_for_low_battery(
    lifecycle: Lifecycle, settings: LowBatterySettings, text: str, effects: Effects
) -> None:
    """End run and load. In place of the run, start the pattern of the setting `on_low_battery`.

    That pattern is not started if there was no run, or if the run had a lease: the operator of a
    lease wants a robot that stands once the operator is not heard. Nor is it if the run waited
    beneath a hand, or was held by a lost one.
    """
    ended_run = lifecycle.pattern_run.running
    had_lease = lifecycle.goals.lease_ends is not None
    had_hand = lifecycle.pattern_run.hand is not None
    lifecycle.raise_revision("a low battery")
    lifecycle.stop(Reason.LOW_BATTERY, text, effects)
    is_held = had_lease or had_hand
    if ended_run is not None and settings.pattern is not None and not is_held:
        lifecycle.start_run(
            settings.pattern,
            settings.params,
            effects,
            wish=Wish(ended_run.wish.issued, "its low battery", is_own=True),
            seconds=settings.seconds,
        )


def _end_lease(lifecycle: Lifecycle, goal: Goal, effects: Effects) -> None:
    """Stop the run of `goal`, since its operator was not heard for the time of the lease."""
    # Earlier requests become stale: their operators do not know of this end.
    lifecycle.raise_revision(f"the end of the run lease of {goal.issuer}")
    text = f"{goal.issuer} was not heard for {goal.lease:g} s"
    text += lifecycle.goals.old_leases(effects.now)
    lifecycle.stop(Reason.LEASE_ENDED, text, effects)


def _permit(
    params: host_messages.ParamSources,
    touch: TouchZone | None,
    scan_delay: float,
    speed: float | None,
) -> Permit:
    """What a pattern with these parameters permits protection to do."""
    may_recover, _ = params.get("recovery", (False, ""))
    avoidance, _ = params.get("avoidance", ("platform", ""))
    avoids = None if avoidance == "platform" else avoidance == "orca"
    return Permit(may_recover is True, touch, scan_delay, avoids, speed)
