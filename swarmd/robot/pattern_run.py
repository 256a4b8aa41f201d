"""The robot's view of its pattern: load, steps, requested command and its expiry, faults. Pure."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from msgspec import Struct

from swarmd.core.goal import Goal
from swarmd.core.host_messages import Loaded, Stepped
from swarmd.core.values import Scalar, Twist
from swarmd.core.verbs import ReloadRequest, ResumeRequest, RunRequest
from swarmd.protection.decision import NO_PERMIT, Permit

LOAD_TIMEOUT = 3.0  # s
STEP_TIMEOUT = 1.0  # s after which a host that does not answer a step is ended
MIN_EXPIRY = 0.3  # s for which a requested command holds at least
FAULT_WINDOW = 60.0  # s within which faults count towards the quarantine
FAULTS_BEFORE_QUARANTINE = 4
FIRST_BACKOFF = 0.1  # s before the first restart; doubles with each fault
STEP_TOLERANCE = 1e-3  # s by which a step may come early, with a tick
ROUNDING = 1e-6  # s: a deadline must not be missed by the last bit of a float


class RequestedCommand(Struct, frozen=True):
    """The command that the pattern requests.

    `at` is when the step that gave it began; `scan_seq` is the scan that it used (-1: none).
    """

    twist: Twist | None
    at: float
    scan_seq: int


class Wish(Struct, frozen=True):
    """When a run was asked for, in s on the own clock, and the name of the issuer.

    For a run of a goal that was found: when the goal was set. A reload with a new run counts from
    its request. A restart after a fault keeps the wish of the run. A stop that was issued before
    does not end the run.
    """

    at: float
    by: str


@dataclass(frozen=True, slots=True, eq=False)
class Loading:
    """A pattern that is being loaded; the running one stays, without steps, until then.

    `until`: conditions of which any ends the run. `request` is answered when it runs.
    `goal`: the goal of the run. `start_at`: s on the own clock before which it does not begin;
    `loaded`: the host's answer, which waits for that time.
    """

    generation: int
    pattern: str
    params: Mapping[str, Scalar | None]
    seconds: float | None
    since: float
    request: RunRequest | ReloadRequest | ResumeRequest | None
    wish: Wish
    until: tuple[str, ...] = ()
    goal: Goal | None = None
    start_at: float | None = None
    loaded: Loaded | None = None

    @property
    def is_restart(self) -> bool:
        """True if it restarts a pattern that failed: no request and no goal asks for it."""
        return self.request is None and self.goal is None


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A trial of new code, under way for a reload request; `wish`: of the run that may follow."""

    generation: int
    since: float
    request: ReloadRequest
    wish: Wish


@dataclass(slots=True, eq=False)
class Running:
    """The running pattern.

    `permit`: what it permits while it is not held. `period`: s between two steps. `expiry`: s
    for which a requested command holds: three steps, at least MIN_EXPIRY.
    """

    generation: int
    pattern: str
    params: Mapping[str, Scalar | None]
    finish_at: float | None
    rate: float
    channels: frozenset[str]
    values: Mapping[str, tuple[Scalar | None, str]]
    requested: RequestedCommand
    wish: Wish
    until: tuple[str, ...] = ()
    permit: Permit = NO_PERMIT
    period: float = field(init=False)
    expiry: float = field(init=False)

    def __post_init__(self) -> None:
        self.period = 1.0 / self.rate
        self.expiry = max(MIN_EXPIRY, 3.0 / self.rate)

    def channel(self, name: str) -> str | None:
        """The pattern's own name of `<pattern>/<channel>`; None if it does not declare it."""
        if name in self.channels:
            return name
        pattern, _, channel = name.partition("/")
        return channel if pattern == self.pattern and channel in self.channels else None

    def full_name(self, channel: str) -> str:
        """The `<pattern>/<channel>` under which a channel is published."""
        return channel if "/" in channel else f"{self.pattern}/{channel}"


class PatternRun:
    """The load and the run of a pattern, the answers awaited from its host, and its faults."""

    def __init__(self) -> None:
        self.generation = 0
        self.running: Running | None = None
        self.loading: Loading | None = None
        self.restart_at: float | None = None
        self.awaiting_since: float | None = None
        self.stepped_generation = 0
        self.last_step = -1.0
        self.is_due = False
        self.is_outdated = False  # its host may hold code that has been replaced
        self.restarts = 0
        self._faults: deque[float] = deque()

    @property
    def wish(self) -> Wish | None:
        """The newest wish behind what runs or is being loaded; None if the robot stands."""
        present = self.loading or self.running
        return None if present is None else present.wish

    def ready(self, event: Loaded, now: float) -> Loading:
        """Make the loaded pattern the running one, without a requested command yet."""
        loading, self.loading = self.loading, None
        assert loading is not None
        finish_at = None if loading.seconds is None else now + loading.seconds
        if loading.is_restart and self.running is not None:
            finish_at = self.running.finish_at
        else:
            self._faults.clear()
        self.running = Running(
            loading.generation,
            loading.pattern,
            loading.params,
            finish_at,
            event.rate,
            event.channels,
            event.params,
            RequestedCommand(None, now, -1),
            loading.wish,
            loading.until,
        )
        self.awaiting_since = None
        self.last_step = -1.0
        return loading

    def stepped(self, event: Stepped, now: float) -> None:
        """Take the requested command of a step; its age counts from the start of the step."""
        assert self.running is not None
        asked_at = now if self.awaiting_since is None else self.awaiting_since
        self.awaiting_since = None
        self.running.requested = RequestedCommand(event.outputs.twist, asked_at, event.scan_seq)

    def is_expired(self, now: float) -> bool:
        """True if the last requested command has expired, or no pattern runs."""
        running = self.running
        return running is None or now >= running.requested.at + running.expiry - ROUNDING

    def may_step(self, now: float, is_new_scan: bool) -> bool:
        """True if a step is due and the host is free; while the host is busy the step stays due."""
        running = self.running
        if running is None or self.restart_at is not None or self.loading is not None:
            return False
        is_time = now - self.last_step >= running.period - STEP_TOLERANCE
        if not (is_new_scan or self.is_due or is_time):
            return False
        if self.awaiting_since is not None:
            self.is_due = True
            return False
        return True

    def stepping(self, now: float) -> float:
        """Mark the start of a step; returns the seconds since the last one (0 at the first)."""
        assert self.running is not None
        self.stepped_generation = self.running.generation
        dt = 0.0 if self.last_step < 0.0 else now - self.last_step
        self.last_step = now
        self.awaiting_since = now
        self.is_due = False
        return dt

    @property
    def is_restarting(self) -> bool:
        """True while a failed pattern waits for its restart or is being loaded again."""
        is_reloading = self.loading is not None and self.loading.is_restart
        return self.restart_at is not None or is_reloading

    def fault(self, now: float) -> bool:
        """Count a fault; True if the pattern must be quarantined, else its restart is scheduled."""
        self.awaiting_since = None
        self.loading = None
        self.restarts += 1
        self._faults.append(now)
        while self._faults and now - self._faults[0] > FAULT_WINDOW:
            self._faults.popleft()
        if len(self._faults) >= FAULTS_BEFORE_QUARANTINE:
            self.restart_at = None
            return True
        self.restart_at = now + FIRST_BACKOFF * 2.0 ** (len(self._faults) - 1)
        return False

    def end(self) -> None:
        """End the run and any load; a step under way is still awaited."""
        self.end_running()
        self.loading = None

    def end_running(self) -> None:
        """End the run; a load goes on."""
        self.running = None
        self.restart_at = None
        self.is_due = False

    def lifecycle_due_at(self) -> float:
        """A time before which no deadline passes but that of a step; inf without one.

        -inf during a load. A restart is a hold, which its caller looks at.
        """
        running, soonest = self.running, math.inf
        if self.loading is not None:
            return -math.inf
        if running is not None:
            soonest = running.requested.at + running.expiry
            if running.finish_at is not None and running.finish_at < soonest:
                soonest = running.finish_at
        if self.awaiting_since is not None and self.awaiting_since + STEP_TIMEOUT < soonest:
            soonest = self.awaiting_since + STEP_TIMEOUT
        return soonest

    def step_due_at(self) -> float:
        """A time before which `may_step` does nothing without a new scan; inf without one."""
        running = self.running
        if running is None:
            return math.inf
        if self.is_due:  # a busy host is asked again after its answer
            return -math.inf if self.awaiting_since is None else math.inf
        return self.last_step + running.period - STEP_TOLERANCE

    def next_deadline(self, now: float) -> float:
        """The next deadline after `now`; inf without one."""
        running, soonest = self.running, math.inf
        if running is not None:
            if self.awaiting_since is None and self.loading is None:
                at = self.last_step + running.period
                soonest = at if now < at else soonest
            at = running.requested.at + running.expiry
            soonest = at if now < at < soonest else soonest
            if running.finish_at is not None and now < running.finish_at < soonest:
                soonest = running.finish_at
        if self.awaiting_since is not None:
            at = self.awaiting_since + STEP_TIMEOUT
            soonest = at if now < at < soonest else soonest
        if self.restart_at is not None and now < self.restart_at < soonest:
            soonest = self.restart_at
        if self.loading is not None:
            at = self.loading.since + LOAD_TIMEOUT
            soonest = at if now < at < soonest else soonest
            if self.loading.start_at is not None and now < self.loading.start_at < soonest:
                soonest = self.loading.start_at
        return soonest
