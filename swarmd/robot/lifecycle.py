"""How one robot conducts itself: its state, its pattern, its latches, and what changes them. Pure.

A `Turn` gathers what one event leads to; the robot settles it into `Actions`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from msgspec import Struct, structs

from swarmd.core.host_messages import (
    CancelTrial,
    HostCommand,
    HostDied,
    HostEvent,
    KillHost,
    Layers,
    Load,
    Loaded,
    LoadRefused,
    ParamsSet,
    PatternFailed,
    StartTrial,
    Stepped,
)
from swarmd.core.messages import (
    Code,
    Epoch,
    Latch,
    LoggedEvent,
    ParamRequest,
    Reason,
    Refusal,
    Reply,
    Request,
    State,
)
from swarmd.core.values import Platform, Scalar, TouchZone, Value
from swarmd.kit.touch import effective_zone
from swarmd.protection.decision import NO_PERMIT, Permit
from swarmd.robot.actions import Outbox
from swarmd.robot.latches import Latches, LatchRecord
from swarmd.robot.pattern_run import LOAD_TIMEOUT, SILENT_AFTER, PatternRun, Trying
from swarmd.robot.state_machine import Event as Change
from swarmd.robot.state_machine import StateMachine

HOLD_LASTS = 2.0
EVENTS = 10
LINE = 300
_ENDS_TRIAL = frozenset({Change.STOP, Change.ESTOP, Change.STALL})


class Turn(Struct, eq=False):
    """What one event leads to, gathered until it is settled."""

    now: float
    is_beat: bool = False
    host: HostCommand | None = None
    trial: StartTrial | CancelTrial | None = None
    is_latched: bool = False
    is_new_scan: bool = False
    is_new_run: bool = False
    messages: Mapping[str, Value] = {}
    replies: tuple[Reply, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Identity:
    """What a pattern is loaded for. `touch`: where which pattern may touch what is near."""

    robot: str
    platform: Platform
    seed: int
    instance: str
    touch: Mapping[str, TouchZone] = field(default_factory=dict)


class Lifecycle:
    """State, pattern and latches of one robot. Times in s, handed in with each turn."""

    def __init__(self, identity: Identity, latches: LatchRecord | None, now: float) -> None:
        self._identity = identity
        self._born = now
        self.supervisor = StateMachine(now)
        self.hosting = PatternRun()
        self.latches = Latches(latches)
        self.outbox = Outbox()
        self.revision = 0
        self.changed_by = "nobody yet"
        self.duplicate: str | None = None
        self.report: Mapping[str, Scalar] = {}
        self.events: deque[LoggedEvent] = deque(maxlen=EVENTS)
        self.params_request: tuple[ParamRequest, float] | None = None
        self.trial: Trying | None = None
        self.hold_since: float | None = None
        self.mistyped = 0
        self._last_fault = ""
        self._load: Load | None = None
        if self.latches.held:
            self.supervisor.apply(Change.ESTOP, Reason.ESTOP, self.latch_text(), now)

    @property
    def is_running(self) -> bool:
        """True in state running."""
        return self.supervisor.state is State.RUNNING

    @property
    def epoch(self) -> Epoch:
        """What an operator must quote to change this robot."""
        return Epoch(self._identity.instance, self.revision)

    @property
    def permit(self) -> Permit:
        """What the pattern in force may; nothing outside `running` and while it is replaced."""
        running = self.hosting.running
        if running is None or self.hosting.is_restarting:
            return NO_PERMIT
        may_recover, _ = running.values.get("recovery", (False, ""))
        return Permit(may_recover=may_recover is True, touch=running.touch)

    def note(self, text: str, now: float) -> None:
        """Keep an event for describe."""
        self.events.append(LoggedEvent(at=max(now - self._born, 0.0), text=text[:LINE]))

    def applied(self, turn: Turn, request: Request, text: str) -> None:
        """Acknowledge a request; the reply carries the epoch that follows from it."""
        self._reply(turn, request, Code.APPLIED, None, text)

    def refuse(self, turn: Turn, request: Request, refusal: Refusal, text: str) -> None:
        """Refuse a request."""
        self._reply(turn, request, Code.REFUSED, refusal, text)

    def _reply(
        self, turn: Turn, request: Request, code: Code, refusal: Refusal | None, text: str
    ) -> None:
        answer = Reply(
            id=request.id,
            robot=self._identity.robot,
            code=code,
            refusal=refusal,
            text=text[:LINE],
            epoch=self.epoch,
        )
        turn.replies = (*turn.replies, answer)

    def changed(self, by: str) -> None:
        """Raise the revision: what an operator saw before no longer holds."""
        self.revision += 1
        self.changed_by = by[:LINE]

    def latch_text(self) -> str:
        """Who holds the robot, in one line."""
        held = self.latches.held.values()
        texts = (f"by {one.issuer}" + (f": {one.reason}" if one.reason else "") for one in held)
        return ", ".join(dict.fromkeys(texts))[:LINE]

    # Events of the pattern host

    def on_host(self, event: HostEvent, turn: Turn) -> None:
        """Take an answer, a failure or a death; answers of other generations are dropped."""
        hosting = self.hosting
        if isinstance(event, Loaded | LoadRefused):
            if hosting.loading is None or event.generation != hosting.loading.generation:
                return
            if isinstance(event, Loaded):
                self._ready(event, turn)
            else:
                self._refused(event, turn)
        elif isinstance(event, Stepped):
            self._stepped(event, turn)
        elif isinstance(event, ParamsSet):
            self._params_set(event, turn)
        elif isinstance(event, PatternFailed):
            if hosting.running is not None and event.generation == hosting.running.generation:
                self.fault(event.text, turn)
            elif hosting.loading is not None and event.generation == hosting.loading.generation:
                self.fail_load(event.text, turn)
        elif isinstance(event, HostDied):
            self._lose_host(event.text, turn)

    def _ready(self, event: Loaded, turn: Turn) -> None:
        loading = self.hosting.ready(event, turn.now)
        self.hold_since = None
        self.supervisor.apply(Change.RUN, None, "", turn.now)
        if loading.request is None:
            self.note(f"{loading.pattern} restarted", turn.now)
        else:
            turn.is_new_run = True
            self.report = {}
            self.note(f"runs {loading.pattern}, by {loading.request.operator}", turn.now)
            self.applied(turn, loading.request, f"runs {loading.pattern}")
        self._let_touch(loading.pattern, event, turn)

    def _let_touch(self, pattern: str, event: Loaded, turn: Turn) -> None:
        """For this generation alone; every way out of it forgets what is running."""
        assert self.hosting.running is not None
        granted = self._identity.touch.get(pattern)
        self.hosting.running.touch, text = effective_zone(pattern, event.touches, granted)
        if text:
            self.note(f"{pattern} {text}", turn.now)

    def _refused(self, event: LoadRefused, turn: Turn) -> None:
        text = event.text
        loading, self.hosting.loading = self.hosting.loading, None
        if loading is None or loading.request is None:
            self.end(Change.LOAD_FAILED, Reason.LOAD_FAILED, text, turn)
            return
        self.note(f"{loading.pattern} refused: {text}", turn.now)
        self.refuse(turn, loading.request, event.refusal, text)
        if self._load is not None and self._load.is_fresh:  # what ran has lost its host for it
            self.fault("its host was replaced", turn)

    def _stepped(self, event: Stepped, turn: Turn) -> None:
        hosting = self.hosting
        running = hosting.running
        if running is None or event.generation != running.generation:
            if event.generation == hosting.stepped_generation:
                hosting.awaiting_since = None
            return
        hosting.stepped(event, turn.now)
        self.mistyped += event.dropped
        twist = event.outputs.twist
        if twist is not None and not twist.is_finite:
            self.fault("its twist is not finite", turn)
            return
        self.report = event.outputs.report
        said = self.outbox.take(event.outputs.messages, running.channels, turn.now)
        turn.messages = {running.full_name(channel): value for channel, value in said.items()}
        if event.outputs.done is not None:
            self.end(Change.FINISH, Reason.FINISHED, event.outputs.done, turn)

    def _params_set(self, event: ParamsSet, turn: Turn) -> None:
        if self.params_request is None or self.params_request[0].id != event.request:
            return
        request, self.params_request = self.params_request[0], None
        running = self.hosting.running
        if not event.params or running is None:
            refusal = Refusal.INVALID_PARAMETER if event.text else Refusal.NOT_RUNNING
            self.refuse(turn, request, refusal, event.text or "no pattern is running")
            return
        running.values = event.params
        running.params = {**running.params, **request.params}
        self.applied(turn, request, event.text or "set")

    def _lose_host(self, text: str, turn: Turn) -> None:
        self.hosting.awaiting_since = None
        loading = self.hosting.loading
        if loading is not None and loading.request is not None:
            self.fail_load(text, turn)
        elif self.is_running and self.hosting.restart_at is None:
            self.fault(text, turn)

    # What goes wrong with a pattern

    def fault(self, text: str, turn: Turn) -> None:
        """The pattern failed: reload it in a fresh host after a while, or quarantine it."""
        hosting = self.hosting
        running, loading = hosting.running, hosting.loading
        if running is None or not self.is_running:
            return
        turn.host = KillHost(text)
        self._last_fault = text
        self.note(f"{running.pattern} failed: {text}", turn.now)
        if loading is not None and loading.request is not None:
            self.fail_load(text, turn)
        elif not hosting.fault(turn.now):
            self.hold_since = None  # the pattern gets as long to come back as any hold may last
        else:
            detail = f"{running.pattern} failed {hosting.faults} times, last: {text}"
            self.end(Change.FAULT, Reason.QUARANTINED, detail, turn)

    def fail_load(self, text: str, turn: Turn) -> None:
        """Loading came to nothing, and its host with it."""
        loading, self.hosting.loading = self.hosting.loading, None
        turn.host = KillHost(text)
        if loading is None:
            return
        self.note(f"{loading.pattern} was not loaded: {text}", turn.now)
        detail = f"{loading.pattern}: {text}"
        if loading.request is not None:
            self._reply(turn, loading.request, Code.FAILED, Refusal.PATTERN_FAILED, detail)
        self.end(Change.LOAD_FAILED, Reason.LOAD_FAILED, detail, turn)

    def end(self, change: Change, reason: Reason, detail: str, turn: Turn) -> None:
        """Leave running, or change state while not running; nothing is stepped any more."""
        loading = self.hosting.loading
        if change is Change.FINISH and loading is not None and loading.request is not None:
            self.hosting.end_running()  # what an operator asked for next is still wanted
        else:
            self._cancel_load(reason, turn)
            self.hosting.end()
        if change in _ENDS_TRIAL:
            text = f"{reason} while the new code was being tried"
            self.end_trial(Refusal.OVERTAKEN, text, turn)
        if self.params_request is not None:
            overtaken, self.params_request = self.params_request[0], None
            text = f"{reason} before the pattern answered"
            self.refuse(turn, overtaken, Refusal.OVERTAKEN, text)
        self.hold_since = None
        before = self.supervisor.state
        self.supervisor.apply(change, reason, detail[:LINE], turn.now)
        if self.supervisor.state is not before:
            self.note(f"{self.supervisor.state} ({reason}) {detail}".rstrip(), turn.now)

    def end_trial(self, refusal: Refusal, text: str, turn: Turn) -> None:
        """Nothing comes of the trial under way, if there is one; what runs is left alone."""
        trial, self.trial = self.trial, None
        if trial is not None:
            turn.trial = CancelTrial(text)
            self.note(f"{trial.pattern} not reloaded: {text}", turn.now)
            self.refuse(turn, trial.request, refusal, text)

    def _cancel_load(self, reason: Reason, turn: Turn) -> None:
        loading = self.hosting.loading
        if loading is None:
            return
        turn.host = KillHost(f"not wanted any more: {reason}")
        if loading.request is not None:
            text = f"{reason} while it was being loaded"
            self.refuse(turn, loading.request, Refusal.OVERTAKEN, text)

    # What an operator, a peer or the machine does

    def load(self, pattern: str, layers: Layers, turn: Turn) -> None:
        """Ask the host for the pattern that `hosting.begin` announced."""
        hosting = self.hosting
        load = self.load_of(hosting.generation, pattern, layers)
        until = () if hosting.loading is None else hosting.loading.until
        turn.host = self._load = structs.replace(load, is_fresh=hosting.is_outdated, until=until)
        hosting.is_outdated = False

    def load_of(self, generation: int, pattern: str, layers: Layers) -> Load:
        """What a host needs to load a pattern for this robot."""
        of = self._identity
        seed = (of.seed * 1_000_003 + generation) % 2**63
        return Load(generation, pattern, layers, of.robot, of.platform, seed)

    def latch(self, latch_id: str, latch: Latch, turn: Turn) -> None:
        """Emergency stop: latched, whatever the state."""
        turn.is_latched = True
        if self.latches.add(latch_id, latch):
            self.changed(f"{latch.issuer} (estop)")
        self.end(Change.ESTOP, Reason.ESTOP, self.latch_text(), turn)

    def take_over(self, latches: Mapping[str, Latch], turn: Turn) -> None:
        """A peer holds swarm-wide latches: hold them too, unless they were reset here."""
        new = self.latches.take_over(latches)
        if not new:
            return
        turn.is_latched = True
        self.changed(f"{latches[new[0]].issuer} (estop)" if new[0] in latches else "estop")
        self.end(Change.ESTOP, Reason.ESTOP, self.latch_text(), turn)

    def stall(self, late: float, turn: Turn) -> None:
        """The guardian's loop was late: what was asked for before no longer counts."""
        self.changed(f"a stall of {late:.1f} s")
        detail = f"the daemon did not run for {late:.1f} s"
        self.end(Change.STALL, Reason.LOOP_STALLED, detail, turn)

    def on_duplicate(self, holder: str | None, turn: Turn) -> None:
        """Another instance holds this id (None: no longer)."""
        if holder is not None and holder != self.duplicate:
            self.changed("a second robot of this name")
            detail = f"this id is also held by {holder}"
            self.end(Change.FAULT, Reason.DUPLICATE_ID, detail, turn)
        self.duplicate = holder

    # Time

    def advance(self, hold: Reason | None, turn: Turn) -> Reason | None:
        """Carry out what is due at this time; the hold that is in force now, if any."""
        hosting, now = self.hosting, turn.now
        loading = hosting.loading
        if loading is not None and now - loading.since >= LOAD_TIMEOUT:
            self.fail_load(f"loading took more than {LOAD_TIMEOUT:.0f} s", turn)
        if hosting.awaiting_since is not None and now - hosting.awaiting_since >= SILENT_AFTER:
            hosting.awaiting_since = None
            self._end_silent_host(turn)
        if self.params_request is not None and now - self.params_request[1] >= LOAD_TIMEOUT:
            request, self.params_request = self.params_request[0], None
            text = "the pattern did not answer"
            self._reply(turn, request, Code.FAILED, Refusal.PATTERN_FAILED, text)
        running = hosting.running
        if not self.is_running or running is None:
            return None
        if running.finish_at is not None and now >= running.finish_at:
            self.end(Change.FINISH, Reason.FINISHED, "its time is over", turn)
            return None
        return self._held(hold, turn)

    def _end_silent_host(self, turn: Turn) -> None:
        """The host hangs in a step; what waits behind that step is loaded in a new one."""
        hosting, text = self.hosting, f"gave no answer for {SILENT_AFTER:.0f} s"
        if hosting.loading is None or self._load is None:
            turn.host = KillHost("silent")
            self.fault(text, turn)
            return
        self.note(f"the pattern before {hosting.loading.pattern} {text}", turn.now)
        hosting.loading = replace(hosting.loading, since=turn.now)
        turn.host = structs.replace(self._load, is_fresh=True)

    def _held(self, hold: Reason | None, turn: Turn) -> Reason | None:
        if hold is None and self.hosting.is_restarting:
            hold = Reason.PATTERN_RESTARTING
        if hold is None and self.hosting.is_expired(turn.now):
            hold = Reason.COMMAND_EXPIRED
        is_switching = hold is Reason.COMMAND_EXPIRED and self.hosting.loading is not None
        if hold is None or is_switching:  # a load has a limit of its own
            self.hold_since = None
        elif self.hold_since is None:
            self.hold_since = turn.now
        elif turn.now - self.hold_since >= HOLD_LASTS:
            text = f"for {HOLD_LASTS:.0f} s"
            if hold is Reason.PATTERN_RESTARTING:
                text += f", last: {self._last_fault}"
            self.end(Change.HOLD_LASTED, hold, text, turn)
            return None
        return hold
