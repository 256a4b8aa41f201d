"""One robot without I/O: `step` takes an input and a time, and returns `Actions`.

Two shells drive a `Robot`: the daemon and the lockstep simulator. Every method is O(1) and never
waits. `wake_at` returns the next deadline; the shell must then tick the robot, even between two
regular ticks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING, Any, get_args

from msgspec.structs import astuple

from swarmd.core import events
from swarmd.core.events import Input
from swarmd.core.goal import GoalRecord, HeldGoal, digest_of
from swarmd.core.host_messages import TrialDone
from swarmd.core.low_battery import READING as BATTERY
from swarmd.core.messages import (
    MAX_TRACKS,
    Epoch,
    Latch,
    Motion,
    Reason,
    ShownDecision,
    ShownPose,
    ShownTrack,
    State,
    Status,
    Tracks,
)
from swarmd.core.values import OPTION_INPUTS, Neighbor, Platform, Scalar, Scan, SharedPose
from swarmd.robot.actions import Actions
from swarmd.robot.goal_handler import GoalHandler
from swarmd.robot.own_pose import POSE_TIMEOUT
from swarmd.robot.pattern_run import PatternRun
from swarmd.robot.peer_faults import PeerFaults
from swarmd.robot.protection.compatibility import Accepts, longest_diagonal
from swarmd.robot.protection.decision import Decision
from swarmd.robot.protection.protection import Protection, ProtectionView
from swarmd.robot.requests import RequestHandler
from swarmd.robot.robot_log import RobotLog
from swarmd.robot.sensors import Sensors
from swarmd.robot.setup import EarlierLives, RobotIdentity, RobotSetup
from swarmd.robot.standing import StandingWatch
from swarmd.robot.state import Lifecycle
from swarmd.robot.state_machine import StateMachine
from swarmd.robot.status import decision_summary, make_status, status_reason
from swarmd.robot.status_watch import StatusWatch
from swarmd.robot.ticker import DutyCycle, Ticker

if TYPE_CHECKING:
    from swarmd.robot.effects import Effects
    from swarmd.robot.steering_interface import MakeKin, MakeSteering


def _settled(
    handle: Callable[[Robot, Any, Effects], object],
) -> Callable[[Robot, Any, float], Actions]:
    """A handler of inputs that acts by `handle`, then checks holds and deadlines and decides."""

    def on_input(robot: Robot, one: Any, now: float) -> Actions:
        effects = robot._begin(now)
        handle(robot, one, effects)
        return robot._settle(effects)

    return on_input


class Robot(Ticker):
    """Lifecycle, sensors, protection and status of one robot.

    `make_steering` makes what may ask for another command than the pattern, `make_kin` what names
    peers (None: nothing). `seed` makes the random
    choices of patterns and steering repeatable. `instance`: the id of
    this daemon process. `now`: s on a monotonic clock. `earlier`: the records on disk of earlier
    daemon processes. `decision`: the last decision of protection, made at `decided_at` (s).
    """

    decision: Decision
    decided_at: float
    _sensors: Sensors
    _lifecycle: Lifecycle
    _machine: StateMachine
    _run: PatternRun
    _requests: RequestHandler

    def __init__(
        self,
        id: str,
        platform: Platform,
        setup: RobotSetup,
        *,
        make_steering: MakeSteering,
        make_kin: MakeKin | None = None,
        seed: int,
        instance: str,
        now: float,
        earlier: EarlierLives = EarlierLives(),  # noqa: B008  # it is frozen
    ) -> None:
        """Make the robot at rest, with the counts, latches and goals of earlier processes."""
        super().__init__()
        self.id = id
        settings = setup.settings
        self.platform = platform
        self._last_tick = now
        self._handlers = HANDLERS
        accepts = Accepts.of(settings.accepts_unseen, settings.accepts_faster)
        self._sensors = Sensors(
            platform,
            accepts,
            tells_pose=setup.tells_pose,
            anchors=settings.anchors(POSE_TIMEOUT),
            make_kin=make_kin,
        )
        self._protection = Protection(platform, settings.layers.values())
        self._steering = make_steering(platform, ProtectionView(self._protection), f"{seed}/{id}")
        identity = RobotIdentity(
            robot=id, platform=platform, setup=setup, seed=seed, instance=instance
        )
        self._lifecycle = Lifecycle(identity, earlier.latches, earlier.goals, now)
        # The counts continue, so that no request or answer to an earlier process seems new.
        self._lifecycle.revision = earlier.revision
        self._lifecycle.pattern_run.generation = earlier.generation
        self._log = RobotLog(self._lifecycle)
        # Parts of the lifecycle as fields, since each tick reads them.
        self._machine = self._lifecycle.state_machine
        self._run = self._lifecycle.pattern_run
        self._kept_goals = self._lifecycle.goals
        self._goals = GoalHandler(self._lifecycle)
        self._requests = RequestHandler(
            id, self._lifecycle, self._goals, self._protection, self._sensors, now
        )
        self._duty = DutyCycle()  # counts the ticks of a run in which protection is active
        self._standing = StandingWatch(platform)
        self._peer_faults = PeerFaults()
        self._status_watch = StatusWatch(self._lifecycle, self._sensors)
        self._decide(None, now)  # the first decision: zero, since no scan has arrived

    # Present state

    @property
    def is_running(self) -> bool:
        """True in state running."""
        return self._lifecycle.is_running

    @property
    def state(self) -> State:
        """The state."""
        state: State = self._machine.state
        return state

    @property
    def reason(self) -> Reason | None:
        """The one reason why the robot does not move; None while the robot moves."""
        machine = self._machine
        is_decided = machine.state is State.RUNNING or self._lifecycle.is_driven
        return self.decision.reason if is_decided else machine.reason

    @property
    def identity(self) -> RobotIdentity:
        """What the robot is made of, in this life of its daemon."""
        return self._lifecycle.identity

    @property
    def epoch(self) -> Epoch:
        """The epoch that a request must quote to change the robot."""
        return self._lifecycle.epoch

    @property
    def generation(self) -> int:
        """The count of pattern loads so far."""
        return int(self._run.generation)

    @property
    def running_generation(self) -> int | None:
        """The generation of the pattern that runs or is being loaded; None without one."""
        run = self._lifecycle.pattern_run
        present = run.loading or run.running
        return None if present is None else present.generation

    @property
    def running_pattern(self) -> str | None:
        """The pattern that runs; None without one."""
        running = self._run.running
        return None if running is None else str(running.pattern)

    @property
    def running_speed(self) -> float | None:
        """The greatest speed of the present run in m/s; None: no bound beside that of the robot."""
        running = self._run.running
        return None if running is None else running.permit.speed

    @property
    def generations(self) -> tuple[int, ...]:
        """The generations of the patterns that run or are being loaded."""
        run = self._run
        return tuple(load.generation for load in (run.running, run.loading) if load is not None)

    @property
    def latches(self) -> Mapping[str, Latch]:
        """The emergency stops that hold the robot, by id, without their ages."""
        return self._lifecycle.latches.held

    def aged_latches(self, now: float) -> dict[str, Latch]:
        """The emergency stops that hold the robot, by id, with their ages at `now` s."""
        return self._lifecycle.latches.aged(now)

    @property
    def cleared(self) -> Collection[str]:
        """The ids of emergency stops that were reset: their late copies do not latch again."""
        return self._lifecycle.latches.cleared

    @property
    def goal(self) -> HeldGoal | None:
        """The greatest goal that the robot has seen."""
        return self._lifecycle.goals.held

    @property
    def wished(self) -> float:
        """When the present load or run was requested, in s; -inf if the robot stands."""
        wish = self._run.wish
        return -math.inf if wish is None else float(wish.at)

    @property
    def reset_at(self) -> float:
        """The time of the last reset in s; -inf without a reset."""
        return self._requests.reset_at

    @property
    def goals(self) -> GoalRecord:
        """The goals and labels as written to disk."""
        return self._lifecycle.goals.record()

    @property
    def labels(self) -> tuple[str, ...]:
        """The labels of the robot."""
        return self._lifecycle.goals.labels

    @property
    def report(self) -> Mapping[str, Scalar]:
        """The last report of the pattern."""
        return self._lifecycle.report

    @property
    def readings(self) -> Mapping[str, float]:
        """The present scalar sensors by name."""
        return self._sensors.readings

    # Inputs from the driver and the network

    @_settled
    def _on_ranges(self, one: events.RangesInput, effects: Effects) -> None:
        effects.is_routine = True
        self._sensors.on_ranges(one.scan, effects.now)

    def _on_peers(self, one: events.PeersInput, now: float) -> None:
        robots: dict[tuple[str, str], list[str]] = {}  # peers with an equal finding share an event
        self._protection.hear(longest_diagonal(one.bodies.values()))
        for finding in self._sensors.on_peers(one.bodies):
            robots.setdefault((finding.kind, finding.text), []).append(finding.robot)
            self._due_at = -math.inf
            self._quiet_until = -math.inf
        for (kind, text), names in robots.items():
            self._log.peers(kind, text, names, now)
        self._log.advance(now)

    def _on_peer_faults(self, one: events.PeerFaultsInput, now: float) -> None:
        for fault in self._peer_faults.take(one.faults, now):
            self._log.peers(fault.kind, fault.text, [fault.robot], now)
        self._log.advance(now)

    def pose_to_tell(self, now: float) -> tuple[SharedPose, float] | None:
        """The own pose to send to peers, and its highest possible age in s; None: send nothing."""
        return self._sensors.peers.pose_to_tell(now)

    def place_neighbors(self, neighbors: tuple[Neighbor, ...], now: float) -> tuple[Neighbor, ...]:
        """The neighbors with the places that poses in a shared frame give; for neighborhoods."""
        sensors = self._sensors
        return sensors.known_places.by_poses(neighbors, sensors.own_pose.last, now)

    def _on_lease(self, one: events.LeaseInput, now: float) -> Actions | None:
        if not self._goals.on_lease(one, now):
            return None
        effects = self._begin(now)
        self._goals.join_if_settled(effects)
        return self._settle(effects)

    def _on_readings(self, one: events.ReadingsInput, now: float) -> Actions | None:
        self._sensors.on_readings(one.readings)
        lifecycle = self._lifecycle
        charge = self._sensors.readings.get(BATTERY)
        settings = lifecycle.identity.setup.settings.on_low_battery
        if settings is None or not lifecycle.battery.take(charge, settings, now):
            return None
        effects = self._begin(now)
        lifecycle.on_battery(settings, effects)
        return self._settle(effects)

    def _on_drive(self, one: events.DriveInput, now: float) -> Actions | None:
        if not self._lifecycle.on_drive(one, now):
            return None
        return self._settle(self._begin(now))

    @_settled
    def _on_hazards(self, one: events.HazardsInput, effects: Effects) -> None:
        holds = self._sensors.hazards
        now = effects.now
        before = holds.present
        self._sensors.on_hazards(one.hazards, now)
        if before != holds.present:
            self._log.hazards([hazard.text for hazard in holds.present], now)

    @_settled
    def _on_driver(self, one: events.DriverInput, effects: Effects) -> None:
        sensors = self._sensors
        now = effects.now
        if (one.is_up, one.hold) != (sensors.is_driver_up, sensors.base_hold.reason):
            self._lifecycle.log(f"driver: {one.text}", now)
        sensors.on_driver(one.is_up, one.text, now, hold=one.hold, gets_zero=one.gets_zero)
        hold = one.hold if one.is_up else Reason.DRIVER_LOST
        self._lifecycle.base_fault = "" if hold is None else f"held: {hold}: {one.text}"
        settings = self._lifecycle.identity.setup.settings.on_low_battery
        if settings is not None and not sensors.is_driver_up:  # the readings have become stale
            self._lifecycle.battery.take(None, settings, now)

    # Pattern host, operators and peers

    @_settled
    def _on_host(self, one: events.HostInput, effects: Effects) -> None:
        if isinstance(one.event, TrialDone):
            self._requests.on_trial_done(one.event, effects)
        else:
            self._lifecycle.on_host(one.event, effects)
        if effects.is_new_run:
            self._sensors.on_new_run(effects.now)
            self._duty = DutyCycle()

    @_settled
    def _on_forget(self, one: events.ForgetInput, effects: Effects) -> None:
        """Drop goals whose issuers are no longer operators; `on_roster` has ended their runs."""
        text = f"forgets {len(one.digests)} goals that no operator of the roster signed"
        self._lifecycle.log(text, effects.now)
        self._lifecycle.goals.forget(lambda goal: digest_of(goal).hex() not in one.digests)

    def _on_provisional(self, one: events.ProvisionalInput, now: float) -> None:
        self._lifecycle.provisional = one.generations

    # Time

    def status(self, now: float) -> Status:
        """The status at `now`."""
        return make_status(
            self._lifecycle,
            self._sensors,
            self.decision,
            self._duty,
            now,
            self._protection,
            self._standing.held_for(now) if self.is_running else None,
            self._peer_faults.at(now),
        )

    def motion(self, now: float) -> Motion | None:
        """Measured pose and commands, for viewers; None before the first odometry."""
        odometry = self._sensors.odometry
        if odometry is None:
            return None
        pose = odometry.pose
        decision = self.decision
        return Motion(
            robot=self.id,
            at=now,
            x=pose.x,
            y=pose.y,
            yaw=math.remainder(pose.yaw, 2.0 * math.pi),
            requested=astuple(decision.requested),
            safe=astuple(decision.safe),
            is_active=decision.is_active,
            gap=decision.min_gap,
            rows=decision.rows[:3],
        )

    def shared_pose(self, now: float) -> ShownPose | None:
        """The own pose in a shared frame, for viewers; None without a fresh pose."""
        pose_and_age = self._sensors.own_pose.shown(now)
        if pose_and_age is None:
            return None
        shared, age = pose_and_age
        return ShownPose(
            robot=self.id,
            at=now,
            age=age,
            x=shared.pose.x,
            y=shared.pose.y,
            yaw=math.remainder(shared.pose.yaw, 2.0 * math.pi),
            error=shared.error,
            yaw_error=shared.yaw_error,
            frame=shared.frame,
        )

    def shown_decision(self, now: float) -> ShownDecision:
        """The last decision of protection, for viewers."""
        return ShownDecision(
            robot=self.id,
            at=now,
            state=self.state,
            reason=status_reason(self._lifecycle, self.decision),
            decision=decision_summary(self.decision, self._duty, self._sensors, now),
        )

    def tracks(self, now: float) -> Tracks | None:
        """The nearest tracked objects, for viewers; None while nothing is tracked."""
        tracks = self._steering.tracks(self._sensors.context(now))
        if tracks is None:
            return None
        near = sorted(tracks, key=lambda track: math.hypot(track.x, track.y))[:MAX_TRACKS]
        kin = self._sensors.kin
        names = {} if kin is None else kin.names(now)
        shown = (ShownTrack(t.x, t.y, t.vx, t.vy, t.radius, names.get(t.id)) for t in near)
        return Tracks(self.id, tuple(shown))

    @property
    def scan(self) -> Scan | None:
        """The latest conditioned scan."""
        return self._sensors.scan


HANDLERS: dict[type[Input], Callable[[Robot, Any, float], Actions | None]] = {
    # Inputs from the driver and the network
    events.ScanInput: Robot._on_scan,
    events.RangesInput: Robot._on_ranges,
    events.OdometryInput: lambda robot, one, now: robot._take_odometry(one.odometry, now),
    events.NeighborsInput: lambda robot, one, now: robot._sensors.on_neighbors(one.neighbors, now),
    events.PoseInput: lambda robot, one, now: robot._sensors.on_pose(one.pose, now),
    events.ReadingsInput: Robot._on_readings,
    **{
        kind: lambda robot, one, now: robot._sensors.on_option_input(one, now)
        for kind in get_args(events.SensorInput)
        if kind.__struct_config__.tag in OPTION_INPUTS
    },
    events.HazardsInput: Robot._on_hazards,
    events.DriverInput: Robot._on_driver,
    events.MessageInput: Robot._on_message,
    events.PeersInput: Robot._on_peers,
    events.KinInput: lambda robot, one, now: robot._sensors.on_kin(one.robot, one.message, now),
    events.PeerFaultsInput: Robot._on_peer_faults,
    events.PlaceInput: lambda robot, one, now: robot._sensors.on_place(one.place, now),
    # Pattern host, operators and peers
    events.LatchesInput: _settled(
        lambda robot, one, effects: robot._lifecycle.adopt_latches(one.latches, effects)
    ),
    events.GoalInput: _settled(
        lambda robot, one, effects: robot._goals.on_goal(
            one.goal, one.age, effects, may_join=one.may_join
        )
    ),
    events.LeaseInput: Robot._on_lease,
    events.DuplicateInput: _settled(
        lambda robot, one, effects: robot._lifecycle.on_duplicate(one.holder, effects)
    ),
    events.HostInput: Robot._on_host,
    # The reply to a request is in these actions or in the actions of a later event.
    events.RequestInput: _settled(
        lambda robot, one, effects: robot._requests.answer(one.request, effects)
    ),
    events.DriveInput: Robot._on_drive,
    events.CodeInput: _settled(lambda robot, one, effects: robot._lifecycle.outdate_host(effects)),
    events.ProvisionalInput: Robot._on_provisional,
    events.ForgetInput: Robot._on_forget,
    events.NetworkInput: _settled(
        lambda robot, one, effects: robot._lifecycle.on_network_changed(one.text, effects)
    ),
    events.RosterInput: _settled(
        lambda robot, one, effects: robot._lifecycle.on_roster(
            one.text, effects, is_revoked=one.is_revoked
        )
    ),
    events.LeaveInput: _settled(
        lambda robot, one, effects: robot._lifecycle.stop(Reason.LEAVING, "", effects)
    ),
    events.NoteInput: lambda robot, one, now: robot._lifecycle.log(one.text, now),
    events.TickInput: Robot._on_tick,
}
