"""The hot path of one robot: turns inputs and ticks into `Actions`, and checks holds and deadlines.

A kernel (see `core/kernels.py`), compiled into one unit with effects.py, pattern_run.py,
input_ages.py and state_machine.py. A `Ticker` has all that an input can lead to in an instant;
`Robot` extends it by what is asked of a robot, and by the inputs that are rarer than a tick. Times
are in s on the robot's clock. A deadline that is not set is inf.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from swarmd.core import cython_shadow as cython
from swarmd.core.avoided import Avoided, WayState
from swarmd.core.clock import STALL_TIMEOUT
from swarmd.core.cython_shadow import INFINITY, Table, fabs, isnan
from swarmd.core.events import HostInput
from swarmd.core.host_messages import Step, Stepped
from swarmd.core.messages import Reason, State
from swarmd.core.values import ZERO, Twist
from swarmd.robot import timeouts
from swarmd.robot.actions import Actions
from swarmd.robot.effects import Effects
from swarmd.robot.input_ages import InputAges
from swarmd.robot.pattern_run import NOTHING_PERMITTED, ROUNDING, PatternRun, Running, later
from swarmd.robot.protection.decision import NO_PERMIT, Steered
from swarmd.robot.state_machine import StateMachine

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmd.core.events import Input, KinInput, MessageInput, ScanInput, TickInput
    from swarmd.core.host_messages import HostCommand
    from swarmd.core.kin_message import KinMessage
    from swarmd.core.values import Odometry
    from swarmd.robot.goals import Goals
    from swarmd.robot.peer_faults import PeerFaults
    from swarmd.robot.protection.decision import Decision, DecisionContext
    from swarmd.robot.protection.protection import Protection
    from swarmd.robot.requests import RequestHandler
    from swarmd.robot.robot_log import RobotLog
    from swarmd.robot.sensors import Sensors
    from swarmd.robot.standing import StandingWatch
    from swarmd.robot.state import Lifecycle
    from swarmd.robot.status_watch import StatusWatch
    from swarmd.robot.steering_interface import Steers

_MAX_HOLD_TIME = timeouts.MAX_HOLD_TIME
_STATUS_PERIOD = timeouts.STATUS_PERIOD
_STALL_TIMEOUT = STALL_TIMEOUT
# Constants as C variables: Cython looks up a Python global in a dict at each use.
_RUNNING = State.RUNNING
_IDLE = State.IDLE
_Actions = Actions
_HostInput = HostInput
_Step = Step
_Stepped = Stepped
_no_permit = NO_PERMIT
_Steered = Steered
_Twist = Twist
_Avoided = Avoided
_WayState = WayState
_stand = Steered(ZERO)  # asked in place of steering that failed
_STALE_MARGIN = 1e-4  # s after a scan is stale until the alarm


def _check_steered(steered: Any) -> None:
    """Raise TypeError or ValueError unless all that steering gave is of the declared types."""
    if type(steered) is not _Steered or type(steered.is_recovering) is not bool:
        raise TypeError("it gave something else than what it asks (Steered)")
    twist = steered.twist
    avoided = steered.avoided
    if type(twist) is not _Twist:
        raise TypeError("it asks something else than a command (Twist)")
    linear = twist.linear
    angular = twist.angular
    lateral = twist.lateral
    if not (fabs(linear) < INFINITY and fabs(angular) < INFINITY and fabs(lateral) < INFINITY):
        raise ValueError(f"it asks {linear:g}, {angular:g} and {lateral:g} m/s and rad/s")
    if avoided is not None:
        if type(avoided) is not _Avoided or type(avoided.way) is not _WayState:
            raise TypeError("it avoids something else than an object or an opening (Avoided)")
        bearing = avoided.bearing
        distance = avoided.distance
        if not (fabs(bearing) < INFINITY and fabs(distance) < INFINITY):
            raise ValueError(f"it avoids something at {bearing:g} rad and {distance:g} m")


@cython.cclass
class DutyCycle:
    """Counts the ticks in `running` since the last run began, and those with active protection."""

    decisions: int
    active: int

    @property
    def share(self) -> float:
        """The share of ticks with active protection, 0 to 1; 0 before the first tick."""
        return self.active / float(self.decisions) if self.decisions else 0.0


@cython.cclass
class Ticker:
    """Handles the inputs of one robot: each input changes the robot, then becomes `Actions`.

    A quiet tick only decides (computes the safe command), since no deadline has passed. Two
    attributes have the times until which checks can be left out. The first tick after an event
    computes both anew.

    - `_quiet_until`: all ticks before this time are quiet. An event sets this time to -inf.
    - `_due_at`: before this time `Lifecycle.advance` without a hold has nothing to do. An event
      that may change the lifecycle sets this time to -inf.

    Odometry, neighbours, readings and messages change no deadline: these events set neither time.
    """

    decision: Decision
    decided_at: float
    _sensors: Sensors
    _run: PatternRun
    _lifecycle: Lifecycle
    _machine: StateMachine
    _kept_goals: Goals
    _requests: RequestHandler
    _protection: Protection
    _steering: Steers
    _duty: DutyCycle
    _log: RobotLog
    _standing: StandingWatch
    _status_watch: StatusWatch
    _peer_faults: PeerFaults
    _last_tick: float
    _due_at: float
    _quiet_until: float
    _published_at: float
    # The lifecycle may have changed since the last check for a new status.
    _is_status_due: bool
    _blind: str  # the text of the blind sectors that was logged last
    _restarts: int  # the logged count of restarts of the scan delay's estimate
    # The base does not follow its commands.
    _is_off_command: bool
    # By type of input: the function (robot, input, time) that handles this type.
    _handlers: dict[type[Input], Callable[[Any, Any, float], Actions | None]]
    # The hold after the last event; no tick is quiet under a hold.
    _hold: Reason | None
    _settled: Actions  # the actions of the last event that was not a quiet tick

    def __init__(self) -> None:
        self.decided_at = -INFINITY
        self._due_at = -INFINITY
        self._quiet_until = -INFINITY
        self._published_at = -INFINITY
        self._hold = Reason.NO_SCAN
        self._is_status_due = True
        self._blind = ""

    def step(self, input: Input, now: float) -> Actions | None:
        """Handle one input at `now`; returns the work of the shell, None without work."""
        if type(input) is _HostInput and type(input.event) is _Stepped:
            effects = Ticker._begin(self, now)
            self._lifecycle.on_stepped(input.event, effects)
            return self._settled_after(effects)
        return self._handlers[type(input)](self, input, now)

    def _begin(self, now: float) -> Effects:
        """Begin the effects of an event. After a stall of the loop, ends the run first."""
        effects = Effects(now)
        late = now - self._last_tick
        if late > _STALL_TIMEOUT:
            self._last_tick = now
            self._due_at = -INFINITY
            self._lifecycle.stall(late, effects)
        return effects

    def _on_tick(self, one: TickInput, now: float) -> Actions:
        actions = self._tick(now)
        if actions is not None:
            return actions
        decision = self.decision
        twist = decision.safe
        last = self._settled
        requested_scan_seq = last.requested_scan_seq
        is_idle = last.is_idle
        is_stopped = last.is_stopped
        is_quiet = True
        return _Actions(twist, decision, requested_scan_seq, is_idle, is_stopped, is_quiet)

    def _tick(self, now: float) -> Actions | None:
        """Check all deadlines; the shell calls this at 20 Hz, at rest at 10 Hz, and at `wake_at`.

        Returns the actions; None after a quiet tick, which only computes the safe command.
        """
        if now >= self._quiet_until:
            self._look_ahead(now)
        is_quiet = now < self._quiet_until and now - self._last_tick <= _STALL_TIMEOUT
        if now > self._sensors.pose_hold.begins:  # a jump of pose or odometry ends no quiet time
            is_quiet = False
        effects = None if is_quiet else Ticker._begin(self, now)
        self._last_tick = now
        if self._machine.state is _RUNNING:
            duty = self._duty
            duty.decisions += 1
            duty.active += self.decision.is_active
        if effects is None:
            Ticker._decide(self, None, now)
            return None
        effects.is_tick = True
        effects.is_routine = True
        return self._settled_after(effects)

    def _settle(self, effects: Effects) -> Actions:
        return self._settled_after(effects)

    def _settled_after(self, effects: Effects) -> Actions:
        """Check holds and deadlines after an event, decide, and return the actions of the shell.

        A hold is a present reason for which a running robot stands. Cython calls a method in C only
        if the call is written as `Class.method(object)`.
        """
        now = effects.now
        hold = self._checked_hold(effects)
        self._quiet_until = -INFINITY
        self._hold = hold
        decision = Ticker._decide(self, hold, now)
        if self._run.restart_at < INFINITY:
            self._lifecycle.restart_failed(effects)
        host_command = self._host_command(effects)
        # A status is made only at a tick, so that replies to requests do not wait for it. The
        # exception is a new latch, which peers must learn at once.
        may_publish = effects.is_tick or effects.is_latched
        has_status = may_publish and self._must_publish(now)
        actions = self._settled = self._actions(effects, decision, host_command, has_status)
        return actions

    def _checked_hold(self, effects: Effects) -> Reason | None:
        """The present hold, else None. Ends the run for a hazard, and acts on due deadlines."""
        now = effects.now
        sensors = self._sensors
        running = self._run.running
        # How late (s beyond the latency of the platform) scans may be for the running pattern.
        hand = self._run.hand
        is_driven = hand is not None and hand.is_driving
        delay = 0.0 if running is None or is_driven else running.permit.scan_delay
        InputAges.permit_delay(sensors, delay)
        hold = InputAges.hold(sensors, now)
        if (
            sensors.hazard_hold.ends_run
        ):  # a wheel drop or a lift, also under a hold for another reason
            self._lifecycle.on_hazard(sensors.hazards.text(now), effects)
        # Only a routine event has certainly not changed the lifecycle.
        if hold is not None or now >= self._due_at or not effects.is_routine:
            self._requests.advance(effects)
            hold = self._lifecycle.advance(hold, effects, sensors.hold_text(hold, now))
            self._is_status_due = True
            self._due_at = -INFINITY
        return hold

    def _host_command(self, effects: Effects) -> HostCommand | None:
        """The command of this event for the pattern host: the next step if no other is wanted."""
        run = self._run
        now = effects.now
        if effects.host is not None or self._machine.state is not _RUNNING:
            return effects.host
        if run.running is None or not run.may_step(now, effects.is_new_scan):
            return None
        return _Step(
            run.running.generation, InputAges.inputs(self._sensors, now, run.stepping(now))
        )

    def _must_publish(self, now: float) -> bool:
        """True if a status is due, which then counts as published.

        That is if a value that peers act on has changed, or after STATUS_PERIOD.
        """
        if not (self._is_status_due or now >= self._published_at + _STATUS_PERIOD - ROUNDING):
            return False
        self._is_status_due = False  # nothing has changed since this check
        self._watch_standing(now)
        is_recent = now - self._published_at < _STATUS_PERIOD
        if not self._status_watch.take_due(self.decision, is_recent):
            return False
        self._published_at = now
        return True

    def _watch_standing(self, now: float) -> None:
        """Notice a robot that protection keeps in place, and log that it does."""
        sensors = self._sensors
        pose = None if sensors.odometry is None else sensors.odometry.pose
        if self._standing.update(self.decision, pose, sensors.scan, now):
            self._log.held(now)

    def _actions(
        self,
        effects: Effects,
        decision: Decision,
        host_command: HostCommand | None,
        has_status: bool,
    ) -> Actions:
        """The actions after an event.

        Each local has the name of its field, in the order of the fields (a test compares them):
        keywords would take 2.5 us in each event.
        """
        running = self._run.running
        state = self._machine.state
        twist = decision.safe
        requested_scan_seq = -1 if running is None else running.scan_seq
        has_hand = self._run.hand is not None
        is_idle = self._sensors.is_driver_up and state is _IDLE and not has_hand
        is_stopped = state is not _IDLE and state is not _RUNNING and not has_hand
        is_quiet = False
        latches = self._lifecycle.latches.record() if effects.is_latched else None
        goals = self._kept_goals.take_record() if self._kept_goals.is_changed else None
        trial = effects.trial
        host = host_command
        messages = effects.messages
        replies = effects.replies
        failed_code = effects.failed_code
        ended = effects.ended
        grip = effects.grip
        kin_message = effects.kin_message
        return _Actions(
            twist,
            decision,
            requested_scan_seq,
            is_idle,
            is_stopped,
            is_quiet,
            latches,
            goals,
            trial,
            host,
            messages,
            has_status,
            replies,
            failed_code,
            ended,
            grip,
            kin_message,
        )

    def _look_ahead(self, now: float) -> None:
        """Set `_quiet_until` and `_due_at` for a time without events; no quiet ticks in a hold."""
        if self._hold is not None:
            return
        due = self._lifecycle_due_at()
        if self._machine.state is _RUNNING or self._run.hand is not None:
            due = min(due, InputAges.hold_due_at(self._sensors, now))
        self._due_at = due - ROUNDING
        if not self._is_status_due:
            due = min(due, self._run.step_due_at(), self._published_at + _STATUS_PERIOD)
            self._quiet_until = due - ROUNDING

    def _lifecycle_due_at(self) -> float:
        """A time before which `advance` without a hold changes nothing; inf without a deadline."""
        lifecycle = self._lifecycle
        if lifecycle.params_request is not None or lifecycle.trial is not None:
            return -INFINITY
        due = self._run.lifecycle_due_at()
        if self._kept_goals.lease_until is not None and self._kept_goals.lease_ends is not None:
            due = min(due, self._kept_goals.lease_ends)
        return due

    @property
    def is_at_rest(self) -> bool:
        """True if no deadline is pending: no run, load or trial, and no awaited answer.

        False while the base is not connected: another node may drive the base, and a stopped robot
        must then send zero.
        """
        is_due = self._machine.state is _RUNNING or self._lifecycle_due_at() < INFINITY
        return bool(self._sensors.is_driver_up) and not is_due

    def _on_scan(self, one: ScanInput, now: float) -> Actions:
        effects: Effects = Ticker._begin(self, now)
        sensors = self._sensors
        protection = self._protection
        effects.is_routine = True
        effects.is_new_scan = sensors.on_scan(one.scan, now)
        self._look_at_stamps(now)
        blind = sensors.blind_text
        if blind != self._blind:
            self._blind = blind
            self._log.blind_sectors(blind, now)
        if effects.is_new_scan and sensors.scan is not None:
            context = InputAges.context(sensors, now)
            protection.observe(sensors.scan, context)
            self._steering.observe(sensors.scan, context)
            if protection.events:
                self._log.protection(protection.events, now)
            running = self._run.running
            asks = running is not None and running.needs_places
            if asks or sensors.kin is not None:
                effects.kin_message = self._share(context, asks)
        return self._settled_after(effects)

    def _share(self, context: DecisionContext, asks: bool) -> KinMessage | None:
        """Name the tracks after a new scan; the message to peers that is due, or None.

        `asks`: the running pattern needs the places of peers.
        """
        sensors = self._sensors
        steering = self._steering
        now = context.now
        if asks:
            InputAges.ask_kin(sensors, now)
        sensors.end_kin(now)
        kin = sensors.kin
        scan = sensors.scan
        steering.must_track = kin is not None
        if kin is None or scan is None:
            return None
        tracks = steering.tracks(context) or ()
        kin.observe(tracks, scan, now)
        opinions = kin.opinions(sensors.peers.missed_by, now)
        if opinions is not None:
            for fault in self._peer_faults.judge(opinions, now):
                self._log.peers(fault.kind, fault.text, [fault.robot], now)
            self._log.advance(now)
        command = self.decision.safe
        stands = command.linear == 0.0 and command.angular == 0.0 and command.lateral == 0.0
        return kin.next_message(now, asks != 0, stands)

    def _look_at_stamps(self, now: float) -> None:
        """Log that stamps of scan or odometry jumped, and the scan delay is measured anew."""
        restarts = self._sensors.scan_delay.restarts
        if restarts != self._restarts:
            self._restarts = restarts
            self._log.stamps_jumped(now)

    def _take_odometry(self, odometry: Odometry, now: float) -> None:
        sensors = self._sensors
        protection = self._protection
        InputAges.on_odometry(sensors, odometry, now)
        self._look_at_stamps(now)
        if sensors.odometry is odometry:
            protection.on_odometry(odometry)
            self._steering.on_odometry(odometry)
            if protection.events:
                self._log.protection(protection.events, now)
            text = protection.not_following
            is_off_command = bool(text)
            if is_off_command != self._is_off_command:
                self._is_off_command = is_off_command
                if is_off_command or self._machine.state is _RUNNING:
                    self._log.following(text, now)
            blocked_bearing = protection.following.blocked_bearing
            if not isnan(blocked_bearing):
                sensors.on_blocked(blocked_bearing, now)

    def _on_message(self, one: MessageInput, now: float) -> None:
        """Take in a message; ignored on a channel that the running pattern does not declare."""
        running = self._run.running
        channel = None if running is None else Running.channel(running, one.channel)
        if channel is not None:
            self._sensors.on_message(one.sender, channel, one.value, now, one.is_program, one.size)

    def _decide(self, hold: Reason | None, now: float) -> Decision:
        """Decide on the safe command. Protection decides last, on what steering asks."""
        running = self._run.running
        context = InputAges.context(self._sensors, now)
        requested: Twist | None = None
        is_running = False
        permit = _no_permit
        if running is not None:
            requested = running.requested
            is_running = self._machine.state is _RUNNING
            # A hold permits nothing, and a restart of the pattern is a hold.
            permit = running.permit if hold is None else NOTHING_PERMITTED
        hand = self._run.hand
        if hand is not None and hand.is_driving:  # whatever the pattern requests
            requested = hand.twist
            is_running = True
            permit = hand.permit if hold is None else NOTHING_PERMITTED
        try:
            steered = self._steering.steer(requested, context, is_running, hold, permit)
            if steered is not None:
                _check_steered(steered)
        except Exception as error:
            self._log.steering_failed(error, now)
            steered = _stand
        decision = self._protection.decide(requested, context, is_running, hold, permit, steered)
        self.decided_at = now
        self.decision = decision
        return decision

    def wake_at(self, now: float) -> float | None:
        """The next deadline in s for a tick between two regular ticks; None without a deadline.

        Counts the deadlines of the pattern run, the run lease, the scans and the longest hold. All
        other deadlines wait for the next regular tick.
        """
        soonest = self._run.next_deadline(now)
        if self._machine.state is _RUNNING or self._run.hand is not None:
            if self._kept_goals.lease_until is not None:
                lease_ends = self._kept_goals.lease_ends
                if lease_ends is not None:
                    soonest = min(soonest, later(lease_ends, now))
            stale_at = InputAges.stale_at(self._sensors)
            if stale_at is not None:
                soonest = min(soonest, later(stale_at + _STALE_MARGIN, now))
            soonest = min(soonest, later(self._lifecycle.hold_since + _MAX_HOLD_TIME, now))
        return soonest if soonest < INFINITY else None


def tick_many(
    robots: list[Any], rows: list[int], commands: Table, now: float
) -> list[tuple[int, Actions]]:
    """Tick many robots; returns index and actions of each robot whose tick is not quiet.

    A quiet tick only computes the safe command, and writes the command into `commands`: a row of
    linear (m/s), angular (rad/s) and lateral (m/s) for each robot. `rows[i]`: the row of
    `robots[i]`.
    """
    not_quiet: list[Any] = []
    robot: Ticker
    for i in range(len(robots)):
        robot = robots[i]
        actions = robot._tick(now)
        if actions is None:
            row = rows[i]
            twist = robot.decision.safe
            commands[row, 0] = twist.linear
            commands[row, 1] = twist.angular
            commands[row, 2] = twist.lateral
        else:
            not_quiet.append((i, actions))
    return not_quiet


def odometry_many(robots: list[Any], readings: list[Any], now: float) -> None:
    """Hand each reading to the robot at the same index; a robot of None is skipped."""
    robot: Ticker
    for i in range(len(robots)):
        robot = robots[i]
        if robot is not None:
            robot._take_odometry(readings[i], now)


def message_many(robots: list[Any], message: MessageInput, now: float) -> None:
    """Hand a message to each of its receivers; a robot of None is skipped."""
    robot: Ticker
    for robot in robots:
        if robot is not None:
            robot._on_message(message, now)


def kin_many(robots: list[Any], one: KinInput, now: float) -> list[Any]:
    """What names peers, of each receiver of what a robot tells; a robot of None is skipped.

    As `InputAges.on_kin`, but the caller hands the message over.
    """
    asks = one.message.asks
    hearing: list[Any] = []
    robot: Ticker
    for robot in robots:
        if robot is not None:
            if asks:
                InputAges.ask_kin(robot._sensors, now)
            if robot._sensors.kin is not None:
                hearing.append(robot._sensors.kin)
    return hearing
