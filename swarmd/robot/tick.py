"""The hot path of one robot: ages of its inputs, deadlines of its pattern, holds, ticks.

A kernel (see `core/kernels.py`): `Sensors` and `Robot` extend these classes by the work that is
rarer than a tick. Times are in s on the robot's clock. A deadline that is not set is inf, the time
of an input that has not arrived is -inf.
"""

from __future__ import annotations

from collections import deque
from types import MappingProxyType
from typing import TYPE_CHECKING

from msgspec.structs import replace

from swarmd.core.clock import STALL_TIMEOUT
from swarmd.core.events import HostInput
from swarmd.core.host_messages import KillHost, Load, SetParams, Step, Stepped
from swarmd.core.messages import Reason, State
from swarmd.core.values import Inputs, Neighbor
from swarmd.protection.decision import NO_PERMIT, DecisionContext
from swarmd.robot import timeouts
from swarmd.robot.actions import Actions

if TYPE_CHECKING:  # Cython reads this import, CPython the other
    import cython

    from swarmd.core.events import Input, ScanInput, TickInput
    from swarmd.core.host_messages import Loaded
    from swarmd.robot.pattern_run import Loading, Wish
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import INFINITY, floor
else:
    from swarmd.core.cython_shadow import INFINITY, floor

_STEP_TIMEOUT = cython.declare(cython.double, timeouts.STEP_TIMEOUT)
_STEP_TOLERANCE = cython.declare(cython.double, timeouts.STEP_TOLERANCE)
_ROUNDING = cython.declare(cython.double, timeouts.ROUNDING)
_MAX_HOLD_TIME = cython.declare(cython.double, timeouts.MAX_HOLD_TIME)
_STATUS_PERIOD = cython.declare(cython.double, timeouts.STATUS_PERIOD)
_ODOMETRY_TIMEOUT = cython.declare(cython.double, timeouts.ODOMETRY_TIMEOUT)
_NEIGHBOR_TIMEOUT = cython.declare(cython.double, timeouts.NEIGHBOR_TIMEOUT)
_AGE_UPDATE_PERIOD = cython.declare(cython.double, timeouts.AGE_UPDATE_PERIOD)
_STALL_TIMEOUT = cython.declare(cython.double, STALL_TIMEOUT)
# A name of C is found at once, one of the module in a dict.
_RUNNING, _IDLE = cython.declare(object, State.RUNNING), cython.declare(object, State.IDLE)
_HAZARD = cython.declare(object, Reason.HAZARD)
_Actions, _Context = cython.declare(object, Actions), cython.declare(object, DecisionContext)
_HostInput = cython.declare(object, HostInput)
_Step, _Stepped = cython.declare(object, Step), cython.declare(object, Stepped)
_Inputs = cython.declare(object, Inputs)
_NO_PERMIT = cython.declare(object, NO_PERMIT)
_NO_MESSAGES = cython.declare(object, MappingProxyType({}))
_STALE_MARGIN = cython.declare(cython.double, 1e-4)  # s after a scan is stale until the alarm


@cython.final
@cython.auto_pickle(False)
@cython.cclass
class Effects:
    """The effects of one event at `now`, gathered until the robot settles them into `Actions`.

    `is_routine`: the event is a tick, a scan or the answer to a step, and has not changed the
    lifecycle, but for the requested command. The others are as in `Actions`.
    """

    now = cython.declare(cython.double, visibility="readonly")
    is_tick = cython.declare(cython.bint, visibility="public")
    is_routine = cython.declare(cython.bint, visibility="public")
    is_latched = cython.declare(cython.bint, visibility="public")
    is_new_scan = cython.declare(cython.bint, visibility="public")
    is_new_run = cython.declare(cython.bint, visibility="public")
    trial = cython.declare(object, visibility="public")
    messages = cython.declare(object, visibility="public")
    replies = cython.declare(tuple, visibility="public")
    host = cython.declare(object, visibility="public")
    failed_code = cython.declare(object, visibility="public")
    ended = cython.declare(object, visibility="public")
    grip = cython.declare(object, visibility="public")

    def __init__(self, now: cython.double) -> None:
        self.now, self.messages, self.replies, self.ended = now, _NO_MESSAGES, (), ""

    def command_host(self, command: KillHost | Load | SetParams | Step) -> None:
        """Choose the one command of this event for the pattern host.

        KillHost and Load decide which pattern the host holds, so the later of them wins; a Load
        after a KillHost asks for a fresh host. SetParams and Step are meant for the pattern that
        the host holds now, so they never replace another command.
        """
        if isinstance(command, (SetParams, Step)) and self.host is not None:
            return
        if isinstance(command, Load) and isinstance(self.host, KillHost):
            command = replace(command, is_fresh=True)
        self.host = command


@cython.cclass
class StateField:
    """The state of a robot, which `StateMachine` changes."""

    state = cython.declare(object, visibility="public")


@cython.final
@cython.cclass
class Running:
    """The running pattern.

    `permit`: what it permits while it is not held. `period`: s between two steps. `expiry`: s for
    which a requested command holds: three steps, at least MIN_EXPIRY. `requested` is the command
    that it requests, None to stand; `requested_at` when the step that gave it began, `scan_seq` the
    scan that it used (-1: none). `finish_at`: inf without an end.
    """

    generation = cython.declare(object, visibility="readonly")
    pattern = cython.declare(object, visibility="readonly")
    params = cython.declare(object, visibility="public")
    rate = cython.declare(object, visibility="readonly")
    channels = cython.declare(object, visibility="readonly")
    values = cython.declare(object, visibility="public")
    wish = cython.declare(object, visibility="readonly")
    until = cython.declare(object, visibility="readonly")
    permit = cython.declare(object, visibility="public")
    finish_at = cython.declare(cython.double, visibility="readonly")
    period = cython.declare(cython.double, visibility="readonly")
    expiry = cython.declare(cython.double, visibility="readonly")
    requested = cython.declare(object, visibility="readonly")
    requested_at = cython.declare(cython.double, visibility="readonly")
    scan_seq = cython.declare(cython.Py_ssize_t, visibility="readonly")

    def __init__(self, loading, event, finish_at: cython.double, now: cython.double) -> None:
        """`loading` is the load that has ended with `event`, at `now`."""
        self.generation, self.pattern, self.params = (
            loading.generation,
            loading.pattern,
            loading.params,
        )
        self.rate, self.channels, self.values = event.rate, event.channels, event.params
        self.wish, self.until, self.permit = loading.wish, loading.until, _NO_PERMIT
        self.finish_at = finish_at
        self.period, self.expiry = 1.0 / event.rate, max(timeouts.MIN_EXPIRY, 3.0 / event.rate)
        self.requested, self.requested_at, self.scan_seq = None, now, -1

    def channel(self, name: str) -> str | None:
        """The pattern's own name of `<pattern>/<channel>`; None if it does not declare it."""
        if name in self.channels:
            return name
        pattern, _, channel = name.partition("/")
        return channel if pattern == self.pattern and channel in self.channels else None

    def full_name(self, channel: str) -> str:
        """The `<pattern>/<channel>` under which a channel is published."""
        return channel if "/" in channel else f"{self.pattern}/{channel}"


@cython.final
@cython.cclass
class PatternRun:
    """The load and the run of a pattern, the answer awaited from its host, and its faults.

    `awaiting_since`: when the step began whose answer is due. `is_due`: a step was due while the
    host was busy. `is_outdated`: the host may hold code that has been replaced.
    """

    running = cython.declare(Running, visibility="public")
    loading = cython.declare(object, visibility="public")
    restart_at = cython.declare(cython.double, visibility="public")
    awaiting_since = cython.declare(cython.double, visibility="public")
    last_step = cython.declare(cython.double, visibility="public")
    stepped_generation = cython.declare(object, visibility="public")
    is_due = cython.declare(cython.bint, visibility="public")
    is_outdated = cython.declare(cython.bint, visibility="public")
    generation = cython.declare(object, visibility="public")
    restarts = cython.declare(cython.Py_ssize_t, visibility="public")
    _faults: object

    def __init__(self) -> None:
        self.restart_at = self.awaiting_since = INFINITY
        self.last_step, self.generation, self.stepped_generation = -1.0, 0, 0
        self._faults = deque[float]()

    @property
    def wish(self) -> Wish | None:
        """The newest wish behind what runs or is being loaded; None if the robot stands."""
        present = self.running if self.loading is None else self.loading
        return None if present is None else present.wish

    def ready(self, event: Loaded, now: cython.double) -> Loading:
        """Make the loaded pattern the running one, without a requested command yet."""
        loading, self.loading = self.loading, None
        finish_at: cython.double = INFINITY if loading.seconds is None else now + loading.seconds
        if loading.is_restart and self.running is not None:
            finish_at = self.running.finish_at
        else:
            self._faults.clear()
        self.running = Running(loading, event, finish_at, now)
        self.awaiting_since, self.last_step = INFINITY, -1.0
        return loading

    def stepped(self, outputs, scan_seq: cython.Py_ssize_t, now: cython.double) -> None:
        """Take the requested command of a step; its age counts from the start of the step."""
        running = self.running
        asked_at = self.awaiting_since
        running.requested_at = now if asked_at == INFINITY else asked_at
        self.awaiting_since = INFINITY
        running.requested, running.scan_seq = outputs.twist, scan_seq

    def is_expired(self, now: cython.double) -> bool:
        """True if the last requested command has expired, or no pattern runs."""
        running = self.running
        return running is None or now >= running.requested_at + running.expiry - _ROUNDING

    @cython.ccall
    @cython.exceptval(check=False)
    def may_step(self, now: cython.double, is_new_scan: cython.bint) -> cython.bint:
        """True if a step is due and the host is free; while the host is busy the step stays due."""
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
        """Mark the start of a step; returns the seconds since the last one (0 at the first)."""
        self.stepped_generation = self.running.generation
        dt = 0.0 if self.last_step < 0.0 else now - self.last_step
        self.last_step = self.awaiting_since = now
        self.is_due = False
        return dt

    @property
    def is_restarting(self) -> bool:
        """True while a failed pattern waits for its restart or is being loaded again."""
        is_reloading = self.loading is not None and self.loading.is_restart
        return self.restart_at < INFINITY or is_reloading

    def fault(self, now: cython.double) -> bool:
        """Count a fault; True if the pattern must be quarantined, else its restart is scheduled."""
        self.awaiting_since = self.restart_at = INFINITY
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
        """End the run and any load; a step under way is still awaited."""
        self.end_running()
        self.loading = None

    def end_running(self) -> None:
        """End the run; a load goes on."""
        self.running, self.restart_at, self.is_due = None, INFINITY, False

    @cython.cfunc
    @cython.exceptval(check=False)
    def lifecycle_due_at(self) -> cython.double:
        """A time before which no deadline passes but that of a step; inf without one.

        -inf during a load. A restart is a hold, which its caller looks at.
        """
        running = self.running
        if self.loading is not None:
            return -INFINITY
        soonest: cython.double = self.awaiting_since + _STEP_TIMEOUT
        if running is not None:
            soonest = min(soonest, running.requested_at + running.expiry, running.finish_at)
        return soonest

    @cython.cfunc
    @cython.exceptval(check=False)
    def step_due_at(self) -> cython.double:
        """A time before which `may_step` does nothing without a new scan; inf without one."""
        running = self.running
        if running is None:
            return INFINITY
        if self.is_due:  # a busy host is asked again after its answer
            return -INFINITY if self.awaiting_since == INFINITY else INFINITY
        return self.last_step + running.period - _STEP_TOLERANCE

    @cython.ccall
    def next_deadline(self, now: cython.double) -> float:
        """The next deadline after `now`; inf without one."""
        running = self.running
        soonest: cython.double = _later(self.awaiting_since + _STEP_TIMEOUT, now)
        if running is not None:
            if self.awaiting_since == INFINITY and self.loading is None:
                soonest = _later(self.last_step + running.period, now)
            soonest = min(soonest, _later(running.requested_at + running.expiry, now))
            soonest = min(soonest, _later(running.finish_at, now))
        soonest = min(soonest, _later(self.restart_at, now))
        loading = self.loading
        if loading is not None:
            soonest = min(soonest, _later(loading.since + timeouts.LOAD_TIMEOUT, now))
            if loading.start_at is not None:
                soonest = min(soonest, _later(loading.start_at, now))
        return soonest


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _later(at: cython.double, now: cython.double) -> cython.double:
    """The time `at` if it is to come, else inf."""
    return at if now < at else INFINITY


@cython.cclass
class InputTimes:
    """The arrival of inputs, the holds that follow, and the context of decisions.

    `problem`: why the last scan does not count. `peers_due`: the time until which no peer holds the
    robot, `hazards_until` that until which a hazard does. `ring`: that of range sensors, or None.
    """

    odometry = cython.declare(object, visibility="public")
    scan = cython.declare(object, visibility="public")
    readings = cython.declare(object, visibility="public")
    detections = cython.declare(object, visibility="public")
    pose = cython.declare(object, visibility="public")
    pose_until = cython.declare(cython.double, visibility="public")
    scan_delay = cython.declare(object, visibility="public")
    is_driver_up = cython.declare(cython.bint, visibility="public")
    driver_hold = cython.declare(object, visibility="public")
    permitted_delay = cython.declare(cython.double, visibility="public")
    _scan_at = cython.declare(cython.double, visibility="public")
    _odometry_at = cython.declare(cython.double, visibility="public")
    _added = cython.declare(cython.double, visibility="public")
    _is_late = cython.declare(cython.bint, visibility="public")
    _is_clock_set = cython.declare(cython.bint, visibility="public")
    _stale_after = cython.declare(cython.double, visibility="public")
    _max_delay = cython.declare(cython.double, visibility="public")
    _needs_odometry = cython.declare(cython.bint, visibility="public")
    _problem = cython.declare(object, visibility="public")
    _ring = cython.declare(object, visibility="public")
    _peers_due = cython.declare(cython.double, visibility="public")
    _teller = cython.declare(object, visibility="public")
    _hazards_until = cython.declare(cython.double, visibility="public")
    _ends_run = cython.declare(cython.bint, visibility="public")
    _is_new_scan = cython.declare(cython.bint, visibility="public")
    _history = cython.declare(object, visibility="public")
    _inbox = cython.declare(object, visibility="public")
    _neighbors = cython.declare(tuple, visibility="public")
    _neighbors_at = cython.declare(cython.double, visibility="public")
    # The neighbours with their ages, and how often they were brought up to date.
    _aged = cython.declare(tuple, visibility="public")
    _renewals = cython.declare(cython.double, visibility="public")
    _context = cython.declare(object, visibility="public")
    _context_at: cython.double

    def __init__(self) -> None:
        self._scan_at = self._odometry_at = self._hazards_until = -INFINITY
        self._peers_due = INFINITY
        self._neighbors = self._aged = ()

    @cython.ccall
    def on_odometry(self, odometry, now: cython.double):
        """Take in a measured pose and twist.

        A reading with an old stamp does not renew the age. The robot ignores an invalid reading.
        """
        is_new = self._history.take(odometry, now)
        if is_new is None:
            return
        self._context, self.odometry = None, odometry
        if is_new:
            self._odometry_at = now

    @cython.ccall
    def neighbors(self, now: cython.double) -> tuple:
        """The neighbours, with ages to within 0.5 s; none after 3 s without an update."""
        past: cython.double = now - self._neighbors_at
        if past > _NEIGHBOR_TIMEOUT:
            return ()
        renewals: cython.double = floor(past / _AGE_UPDATE_PERIOD)
        if renewals != self._renewals:
            self._renewals, past = renewals, renewals * _AGE_UPDATE_PERIOD
            self._aged = tuple(
                [
                    Neighbor(n.id, n.age + past, n.distance, n.bearing, n.heading)
                    for n in self._neighbors
                ]
            )
        return self._aged

    @cython.ccall
    def inputs(self, now: cython.double, dt: cython.double):
        """The inputs of one step; a message, like the mark of a new scan, is in one step only."""
        inputs = _Inputs(
            now,
            dt,
            self.scan,
            self._is_new_scan != 0,
            self.odometry,
            InputTimes.neighbors(self, now),
            self._take_messages(now) if self._inbox else (),
            self.readings,
            None if self._ring is None else self._ring.scan,
            self.detections,
            self.pose if now <= self.pose_until else None,
        )
        self._is_new_scan = False
        return inputs

    @cython.ccall
    def context(self, now: cython.double) -> DecisionContext:
        """The context of a decision at `now`: the same object for the same time and inputs."""
        if self._context is None or self._context_at != now:
            self._context_at = now
            self._context = _Context(
                now,
                None if self._scan_at == -INFINITY else now - self._scan_at,
                self.odometry,
                None if self._odometry_at == -INFINITY else now - self._odometry_at,
                self._added,
                () if self._teller is None else self._teller.told(now),
                () if self._ring is None else self._ring.obstacles(now),
            )
        return self._context

    @cython.ccall
    def hold(self, now: cython.double) -> Reason | None:
        """The reason why the sensors forbid motion; None if they do not."""
        if not self.is_driver_up:
            return Reason.DRIVER_LOST
        if self.driver_hold is not None:
            return self.driver_hold
        if now < self._hazards_until:
            return _HAZARD
        if self._scan_at == -INFINITY:
            return self._problem or Reason.NO_SCAN
        age: cython.double = now - self._scan_at
        if self._is_late and self._added > self.permitted_delay and age <= self._stale_after:
            return Reason.CLOCK_SET if self._is_clock_set else Reason.LATE_SCAN
        if age > self._longest_age():
            return self._problem or Reason.STALE_SCAN
        if self._ring is not None:
            reason = self._ring.hold(now)
            if reason is not None:
                return reason
        if self._needs_odometry and now - self._odometry_at > _ODOMETRY_TIMEOUT:
            return Reason.STALE_ODOMETRY
        return Reason.INCOMPATIBLE_PEER if now > self._peers_due else None

    @cython.ccall
    def hold_due_at(self) -> float:
        """A time until which `hold` stays None, if it is None now and nothing arrives."""
        due: cython.double = self._peers_due
        if self._scan_at > -INFINITY:
            due = min(due, self._scan_at + self._stale_after - self._added)
        if self._needs_odometry and self._odometry_at > -INFINITY:
            due = min(due, self._odometry_at + _ODOMETRY_TIMEOUT)
        if self._ring is not None:
            stale_at = self._ring.stale_at
            if stale_at is not None:
                due = min(due, stale_at)
        return due

    @cython.ccall
    def stale_at(self) -> float | None:
        """The time at which the present scan, or that of the ring, becomes too old.

        None before the first.
        """
        if self._scan_at == -INFINITY:
            return None
        stale_at = self._scan_at + self._longest_age()
        ring_at = None if self._ring is None else self._ring.stale_at
        return stale_at if ring_at is None else min(stale_at, ring_at)

    @cython.cfunc
    @cython.exceptval(check=False)
    def _longest_age(self) -> cython.double:
        """The age in s beyond which a scan is stale: age and delay count together.

        A permitted delay beyond the platform's bound takes nothing more of it.
        """
        added: cython.double = self._added
        if added <= self.permitted_delay and self._max_delay < added:
            added = self._max_delay
        return self._stale_after - added


@cython.final
@cython.cclass
class DutyCycle:
    """Ticks in `running` since the last run request, and the ticks with active protection."""

    decisions = cython.declare(cython.Py_ssize_t, visibility="readonly")
    active = cython.declare(cython.Py_ssize_t, visibility="readonly")

    @property
    def share(self) -> float:
        """Between 0 and 1; 0 before the first tick."""
        return self.active / float(self.decisions) if self.decisions else 0.0


@cython.cclass
class Ticker:
    """Ticks and settles the inputs of one robot.

    Quiet ticks: the first tick after an event finds until when nothing is due. Each event but a
    quiet tick resets `_quiet_until`. An event that may change the lifecycle resets `_due_at`, too.
    Odometry, neighbours, readings and messages reset neither.
    """

    decision = cython.declare(object, visibility="public")
    decided_at = cython.declare(cython.double, visibility="public")
    _sensors = cython.declare(InputTimes, visibility="public")
    _run = cython.declare(PatternRun, visibility="public")
    _lifecycle = cython.declare(object, visibility="public")
    _machine = cython.declare(StateField, visibility="public")
    _kept_goals = cython.declare(object, visibility="public")
    _requests = cython.declare(object, visibility="public")
    _protection = cython.declare(object, visibility="public")
    _duty = cython.declare(DutyCycle, visibility="public")
    _last_tick = cython.declare(cython.double, visibility="public")
    # Before it only a step or the status can be due.
    _due_at = cython.declare(cython.double, visibility="public")
    # Before it nothing is due: a tick only decides.
    _quiet_until = cython.declare(cython.double, visibility="public")
    _published_at = cython.declare(cython.double, visibility="public")
    # The lifecycle may have changed since the last look at it.
    _is_status_due = cython.declare(cython.bint, visibility="public")
    _blind: object  # the blind sectors that were logged
    _restarts: cython.Py_ssize_t  # of the scan delay, that were logged
    # The base does not follow its commands.
    _is_off_command = cython.declare(cython.bint, visibility="public")
    # What takes each type of input: of the robot, the input, the time.
    _handlers = cython.declare(dict, visibility="public")
    # That of the last event; under a hold no tick is quiet.
    _hold = cython.declare(object, visibility="public")
    _settled: object  # the actions of the last event but a quiet tick

    def __init__(self) -> None:
        self.decided_at = self._due_at = self._quiet_until = self._published_at = -INFINITY
        self._hold, self._is_status_due, self._blind = Reason.NO_SCAN, True, ""

    def step(self, input: Input, now: cython.double) -> Actions | None:
        """Take one input at `now`; the work of the shell, None if nothing changes for the shell."""
        if type(input) is _HostInput and type(input.event) is _Stepped:
            effects = Ticker._begin(self, now)
            self._lifecycle.on_stepped(input.event, effects)
            return self._settled_after(effects)
        return self._handlers[type(input)](self, input, now)

    @cython.ccall
    def _begin(self, now: cython.double) -> Effects:
        """Begin the effects of an event. After a stall of the loop the run ends first."""
        effects = Effects(now)
        late = now - self._last_tick
        if late > _STALL_TIMEOUT:
            self._last_tick = now
            self._due_at = -INFINITY
            self._lifecycle.stall(late, effects)
        return effects

    def _on_tick(self, one: TickInput, now: cython.double) -> Actions:
        actions = self._tick(now)
        if actions is not None:
            return actions
        last, decision = self._settled, self.decision
        seq, is_idle, is_stopped = last.requested_scan_seq, last.is_idle, last.is_stopped
        return _Actions(decision.safe, decision, seq, is_idle, is_stopped, True)

    @cython.cfunc
    def _tick(self, now: cython.double):
        """Check all deadlines: 20 times a second, at rest 10 times, and at `wake_at`.

        None after a quiet tick, which decides only.
        """
        if now >= self._quiet_until:
            self._look_ahead()
        is_quiet: cython.bint = now < self._quiet_until and now - self._last_tick <= _STALL_TIMEOUT
        effects = None if is_quiet else Ticker._begin(self, now)
        self._last_tick = now
        if self._machine.state is _RUNNING:
            duty = self._duty
            duty.decisions += 1
            duty.active += self.decision.is_active
        if effects is None:
            Ticker._decide(self, None, now)
            return None
        effects.is_tick = effects.is_routine = True
        return self._settled_after(effects)

    def _settle(self, effects: Effects) -> Actions:
        """The actions that follow from an event."""
        return self._settled_after(effects)

    @cython.cfunc
    def _settled_after(self, effects: Effects):
        now: cython.double = effects.now
        sensors, run, lifecycle = self._sensors, self._run, self._lifecycle
        is_routine: cython.bint = effects.is_routine
        running = run.running
        sensors.permitted_delay = 0.0 if running is None else running.permit.scan_delay
        hold = InputTimes.hold(sensors, now)
        detail = ""
        if hold is _HAZARD or sensors._ends_run:
            detail = sensors.hazard_text(now)
        if sensors._ends_run:
            lifecycle.on_hazard(detail, effects)
        if hold is not None or now >= self._due_at or not is_routine:
            self._requests.advance(effects)
            hold = lifecycle.advance(hold, effects, detail if hold is _HAZARD else "")
            self._is_status_due, self._due_at = True, -INFINITY
        self._quiet_until, self._hold = -INFINITY, hold
        decision = Ticker._decide(self, hold, now)
        machine = self._machine
        if run.restart_at < INFINITY:
            self._restart(effects)
        state = machine.state
        host = effects.host
        if host is None and state is _RUNNING and run.may_step(now, effects.is_new_scan):
            inputs = InputTimes.inputs(sensors, now, run.stepping(now))
            host = _Step(run.running.generation, inputs)
        # Replies go first: a status may wait for the tick, an emergency stop may not.
        is_latched: cython.bint = effects.is_latched
        has_status: cython.bint = effects.is_tick or is_latched
        if has_status:
            has_status = (
                self._is_status_due or now >= self._published_at + _STATUS_PERIOD - _ROUNDING
            ) and self._has_new_status(now)
        running = run.running
        actions = self._settled = _Actions(
            decision.safe,
            decision,
            -1 if running is None else running.scan_seq,
            sensors.is_driver_up and state is _IDLE,
            state is not _IDLE and state is not _RUNNING,
            False,
            lifecycle.latches.record() if is_latched else None,
            self._kept_goals.take_record() if self._kept_goals.is_changed else None,
            effects.trial,
            host,
            effects.messages,
            has_status,
            effects.replies,
            effects.failed_code,
            effects.ended,
            effects.grip,
        )
        return actions

    @cython.cfunc
    def _look_ahead(self):
        """Find until when nothing is due if no event comes; a hold is looked at in each tick."""
        if self._hold is not None:
            return
        due: cython.double = self._lifecycle_due_at()
        if self._machine.state is _RUNNING:
            due = min(due, InputTimes.hold_due_at(self._sensors))
        self._due_at = due - _ROUNDING
        if not self._is_status_due:
            due = min(due, self._run.step_due_at(), self._published_at + _STATUS_PERIOD)
            self._quiet_until = due - _ROUNDING

    @cython.cfunc
    def _lifecycle_due_at(self) -> cython.double:
        """A time before which `advance` without a hold changes nothing; inf without one."""
        lifecycle = self._lifecycle
        if lifecycle.params_request is not None or lifecycle.trial is not None:
            return -INFINITY
        due: cython.double = self._run.lifecycle_due_at()
        if self._kept_goals.lease_until is not None and self._kept_goals.lease_ends is not None:
            due = min(due, self._kept_goals.lease_ends)
        return due

    @property
    def is_at_rest(self) -> bool:
        """True if only events change the state: no run, load or trial, and no answer due.

        False without the base: another node may drive it, and a stopped robot then sends zero.
        """
        is_due = self._machine.state is _RUNNING or self._lifecycle_due_at() < INFINITY
        return bool(self._sensors.is_driver_up) and not is_due

    def _on_scan(self, one: ScanInput, now: cython.double) -> Actions:
        effects: Effects = Ticker._begin(self, now)
        sensors, protection = self._sensors, self._protection
        effects.is_routine, effects.is_new_scan = True, sensors.on_scan(one.scan, now)
        self._look_at_stamps(now)
        blind = sensors.blind_text
        if blind != self._blind:
            self._blind = blind
            text = blind or "all sectors return something again"
            self._lifecycle.log(f"scan: {text}", now)
        if effects.is_new_scan:
            protection.observe(sensors.scan, InputTimes.context(sensors, now))
            if protection.events:
                self._log_protection(now)
        return self._settled_after(effects)

    @cython.cfunc
    def _look_at_stamps(self, now: cython.double):
        """Log that stamps jumped."""
        restarts: cython.Py_ssize_t = self._sensors.scan_delay.restarts
        if restarts != self._restarts:
            self._restarts = restarts
            text = "stamps of odometry or scan jumped: the scan delay is measured anew"
            self._events.log("stamps that jump", text, now)

    @cython.ccall
    def _take_odometry(self, odometry, now: cython.double):
        sensors, protection = self._sensors, self._protection
        InputTimes.on_odometry(sensors, odometry, now)
        self._look_at_stamps(now)
        if sensors.odometry is odometry:
            protection.on_odometry(odometry)
            if protection.events:
                self._log_protection(now)
            text = protection.not_following
            if bool(text) != self._is_off_command:
                self._log_following(text, now)

    @cython.ccall
    def _decide(self, hold, now: cython.double):
        running = self._run.running
        context = InputTimes.context(self._sensors, now)
        if running is None:
            decision = self._protection.decide(None, context, False, hold)
        else:
            decision = self._protection.decide(
                running.requested,
                context,
                self._machine.state is _RUNNING,
                hold,
                # Nothing is permitted under a hold, and a pattern that restarts is held.
                running.permit if hold is None else _NO_PERMIT,
            )
        self.decided_at, self.decision = now, decision
        return decision

    def wake_at(self, now: cython.double) -> float | None:
        """The next deadline for which the robot must be woken between ticks; None without one.

        Deadlines of the pattern run, the run lease, the scans and the longest hold; all others are
        checked at ticks.
        """
        soonest: cython.double = self._run.next_deadline(now)
        if self._machine.state is _RUNNING:
            if self._kept_goals.lease_until is not None:
                lease_ends = self._kept_goals.lease_ends
                if lease_ends is not None:
                    soonest = min(soonest, _later(lease_ends, now))
            stale_at = InputTimes.stale_at(self._sensors)
            if stale_at is not None:
                soonest = min(soonest, _later(stale_at + _STALE_MARGIN, now))
            soonest = min(soonest, _later(self._lifecycle.hold_since + _MAX_HOLD_TIME, now))
        return soonest if soonest < INFINITY else None


def tick_many(
    robots: list, rows: list, commands: cython.double[:, ::1], now: cython.double
) -> list[tuple[int, Actions]]:
    """Tick robots: the place in `robots` and the actions of each tick that is not quiet.

    The command of a quiet tick goes into the robot's row of `commands`: linear, angular, lateral.
    """
    found: list = []
    robot: Ticker
    i: cython.Py_ssize_t
    row: cython.Py_ssize_t
    for i in range(len(robots)):
        robot = robots[i]
        actions = robot._tick(now)
        if actions is None:
            row, twist = rows[i], robot.decision.safe
            commands[row, 0], commands[row, 1] = twist.linear, twist.angular
            commands[row, 2] = twist.lateral
        else:
            found.append((i, actions))
    return found


def odometry_many(robots: list, readings: list, now: cython.double) -> None:
    """Hand its reading of odometry to each robot; None in place of a robot that is not there."""
    robot: Ticker
    i: cython.Py_ssize_t
    for i in range(len(robots)):
        robot = robots[i]
        if robot is not None:
            robot._take_odometry(readings[i], now)
