"""Replacing a pattern's code: what runs is stopped once the new code is known to load. Pure.

The new code is first tried in a process of its own, for this robot and with the parameters in
force. Until that is done nothing else changes; a stop, or a trial that fails, leaves all as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from swarmd.frames import Cancel, Kill, Layers, Tried, Try
from swarmd.messages import Code, Reason, Request
from swarmd.robot.conduct import Conduct, Turn
from swarmd.robot.hosting import Trying
from swarmd.robot.supervisor import Event as Change
from swarmd.values import Scalar

TRIAL_TIMEOUT = 10.0


def under_way(conduct: Conduct) -> str:
    """What an operator has asked for and the host has not answered yet; empty if nothing."""
    loading, trial = conduct.hosting.loading, conduct.trial
    if loading is not None and loading.request is not None:
        return f"still loading {loading.pattern}, by {loading.request.operator}"
    return f"still trying {trial.pattern}, by {trial.request.operator}" if trial else ""


class Reloading:
    """Answers `reload`. `layers`: all of a pattern's parameters, those handed in on top."""

    def __init__(
        self, conduct: Conduct, layers: Callable[[str, Mapping[str, Scalar | None]], Layers]
    ) -> None:
        self._conduct = conduct
        self._layers = layers
        self._trials = 0

    def begin(self, request: Request, turn: Turn) -> None:
        """Have the code tried, or refuse; the reply follows when the trial is done."""
        conduct = self._conduct
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
        turn.trial = Try(conduct.load_of(self._trials, pattern, self._layers(pattern, params)))

    def on_tried(self, event: Tried, turn: Turn) -> None:
        """Take the outcome; that of a trial which nobody waits for any more is dropped."""
        conduct, trial = self._conduct, self._conduct.trial
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
            turn.trial = Cancel("not wanted yet")
            text = f"a run of {trial.pattern} takes the new code; {running.pattern} goes on"
            conduct.reply(turn, trial.request, Code.APPLIED, text)
        else:
            turn.host = Kill("reloaded")
            text = f"a run of {trial.pattern} takes the new code; {state}, as before"
            conduct.reply(turn, trial.request, Code.APPLIED, text)

    def advance(self, turn: Turn) -> None:
        """End a trial whose time is over."""
        trial = self._conduct.trial
        if trial is not None and turn.now - trial.since >= TRIAL_TIMEOUT:
            text = f"{trial.pattern}: loading took more than {TRIAL_TIMEOUT:.0f} s"
            self._conduct.end_trial(text, turn)

    def _replace(self, trial: Trying, turn: Turn) -> None:
        """Stop what runs and its host; run the new code in a fresh one if that was asked for."""
        conduct, request = self._conduct, trial.request
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
            turn.host = Kill("reloaded")
            conduct.reply(turn, request, Code.APPLIED, "reloaded, and stopped")
