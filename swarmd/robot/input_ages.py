"""The ages of a robot's inputs: the holds that follow from them, and the context of decisions.

A hold is a reason for which a running robot stands, such as a scan that is too old. A kernel (see
`core/kernels.py`), compiled into one unit with ticker.py. `Sensors` extends `InputAges` by the
work that is rarer than a tick. Times are in s on the robot's clock. The time of an input that has
not arrived is -inf.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.core import cython_shadow as cython
from swarmd.core.cython_shadow import INFINITY, floor
from swarmd.core.messages import Reason
from swarmd.core.values import Inputs, Neighbor
from swarmd.robot import timeouts
from swarmd.robot.protection.decision import DecisionContext

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmd.core.kin_message import KinMessage
    from swarmd.core.neighbor_places import NeighborPlaces
    from swarmd.core.values import Detection, Odometry, Scan
    from swarmd.robot.inbox import Inbox
    from swarmd.robot.own_pose import OwnPose
    from swarmd.robot.peers import Peers
    from swarmd.robot.protection.decision import PoseAnchors
    from swarmd.robot.sensing.conditioning import ScanConditioner
    from swarmd.robot.sensing.odometry_history import OdometryHistory
    from swarmd.robot.sensing.scan_delay import ScanDelay
    from swarmd.robot.sensors import RangeRing
    from swarmd.robot.steering_interface import MakeKin, NamesPeers

_ODOMETRY_TIMEOUT = timeouts.ODOMETRY_TIMEOUT
_NEIGHBOR_TIMEOUT = timeouts.NEIGHBOR_TIMEOUT
_KIN_TIMEOUT = timeouts.KIN_TIMEOUT
_AGE_UPDATE_PERIOD = timeouts.AGE_UPDATE_PERIOD
_Context = DecisionContext
_Inputs = Inputs


@cython.cclass
class Hold:
    """A row of the holds: from `begins` until `until` the input of the row forbids motion.

    Both are times in s, which the input sets when it arrives: `begins` of -inf is a hold that is
    present. `reason`: what the robot gives as the cause. `ends_run`: the run ends at once.
    """

    reason: Reason | None
    begins: float
    until: float
    ends_run: bool

    def __init__(self, reason: Reason | None, begins: float = INFINITY) -> None:
        self.reason = reason
        self.begins = begins
        self.until = INFINITY


@cython.cclass
class InputAges:
    """The arrival times of inputs, the holds that follow, and the context of decisions.

    - `holds`: the rows in the order in which `hold` looks at them; the eight names below are rows.
    - `lost_hold`: the driver has no base. `base_hold`: the driver forbids motion itself.
    - `hazard_hold`: until the last hazard is over. `delay_hold`: scans come later than permitted.
    - `scan_hold`, `ring_hold`, `odometry_hold`: an input is too old, or none has come.
    - `peers_hold`, `pose_hold`: the place of a peer, or the pose for layers, is too old.
    - `_teller`: the `Peers` object while the place of any peer is known; such places are obstacles.
    - `_ring`: the `RangeRing` of a robot with such sensors.
    - `own_pose`: the pose of the robot in a shared frame.
    - `_places`: the `NeighborPlaces` of a robot that computes where its neighbours are.
    - `kin`: names the peers of a robot while it or a peer needs their places.
    - `_anchors`: the `PoseAnchors` of a robot whose layers need its pose in a shared frame.

    An object that the robot does not have is None.
    """

    odometry: Odometry | None
    scan: Scan | None
    readings: Mapping[str, float]
    detections: tuple[Detection, ...] | None
    own_pose: OwnPose
    scan_delay: ScanDelay
    is_driver_up: bool
    holds: tuple[Hold, ...]
    lost_hold: Hold
    base_hold: Hold
    hazard_hold: Hold
    delay_hold: Hold
    scan_hold: Hold
    ring_hold: Hold
    odometry_hold: Hold
    peers_hold: Hold
    pose_hold: Hold
    permitted_delay: float
    _scan_at: float
    _odometry_at: float
    _added: float
    _is_late: bool
    _stale_after: float
    _max_delay: float
    _ring: RangeRing | None
    _places: NeighborPlaces | None
    _anchors: PoseAnchors | None
    kin: NamesPeers | None
    _make_kin: MakeKin | None
    _is_partial: bool
    _radius: float
    _middle: float  # see `Kin`
    # s, until which this robot or a peer needs places.
    _kin_until: float
    _teller: Peers | None
    _is_new_scan: bool
    _history: OdometryHistory
    _conditioner: ScanConditioner
    # The last reading that was refused, or whose stamp stands still; None after a good one.
    _bad_odometry: Odometry | None
    inbox: Inbox
    _neighbors: tuple[Neighbor, ...]
    _neighbors_at: float
    # The neighbours with their ages, and how often these ages were computed anew.
    _aged: tuple[Neighbor, ...]
    _renewals: float
    _context: DecisionContext | None
    _context_at: float

    def __init__(self) -> None:
        self._scan_at = -INFINITY
        self._odometry_at = -INFINITY
        self._kin_until = -INFINITY
        self.lost_hold = Hold(Reason.DRIVER_LOST, -INFINITY)
        self.base_hold = Hold(None)  # the driver gives the reason
        self.hazard_hold = Hold(Reason.HAZARD, -INFINITY)
        self.hazard_hold.until = -INFINITY
        self.delay_hold = Hold(Reason.LATE_SCAN)
        self.scan_hold = Hold(Reason.NO_SCAN, -INFINITY)
        self.ring_hold = Hold(Reason.NO_SCAN)
        self.odometry_hold = Hold(Reason.STALE_ODOMETRY)
        self.peers_hold = Hold(Reason.INCOMPATIBLE_PEER)
        self.pose_hold = Hold(Reason.NO_POSE)
        self.holds = (
            self.lost_hold,
            self.base_hold,
            self.hazard_hold,
            self.delay_hold,
            self.scan_hold,
            self.ring_hold,
            self.odometry_hold,
            self.peers_hold,
            self.pose_hold,
        )
        self._neighbors = self._aged = ()

    def on_odometry(self, odometry: Odometry, now: float) -> None:
        """Take in a measured pose and twist. An invalid reading is ignored.

        A reading whose stamp is not newer than the last stamp does not renew the age of odometry.
        """
        is_new = self._history.take(odometry, now)
        self._bad_odometry = None if is_new else odometry
        if is_new is None:
            return
        self._context = None
        self.odometry = odometry
        if self._history.has_shifted:
            self._conditioner.forget_motion()
            if self._ring is not None:
                self._ring.forget_motion()
        if is_new:
            self._odometry_at = now
            if self.odometry_hold.begins < INFINITY:  # the platform provides odometry
                self.odometry_hold.begins = now + _ODOMETRY_TIMEOUT
            if self._anchors is not None:
                self._anchors.on_odometry(odometry)
                self.pose_hold.begins = self._anchors.until
            if self.kin is not None:
                self.kin.on_odometry(odometry, now)

    def on_kin(self, robot: str, message: KinMessage, now: float) -> None:
        """Take in the motion of a peer and what it sees; ignored without a use for it."""
        if message.asks:
            InputAges.ask_kin(self, now)
        if self.kin is not None:
            self.kin.on_message(robot, message, now)

    def ask_kin(self, now: float) -> None:
        """Name peers for some seconds from now on, if the platform can."""
        self._kin_until = now + _KIN_TIMEOUT
        if self.kin is None and self._make_kin is not None:
            resets = round(1000.0 * now) % 2**16
            self.kin = self._make_kin(self._middle, resets, self._is_partial, self._radius)

    def neighbors(self, now: float) -> tuple[Neighbor, ...]:
        """The neighbours; each age is exact to 0.5 s. Empty after 3 s without an update.

        `_places`, and then `kin`, add the places that the base does not measure.
        """
        past = now - self._neighbors_at
        if past > _NEIGHBOR_TIMEOUT:
            return ()
        renewals = floor(past / _AGE_UPDATE_PERIOD)
        if renewals != self._renewals:
            self._renewals = renewals
            past = renewals * _AGE_UPDATE_PERIOD
            self._aged = tuple(
                [
                    Neighbor(n.id, n.age + past, n.distance, n.bearing, n.heading, True, n.error)
                    for n in self._neighbors
                ]
            )
        known = (
            self._aged
            if self._places is None
            else self._places.complete(self._aged, self.own_pose.last, now)
        )
        return known if self.kin is None else self.kin.complete(known, now)

    def inputs(self, now: float, dt: float) -> Inputs:
        """The inputs for one step of the pattern; `dt`: s since the step before.

        Each message, and the mark of a new scan, appears in the inputs of a single step.
        """
        inputs = _Inputs(
            now,
            dt,
            self.scan,
            self._is_new_scan != 0,
            self.odometry,
            InputAges.neighbors(self, now),
            self.inbox.take(now),
            self.readings,
            None if self._ring is None else self._ring.scan,
            self.detections,
            self.own_pose.usable(now),
        )
        self._is_new_scan = False
        return inputs

    def context(self, now: float) -> DecisionContext:
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
                None if self._anchors is None else self._anchors.anchor(now),
            )
        return self._context

    def hold(self, now: float) -> Reason | None:
        """The reason why the inputs forbid motion; None if they permit motion."""
        row: Hold
        for row in self.holds:
            if row.begins < now < row.until:
                return row.reason
        return None

    def hold_due_at(self, now: float) -> float:
        """A time until which `hold` is None if no input arrives; one of the past if it is not."""
        due = INFINITY
        row: Hold
        for row in self.holds:
            if row.begins < due and now < row.until:
                due = row.begins
        return due

    def stale_at(self) -> float | None:
        """The time at which the first of the present scans (lidar and ring) becomes too old.

        None before the first scan.
        """
        if self._scan_at == -INFINITY:
            return None
        stale_at = self.scan_hold.begins
        ring_at = self.ring_hold.begins
        return min(stale_at, ring_at) if ring_at > -INFINITY else stale_at

    def permit_delay(self, seconds: float) -> None:
        """Set how late (s beyond the latency of the platform) scans may be."""
        if seconds != self.permitted_delay:
            self.permitted_delay = seconds
            InputAges.time_scan(self)

    def time_scan(self) -> None:
        """Set when the last scan is stale, and whether it came too late.

        A scan is stale at the platform's limit `stale_after` less the measured delay of scans,
        since the rays of a delayed scan are older than its arrival. If the running pattern permits
        a delay above the platform's bound `max_scan_delay`, only `max_scan_delay` is subtracted.
        """
        delay = self._added
        is_permitted = delay <= self.permitted_delay
        stale_at = self._scan_at + self._stale_after
        self.delay_hold.begins = -INFINITY if self._is_late and not is_permitted else INFINITY
        self.delay_hold.until = stale_at
        if is_permitted and delay > self._max_delay:
            delay = self._max_delay
        self.scan_hold.begins = stale_at - delay
