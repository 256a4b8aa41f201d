"""One robot without any I/O: values in, values out, time handed in.

Two shells drive it: the daemon, and the lockstep simulator. Every method is O(1) and waits for
nothing; `wake_at` names the next moment at which `tick` must be called even between two ticks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from swarmd.core.host_messages import HostEvent, Step, TrialDone
from swarmd.core.messages import Epoch, Latch, Reason, Request, State, Status
from swarmd.core.values import Neighbor, Odometry, Platform, Scalar, Scan, Value
from swarmd.protection.arbiter import Protection
from swarmd.protection.decision import Decision
from swarmd.robot.actions import Actions
from swarmd.robot.latches import LatchRecord
from swarmd.robot.lifecycle import HOLD_LASTS, Identity, Lifecycle, Turn
from swarmd.robot.requests import RequestHandler
from swarmd.robot.sensors import Sensors
from swarmd.robot.state_machine import Event as Change
from swarmd.robot.status import Duty, RobotSettings, make_status, standing_reason

TICK = 0.05
STALLED_AFTER = 1.0
STATUS_PERIOD = 1.0


class Robot:
    """StateMachine, protection and the pattern's bookkeeping of one robot.

    `seed` makes every random choice of its patterns repeatable, `instance` names this life of the
    daemon, `now` is in s on a monotonic clock, `latches` are those that an earlier life stored.
    """

    def __init__(
        self,
        id: str,
        platform: Platform,
        settings: RobotSettings,
        *,
        seed: int,
        instance: str,
        now: float,
        latches: LatchRecord | None = None,
    ) -> None:
        self.id = id
        self.platform = platform
        self._settings = settings
        self._born = now
        self._beat = now
        self._sensors = Sensors(platform)
        self._protection = Protection(platform, f"{seed}/{id}")
        identity = Identity(id, platform, seed, instance, settings.touch)
        self._lifecycle = Lifecycle(identity, latches, now)
        self._requests = RequestHandler(id, self._lifecycle, settings.layers, self._standing)
        self._duty = Duty()
        self._published: tuple[object, ...] = ()
        self._published_at = -math.inf
        self._decision = self._decide(None, now)

    # How it stands

    @property
    def is_running(self) -> bool:
        """True in state running."""
        return self._lifecycle.is_running

    @property
    def state(self) -> State:
        """What it is doing."""
        return self._lifecycle.supervisor.state

    @property
    def reason(self) -> Reason | None:
        """The one reason why it stands; None while it moves."""
        return standing_reason(self._lifecycle, self._decision)

    @property
    def decision(self) -> Decision:
        """The last decision of protection."""
        return self._decision

    @property
    def epoch(self) -> Epoch:
        """What an operator must quote to change it."""
        return self._lifecycle.epoch

    @property
    def report(self) -> Mapping[str, Scalar]:
        """What its pattern last reported."""
        return self._lifecycle.report

    # What it senses

    def on_scan(self, scan: Scan, now: float) -> Actions:
        """A sweep arrived, as the sensor gave it."""
        turn = self._enter(now)
        turn.is_new_scan = self._sensors.on_scan(scan, now)
        if turn.is_new_scan and self._sensors.scan is not None:
            self._protection.observe(self._sensors.scan, self._sensors.context(now))
        return self._settle(turn)

    def on_odometry(self, odometry: Odometry, now: float) -> None:
        """A measured pose and twist arrived."""
        self._sensors.on_odometry(odometry, now)

    def on_neighbors(self, neighbors: tuple[Neighbor, ...], now: float) -> None:
        """Who is near: from the body if it knows, else all members."""
        self._sensors.on_neighbors(neighbors, now)

    def on_readings(self, readings: Mapping[str, float]) -> None:
        """Scalar sensors by name."""
        self._sensors.readings = readings

    def on_message(self, sender: str, name: str, value: Value, now: float) -> bool:
        """A pattern said something on `<pattern>/<channel>`; False if its robot is no neighbour.

        What the running pattern does not listen to is dropped in silence.
        """
        running = self._lifecycle.hosting.running
        channel = None if running is None else running.channel(name)
        return channel is None or self._sensors.on_message(sender, channel, value, now)

    def on_driver(self, is_up: bool, text: str, now: float) -> Actions:
        """The base is there, or lost and why."""
        turn = self._enter(now)
        if is_up != self._sensors.is_driver_up:
            self._lifecycle.note(f"driver: {text}", now)
        self._sensors.on_driver(is_up, text)
        return self._settle(turn)

    # What it is told

    def on_host(self, event: HostEvent, now: float) -> Actions:
        """The pattern host answered, failed or died; other generations' answers are dropped."""
        turn = self._enter(now)
        if isinstance(event, TrialDone):
            self._requests.reloading.on_tried(event, turn)
        else:
            self._lifecycle.on_host(event, turn)
        if turn.is_new_run:
            self._sensors.forget_messages()
            self._duty = Duty()
        return self._settle(turn)

    def on_request(self, request: Request, now: float) -> Actions:
        """An operator asks; the reply is in these actions, or in those of a later host event."""
        turn = self._enter(now)
        self._requests.answer(request, turn)
        return self._settle(turn)

    def on_latches(self, latches: Mapping[str, Latch], now: float) -> Actions:
        """A peer is estopped: a swarm-wide latch holds this robot too."""
        turn = self._enter(now)
        self._lifecycle.take_over(latches, turn)
        return self._settle(turn)

    def on_duplicate(self, holder: str | None, now: float) -> Actions:
        """Another instance holds this id; None: it has gone."""
        turn = self._enter(now)
        self._lifecycle.on_duplicate(holder, turn)
        return self._settle(turn)

    def on_leave(self, now: float) -> Actions:
        """The daemon is leaving: zero, from now on."""
        turn = self._enter(now)
        self._lifecycle.end(Change.STOP, Reason.LEAVING, "", turn)
        return self._settle(turn)

    # Time

    def tick(self, now: float) -> Actions:
        """20 times a second, and at `wake_at`: ages, expiries, latches."""
        turn = self._enter(now)
        turn.is_beat = True
        self._beat = now
        if self._lifecycle.is_running:
            self._duty.decisions += 1
            self._duty.active += self._decision.is_active
        return self._settle(turn)

    def wake_at(self, now: float) -> float | None:
        """The next deadline after `now`, for an armed timer; None if there is none."""
        conduct = self._lifecycle
        soonest = conduct.hosting.next_deadline(now)
        if conduct.is_running:
            stale_at = self._sensors.stale_at()
            if stale_at is not None and now < stale_at + 1e-4 < soonest:
                soonest = stale_at + 1e-4
            since = conduct.hold_since
            if since is not None and now < since + HOLD_LASTS < soonest:
                soonest = since + HOLD_LASTS
        return soonest if soonest < math.inf else None

    def status(self, now: float) -> Status:
        """What the robot says of itself at `now`."""
        return make_status(
            self.id,
            self.platform,
            self._settings,
            self._lifecycle,
            self._sensors,
            self._decision,
            self._duty,
            self._born,
            now,
        )

    def _enter(self, now: float) -> Turn:
        """Begin a turn. A loop that stood for over 1 s stops before it reads what waited."""
        turn = Turn(now)
        late = now - self._beat
        if late > STALLED_AFTER:
            self._beat = now
            self._lifecycle.stall(late, turn)
        return turn

    def _settle(self, turn: Turn) -> Actions:
        now, conduct = turn.now, self._lifecycle
        self._requests.reloading.advance(turn)
        hold = conduct.advance(self._sensors.hold(now), turn)
        self._decision = self._decide(hold, now)
        self._restart(turn)
        if turn.host is None and conduct.is_running:
            self._step(turn)
        running = conduct.hosting.running
        return Actions(
            twist=self._decision.safe,
            decision=self._decision,
            requested_scan_seq=-1 if running is None else running.requested.scan_seq,
            is_idle=self._sensors.is_driver_up and conduct.supervisor.state is State.IDLE,
            latches=conduct.latches.record() if turn.is_latched else None,
            trial=turn.trial,
            host=turn.host,
            messages=turn.messages,
            # Acks first: what all peers hear of may wait for the tick, an emergency stop may not.
            status=self._news(now) if turn.is_beat or turn.is_latched else None,
            replies=turn.replies,
        )

    def _decide(self, hold: Reason | None, now: float) -> Decision:
        running = self._lifecycle.hosting.running
        return self._protection.decide(
            None if running is None else running.requested.twist,
            self._sensors.context(now),
            is_running=self._lifecycle.is_running and running is not None,
            hold=hold,
            permit=self._lifecycle.permit,
        )

    def _restart(self, turn: Turn) -> None:
        hosting = self._lifecycle.hosting
        running = hosting.running
        if running is None or hosting.restart_at is None or turn.now < hosting.restart_at:
            return
        if turn.host is None:
            hosting.begin(running.pattern, running.params, None, None, turn.now, running.until)
            layers = self._requests.layers(running.pattern, running.params)
            self._lifecycle.load(running.pattern, layers, turn)

    def _step(self, turn: Turn) -> None:
        hosting = self._lifecycle.hosting
        if hosting.running is None or not hosting.may_step(turn.now, turn.is_new_scan):
            return
        dt = hosting.stepping(turn.now)
        turn.host = Step(hosting.running.generation, self._sensors.inputs(turn.now, dt))

    def _news(self, now: float) -> Status | None:
        """The status, if something that others act on has changed or a second has passed."""
        conduct, supervisor = self._lifecycle, self._lifecycle.supervisor
        reason = standing_reason(conduct, self._decision)
        if reason in (Reason.NO_REQUESTED_COMMAND, Reason.PROTECTION):
            reason = None  # these come and go with every scan
        running, loading = conduct.hosting.running, conduct.hosting.loading
        now_says = (
            supervisor.state,
            reason,
            supervisor.detail,
            conduct.revision,
            None if running is None else running.generation,
            None if running is None else running.values,
            None if loading is None else loading.generation,
            tuple(conduct.latches.held),
            self._sensors.is_driver_up,
        )
        if now_says == self._published and now - self._published_at < STATUS_PERIOD:
            return None
        self._published, self._published_at = now_says, now
        return self.status(now)

    def _standing(self) -> str:
        """How the body stands, for the ack of a stop."""
        odometry = self._sensors.odometry
        if odometry is None:
            return "commanded zero"
        twist = odometry.twist
        linear, angular = round(twist.linear, 2) + 0.0, round(twist.angular, 2) + 0.0  # no -0.00
        return f"commanded zero; measured {linear:.2f} m/s, {angular:.2f} rad/s"
