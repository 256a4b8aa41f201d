"""Replacing a pattern's code: what runs is stopped once the new code is known to load. Pure.

The new code is first tried in a process of its own, for this robot and with the parameters in
force. Until that is done nothing else changes; a stop, or a trial that fails, leaves all as it is.

What operators can ask of one robot, and when it refuses. Pure.

Nothing late may start motion: run, reset, reload and param set quote the epoch that the operator
saw, and any other is refused. stop and estop quote nothing and are always taken.
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
from swarmd.core.messages import Code, Latch, Reason, Request, State
from swarmd.core.values import Scalar
from swarmd.kit.conditions import parse_conditions
from swarmd.robot.lifecycle import Lifecycle, Turn
from swarmd.robot.pattern_run import Trying
from swarmd.robot.state_machine import Event as Change

TRIAL_TIMEOUT = 10.0


def under_way(conduct: Lifecycle) -> str:
    """What an operator has asked for and the host has not answered yet; empty if nothing."""
    loading, trial = conduct.hosting.loading, conduct.trial
    if loading is not None and loading.request is not None:
        return f"still loading {loading.pattern}, by {loading.request.operator}"
    return f"still trying {trial.pattern}, by {trial.request.operator}" if trial else ""


class ReloadHandler:
    """Answers `reload`. `layers`: all of a pattern's parameters, those handed in on top."""

    def __init__(
        self, conduct: Lifecycle, layers: Callable[[str, Mapping[str, Scalar | None]], Layers]
    ) -> None:
        self._lifecycle = conduct
        self._layers = layers
        self._trials = 0

    def begin(self, request: Request, turn: Turn) -> None:
        """Have the code tried, or refuse; the reply follows when the trial is done."""
        conduct = self._lifecycle
        hosting, pattern = conduct.hosting, request.args.get("pattern")
        if not isinstance(pattern, str) or not isinstance(request.args.get("run", False), bool):
            text = "reload wants a pattern by name, and run as true or false"
            conduct.reply(turn, request, Code.REFUSED, text)
            return
        if text := under_way(conduct):
            conduct.reply(turn, request, Code.REFUSED, text)
            return
        conduct.changed(f"{request.operator} (reload {pattern})")
        running = hosting.running
        is_running = running is not None and running.pattern == pattern
        params = running.params if running is not None and is_running else {}
        self._trials += 1
        conduct.trial = Trying(self._trials, pattern, turn.now, request)
        turn.trial = StartTrial(
            conduct.load_of(self._trials, pattern, self._layers(pattern, params))
        )

    def on_tried(self, event: TrialDone, turn: Turn) -> None:
        """Take the outcome; that of a trial which nobody waits for any more is dropped."""
        conduct, trial = self._lifecycle, self._lifecycle.trial
        if trial is None or event.generation != trial.generation:
            return
        if event.text:
            conduct.end_trial(event.text, turn)
            return
        conduct.trial = None
        hosting, state = conduct.hosting, conduct.supervisor.state
        running = hosting.running
        if running is not None and running.pattern == trial.pattern:
            self._replace(trial, turn)
        elif running is not None:
            hosting.is_outdated = True
            turn.trial = CancelTrial("not wanted yet")
            text = f"a run of {trial.pattern} takes the new code; {running.pattern} goes on"
            conduct.reply(turn, trial.request, Code.APPLIED, text)
        else:
            turn.host = KillHost("reloaded")
            text = f"a run of {trial.pattern} takes the new code; {state}, as before"
            conduct.reply(turn, trial.request, Code.APPLIED, text)

    def advance(self, turn: Turn) -> None:
        """End a trial whose time is over."""
        trial = self._lifecycle.trial
        if trial is not None and turn.now - trial.since >= TRIAL_TIMEOUT:
            text = f"{trial.pattern}: loading took more than {TRIAL_TIMEOUT:.0f} s"
            self._lifecycle.end_trial(text, turn)

    def _replace(self, trial: Trying, turn: Turn) -> None:
        """Stop what runs and its host; run the new code in a fresh one if that was asked for."""
        conduct, request = self._lifecycle, trial.request
        hosting = conduct.hosting
        running = hosting.running
        assert running is not None
        left = None if running.finish_at is None else max(running.finish_at - turn.now, 1e-3)
        conduct.note(f"{trial.pattern} reloaded, by {request.operator}", turn.now)
        conduct.end(Change.STOP, Reason.RELOADED, f"{trial.pattern}, by {request.operator}", turn)
        hosting.awaiting_since = None  # the host that owes a step is gone
        if request.args.get("run", False):
            hosting.is_outdated = True
            hosting.begin(trial.pattern, running.params, left, request, turn.now, running.until)
            conduct.load(trial.pattern, self._layers(trial.pattern, running.params), turn)
        else:
            turn.host = KillHost("reloaded")
            conduct.reply(turn, request, Code.APPLIED, "reloaded, and stopped")


QUOTING = frozenset({"run", "reset", "reload", "param"})
VERBS = frozenset({"run", "stop", "estop", "reset", "reload", "param"})
MAX_SECONDS = 1e7


class Verbs:
    """Answers requests. `layers`: the configured parameters of a pattern, weakest first."""

    def __init__(
        self,
        robot: str,
        conduct: Lifecycle,
        layers: Callable[[str], Layers],
        standing: Callable[[], str],
    ) -> None:
        self._robot = robot
        self._lifecycle = conduct
        self._layers = layers
        self._standing = standing
        self.reloading = ReloadHandler(conduct, self.layers)
        self._last_stop = ("", -1)  # its id, and the revision that it led to

    def answer(self, request: Request, turn: Turn) -> None:
        """Carry the request out or refuse it; not even a reply if it names other robots."""
        targets = request.targets
        if targets is not None and self._robot not in targets:
            return
        if request.verb == "estop":
            self._estop(request, turn)
        elif request.verb == "stop":
            self._stop(request, turn)
        elif request.verb == "param" and "set" not in request.args:
            self._lifecycle.reply(turn, request, Code.APPLIED, "")
        elif request.verb not in VERBS:
            self._refuse(request, turn, f"there is no verb {request.verb!r}")
        elif targets is None:
            self._refuse(request, turn, f"{request.verb} must name its targets")
        elif targets[self._robot] != self._lifecycle.epoch:
            by = self._lifecycle.changed_by
            self._refuse(request, turn, f"robot changed since you looked, by {by}")
        elif request.verb == "run":
            self._run(request, turn)
        elif request.verb == "reset":
            self._reset(request, turn)
        elif request.verb == "reload":
            self.reloading.begin(request, turn)
        else:
            self._set_params(request, turn)

    def _refuse(self, request: Request, turn: Turn, text: str) -> None:
        self._lifecycle.reply(turn, request, Code.REFUSED, text)

    def _stop(self, request: Request, turn: Turn) -> None:
        conduct = self._lifecycle
        # An operator repeats a stop on every new link: that is one change, told to all peers once.
        if self._last_stop != (request.id, conduct.revision):
            conduct.changed(f"{request.operator} (stop)")
            self._last_stop = (request.id, conduct.revision)
        conduct.end(Change.STOP, Reason.OPERATOR, f"by {request.operator}", turn)
        conduct.reply(turn, request, Code.APPLIED, self._standing())

    def _estop(self, request: Request, turn: Turn) -> None:
        latch_id = request.id if is_id(request.id) else "unnamed"
        scope = request.args.get("scope")
        latch = Latch(
            issuer=request.operator,
            scope="robots" if scope == "robots" else "swarm",
            reason=str(request.args.get("reason") or ""),
        )
        self._lifecycle.latch(latch_id, latch, turn)
        self._lifecycle.reply(turn, request, Code.APPLIED, self._standing())

    def _run(self, request: Request, turn: Turn) -> None:
        conduct = self._lifecycle
        hosting, state = conduct.hosting, conduct.supervisor.state
        pattern, params = request.args.get("pattern"), request.args.get("params") or {}
        seconds, until = request.args.get("seconds"), request.args.get("until") or ()
        if state in (State.ESTOPPED, State.FAULTED):
            reason = conduct.supervisor.reason
            text = f"{state} ({reason}) {conduct.supervisor.detail}; reset it first"
            self._refuse(request, turn, text)
        elif not isinstance(pattern, str) or not isinstance(params, dict):
            self._refuse(request, turn, "run wants a pattern by name and params by name")
        elif not _is_duration(seconds):
            self._refuse(request, turn, f"seconds is {seconds!r}; wanted above 0 and up to 1e7")
        elif fault := _fault_of(until):
            self._refuse(request, turn, fault)
        elif text := under_way(conduct):
            self._refuse(request, turn, text)
        else:
            conduct.changed(f"{request.operator} (run {pattern})")
            duration = float(seconds) if isinstance(seconds, int | float) else None
            ends = tuple(until) if isinstance(until, list) else ()
            hosting.begin(pattern, params, duration, request, turn.now, ends)
            conduct.load(pattern, self.layers(pattern, params), turn)

    def layers(self, pattern: str, params: Mapping[str, Scalar | None]) -> Layers:
        """All layers of a pattern's parameters, those of the request on top."""
        return (*self._layers(pattern), ("runtime", dict(params)))

    def _reset(self, request: Request, turn: Turn) -> None:
        conduct = self._lifecycle
        ids = request.args.get("ids") or []
        if not isinstance(ids, list):
            self._refuse(request, turn, "reset wants a list of ids")
            return
        if conduct.duplicate is not None:
            self._refuse(request, turn, f"this id is still held by {conduct.duplicate}")
            return
        state = conduct.supervisor.state
        named = [latch_id for latch_id in ids if latch_id in conduct.latches.held]
        if named:
            conduct.latches.clear(named)
            turn.is_latched = True
        if conduct.latches.held:
            text = f"still estopped {conduct.latch_text()}; look again and reset once more"
            if named:
                conduct.changed(f"{request.operator} (reset)")
            self._refuse(request, turn, text)
        elif state in (State.RUNNING, State.IDLE):
            conduct.reply(turn, request, Code.APPLIED, f"{state}: nothing to reset")
        else:
            conduct.changed(f"{request.operator} (reset)")
            detail = str(request.args.get("reason") or f"by {request.operator}")
            conduct.end(Change.RESET, Reason.RESET, detail, turn)
            conduct.reply(turn, request, Code.APPLIED, "idle")

    def _set_params(self, request: Request, turn: Turn) -> None:
        conduct = self._lifecycle
        values, running = request.args.get("set"), conduct.hosting.running
        if not isinstance(values, dict) or not values:
            self._refuse(request, turn, "param set wants values by name")
        elif running is None or not conduct.is_running or conduct.hosting.is_restarting:
            self._refuse(request, turn, "no pattern is running")
        elif conduct.params_request is not None or conduct.hosting.loading or conduct.trial:
            self._refuse(request, turn, "another change is on its way")
        else:
            conduct.changed(f"{request.operator} (param set)")
            conduct.params_request = (request, turn.now)
            turn.host = SetParams(running.generation, request.id, dict(values))


def _fault_of(until: object) -> str:
    """What is wrong with the conditions that are to end a run; empty if nothing."""
    try:
        if until:
            parse_conditions(until)
    except ConfigError as error:
        return str(error)
    return ""


def _is_duration(seconds: object) -> bool:
    if seconds is None:
        return True
    is_number = isinstance(seconds, int | float) and not isinstance(seconds, bool)
    return is_number and 0.0 < float(str(seconds)) <= MAX_SECONDS
