"""The ages of a robot's inputs: the holds that follow from them, and the context of decisions.

A hold is a reason for which a running robot stands, such as a scan that is too old. A kernel (see
`core/kernels.py`), compiled into one library with ticker.py. `Sensors` extends `InputAges` by the
work that is rarer than a tick. Times are in s on the robot's clock. The time of an input that has
not arrived is -inf.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from swarmd.core.messages import Reason
from swarmd.core.values import Inputs, Neighbor
from swarmd.protection.decision import DecisionContext
from swarmd.robot import timeouts

if TYPE_CHECKING:  # Cython reads this import, CPython the other
    from collections import deque
    from collections.abc import Mapping

    import cython

    from swarmd.core.neighbor_places import NeighborPlaces
    from swarmd.core.values import Detection, Odometry, Pose, Scan
    from swarmd.protection.decision import PoseAnchors
    from swarmd.robot.peers import Peers
    from swarmd.robot.sensors import RangeRing
    from swarmd.sensing.odometry_history import OdometryHistory
    from swarmd.sensing.scan_delay import ScanDelay
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import INFINITY, floor
else:
    from swarmd.core.cython_shadow import INFINITY, floor

_ODOMETRY_TIMEOUT = cython.declare(cython.double, timeouts.ODOMETRY_TIMEOUT)
_NEIGHBOR_TIMEOUT = cython.declare(cython.double, timeouts.NEIGHBOR_TIMEOUT)
_AGE_UPDATE_PERIOD = cython.declare(cython.double, timeouts.AGE_UPDATE_PERIOD)
# A name of C is found at once, one of the module in a dict.
HAZARD = cython.declare(object, Reason.HAZARD)
_Context = cython.declare(object, DecisionContext)
_Inputs = cython.declare(object, Inputs)


@cython.cclass
class InputAges:
    """The arrival times of inputs, the holds that follow, and the context of decisions.

    - `_problem`: why the last scan is not usable; None for a usable scan.
    - `_hazards_until`: a hazard holds the robot until this time.
    - `_peers_due`: after this time the place of a peer is too old, which holds the robot.
    - `_anchor_due`: after this time the pose for layers is too old, which holds the robot.
    - `_teller`: the `Peers` object while the place of any peer is known; such places are obstacles.
    - `_ring`: the `RangeRing` of a robot with such sensors.
    - `_places`: the `NeighborPlaces` of a robot that computes where its neighbours are.
    - `_anchors`: the `PoseAnchors` of a robot whose layers need its pose in a shared frame.

    An object that the robot does not have is None.
    """

    odometry: Odometry | None = cython.declare(object, visibility="public")
    scan: Scan | None = cython.declare(object, visibility="public")
    readings: Mapping[str, float] = cython.declare(object, visibility="public")
    detections: tuple[Detection, ...] | None = cython.declare(object, visibility="public")
    pose: Pose | None = cython.declare(object, visibility="public")
    pose_until = cython.declare(cython.double, visibility="public")
    scan_delay: ScanDelay = cython.declare(object, visibility="public")
    is_driver_up = cython.declare(cython.bint, visibility="public")
    driver_hold: Reason | None = cython.declare(object, visibility="public")
    permitted_delay = cython.declare(cython.double, visibility="public")
    _scan_at = cython.declare(cython.double, visibility="public")
    _odometry_at = cython.declare(cython.double, visibility="public")
    _added = cython.declare(cython.double, visibility="public")
    _is_late = cython.declare(cython.bint, visibility="public")
    _is_clock_set = cython.declare(cython.bint, visibility="public")
    _stale_after = cython.declare(cython.double, visibility="public")
    _max_delay = cython.declare(cython.double, visibility="public")
    _needs_odometry = cython.declare(cython.bint, visibility="public")
    _problem: Reason | None = cython.declare(object, visibility="public")
    _ring: RangeRing | None = cython.declare(object, visibility="public")
    _peers_due = cython.declare(cython.double, visibility="public")
    _places: NeighborPlaces | None = cython.declare(object, visibility="public")
    _anchors: PoseAnchors | None = cython.declare(object, visibility="public")
    _anchor_due = cython.declare(cython.double, visibility="public")
    _teller: Peers | None = cython.declare(object, visibility="public")
    _hazards_until = cython.declare(cython.double, visibility="public")
    _ends_run = cython.declare(cython.bint, visibility="public")
    _is_new_scan = cython.declare(cython.bint, visibility="public")
    _history: OdometryHistory = cython.declare(object, visibility="public")
    _inbox: deque[Any] = cython.declare(object, visibility="public")
    _neighbors: tuple[Neighbor, ...] = cython.declare(tuple, visibility="public")
    _neighbors_at = cython.declare(cython.double, visibility="public")
    # The neighbours with their ages, and how often these ages were computed anew.
    _aged: tuple[Neighbor, ...] = cython.declare(tuple, visibility="public")
    _renewals = cython.declare(cython.double, visibility="public")
    _context: DecisionContext | None = cython.declare(object, visibility="public")
    _context_at: cython.double

    def __init__(self) -> None:
        self._scan_at = self._odometry_at = self._hazards_until = -INFINITY
        self._peers_due = self._anchor_due = INFINITY
        self._neighbors = self._aged = ()

    @cython.ccall
    def on_odometry(self, odometry: Odometry, now: cython.double) -> None:
        """Take in a measured pose and twist. An invalid reading is ignored.

        A reading whose stamp is not newer than the last stamp does not renew the age of odometry.
        """
        is_new = self._history.take(odometry, now)
        if is_new is None:
            return
        self._context, self.odometry = None, odometry
        if is_new:
            self._odometry_at = now
            if self._anchors is not None:
                self._anchors.on_odometry(odometry)
                self._anchor_due = self._anchors.until

    @cython.ccall
    def neighbors(self, now: cython.double) -> tuple[Neighbor, ...]:
        """The neighbours; each age is exact to 0.5 s. Empty after 3 s without an update.

        `_places` adds the places that the base does not measure.
        """
        past: cython.double = now - self._neighbors_at
        if past > _NEIGHBOR_TIMEOUT:
            return ()
        renewals: cython.double = floor(past / _AGE_UPDATE_PERIOD)
        if renewals != self._renewals:
            self._renewals, past = renewals, renewals * _AGE_UPDATE_PERIOD
            self._aged = tuple(
                [
                    Neighbor(n.id, n.age + past, n.distance, n.bearing, n.heading, True, n.error)
                    for n in self._neighbors
                ]
            )
        return self._aged if self._places is None else self._places.complete(self._aged, now)

    @cython.ccall
    def inputs(self, now: cython.double, dt: cython.double) -> Inputs:
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
            self._take_messages(now) if self._inbox else (),  # type: ignore[attr-defined]  # of Sensors
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
                None if self._anchors is None else self._anchors.anchor(now),
            )
        return self._context

    @cython.ccall
    def hold(self, now: cython.double) -> Reason | None:
        """The reason why the inputs forbid motion; None if they permit motion."""
        if not self.is_driver_up:
            return Reason.DRIVER_LOST
        if self.driver_hold is not None:
            return self.driver_hold
        if now < self._hazards_until:
            return HAZARD
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
        if now > self._peers_due:
            return Reason.INCOMPATIBLE_PEER
        return Reason.NO_POSE if now > self._anchor_due else None

    @cython.ccall
    def hold_due_at(self) -> float:
        """A time until which `hold` stays None, if `hold` is None now and no input arrives."""
        due: cython.double = min(self._peers_due, self._anchor_due)
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
        """The time at which the first of the present scans (lidar and ring) becomes too old.

        None before the first scan.
        """
        if self._scan_at == -INFINITY:
            return None
        stale_at = self._scan_at + self._longest_age()
        ring_at = None if self._ring is None else self._ring.stale_at
        return stale_at if ring_at is None else min(stale_at, ring_at)

    @cython.cfunc
    @cython.exceptval(check=False)
    def _longest_age(self) -> cython.double:
        """The age in s since arrival beyond which a scan is stale.

        This age is the platform's limit `stale_after` less the measured delay of scans, since the
        rays of a delayed scan are older than its arrival. If the running pattern permits a delay
        above the platform's bound `max_scan_delay`, only `max_scan_delay` is subtracted.
        """
        delay: cython.double = self._added
        is_permitted: cython.bint = delay <= self.permitted_delay
        if is_permitted and delay > self._max_delay:
            delay = self._max_delay
        return self._stale_after - delay
