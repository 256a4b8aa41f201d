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

_STEP_TIMEOUT = cython.declare(cython.double, timeouts.STEP_TIMEOUT)
_STEP_TOLERANCE = cython.declare(cython.double, timeouts.STEP_TOLERANCE)
ROUNDING = cython.declare(cython.double, timeouts.ROUNDING)
# Constants as C variables: Cython looks up a Python global in a dict at each use.
NOTHING_PERMITTED = cython.declare(object, NO_PERMIT)


@cython.final
@cython.cclass
class Running:
    """The running pattern, and the command that it requested last."""

    generation: int = cython.declare(object, visibility="readonly")  # the number of the load
    pattern: str = cython.declare(object, visibility="readonly")
    params: Mapping[str, Scalar | None] = cython.declare(object, visibility="public")
    rate: float = cython.declare(object, visibility="readonly")
    channels: frozenset[str] = cython.declare(object, visibility="readonly")
    values: ParamSources = cython.declare(object, visibility="public")
    wish: Wish = cython.declare(object, visibility="readonly")
    until: tuple[str, ...] = cython.declare(object, visibility="readonly")
    # What protection may do and allow for this pattern, such as to touch an object.
    permit: Permit = cython.declare(object, visibility="public")
    finish_at = cython.declare(cython.double, visibility="readonly")  # inf: no end
    period = cython.declare(cython.double, visibility="readonly")  # s between two steps
    # The pattern needs the places of peers.
    needs_places = cython.declare(cython.bint, visibility="readonly")
    # s for which a requested command is valid (rule 1 of the module).
    expiry = cython.declare(cython.double, visibility="readonly")
    # The last requested command, None to stand; the start of the step that returned this command;
    # and the number of the scan that this step used, -1 without a scan.
    requested: Twist | None = cython.declare(object, visibility="readonly")
    requested_at = cython.declare(cython.double, visibility="readonly")
    scan_seq = cython.declare(cython.Py_ssize_t, visibility="readonly")

    def __init__(
        self, loading: Loading, event: Loaded, finish_at: cython.double, now: cython.double
    ) -> None:
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

    @cython.ccall
    def channel(self, name: str) -> str | None:
        """The channel name in the pattern for `<pattern>/<channel>`; None if undeclared."""
        if name in self.channels:
            return name
        pattern, _, channel = name.partition("/")
        return channel if pattern == self.pattern and channel in self.channels else None

    def full_name(self, channel: str) -> str:
        """The name `<pattern>/<channel>` under which a channel is published."""
        return channel if "/" in channel else f"{self.pattern}/{channel}"


@cython.final
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

    running: Running | None = cython.declare(Running, visibility="public")
    loading: Loading | None = cython.declare(object, visibility="public")
    restart_at = cython.declare(cython.double, visibility="public")
    awaiting_since = cython.declare(cython.double, visibility="public")
    last_step = cython.declare(cython.double, visibility="public")
    stepped_generation: int = cython.declare(object, visibility="public")
    is_due = cython.declare(cython.bint, visibility="public")
    is_outdated = cython.declare(cython.bint, visibility="public")
    hand: Hand | None = cython.declare(object, visibility="public")
    generation: int = cython.declare(object, visibility="public")
    restarts = cython.declare(cython.Py_ssize_t, visibility="public")
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

    def ready(self, event: Loaded, now: cython.double) -> Loading:
        """Make the loaded pattern the running one, without a requested command yet."""
        loading = self.loading
        self.loading = None
        assert loading is not None  # the host answers loads alone
        finish_at: cython.double = INFINITY if loading.seconds is None else now + loading.seconds
        if loading.is_restart and self.running is not None:
            finish_at = self.running.finish_at
        else:
            self._faults.clear()
        self.running = Running(loading, event, finish_at, now)
        self.awaiting_since = INFINITY
        self.last_step = -1.0
        return loading

    def stepped(self, outputs: Outputs, scan_seq: cython.Py_ssize_t, now: cython.double) -> None:
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

    def is_expired(self, now: cython.double) -> bool:
        """True if the last requested command has expired, or no pattern runs."""
        running = self.running
        return running is None or now >= running.requested_at + running.expiry - ROUNDING

    @cython.ccall
    @cython.exceptval(check=False)
    def may_step(self, now: cython.double, is_new_scan: cython.bint) -> cython.bint:
        """True if a step is due and the host is free. Sets `is_due` if the host is busy."""
        running = self.running
        if running is None or self.restart_at < INFINITY or self.loading is not None:
            return False
        is_time: cython.bint = now - self.last_step >= running.period - _STEP_TOLERANCE
        if not (is_new_scan or self.is_due or is_time):
            return False
        if self.awaiting_since < INFINITY:
            self.is_due = True
            return False
        return True

    @cython.ccall
    def stepping(self, now: cython.double) -> float:
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

    def fault(self, now: cython.double) -> bool:
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

    @cython.cfunc
    @cython.exceptval(check=False)
    def lifecycle_due_at(self) -> cython.double:
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

    @cython.cfunc
    @cython.exceptval(check=False)
    def step_due_at(self) -> cython.double:
        """A time before which `may_step` stays False without a new scan; inf without a run."""
        running = self.running
        if running is None:
            return INFINITY
        if self.is_due:  # the due step follows the answer of the busy host
            return -INFINITY if self.awaiting_since == INFINITY else INFINITY
        return self.last_step + running.period - _STEP_TOLERANCE

    @cython.ccall
    def next_deadline(self, now: cython.double) -> float:
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


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def later(at: cython.double, now: cython.double) -> cython.double:
    """The time `at` if it lies after `now`, else inf."""
    return at if now < at else INFINITY
