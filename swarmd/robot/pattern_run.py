"""The load and the run of a pattern: steps, the expiry of its command, faults, backoff of restarts.

A kernel (see `core/kernels.py`), compiled into one unit with ticker.py. Times are in s on the
robot's clock. A deadline that is not set is inf.

1. A requested command expires three periods after the start of the step that returned it, or after
   MIN_EXPIRY if that is longer.
2. A step is due after a period, or with a new scan. The host computes one step at a time: a step
   that becomes due during another step stays due.
3. After a fault the pattern is restarted after FIRST_BACKOFF. Each further fault within
   FAULT_WINDOW doubles the wait. FAULTS_BEFORE_QUARANTINE faults within FAULT_WINDOW end the run.
4. A run request clears the faults. A restart keeps the faults, and the end time of the run.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from swarmd.core import cython_shadow as cython
from swarmd.core.cython_shadow import INFINITY
from swarmd.core.values import slowed
from swarmd.robot import timeouts
from swarmd.robot.protection.decision import NO_PERMIT

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmd.core.host_messages import Loaded, ParamSources
    from swarmd.core.values import Outputs, Scalar, Twist
    from swarmd.robot.hand import Hand
    from swarmd.robot.pattern_load import Loading, Wish
    from swarmd.robot.protection.decision import Permit

_STEP_TIMEOUT = timeouts.STEP_TIMEOUT
_STEP_TOLERANCE = timeouts.STEP_TOLERANCE
ROUNDING = timeouts.ROUNDING
# Constants as C variables: Cython looks up a Python global in a dict at each use.
NOTHING_PERMITTED = NO_PERMIT


@cython.cclass
class Running:
    """The running pattern, and the command that it requested last."""

    generation: int  # the number of the load
    pattern: str
    params: Mapping[str, Scalar | None]
    rate: float
    channels: frozenset[str]
    values: ParamSources
    wish: Wish
    until: tuple[str, ...]
    # What protection may do and allow for this pattern, such as to touch an object.
    permit: Permit
    finish_at: float  # inf: no end
    period: float  # s between two steps
    # The pattern needs the places of peers.
    needs_places: bool
    # s for which a requested command is valid (rule 1 of the module).
    expiry: float
    # The last requested command, None to stand; the start of the step that returned this command;
    # and the number of the scan that this step used, -1 without a scan.
    requested: Twist | None
    requested_at: float
    scan_seq: int

    def __init__(self, loading: Loading, event: Loaded, finish_at: float, now: float) -> None:
        """Start the run of `loading`, whose load ended with `event` at `now`."""
        self.generation = loading.generation
        self.pattern = loading.pattern
        self.params = loading.params
        self.rate = event.rate
        self.channels = event.channels
        self.values = event.params
        self.wish = loading.wish
        self.until = loading.until
        self.permit = NOTHING_PERMITTED
        self.finish_at = finish_at
        self.needs_places = event.needs_places
        self.period = 1.0 / event.rate
        self.expiry = max(timeouts.MIN_EXPIRY, 3.0 / event.rate)
        self.requested_at = now
        self.scan_seq = -1

    def channel(self, name: str) -> str | None:
        """The channel name in the pattern for `<pattern>/<channel>`; None if undeclared."""
        if name in self.channels:
            return name
        pattern, _, channel = name.partition("/")
        return channel if pattern == self.pattern and channel in self.channels else None

    def full_name(self, channel: str) -> str:
        """The name `<pattern>/<channel>` under which a channel is published."""
        return channel if "/" in channel else f"{self.pattern}/{channel}"


@cython.cclass
class PatternRun:
    """The load and the run of a pattern, the answer awaited from its host, and its faults.

    - `awaiting_since`: the start of the present step; inf while the host is free.
    - `stepped_generation`: the generation (number of a load) whose pattern got the last step.
    - `is_due`: a step became due while the host was busy.
    - `is_outdated`: the host may contain replaced code.
    - `hand`: the operator who drives the robot, or whose hand was lost; None without one.
    - `restarts`: the count of all faults since the start of the daemon.
    """

    running: Running | None
    loading: Loading | None
    restart_at: float
    awaiting_since: float
    last_step: float
    stepped_generation: int
    is_due: bool
    is_outdated: bool
    hand: Hand | None
    generation: int
    restarts: int
    _faults: deque[float]

    def __init__(self) -> None:
        self.restart_at = INFINITY
        self.awaiting_since = INFINITY
        self.last_step = -1.0
        self.generation = 0
        self.stepped_generation = 0
        self._faults = deque[float]()

    @property
    def wish(self) -> Wish | None:
        """The wish of the load, or without a load of the run; None if the robot stands."""
        present = self.running if self.loading is None else self.loading
        return None if present is None else present.wish

    def ready(self, event: Loaded, now: float) -> Loading:
        """Make the loaded pattern the running one, without a requested command yet."""
        loading = self.loading
        self.loading = None
        assert loading is not None  # the host answers loads alone
        finish_at = INFINITY if loading.seconds is None else now + loading.seconds
        if loading.is_restart and self.running is not None:
            finish_at = self.running.finish_at
        else:
            self._faults.clear()
        self.running = Running(loading, event, finish_at, now)
        self.awaiting_since = INFINITY
        self.last_step = -1.0
        return loading

    def stepped(self, outputs: Outputs, scan_seq: int, now: float) -> None:
        """Take the requested command that a step returned; it ages from the start of that step."""
        running = self.running
        assert running is not None  # Lifecycle has compared its generation
        asked_at = self.awaiting_since
        running.requested_at = now if asked_at == INFINITY else asked_at
        self.awaiting_since = INFINITY
        # Steering and protection see no request beyond the bound: what is slow by its bound is not
        # blocked, and its command is not one that protection has changed.
        twist = outputs.twist
        speed = running.permit.speed
        running.requested = twist if twist is None or speed is None else slowed(twist, speed)
        running.scan_seq = scan_seq

    def is_expired(self, now: float) -> bool:
        """True if the last requested command has expired, or no pattern runs."""
        running = self.running
        return running is None or now >= running.requested_at + running.expiry - ROUNDING

    def may_step(self, now: float, is_new_scan: bool) -> bool:
        """True if a step is due and the host is free. Sets `is_due` if the host is busy."""
        running = self.running
        if running is None or self.restart_at < INFINITY or self.loading is not None:
            return False
        is_time = now - self.last_step >= running.period - _STEP_TOLERANCE
        if not (is_new_scan or self.is_due or is_time):
            return False
        if self.awaiting_since < INFINITY:
            self.is_due = True
            return False
        return True

    def stepping(self, now: float) -> float:
        """Mark the start of a step; returns the s since the start of the step before (first: 0)."""
        assert self.running is not None  # `may_step`
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
        return self.restart_at < INFINITY or is_reloading

    def fault(self, now: float) -> bool:
        """Count a fault; True if the pattern must be quarantined. Else sets `restart_at`."""
        self.awaiting_since = INFINITY
        self.restart_at = INFINITY
        self.loading = None
        self.restarts += 1
        faults = self._faults
        faults.append(now)
        while faults and now - faults[0] > timeouts.FAULT_WINDOW:
            faults.popleft()
        if len(faults) >= timeouts.FAULTS_BEFORE_QUARANTINE:
            return True
        self.restart_at = now + timeouts.FIRST_BACKOFF * 2.0 ** (len(faults) - 1)
        return False

    def end(self) -> None:
        """End the run and any load; the answer to a present step is still awaited."""
        self.end_running()
        self.loading = None

    def end_running(self) -> None:
        """End the run; a load goes on."""
        self.running = None
        self.restart_at = INFINITY
        self.is_due = False

    def lifecycle_due_at(self) -> float:
        """The next deadline of the host's answer and of the run in s; inf without a deadline.

        During a load -inf: the caller then checks all deadlines at each tick. `step_due_at` has the
        deadline of the next step. `restart_at` is left out: until the restart the robot is in the
        hold `pattern_restarting`, and in a hold the caller checks all deadlines at each tick.
        """
        running = self.running
        if self.loading is not None:
            return -INFINITY
        soonest = self.awaiting_since + _STEP_TIMEOUT
        if self.hand is not None:
            soonest = min(soonest, self.hand.due_at)
        if running is not None:
            soonest = min(soonest, running.requested_at + running.expiry, running.finish_at)
        return soonest

    def step_due_at(self) -> float:
        """A time before which `may_step` stays False without a new scan; inf without a run."""
        running = self.running
        if running is None:
            return INFINITY
        if self.is_due:  # the due step follows the answer of the busy host
            return -INFINITY if self.awaiting_since == INFINITY else INFINITY
        return self.last_step + running.period - _STEP_TOLERANCE

    def next_deadline(self, now: float) -> float:
        """The next deadline after `now`; inf without one."""
        running = self.running
        soonest = later(self.awaiting_since + _STEP_TIMEOUT, now)
        if self.hand is not None:
            soonest = min(soonest, later(self.hand.due_at, now))
        if running is not None:
            if self.awaiting_since == INFINITY and self.loading is None:
                soonest = min(soonest, later(self.last_step + running.period, now))
            soonest = min(soonest, later(running.requested_at + running.expiry, now))
            soonest = min(soonest, later(running.finish_at, now))
        soonest = min(soonest, later(self.restart_at, now))
        loading = self.loading
        if loading is not None:
            soonest = min(soonest, later(loading.since + timeouts.LOAD_TIMEOUT, now))
            if loading.start_at is not None:
                soonest = min(soonest, later(loading.start_at, now))
        return soonest


def later(at: float, now: float) -> float:
    """The time `at` if it lies after `now`, else inf."""
    return at if now < at else INFINITY
