"""The latest inputs of one robot: scans, odometry, neighbours, readings, messages and hazards.

Each input sets when its hold begins: a row of `InputAges.holds` (input_ages.py). The limit of a
scan is the platform's `scan.stale_after`, less the measured delay. `hazard_holds.py` has the holds
of hazards.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import astuple

from swarmd.core.angles import TURN
from swarmd.core.events import DetectionsInput, SensorInput, tag_of
from swarmd.core.hazard import Hazard
from swarmd.core.messages import Body, PeerFinding, Reason
from swarmd.core.neighbor_places import NeighborPlaces
from swarmd.core.values import (
    KIN,
    OPTION_INPUTS,
    PLACES_BY_POSE,
    Neighbor,
    Odometry,
    PeerPlace,
    Platform,
    Scan,
    ScanSpec,
    SharedPose,
    Value,
)
from swarmd.robot.hazard_holds import HazardHolds
from swarmd.robot.inbox import Inbox
from swarmd.robot.input_ages import InputAges
from swarmd.robot.own_pose import OwnPose
from swarmd.robot.peers import Peers
from swarmd.robot.protection.compatibility import (
    ACCEPTS_NONE,
    Accepts,
    barrier_settings,
    fastest_corner,
)
from swarmd.robot.protection.decision import PoseAnchors, ToldObstacle
from swarmd.robot.protection.footprint import Footprint
from swarmd.robot.sensing.conditioning import ScanConditioner
from swarmd.robot.sensing.deskew import Deskewer
from swarmd.robot.sensing.odometry_history import OdometryHistory
from swarmd.robot.sensing.rays import unit_vectors
from swarmd.robot.sensing.scan_delay import ScanDelay
from swarmd.robot.steering_interface import MakeKin
from swarmd.robot.timeouts import NEIGHBOR_TIMEOUT, ODOMETRY_TIMEOUT

if TYPE_CHECKING:
    from swarmd.robot.input_ages import Hold

SCAN_TIMES = 12  # scans over which the scan rate is measured

_WIDEST_GAP = math.radians(20.0)
"""rad between neighbouring rays, behind which a robot that moves is hidden at some looks alone."""
_LEAST_RANGE = 2.0
"""m, with which a lidar shows a robot within 1.8 m, up to which kin looks."""


class Sensors(InputAges):
    """Scans, odometry, neighbours, readings, messages and state of the driver, with their ages.

    All times are in s on the robot's monotonic clock and come with each call.
    """

    scan_delay: ScanDelay
    _deskewer: Deskewer
    scan: Scan | None
    odometry: Odometry | None
    readings: Mapping[str, float]

    def __init__(
        self,
        platform: Platform,
        accepts: Accepts = ACCEPTS_NONE,
        *,
        tells_pose: bool = False,
        anchors: PoseAnchors | None = None,
        make_kin: MakeKin | None = None,
    ) -> None:
        """Begin without any input; the parts follow from the sensors of `platform`.

        `accepts`, `anchors`: of the `RobotSettings`. `tells_pose`: see `RobotSetup`.
        `make_kin`: None names no peers.
        """
        super().__init__()
        self._begin_lidar(platform)
        ring = platform.ranges
        self._ring = None if ring is None else RangeRing(platform, ring, self.ring_hold)
        self._given: tuple[Neighbor, ...] = ()  # neighbours as the driver sent them
        self._neighbor_ids: frozenset[str] | None = None  # None until the next message needs it
        self.own_pose = OwnPose(platform.limits)
        self.peers = Peers(platform, accepts, self.own_pose, tells_pose=tells_pose)
        self.known_places = NeighborPlaces()
        self._places = self.known_places if PLACES_BY_POSE & platform.provides else None
        self._make_kin = make_kin if KIN in platform.provides else None
        self._is_partial = self._make_kin is not None and _is_partial(platform.scan)
        # m from the axle ahead to the middle of what other lidars see.
        self._middle = 0.5 * float(platform.footprint[:, 0].min() + platform.footprint[:, 0].max())
        self._radius = self.peers.own.radius
        self._anchors = anchors
        if anchors is not None:  # else this hold never begins
            self.pose_hold.begins = anchors.until
        # Messages of other robots' patterns, kept until the next step of the own pattern.
        self.inbox = Inbox()
        self.rejected = 0  # messages whose sender is no neighbour
        self._begin_driver_reports()

    def _begin_lidar(self, platform: Platform) -> None:
        """Make the parts that check a scan, measure its delay, and correct it by odometry."""
        self._stale_after = platform.scan.stale_after
        self._max_delay = platform.scan.max_scan_delay
        if "odometry" in platform.provides:
            self.odometry_hold.begins = -math.inf
        # The protection mode `barrier` remembers obstacles that vanish in the blind zone of the
        # lidar, and does so more precisely than the conditioner.
        guesses_near = platform.protection.get("mode") != "barrier"
        self._conditioner = ScanConditioner(platform.scan, guesses_near=guesses_near)
        self.scan_delay = ScanDelay(platform.scan)
        self._history = OdometryHistory(self.scan_delay)
        self._deskewer = Deskewer(platform.scan, self._history)
        # The arrival times of scans, for the scan rate.
        self._scan_times: deque[float] = deque(maxlen=SCAN_TIMES)

    def _begin_driver_reports(self) -> None:
        """Set hazards, readings and driver state to the values before any report."""
        self.hazards = HazardHolds()
        self.readings = {}  # scalar sensors, by name
        self._forget_option_inputs()  # sets detections and other optional inputs to None
        self.stale_readings: tuple[str, ...] = ()  # names of readings that are too old
        self.driver_text = "not connected yet"
        self.gets_zero = False  # True: the driver still sends zero to a base that counts as lost

    def on_scan(self, scan: Scan, now: float) -> bool:
        """Take in a scan of the driver; True if the scan is new and valid."""
        odometry = self._fresh_odometry(now)
        conditioned = self._conditioner.take(scan, odometry, now)
        self._context = None
        if isinstance(conditioned, Reason):
            self.scan_hold.reason = conditioned
            return False
        self.scan_delay.on_scan(scan, now)
        self._added = self.scan_delay.added
        self._is_late = self.scan_delay.is_late
        is_clock_set = self._is_late and self.scan_delay.is_clock_set
        self.delay_hold.reason = Reason.CLOCK_SET if is_clock_set else Reason.LATE_SCAN
        self._scan_at = self._conditioner.known_at
        is_whole = self._scan_at == now
        self.scan_hold.reason = Reason.STALE_SCAN if is_whole else Reason.INVALID_SCAN
        self.time_scan()
        self._scan_times.append(now)
        self._is_new_scan = True
        odometry_age = None if odometry is None else self.odometry_age(now)
        self.scan = self._deskewer.deskew(conditioned, now, odometry_age, self.scan_delay.added)
        return True

    def on_ranges(self, scan: Scan, now: float) -> None:
        """Take in a scan of the platform's ring of range sensors; ignored without a ring."""
        self._context = None
        if self._ring is not None:
            self._ring.on_scan(scan, self._fresh_odometry(now), now)

    def _fresh_odometry(self, now: float) -> Odometry | None:
        return self.odometry if now - self._odometry_at <= ODOMETRY_TIMEOUT else None

    @property
    def blind_text(self) -> str:
        """The blind sectors of the lidar as text; empty without a blind sector."""
        return self._conditioner.blind_text

    def on_blocked(self, bearing: float, now: float) -> None:
        """Doubt rays without a return in a direction (rad) into which the base does not move."""
        self._conditioner.on_blocked(bearing, now)

    def on_new_run(self, now: float) -> None:
        """Drop what belongs to the run before: messages, and doubts about blocked directions."""
        self.inbox.clear()
        self._conditioner.on_new_run(now)

    def on_neighbors(self, neighbors: tuple[Neighbor, ...], now: float) -> None:
        """Take in all robots that are sensed or heard; the robots in reach are the neighbours."""
        if neighbors is not self._given:
            self._given = neighbors
            if not all(neighbor.in_reach for neighbor in neighbors):
                neighbors = tuple(neighbor for neighbor in neighbors if neighbor.in_reach)
            self._neighbors = neighbors
            self._neighbor_ids = None
        self._neighbors_at = now
        self._aged = self._neighbors
        self._renewals = 0.0
        if self.peers.on_neighbors(self._given, now):
            self._look_at_peers()

    def on_pose(self, pose: SharedPose, now: float) -> None:
        """Take in the own pose in a shared frame."""
        odometry = self._fresh_odometry(now)
        own = self.own_pose.take(pose, None if odometry is None else odometry.twist, now)
        if own is not None and self._anchors is not None:
            self._anchors.on_pose(pose, own.at, self.own_pose.errors, self._odometry_at)
            self._context = None
            self.pose_hold.begins = self._anchors.until

    def pose_text(self, now: float) -> str:
        """Why layers have no usable pose; empty with a pose, and without a layer that needs one."""
        return "" if self._anchors is None else self._anchors.text(now)

    def on_place(self, place: PeerPlace, now: float) -> None:
        """Take in the place that a peer reports in a shared frame."""
        self.known_places.on_place(place, now)
        if self.peers.on_place(place, now):
            self._look_at_peers()

    def end_kin(self, now: float) -> None:
        """Name peers no more if no robot has asked for it."""
        if now > self._kin_until:
            self.kin = None

    def on_peers(self, bodies: Mapping[str, Body | None]) -> list[PeerFinding]:
        """Take in the bodies that all known peers report; returns the new findings."""
        new_findings = self.peers.on_peers(bodies)
        self._look_at_peers()
        return new_findings

    def _look_at_peers(self) -> None:
        """Set the hold deadline and the source of places from the present peers."""
        self._context = None
        self.peers_hold.begins = self.peers.hold_due_at()
        self._teller = self.peers if self.peers.has_places else None

    def on_hazards(self, hazards: tuple[Hazard, ...], now: float) -> None:
        """Take in all present hazards of the base."""
        self.hazards.take(hazards, now)
        self.hazard_hold.until = self.hazards.until
        self.hazard_hold.ends_run = self.hazards.ends_run

    def hold_text(self, hold: Reason | None, now: float) -> str:
        """The detail of a hold: hazards, blind sectors, odometry, or the pose for layers."""
        if hold is Reason.HAZARD:
            return self.hazards.text(now)
        if hold is Reason.INVALID_SCAN:
            return self.blind_text
        if hold is Reason.STALE_ODOMETRY:
            return self.odometry_text
        return self.pose_text(now) if hold is Reason.NO_POSE else ""

    @property
    def odometry_text(self) -> str:
        """Why readings of odometry do not count, with the value; empty if none comes."""
        bad = self._bad_odometry
        if bad is None:
            return ""
        return f"refused: {bad.fault}" if bad.fault else f"its stamp stands at {bad.stamp:.12g} s"

    def on_message(
        self,
        sender: str,
        channel: str,
        value: Value,
        now: float,
        is_program: bool = False,
        size: int = 0,
    ) -> bool:
        """Keep a message from `sender` for the next step of the own pattern.

        False (rejected) if the sender is neither a neighbour nor a program (`is_program`). `size`:
        see `Inbox.add`.
        """
        if self._neighbor_ids is None:
            self._neighbor_ids = frozenset(neighbor.id for neighbor in self._neighbors)
        is_neighbor = sender in self._neighbor_ids and now - self._neighbors_at <= NEIGHBOR_TIMEOUT
        if not (is_neighbor or is_program):
            self.rejected += 1
            return False
        self.inbox.add(sender, channel, value, now, size)
        return True

    def on_readings(self, values: Mapping[str, float]) -> None:
        """Replace all readings (values of scalar sensors by name).

        A value of NaN or inf means that the sensor exists and has no fresh value.
        """
        self.readings = {name: v for name, v in values.items() if math.isfinite(v)}
        self.stale_readings = tuple(sorted(values.keys() - self.readings.keys()))

    def on_option_input(self, input: SensorInput, now: float) -> None:
        """Keep an input of OPTION_INPUTS, which is handed to patterns unchanged."""
        (value,) = astuple(input)
        setattr(self, tag_of(input), value)
        if isinstance(input, DetectionsInput):
            self.known_places.on_detections(input.detections, now)

    def _forget_option_inputs(self) -> None:
        for name in OPTION_INPUTS:
            setattr(self, name, None)

    def on_driver(
        self,
        is_up: bool,
        text: str,
        now: float,
        *,
        hold: Reason | None = None,
        gets_zero: bool = False,
    ) -> None:
        """Take in the connection state of the driver: `is_up`, or in `text` why the base is lost.

        `hold`: why the robot must not move although its base is connected. `gets_zero`: the zero
        command of a stopped robot reaches the base even while the base counts as lost.

        Without a connection all readings become stale, and detections and other optional inputs
        None. While the driver forbids motion, scans or odometry come from two sources.
        """
        if (hold is None) != (self.base_hold.reason is None):
            self._conditioner.on_conflict(hold is not None, now)
        if not is_up:
            self._forget_option_inputs()
            self.on_readings(dict.fromkeys((*self.readings, *self.stale_readings), math.nan))
        self.is_driver_up = is_up
        self.lost_hold.begins = math.inf if is_up else -math.inf
        self.driver_text = text
        self.base_hold.reason = hold
        self.base_hold.begins = math.inf if hold is None else -math.inf
        self.gets_zero = gets_zero

    def scan_age(self, now: float) -> float | None:
        """The age of the last valid scan in s; None before the first scan.

        The age counts from the arrival of the scan. If a wide sector of the scan has no valid rays,
        earlier scans fill this sector, and the age counts from the last scan that measured it.
        """
        return None if self._scan_at == -math.inf else now - self._scan_at

    def odometry_age(self, now: float) -> float | None:
        """The time in s since the last new odometry arrived; None before the first."""
        return None if self._odometry_at == -math.inf else now - self._odometry_at

    def scan_rate(self, now: float) -> float:
        """Valid scans per second over the last 12 scans; 0 after the scans have stopped."""
        times = self._scan_times
        if len(times) < 2 or now - times[-1] > 2.0 * self._stale_after:
            return 0.0
        return (len(times) - 1) / max(times[-1] - times[0], 1e-4)


def _is_partial(spec: ScanSpec) -> bool:
    """True if a lidar leaves out a sector in which a robot may be for long, or is short."""
    bearings = np.sort(spec.bearings[~spec.masked(spec.bearings)] % TURN)
    gaps = np.diff(bearings, append=bearings[:1] + TURN)
    return bool(np.max(gaps, initial=0.0) > _WIDEST_GAP) or spec.range_max < _LEAST_RANGE


class RangeRing:
    """The ring of range sensors of a robot (section `ranges` of a platform).

    The ring measures what the lidar cannot see, so its scans are conditioned apart from the lidar,
    and a ring without fresh values holds the robot. `scan`: the last conditioned scan; None before
    the first scan. Times are in s on the robot's clock.
    """

    def __init__(self, platform: Platform, spec: ScanSpec, hold: Hold) -> None:
        """No scan yet. `hold`: the row of the ring, which its scans set."""
        self._spec = spec
        self._outline = Footprint(platform.footprint)
        self._conditioner = ScanConditioner(spec)
        barrier = barrier_settings(platform)
        self._extent = 0.0 if barrier is None else barrier.unseen_extent
        self._speed = fastest_corner(platform)
        self._known_at: float | None = None
        self._hold = hold
        hold.begins = -math.inf
        self._places: list[tuple[float, float]] = []  # x, y of each return in m, base frame
        self._radius = 0.0
        self.scan: Scan | None = None

    def on_scan(self, scan: Scan, odometry: Odometry | None, now: float) -> None:
        """Take in a scan of the ring; an invalid scan does not count."""
        conditioned = self._conditioner.take(scan, odometry, now)
        if isinstance(conditioned, Reason):
            self._hold.reason = conditioned
            return
        self._known_at = known_at = self._conditioner.known_at
        self._hold.reason = Reason.STALE_SCAN if known_at == now else Reason.INVALID_SCAN
        self._hold.begins = known_at + self._spec.stale_after
        # Remembered values belong to an earlier pose: enlarge the discs by the motion since then.
        self._radius = self._extent + (now - known_at) * self._speed
        self.scan = conditioned
        directions = unit_vectors(conditioned.bearings)
        outline = self._outline.along_rays(self._spec.offset, directions)
        # A return within the outline, or too close to measure, lies on the outline.
        distances = np.maximum(np.maximum(conditioned.ranges, conditioned.range_min), outline)
        is_seen = distances < np.inf
        points = self._spec.offset + distances[is_seen, None] * directions[is_seen]
        self._places = [(x, y) for x, y in points.tolist()]

    def forget_motion(self) -> None:
        """Forget what is compared by the motion of the robot, as when odometry was reset."""
        self._conditioner.forget_motion()

    def obstacles(self, now: float) -> tuple[ToldObstacle, ...]:
        """The returns of the ring as discs, each with the age of the oldest value, for protection.

        The radius includes the barrier's `unseen_extent`: how far an obstacle may extend beside the
        measured point. The sensors of a ring measure one after another during one period (1 /
        `rate`). The oldest value is half a period older than `latency`, the mean age at arrival.
        """
        if self._known_at is None:
            return ()
        age = now - self._known_at + self._spec.latency
        age += 0.5 / self._spec.rate
        return tuple(ToldObstacle(x, y, self._radius, age) for x, y in self._places)
