"""Carries out the requests of operators on one robot, or refuses them. Pure.

No late request starts motion:

1. Run, reset, reload and param quote the epoch (count of the robot's changes) that the operator
   saw, and the robot refuses any other epoch.
2. The robot refuses a start (run, resume, reload with a new run) that was issued before a stop that
   it knows (`issue_time.py`).
3. The robot refuses a start that is older than verbs.MAX_AGE and the time that the request declares
   (`planned`).

The robot obeys stop and estop in every state and at every epoch.

A reload replaces the code of a pattern. A trial runs the new code first, in a process of its own,
for this robot and with the parameters in force. Nothing else changes until the trial has passed. A
stop or a failed trial leaves the running pattern and its code as they are.

A stop may arrive late. A run and a load (of the pattern for the next run) each have a `Wish`: the
time at which that run was requested. The robot compares the time at which the stop was issued with
these wishes:

=====================================  ==========================================================
stop issued after all wishes           run and load end
stop issued before all wishes          refused (`overtaken`): run and load continue
stop issued after the wish of the run  the run ends and the load continues; the reply is a
and before the wish of the load        refusal (`overtaken`), since the load starts a new run
no run and no load, new stop           a trial ends; an idle robot becomes stopped
no run and no load, stop issued        nothing changes, and the reply is as for a new stop: a
before an obeyed stop or a reset, or   trial or reset may have been requested after this stop
at the same instant
=====================================  ==========================================================

The age of a stop does not include its time on the network. A stop may therefore seem to be issued
later than it was, never earlier: in doubt the robot stops. So a stop of which no copy came before
the run may end a run that was requested later, by the time of both on their ways. A copy of a stop
that the robot has carried out ends no later run.
"""

from __future__ import annotations

import math
from hashlib import sha256
from typing import TYPE_CHECKING, NamedTuple

from swarmd.core import verbs
from swarmd.core.goal import GoalState
from swarmd.core.host_messages import CancelTrial, KillHost, SetParams, StartTrial, TrialDone
from swarmd.core.keys import is_id
from swarmd.core.messages import Latch, Reason, State
from swarmd.core.refusal import Refusal
from swarmd.robot.goal_handler import GoalHandler, fault_of
from swarmd.robot.hand import Hand
from swarmd.robot.issue_time import IssueTime
from swarmd.robot.pattern_load import PendingParams, Trial, Wish, load_command
from swarmd.robot.sensors import Sensors
from swarmd.robot.state import Lifecycle

if TYPE_CHECKING:
    from swarmd.robot.effects import Effects
    from swarmd.robot.protection.protection import Protection

Start = verbs.RunRequest | verbs.ResumeRequest | verbs.ReloadRequest | verbs.DriveRequest

TRIAL_TIMEOUT = 10.0
MAX_STOPS = 64  # ids of stops that are remembered
STOP_TIME = 2.0
"""Seconds after a stop in which a base comes to rest: all platforms need less."""
_RESPONSE = 0.2  # s after the last command to move, in which the base may not have responded yet
# m/s and rad/s, at most, that odometry shows of a base at rest
_REST_SPEED = 0.02
_REST_TURN = 0.05
MAX_WHY = 200  # characters of the driver's text in the answer to a stop


class _StopTime(NamedTuple):
    """When a stop was issued, and whether the robot carried out an earlier copy of this stop."""

    issued: IssueTime
    is_copy: bool

    def is_before(self, wish: Wish) -> bool:
        """True if the run of `wish` was requested after the stop, which must not end this run."""
        if self.is_copy:
            # At equal times, too: the first copy has ended all runs that were requested before it.
            return not wish.issued.is_before(self.issued)
        return self.issued.is_surely_before(wish.issued)  # at equal times the robot stops


class RequestHandler:
    """Carries out the requests of operators."""

    def __init__(
        self,
        robot: str,
        lifecycle: Lifecycle,
        goals: GoalHandler,
        protection: Protection,
        sensors: Sensors,
        now: float,
    ) -> None:
        self._robot = robot
        self._goals = goals
        self._protection = protection
        self._lifecycle = lifecycle
        self._sensors = sensors
        self._trials = 0
        self._heard_by = now + STOP_TIME  # a base may move unheard until this time
        # By id of a stop, the time at which it was first carried out.
        self._executed: dict[str, float] = {}
        # A robot without a run or load has obeyed all stops that were issued until this time.
        self._obeyed_until = -math.inf
        self.reset_at = -math.inf  # the time of the last reset

    def answer(self, request: verbs.Request, effects: Effects) -> None:
        """Carry the request out or refuse it; no reply if the request targets only other robots."""
        if request.targets is not None and self._robot not in request.targets:
            return
        is_release = isinstance(request, verbs.DriveRequest) and request.is_release
        needs_epoch = verbs.VERBS[request.verb].needs_epoch and not is_release
        if needs_epoch and (refusal := self._refusal_of(request)):
            self._lifecycle.refuse(effects, request, *refusal)
        else:
            getattr(self, f"on_{request.verb}")(request, effects)

    def _refusal_of(self, request: verbs.Request) -> tuple[Refusal, str] | None:
        """Why a request is refused: the robot is revoked, or another epoch is quoted. Else None."""
        revoked = self._lifecycle.revoked
        quoted = (request.targets or {})[self._robot]
        if revoked and not isinstance(request, verbs.ResetRequest):
            return Refusal.REVOKED, f"{revoked}; it is no longer a robot of this swarm"
        # Only the goal of this same request, received from a peer, may have changed the epoch.
        is_same = quoted == self._lifecycle.epoch
        if not is_same and not self._goals.has_goal_by_peer(request, quoted):
            text = f"robot changed since you looked, by {self._lifecycle.changed_by}"
            return Refusal.STALE_EPOCH, text
        return None

    # Requests, by the names of their verbs

    def on_stop(self, request: verbs.StopRequest, effects: Effects) -> None:
        """Stop; refuse (`overtaken`) if the next run was requested after the stop was issued.

        A stop may arrive late, or as a copy that a robot relays or the operator repeats. The table
        of the module lists the cases.
        """
        lifecycle = self._lifecycle
        next_wish = self._lifecycle.pattern_run.wish
        stop = self._time_of(request, effects.now)
        lifecycle.stops.note(stop.issued, request.operator)
        if next_wish is not None and stop.is_before(next_wish):
            self._refuse_stop(request, stop, next_wish, effects)
            return
        # Robots relay copies of a stop for a minute. Without run and load, a copy must not end a
        # trial or reset that was requested after the first copy.
        is_obeyed_already = stop.is_copy or stop.issued.at <= self._obeyed_until
        self._obeyed_until = max(self._obeyed_until, stop.issued.at)
        hand = lifecycle.pattern_run.hand
        ends_hand = hand is not None and not stop.is_before(hand.wish)
        if next_wish is not None or ends_hand or not is_obeyed_already:
            lifecycle.raise_revision(f"{request.operator} (stop)")
            lifecycle.stop(Reason.OPERATOR, f"by {request.operator}", effects)
        self._goals.on_stop(request, effects)
        self._answer_stop(request, effects)

    def _time_of(self, request: verbs.StopRequest | verbs.EstopRequest, now: float) -> _StopTime:
        """The time of issue by the age that the request states.

        A copy was issued before the first copy was carried out, whatever age the copy states.
        """
        stated = now - request.age
        # Only a stop that was carried out is in `_executed`. The age of a refused copy is not kept:
        # a forged copy would make the true stop look older.
        executed_at = self._executed.get(request.id)
        issued = IssueTime.of(request, stated if executed_at is None else min(stated, executed_at))
        return _StopTime(issued, is_copy=executed_at is not None)

    def _refuse_stop(
        self, request: verbs.StopRequest, stop: _StopTime, next_wish: Wish, effects: Effects
    ) -> None:
        """Refuse a stop that was issued before `next_wish`, which the stop must not end.

        `next_wish`: the wish of the load; without a load the wish of the run. Beside a load, the
        present run has an earlier wish of its own. A stop issued after that wish ends the run, and
        the load continues.
        """
        lifecycle = self._lifecycle
        running = self._lifecycle.pattern_run.running
        hand = self._lifecycle.pattern_run.hand
        # A lost hand stays: it holds the next run, which moves by no late stop.
        if hand is not None and hand.is_driving and not stop.is_before(hand.wish):
            lifecycle.raise_revision(f"{request.operator} (stop)")
            lifecycle.drop_hand(f"stopped by {request.operator}", effects)
        if running is not None and not stop.is_before(running.wish):
            lifecycle.raise_revision(f"{request.operator} (stop)")
            lifecycle.stop(Reason.OPERATOR, f"by {request.operator}", effects, keeps_load=True)
        text = f"run again since, by {next_wish.by}"
        lifecycle.refuse(effects, request, Refusal.OVERTAKEN, text)

    def on_estop(self, request: verbs.EstopRequest, effects: Effects) -> None:
        """Latch the emergency stop; a relayed copy of an estop that was reset is refused."""
        # An id that is no valid name becomes its hash. A common stand-in for all such ids would
        # count as reset from the second estop on, and peers would not adopt that latch.
        is_name = is_id(request.id)
        latch_id = request.id if is_name else sha256(request.id.encode()).hexdigest()[:32]
        if request.is_relayed and self._lifecycle.latches.is_cleared(latch_id):
            lifecycle = self._lifecycle
            lifecycle.refuse(effects, request, Refusal.OVERTAKEN, "reset since it was issued")
            return
        latch = Latch(issuer=request.operator, **verbs.shared_fields(request, Latch))
        self._lifecycle.latch(latch_id, latch, effects)
        self._lifecycle.stops.note(self._time_of(request, effects.now).issued, request.operator)
        self._obeyed_until = effects.now
        self._goals.on_stop(request, effects)
        self._answer_stop(request, effects)

    def on_run(self, request: verbs.RunRequest, effects: Effects) -> None:
        """Load the pattern, or refuse; the reply follows once the pattern is loaded."""
        lifecycle = self._lifecycle
        wish = self._wish_of(request, effects.now)
        now = effects.now
        why = self._refusal_to_start(request, wish, now) or self._refusal_to_run(request, now)
        if why is not None:
            lifecycle.refuse(effects, request, *why)
        else:
            lifecycle.raise_revision(f"{request.operator} (run {request.pattern})")
            lifecycle.start_run(
                request.pattern,
                request.params,
                effects,
                wish=wish,
                seconds=request.seconds,
                until=request.until,
                request=request,
                goal=request.goal,
                start_at=request.at.get(self._robot),
                speed=request.speed,
            )

    def on_resume(self, request: verbs.ResumeRequest, effects: Effects) -> None:
        """Run the robot's own goal."""
        wish = self._wish_of(request, effects.now)
        if why := self._refusal_to_start(request, wish, effects.now):
            self._lifecycle.refuse(effects, request, *why)
        elif self._may_go_on(request):
            self._go_on(request, effects)
        else:
            self._goals.resume(request, wish, effects)

    def _may_go_on(self, request: verbs.ResumeRequest) -> bool:
        """True if a resume lets the run go on that a lost hand holds."""
        lifecycle = self._lifecycle
        own = lifecycle.goals.own
        is_of_other = request.digest and (own is None or request.digest != own.digest.hex())
        return lifecycle.is_running and lifecycle.has_lost_hand and not is_of_other

    def _go_on(self, request: verbs.ResumeRequest, effects: Effects) -> None:
        """Let the run go on that a lost hand holds."""
        lifecycle = self._lifecycle
        run = lifecycle.pattern_run
        assert run.running is not None
        lifecycle.raise_revision(f"{request.operator} (resume {run.running.pattern})")
        lifecycle.take_hand(None)
        lifecycle.applied(effects, request, f"{run.running.pattern} goes on")

    def on_drive(self, request: verbs.DriveRequest, effects: Effects) -> None:
        """Begin a hand, or end one by the word of its driver; or refuse."""
        if request.is_release:
            self._release(request, effects)
            return
        lifecycle = self._lifecycle
        run = lifecycle.pattern_run
        wish = self._wish_of(request, effects.now)
        why = self._refusal_of_state() or self._refusal_of_wish(request, wish, effects.now)
        if why is not None:
            lifecycle.refuse(effects, request, *why)
        elif run.hand is not None and run.hand.is_driving:
            lifecycle.refuse(effects, request, Refusal.BUSY, f"driven by {run.hand.driver}")
        else:
            lifecycle.raise_revision(f"{request.operator} (drive)")
            lifecycle.log(f"driven by {request.operator}", effects.now)
            lifecycle.take_hand(Hand(request, wish, effects.now))
            waits = "" if run.running is None else f"{run.running.pattern} waits"
            remarks = (f"driven by {request.operator}", waits, lifecycle.base_fault)
            lifecycle.applied(effects, request, "; ".join(filter(None, remarks)))

    def _release(self, request: verbs.DriveRequest, effects: Effects) -> None:
        """End the hand by the word of its driver: a run beneath it goes on."""
        lifecycle = self._lifecycle
        run = lifecycle.pattern_run
        hand = run.hand
        if hand is None or hand.id != request.hand:
            text = f"this hand is over already: changed by {lifecycle.changed_by}"
            lifecycle.refuse(effects, request, Refusal.OVERTAKEN, text)
        elif hand.driver != request.operator:
            text = f"driven by {hand.driver}"
            lifecycle.refuse(effects, request, Refusal.NOT_PERMITTED, text)
        elif not hand.is_driving:
            text = f"the hand {hand.lost_text}; resume lets the run go on"
            lifecycle.refuse(effects, request, Refusal.OVERTAKEN, text)
        else:
            lifecycle.raise_revision(f"{request.operator} (drive, released)")
            lifecycle.log(f"released by {request.operator}", effects.now)
            lifecycle.take_hand(None)
            is_on = run.running is not None
            state = lifecycle.state_machine.state
            what = f"{run.running.pattern} goes on" if is_on and run.running else str(state)
            lifecycle.applied(effects, request, f"released; {what}")

    def on_goal(self, request: verbs.GoalRequest, effects: Effects) -> None:
        """Set the goal without a run."""
        self._goals.set_goal(request, effects)

    def on_label(self, request: verbs.LabelRequest, effects: Effects) -> None:
        """Replace the labels."""
        self._goals.set_labels(request, effects)

    def _answer_stop(self, request: verbs.Request, effects: Effects) -> None:
        """Reply to a stop. `is_moving` of the reply is True while the base is not known to rest.

        The operator repeats the stop until the base rests. If the base is not known to rest
        STOP_TIME after the stop, the reply becomes the failure NOT_STOPPED: zero commands do not
        reach the base, or the base does not obey them. A base that the driver has not reached yet
        may still move by a command of an earlier daemon process.
        """
        now = effects.now
        sensors = self._sensors
        lifecycle = self._lifecycle
        executed_at = self._executed.setdefault(request.id, now)
        while len(self._executed) > MAX_STOPS:
            del self._executed[next(iter(self._executed))]
        text = self._stop_text(now)
        gets_zero = sensors.is_driver_up or sensors.gets_zero
        is_moving = not (gets_zero and self._is_at_rest(now))
        if is_moving and now >= executed_at + STOP_TIME:
            lifecycle.fail(effects, request, Refusal.NOT_STOPPED, f"{text}: not known to rest")
        else:
            lifecycle.applied(effects, request, text, is_moving=is_moving)

    def _is_at_rest(self, now: float) -> bool:
        """True if odometry measured the base at rest, after the last command to move took effect.

        A command takes effect within _RESPONSE: what was measured at that time or later counts.
        Without odometry: True once STOP_TIME has passed since the start of the daemon. The text of
        the reply then says that there is no odometry.
        """
        odometry = self._sensors.odometry
        age = self._sensors.odometry_age(now)
        if odometry is None or age is None:
            return now >= self._heard_by
        twist = odometry.twist
        speed = math.hypot(twist.linear, twist.lateral)
        is_slow = speed <= _REST_SPEED and abs(twist.angular) <= _REST_TURN
        measured_at = now - age
        return is_slow and measured_at >= self._protection.moved_at + _RESPONSE

    def _stop_text(self, now: float) -> str:
        """The text that acknowledges a stop: the sent command, and the measured speed and age."""
        sensors = self._sensors
        why = sensors.driver_text[:MAX_WHY]
        if sensors.is_driver_up:
            sent = "commanded zero"
        elif sensors.gets_zero:
            sent = f"commanded zero; {why}"
        else:
            sent = f"nothing was sent: driver lost: {why}"
        odometry = sensors.odometry
        age = sensors.odometry_age(now)
        if odometry is None or age is None:
            return f"{sent}; no odometry"
        twist = odometry.twist
        moves = f"{twist.linear:z.2f} m/s, {twist.angular:z.2f} rad/s"
        if self._lifecycle.identity.platform.limits.lateral > 0.0:
            moves += f", {twist.lateral:z.2f} m/s to the left"
        return f"{sent}; measured {moves}, {age:.1f} s ago"

    def _refusal_to_start(
        self, request: Start, wish: Wish, now: float
    ) -> tuple[Refusal, str] | None:
        """Why no run of this wish can start in the present state; None if a run can start."""
        if why := self._refusal_of_state() or self._refusal_of_wish(request, wish, now):
            return why
        text = under_way(self._lifecycle)
        return (Refusal.BUSY, text) if text else None

    def _refusal_of_state(self) -> tuple[Refusal, str] | None:
        """Why nothing moves the robot before a reset; None if it needs none."""
        machine = self._lifecycle.state_machine
        if machine.state not in (State.ESTOPPED, State.FAULTED):
            return None
        is_estopped = machine.state is State.ESTOPPED
        refusal = Refusal.ESTOPPED if is_estopped else Refusal.FAULTED
        return refusal, f"{machine.state} ({machine.reason}) {machine.detail}; reset it first"

    def _refusal_of_wish(
        self, request: Start, wish: Wish, now: float
    ) -> tuple[Refusal, str] | None:
        """Why a start is refused for the time at which it was issued; None if it is accepted."""
        if by := self._lifecycle.stops.later_than(wish.issued):
            return Refusal.OVERTAKEN, f"stopped since this was asked for, by {by}"
        age = now - wish.at
        planned = min(request.planned, verbs.MAX_PLANNED)
        if age <= verbs.MAX_AGE + planned:
            return None
        most = f"{verbs.MAX_AGE:g} s" + (f" and {planned:.1f} s of work" if planned else "")
        return Refusal.TOO_LATE, f"issued {age:.1f} s ago; at most {most} count: repeat it"

    def _wish_of(self, request: Start, now: float) -> Wish:
        """When and by whom the request was issued.

        The operator may have queried this robot after a stop that came later than the request. So
        the epoch that `request` quotes tells nothing about the time of issue.
        """
        earliest = min(request.issued_at.get(self._robot, now - request.age), now)
        return Wish(IssueTime.of(request, earliest), request.operator)

    def _refusal_to_run(self, request: verbs.RunRequest, now: float) -> tuple[Refusal, str] | None:
        """Why a run is refused for its conditions, start time or goal; None if it is accepted."""
        if fault := fault_of(request.until):
            return Refusal.INVALID_CONDITION, fault
        ahead = request.at.get(self._robot, now) - now
        if ahead <= -verbs.MAX_LATE:  # the load would end later still
            return Refusal.TOO_LATE, f"the run was to start {-ahead:.1f} s ago"
        if ahead > verbs.MAX_AHEAD:
            text = f"the run is to start in {ahead:.0f} s; at most {verbs.MAX_AHEAD:.0f} s ahead"
            return Refusal.INVALID_REQUEST, text
        return self._lifecycle.goals.refusal_of(request)

    def on_reset(self, request: verbs.ResetRequest, effects: Effects) -> None:
        """Clear the named latches, the named findings and a fault; a stopped robot becomes idle.

        A latch is an emergency stop that holds the robot until a reset names the latch. A finding
        is a doubt of the assumption monitor, such as brakes that are weaker than declared. A reset
        never starts motion, and does not end a run.
        """
        lifecycle = self._lifecycle
        findings = [text for text in self._protection.findings if text in request.findings]
        if refusal := self._refusal_to_reset(findings):
            lifecycle.refuse(effects, request, *refusal)
            return
        self._clear_latches(request, effects)
        if lifecycle.latches.held:  # latches that the request does not name
            text = f"still estopped {lifecycle.latches.text}; look again and reset once more"
            lifecycle.refuse(effects, request, Refusal.ESTOPPED, text)
        elif lifecycle.is_running:  # without findings to end, which `_refusal_to_reset` refuses
            lifecycle.goals.bar(effects.now)  # the robot joins no goal that was set before now
            lifecycle.applied(effects, request, "running: nothing to reset")
        elif lifecycle.state_machine.state is State.IDLE and not self._is_joining:
            self._reset_idle_robot(findings, request, effects)
        else:  # estopped, stopped, faulted, or joining a goal, whose load `reset` ends
            lifecycle.raise_revision(_cause_of_reset(request))
            self._end_findings(findings, request, effects)
            lifecycle.reset(request.reason or f"by {request.operator}", effects)
            lifecycle.applied(effects, request, "idle")
            # A copy of an earlier stop counts as obeyed, and does not undo the reset.
            self._obeyed_until = effects.now
            self.reset_at = effects.now

    def _refusal_to_reset(self, findings: list[str]) -> tuple[Refusal, str] | None:
        """Why a reset that ends `findings` is refused before it changes anything, else None."""
        if self._lifecycle.duplicate is not None:
            return Refusal.DUPLICATE_ID, f"this id is still held by {self._lifecycle.duplicate}"
        lifecycle = self._lifecycle
        if findings and (lifecycle.is_running or lifecycle.is_driven):
            text = f"{self._robot} runs; stop it before a finding of its monitor is ended"
            return Refusal.BUSY, text
        return None

    def _clear_latches(self, request: verbs.ResetRequest, effects: Effects) -> None:
        """Clear the named latches. If other latches remain, make earlier requests stale."""
        lifecycle = self._lifecycle
        named = [latch for latch in request.ids if latch in lifecycle.latches.held]
        if named:
            lifecycle.latches.clear(named)
            effects.is_latched = True
            if lifecycle.latches.held:
                lifecycle.raise_revision(_cause_of_reset(request))

    @property
    def _is_joining(self) -> bool:
        """True while the robot loads the pattern of a goal without a request of an operator."""
        loading = self._lifecycle.pattern_run.loading
        return loading is not None and loading.goal is not None and loading.request is None

    def _reset_idle_robot(
        self, findings: list[str], request: verbs.ResetRequest, effects: Effects
    ) -> None:
        """End `findings` of an idle robot, which joins no goal that was set before now."""
        lifecycle = self._lifecycle
        now = effects.now
        lifecycle.goals.bar(now)
        # A copy of an earlier stop counts as obeyed, and does not undo the reset.
        self._obeyed_until = now
        self.reset_at = now
        if findings:
            lifecycle.raise_revision(_cause_of_reset(request))
            self._end_findings(findings, request, effects)
        text = f"{len(findings)} findings ended" if findings else "nothing to reset"
        lifecycle.applied(effects, request, f"idle: {text}")

    def _end_findings(
        self, ended: list[str], request: verbs.ResetRequest, effects: Effects
    ) -> None:
        """End findings of the assumption monitor, and log an event for each."""
        self._protection.forget_findings(ended)
        by = f"{request.operator} ({request.reason})" if request.reason else request.operator
        for text in ended:
            self._lifecycle.log(f"ended by {by}: {text}", effects.now)

    def on_param(self, request: verbs.ParamRequest, effects: Effects) -> None:
        """Set parameters, or refuse; the reply follows once the pattern has taken them."""
        lifecycle = self._lifecycle
        run = self._lifecycle.pattern_run
        if run.running is None or not lifecycle.is_running or run.is_restarting:
            lifecycle.refuse(effects, request, Refusal.NOT_RUNNING, "no pattern is running")
        elif lifecycle.params_request is not None or run.loading or lifecycle.trial:
            lifecycle.refuse(effects, request, Refusal.BUSY, "another change is under way")
        else:
            lifecycle.raise_revision(f"{request.operator} (param set)")
            lifecycle.params_request = PendingParams(request, effects.now)
            effects.command_host(
                SetParams(run.running.generation, request.id, dict(request.params))
            )

    def on_reload(self, request: verbs.ReloadRequest, effects: Effects) -> None:
        """Start a trial of the new code, or refuse; the reply follows when the trial ends."""
        lifecycle = self._lifecycle
        pattern = request.pattern
        if text := under_way(lifecycle):
            lifecycle.refuse(effects, request, Refusal.BUSY, text)
            return
        wish = self._wish_of(request, effects.now)
        if request.is_rerun and (why := self._refusal_of_wish(request, wish, effects.now)):
            lifecycle.refuse(effects, request, *why)
            return
        lifecycle.raise_revision(f"{request.operator} (reload {pattern})")
        running = lifecycle.pattern_run.running
        is_running = running is not None and running.pattern == pattern
        params = running.params if running is not None and is_running else {}
        self._trials += 1
        lifecycle.trial = Trial(self._trials, effects.now, request, wish)
        labels = lifecycle.goals.labels
        load = load_command(lifecycle.identity, labels, self._trials, pattern, params)
        effects.trial = StartTrial(load)

    def on_trial_done(self, event: TrialDone, effects: Effects) -> None:
        """Act on the end of the trial of new code that a reload request started.

        After a passed trial the next run of the pattern takes the new code. A present run of the
        pattern ends, unless a push keeps this run (`keeps_running`). The end of an earlier trial
        is ignored.
        """
        lifecycle = self._lifecycle
        trial = self._lifecycle.trial
        if trial is None or event.generation != trial.generation:
            return
        has_failed = bool(event.text)
        if has_failed:
            lifecycle.end_trial(event.refusal, event.text, effects)
            self._goals.join_if_settled(effects)  # a goal waits for the end of the trial
            return
        lifecycle.trial = None
        request = trial.request
        running = lifecycle.pattern_run.running
        if running is None:
            self._replace_idle_host(request, effects)
        elif running.pattern == request.pattern and not request.keeps_running:
            self._replace(trial, effects)
        else:
            self._keep_run(request, running.pattern, effects)

    def _replace_idle_host(self, request: verbs.ReloadRequest, effects: Effects) -> None:
        """End the host, which runs nothing; then join a goal that waited for the trial.

        The process of the trial, which has imported the new code, becomes the pattern host.
        """
        lifecycle = self._lifecycle
        effects.command_host(KillHost())
        text = f"{_new_code_text(request)}; {lifecycle.state_machine.state}, as before"
        lifecycle.applied(effects, request, text)
        if request.keeps_running:  # the code was pushed: a goal may have waited for this code
            self._goals.on_new_code(request.pattern, effects)
        self._goals.join_if_settled(effects)

    def _keep_run(
        self, request: verbs.ReloadRequest, running_pattern: str, effects: Effects
    ) -> None:
        """Keep the run in its host, and end the process of the trial.

        The host may contain the old code of the pattern, so the next load gets a fresh host.
        """
        self._lifecycle.pattern_run.is_outdated = True
        effects.trial = CancelTrial()
        old_code = " with the old code" if running_pattern == request.pattern else ""
        text = f"{_new_code_text(request)}; {running_pattern} goes on{old_code}"
        self._lifecycle.applied(effects, request, text)

    def advance(self, effects: Effects) -> None:
        """End a trial that takes longer than TRIAL_TIMEOUT."""
        trial = self._lifecycle.trial
        if trial is not None and effects.now - trial.since >= TRIAL_TIMEOUT:
            text = f"{trial.request.pattern}: loading took more than {TRIAL_TIMEOUT:.0f} s"
            self._lifecycle.end_trial(Refusal.PATTERN_FAILED, text, effects)
            self._goals.join_if_settled(effects)

    def _replace(self, trial: Trial, effects: Effects) -> None:
        """Stop the running pattern, whose new code has passed its trial, and end its host.

        If the reload request wants a new run (`is_rerun`), a fresh host loads the new code. The new
        run has the parameters, end conditions, goal and remaining seconds of the stopped run.
        """
        lifecycle = self._lifecycle
        run = self._lifecycle.pattern_run
        request = trial.request
        running = run.running
        goals = lifecycle.goals
        assert running is not None
        # Read before `stop`, which ends the run of the goal.
        goal = goals.own.goal if goals.own and goals.state is GoalState.RUNNING else None
        seconds_left: float | None = None
        if running.finish_at != math.inf:
            # Without time left the new run ends in the event in which it begins.
            seconds_left = running.finish_at - effects.now
        speed = running.permit.speed
        lifecycle.log(f"{request.pattern} reloaded, by {request.operator}", effects.now)
        detail = f"{request.pattern}, by {request.operator}"
        # The new run waits beneath a hand, as the run before; a lost hand holds it.
        lifecycle.stop(Reason.RELOADED, detail, effects, keeps_hand=request.is_rerun)
        run.awaiting_since = math.inf  # no answer to a step is awaited any more: the host ends
        if request.is_rerun:
            # `start_run` replies to the request later, when the new run begins or its load fails.
            lifecycle.start_run(
                request.pattern,
                running.params,
                effects,
                wish=trial.wish,
                seconds=seconds_left,
                until=running.until,
                request=request,
                goal=goal,
                is_fresh=True,
                speed=speed,
            )
        else:
            effects.command_host(KillHost())
            lifecycle.applied(effects, request, "reloaded, and stopped")


def _cause_of_reset(request: verbs.ResetRequest) -> str:
    return f"{request.operator} (reset)"


def _new_code_text(request: verbs.ReloadRequest) -> str:
    return f"a run of {request.pattern} takes the new code"


def under_way(lifecycle: Lifecycle) -> str:
    """The load or trial request that is not answered yet, in words; empty without a request."""
    loading = lifecycle.pattern_run.loading
    trial = lifecycle.trial
    if loading is not None and loading.request is not None:
        return f"still loading {loading.pattern}, by {loading.request.operator}"
    return f"still trying {trial.request.pattern}, by {trial.request.operator}" if trial else ""
