"""The base of patterns that form a shape. A pattern gives the robot's place in the shape.

This base senses the other robots and drives to the place. With range-and-bearing hardware a robot
measures each neighbour. Without such hardware, narrow objects in the scan count as robots. The
place is kept in the odometry frame. The robot drives slower the nearer the place is, and then rests
until the place is farther away than `tolerance`.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import numpy as np

from swarmd.core.errors import ConfigError
from swarmd.core.values import (
    PLACES_BY_SIGHT,
    ZERO,
    Array,
    Inputs,
    Platform,
    Pose,
    Scalar,
    Scan,
    Twist,
    has_places,
    lacks_text,
)
from swarmd.kit.behavior import Context, MovementPattern
from swarmd.kit.formation_geometry import (
    NeighborTracker,
    robot_centers,
    to_base_frame,
    to_odometry_frame,
)
from swarmd.kit.params import (
    ObjectWidth,
    Params,
    Recovery,
    TopSpeed,
    TopTurn,
    about,
    clear_distance,
    of_threshold,
    threshold,
)
from swarmd.kit.steering import NearPoints, near_points

# Share of `tolerance` within which a moving robot has arrived.
_ARRIVAL_SHARE = 0.4
# s: time constant of the low-pass filter of its place.
_PLACE_TIME_CONSTANT = 0.6
# The lowest share of full speed on the way to its place.
_MIN_SPEED_SHARE = 0.15


class FormationParams(Params, frozen=True, kw_only=True):
    """The parameters of every formation."""

    sensing: Annotated[
        Literal["auto", "neighbors", "lidar"],
        about(
            "how others are sensed: by range and bearing, or as narrow objects in the scan; auto: "
            "by range and bearing from hardware or a shared frame, else by the scan",
            source="ours",
        ),
    ] = "auto"
    speed: TopSpeed
    turn: TopTurn
    spacing: Annotated[
        float,
        about(
            "distance from one robot's axle to the next one's",
            ge=0.05,
            le=100.0,
            unit="m",
            source="ours: 2.2 times the protection threshold, and less than half of what the lidar "
            "reaches, so that it sees two in a row",
            derived=_spacing,
        ),
    ]
    range: Annotated[
        float,
        about(
            "robots farther away are ignored; by lidar at most its range",
            ge=0.05,
            le=1000.0,
            unit="m",
            source="ours: all that are sensed",
        ),
    ] = 100.0
    tolerance: Annotated[
        float,
        about(
            "a resting robot moves once its place is farther away",
            ge=0.03,
            le=10.0,
            unit="m",
            source="ours: 0.07 times the spacing; below the noise no robot comes to rest",
            derived=_tolerance,
        ),
    ]
    clearance: Annotated[
        float,
        about(
            "distance to obstacles, from the axle, that no motion may go below",
            ge=0.05,
            le=20.0,
            unit="m",
            source="as attraction: 1.06 times the protection threshold plus 1.3 times the lidar's "
            "offset",
            derived=clear_distance,
        ),
    ]
    brake: Annotated[
        float,
        about(
            "distance over which the speed falls to zero towards its place and towards obstacles",
            ge=0.02,
            le=20.0,
            unit="m",
            source="as dispersion: 0.6 times the protection threshold",
            derived=of_threshold(0.6),
        ),
    ]
    object_width: ObjectWidth
    recovery: Recovery = False


F = TypeVar("F", bound=FormationParams)


class FormationPattern(MovementPattern[F]):
    """Drives to its place among the robots in sight and stands there; a robot alone stands.

    The sensors in `needs` depend on the parameter `sensing`.
    """

    params_type: ClassVar[type[Params]] = FormationParams
    needs = frozenset({"scan", "odometry"})
    is_symmetric = True

    def __init__(self, params: F, context: Context) -> None:
        check_spacing(params, context.platform)
        super().__init__(params, context)
        self._by_lidar = _is_by_lidar(params, context.platform)
        if not self._by_lidar:
            self.needs = self.needs | PLACES_BY_SIGHT
        self._tracker = NeighborTracker()
        self._seq: int | None = None  # of the scan that was looked at last
        self._points = NearPoints(())
        self._goal: tuple[float, float] | None = None
        self._aimed_at = -math.inf
        self._seen = 0
        self._is_settled = False

    def update(self, params: F) -> None:
        """Apply changed parameters; ConfigError if the platform cannot satisfy them."""
        check_spacing(params, self.context.platform)
        by_lidar = _is_by_lidar(params, self.context.platform)
        if not by_lidar and (lack := lacks_text(PLACES_BY_SIGHT, self.context.platform)):
            raise ConfigError(f"parameter sensing is neighbors, which {lack}")
        self._by_lidar = by_lidar
        self._seq = None
        self._goal = None
        super().update(params)

    def report(self) -> Mapping[str, Scalar]:
        """Its state (alone, form or settled) and the number of others in sight."""
        doing = "settled" if self._is_settled else "form"
        return {"state": doing if self._seen else "alone", "seen": self._seen}

    @abstractmethod
    def place(self, others: Array) -> Array:
        """The place (2,) of this robot among `others` (k, 2), k > 0; m in the base frame."""

    def drive(self, inputs: Inputs) -> Twist:
        """The command towards its place."""
        if inputs.scan is None or inputs.odometry is None:
            return ZERO
        pose = inputs.odometry.pose
        self._update_goal(inputs, inputs.scan, pose)
        if self._goal is None or not pose.is_finite:
            return ZERO
        x, y = to_base_frame(self._goal, pose)
        length = math.hypot(x, y)
        # The place depends on the mean of all robots. Without this robot in the mean, the place
        # would be farther away by this factor.
        off = length * (self._seen + 1) / max(self._seen, 1)
        # Hysteresis: the robot comes to rest nearer to its place than it leaves from.
        limit = self.params.tolerance
        self._is_settled = off <= (limit if self._is_settled else _ARRIVAL_SHARE * limit)
        return ZERO if self._is_settled else self._follow(x, y, length)

    def _update_goal(self, inputs: Inputs, scan: Scan, pose: Pose) -> None:
        """Set the obstacle points of a new scan, the number of robots in sight, and the goal.

        The obstacle points are the near returns of the scan, which the robot keeps clear of. The
        goal is this robot's place in the formation, in m in the odometry frame; None without a
        robot in sight. `pose`: of the base in the odometry frame.
        """
        is_new_scan = scan.seq != self._seq
        if is_new_scan:
            self._seq = scan.seq
            self._set_points(scan)
        if self._by_lidar and not is_new_scan:
            return  # the robots in sight are still those of the last scan
        others = self._others(inputs, scan, pose)
        self._seen = len(others)
        if not len(others):
            self._goal = None
            return
        goal = to_odometry_frame(self.place(others).tolist(), pose)
        if self._goal is not None:  # low-pass filter (first order)
            elapsed_s = max(inputs.now - self._aimed_at, 0.0)
            weight = 1.0 - math.exp(-elapsed_s / _PLACE_TIME_CONSTANT)
            (x, y) = self._goal
            (new_x, new_y) = goal
            goal = x + weight * (new_x - x), y + weight * (new_y - y)
        self._goal = goal
        self._aimed_at = inputs.now

    def _set_points(self, scan: Scan) -> None:
        """Set the obstacle points: the near returns of a scan, which the robot keeps clear of."""
        offset = self.context.platform.scan.offset
        # Ranges are from the lidar, and the base may be nearer to a point by the offset.
        reach = self.params.clearance + self.params.brake + math.hypot(*offset)
        self._points = near_points(scan, within=reach, offset=offset)

    def _others(self, inputs: Inputs, scan: Scan, pose: Pose) -> Array:
        """The other robots (k, 2) in m in the base frame: objects of the scan, or neighbours."""
        params = self.params
        if not self._by_lidar:
            return self._tracker.update(inputs.neighbors, pose, params.range, inputs.now)
        reach = min(params.range, scan.range_max)
        offset = self.context.platform.scan.offset
        return robot_centers(scan, reach=reach, width=params.object_width, offset=offset)

    def _follow(self, x: float, y: float, length: float) -> Twist:
        params = self.params
        points = self._points
        spacing = params.clearance
        brake = params.brake
        share = min(max(length / brake, _MIN_SPEED_SHARE), 1.0)
        x = x / length * share
        y = y / length * share
        x, y = points.keep_clear(x, y, spacing=spacing, brake=brake)
        return points.steer(
            x, y, params.speed, params.turn, spacing=spacing, brake=brake, may_back=True
        )


def check_spacing(params: FormationParams, platform: Platform) -> None:
    """ConfigError if protection or the clearance forbids the spacing."""
    least = _min_spacing(params.clearance, platform)
    if params.spacing <= least:
        whose = "the clearance"
        if _kept_free(platform) > params.clearance:
            whose = f"the distance that the protection of {platform.name} keeps"
        raise ConfigError(
            f"parameter spacing is {params.spacing:g} m; expected more than {least:.3g} m:"
            f" {whose} and half the footprint"
        )


def _spacing(platform: Platform) -> float:
    in_sight = min(2.2 * threshold(platform), 0.45 * platform.scan.range_max)
    return max(in_sight, 1.1 * _min_spacing(clear_distance(platform), platform))


def _tolerance(platform: Platform) -> float:
    return max(0.07 * _spacing(platform), 0.03)


def _min_spacing(clearance: float, platform: Platform) -> float:
    half = 0.5 * float(np.ptp(platform.footprint, axis=0).max())
    return max(_kept_free(platform), clearance) + half


def _kept_free(platform: Platform) -> float:
    """The distance in m from the axle that protection keeps free."""
    return threshold(platform) + math.hypot(*platform.scan.offset)


def _is_by_lidar(params: FormationParams, platform: Platform) -> bool:
    kind: Any = params.sensing
    return kind == "lidar" or (kind == "auto" and not has_places(platform))
