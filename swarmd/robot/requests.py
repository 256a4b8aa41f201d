"""What operators can ask of one robot, and when the robot refuses. Pure.

No late request starts motion: run, reset, reload and param quote the epoch that the operator saw,
and the robot refuses any other. It obeys stop and estop in every state, whatever they quote.

Reload replaces a pattern's code. The new code is first tried in a process of its own, for this
robot and with the parameters in force. Until the trial ends nothing else changes; a stop, or a
trial that fails, leaves everything as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from swarmd.core.errors import ConfigError
from swarmd.core.host_messages import (
    CancelTrial,
    KillHost,
    Layers,
    SetParams,
    StartTrial,
    TrialDone,
)
from swarmd.core.keys import is_id
from swarmd.core.messages import (
    EstopRequest,
    Latch,
    ParamRequest,
    Reason,
    Refusal,
    ReloadRequest,
    Request,
    ResetRequest,
    RunRequest,
    State,
    StopRequest,
)
from swarmd.core.values import Scalar
from swarmd.kit.conditions import parse_conditions
from swarmd.robot.lifecycle import Lifecycle, Turn
from swarmd.robot.pattern_run import Trying
from swarmd.robot.state_machine import Event as Change

TRIAL_TIMEOUT = 10.0


class RequestHandler:
    """Carries out requests. `layers`: the configured parameters of a pattern, weakest first."""

    def __init__(
        self,
        robot: str,
        lifecycle: Lifecycle,
        layers: Callable[[str], Layers],
        standing: Callable[[], str],
    ) -> None:
        self._robot = robot
        self._lifecycle = lifecycle
        self._layers = layers
        self._standing = standing
        self.reloading = ReloadHandler(lifecycle, self.layers)
        self._last_stop = ("", -1)  # its id, and the revision that it led to

    def answer(self, request: Request, turn: Turn) -> None:
        """Carry the request out or refuse it; no reply if it targets only other robots."""
        if request.targets is not None and self._robot not in request.targets:
            return
        if isinstance(request, EstopRequest):
            self._estop(request, turn)
        elif isinstance(request, StopRequest):
            self._stop(request, turn)
        elif request.targets[self._robot] != self._lifecycle.epoch:
            text = f"robot changed since you looked, by {self._lifecycle.changed_by}"
            self._lifecycle.refuse(turn, request, Refusal.STALE_EPOCH, text)
        elif isinstance(request, RunRequest):
            self._run(request, turn)
        elif isinstance(request, ResetRequest):
            self._reset(request, turn)
        elif isinstance(request, ReloadRequest):
            self.reloading.begin(request, turn)
        else:
            self._set_params(request, turn)

    def layers(self, pattern: str, params: Mapping[str, Scalar | None]) -> Layers:
        """All layers of a pattern's parameters, those of the request on top."""
        return (*self._layers(pattern), ("runtime", dict(params)))

    def _stop(self, request: StopRequest, turn: Turn) -> None:
        lifecycle = self._lifecycle
        # An operator repeats a stop on every new link; the repeats count as one change.
        if self._last_stop != (request.id, lifecycle.revision):
            lifecycle.changed(f"{request.operator} (stop)")
            self._last_stop = (request.id, lifecycle.revision)
        lifecycle.end(Change.STOP, Reason.OPERATOR, f"by {request.operator}", turn)
        lifecycle.applied(turn, request, self._standing())

    def _estop(self, request: EstopRequest, turn: Turn) -> None:
        latch_id = request.id if is_id(request.id) else "unnamed"
        latch = Latch(issuer=request.operator, scope=request.scope, reason=request.reason)
        self._lifecycle.latch(latch_id, latch, turn)
        self._lifecycle.applied(turn, request, self._standing())

    def _run(self, request: RunRequest, turn: Turn) -> None:
        lifecycle, machine = self._lifecycle, self._lifecycle.supervisor
        if machine.state in (State.ESTOPPED, State.FAULTED):
            is_estopped = machine.state is State.ESTOPPED
            refusal = Refusal.ESTOPPED if is_estopped else Refusal.FAULTED
            text = f"{machine.state} ({machine.reason}) {machine.detail}; reset it first"
            lifecycle.refuse(turn, request, refusal, text)
        elif fault := _fault_of(request.until):
            lifecycle.refuse(turn, request, Refusal.INVALID_CONDITION, fault)
        elif text := under_way(lifecycle):
            lifecycle.refuse(turn, request, Refusal.BUSY, text)
        else:
            lifecycle.changed(f"{request.operator} (run {request.pattern})")
            lifecycle.hosting.begin(
                request.pattern, request.params, request.seconds, request, turn.now, request.until
            )
            lifecycle.load(request.pattern, self.layers(request.pattern, request.params), turn)

    def _reset(self, request: ResetRequest, turn: Turn) -> None:
        lifecycle = self._lifecycle
        if lifecycle.duplicate is not None:
            text = f"this id is still held by {lifecycle.duplicate}"
            lifecycle.refuse(turn, request, Refusal.DUPLICATE_ID, text)
            return
        state = lifecycle.supervisor.state
        named = [latch_id for latch_id in request.ids if latch_id in lifecycle.latches.held]
        if named:
            lifecycle.latches.clear(named)
            turn.is_latched = True
        if lifecycle.latches.held:
            text = f"still estopped {lifecycle.latch_text()}; look again and reset once more"
            if named:
                lifecycle.changed(f"{request.operator} (reset)")
            lifecycle.refuse(turn, request, Refusal.ESTOPPED, text)
        elif state in (State.RUNNING, State.IDLE):
            lifecycle.applied(turn, request, f"{state}: nothing to reset")
        else:
            lifecycle.changed(f"{request.operator} (reset)")
            detail = request.reason or f"by {request.operator}"
            lifecycle.end(Change.RESET, Reason.RESET, detail, turn)
            lifecycle.applied(turn, request, "idle")

    def _set_params(self, request: ParamRequest, turn: Turn) -> None:
        lifecycle, hosting = self._lifecycle, self._lifecycle.hosting
        if hosting.running is None or not lifecycle.is_running or hosting.is_restarting:
            lifecycle.refuse(turn, request, Refusal.NOT_RUNNING, "no pattern is running")
        elif lifecycle.params_request is not None or hosting.loading or lifecycle.trial:
            lifecycle.refuse(turn, request, Refusal.BUSY, "another change is under way")
        else:
            lifecycle.changed(f"{request.operator} (param set)")
            lifecycle.params_request = (request, turn.now)
            turn.host = SetParams(hosting.running.generation, request.id, dict(request.params))


class ReloadHandler:
    """Carries out `reload`. `layers`: all of a pattern's parameters, those handed in on top."""

    def __init__(
        self, lifecycle: Lifecycle, layers: Callable[[str, Mapping[str, Scalar | None]], Layers]
    ) -> None:
        self._lifecycle = lifecycle
        self._layers = layers
        self._trials = 0

    def begin(self, request: ReloadRequest, turn: Turn) -> None:
        """Start a trial of the new code, or refuse; the reply follows when the trial ends."""
        lifecycle, pattern = self._lifecycle, request.pattern
        if text := under_way(lifecycle):
            lifecycle.refuse(turn, request, Refusal.BUSY, text)
            return
        lifecycle.changed(f"{request.operator} (reload {pattern})")
        running = lifecycle.hosting.running
        is_running = running is not None and running.pattern == pattern
        params = running.params if running is not None and is_running else {}
        self._trials += 1
        lifecycle.trial = Trying(self._trials, pattern, turn.now, request)
        turn.trial = StartTrial(
            lifecycle.load_of(self._trials, pattern, self._layers(pattern, params))
        )

    def on_tried(self, event: TrialDone, turn: Turn) -> None:
        """Act on the end of the trial under way; the end of any other trial is ignored."""
        lifecycle, trial = self._lifecycle, self._lifecycle.trial
        if trial is None or event.generation != trial.generation:
            return
        if event.text:
            lifecycle.end_trial(event.refusal, event.text, turn)
            return
        lifecycle.trial = None
        hosting, state = lifecycle.hosting, lifecycle.supervisor.state
        running = hosting.running
        if running is not None and running.pattern == trial.pattern:
            self._replace(trial, turn)
        elif running is not None:
            hosting.is_outdated = True
            turn.trial = CancelTrial("not wanted yet")
            text = f"a run of {trial.pattern} takes the new code; {running.pattern} goes on"
            lifecycle.applied(turn, trial.request, text)
        else:
            turn.host = KillHost("reloaded")
            text = f"a run of {trial.pattern} takes the new code; {state}, as before"
            lifecycle.applied(turn, trial.request, text)

    def advance(self, turn: Turn) -> None:
        """End a trial that takes longer than TRIAL_TIMEOUT."""
        trial = self._lifecycle.trial
        if trial is not None and turn.now - trial.since >= TRIAL_TIMEOUT:
            text = f"{trial.pattern}: loading took more than {TRIAL_TIMEOUT:.0f} s"
            self._lifecycle.end_trial(Refusal.PATTERN_FAILED, text, turn)

    def _replace(self, trial: Trying, turn: Turn) -> None:
        """Stop the running pattern and its host; run the new code in a fresh host if asked to."""
        lifecycle, request = self._lifecycle, trial.request
        hosting = lifecycle.hosting
        running = hosting.running
        assert running is not None
        left = None if running.finish_at is None else max(running.finish_at - turn.now, 1e-3)
        lifecycle.note(f"{trial.pattern} reloaded, by {request.operator}", turn.now)
        detail = f"{trial.pattern}, by {request.operator}"
        lifecycle.end(Change.STOP, Reason.RELOADED, detail, turn)
        hosting.awaiting_since = None  # the host that owes a step is gone
        if request.is_rerun:
            hosting.is_outdated = True
            hosting.begin(trial.pattern, running.params, left, request, turn.now, running.until)
            lifecycle.load(trial.pattern, self._layers(trial.pattern, running.params), turn)
        else:
            turn.host = KillHost("reloaded")
            lifecycle.applied(turn, request, "reloaded, and stopped")


def under_way(lifecycle: Lifecycle) -> str:
    """The request that the pattern host has not answered yet, in words; empty if there is none."""
    loading, trial = lifecycle.hosting.loading, lifecycle.trial
    if loading is not None and loading.request is not None:
        return f"still loading {loading.pattern}, by {loading.request.operator}"
    return f"still trying {trial.pattern}, by {trial.request.operator}" if trial else ""


def _fault_of(until: tuple[str, ...]) -> str:
    """What is wrong with the conditions that end a run; empty if nothing."""
    try:
        if until:
            parse_conditions(until)
    except ConfigError as error:
        return str(error)
    return ""
