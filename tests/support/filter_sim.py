"""Closed-loop simulation of one robot under protection among moving shapes, with real delays.

Scans arrive late, commands take effect late, and the robot brakes no better than protection
assumes. All geometry is exact and implemented here: it judges protection, so it shares no code
with it. One robot, no physics, no pattern; the lockstep simulation covers whole swarms.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from swarmd.core.values import (
    ZERO,
    Array,
    Odometry,
    Platform,
    Pose,
    Scan,
    ScanSpec,
    TouchZone,
    Twist,
)
from swarmd.robot.protection.decision import (
    NO_PERMIT,
    Decision,
    DecisionContext,
    ModeDecision,
    Permit,
    ToldObstacle,
)
from swarmd.robot.sensors import Sensors
from swarmd.testing.scans import trembling
from tests.support.kernel_forms import both_forms
from tests.support.protection import Commander, Protection

DT = 0.01
TICK = 0.05
HERE = Pose()
FORMS = both_forms("swarmd.robot.protection.barrier")
RequestedCommand = Twist | Callable[[float], Twist]


def under_barrier(platform: Platform, **changes: object) -> Platform:
    """The platform in mode `barrier`, with some settings of that mode replaced."""
    protection = platform.protection
    settings = {**protection["barrier"], **changes}
    return replace(platform, protection={**protection, "mode": "barrier", "barrier": settings})


def decided(
    platform: Platform,
    scan: Scan,
    requested: Twist,
    *,
    age: float = 0.0,
    delay: float = 0.0,
    touch: TouchZone | None = None,
    told: tuple[ToldObstacle, ...] = (),
    longest_peer: float = 0.0,
) -> Decision:
    """The decision of new protection for a robot at rest, `age` s after its first scan.

    `delay` s: by how much more than the platform's latency the scan is late. `longest_peer` m: the
    longest diagonal of the peers heard; 0: none. Mode `barrier` decides compiled and interpreted,
    and alike.
    """
    protections, begin = [Protection(platform)], 10.0
    if platform.protection["mode"] == "barrier" and FORMS[0] is not FORMS[1]:
        protections.append(Protection(platform))
        protections[1]._mode = FORMS[0].Barrier(platform)
    first = Odometry(begin, HERE, ZERO)
    later = Odometry(begin + age, HERE, ZERO)
    decisions: list[Decision] = []
    for protection in protections:
        protection.hear(longest_peer)
        protection.observe(scan, DecisionContext(begin, 0.0, first, 0.0, delay))
        context = DecisionContext(begin + age, age, later, 0.0, delay, told)
        decisions.append(
            protection.decide(
                requested, context, is_running=True, hold=None, permit=Permit(touch=touch)
            )
        )
    if len(decisions) > 1:
        assert_alike(*decisions)
    return decisions[0]


def assert_alike(one: Decision | ModeDecision, other: Decision | ModeDecision) -> None:
    """Commands, activity and reported constraints agree to within rounding."""
    assert one.is_active == other.is_active
    assert _numbers(one) == pytest.approx(_numbers(other), abs=1e-12, rel=0.0, nan_ok=True)


def _numbers(decision: Decision | ModeDecision) -> list[float]:
    twist = decision.safe if isinstance(decision, Decision) else decision.twist
    rows = [number for row in decision.rows for number in (row.bearing, row.gap, row.cap)]
    return [twist.linear, twist.angular, twist.lateral, *rows]


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A convex obstacle: `corners` (k, 2) counter-clockwise in its own frame in m, and its motion.

    It is at `pose` at time 0 and moves with `velocity` (x, y) in m/s from `begin` to `end` s.
    `seen` (j, 2): its outline in the scan plane, if different.
    """

    corners: Array
    pose: Pose = HERE
    velocity: tuple[float, float] = (0.0, 0.0)
    begin: float = 0.0
    end: float = math.inf
    seen: Array | None = None

    def at(self, time: float) -> Pose:
        """Where it is."""
        t = min(max(time, self.begin), self.end) - self.begin
        (vx, vy), pose = self.velocity, self.pose
        return Pose(pose.x + vx * t, pose.y + vy * t, pose.yaw)


def box(length: float, width: float, pose: Pose = HERE, **motion: object) -> Shape:
    """A rectangle, `length` along its own x and `width` along its y; `motion` as in Shape."""
    x, y = 0.5 * length, 0.5 * width
    corners = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    return Shape(corners, pose, **motion)  # type: ignore[arg-type]  # Shape's own keywords


def pole(radius: float, pose: Pose = HERE, **motion: object) -> Shape:
    """A round obstacle, as a polygon of 24 corners around the circle; `motion` as in Shape."""
    return Shape(round_corners(radius), pose, **motion)  # type: ignore[arg-type]  # as above


def round_corners(radius: float, sides: int = 24) -> Array:
    """(sides, 2) corners of the regular polygon around a circle at the origin."""
    angles = np.arange(sides) * (2.0 * math.pi / sides)
    outer = radius / math.cos(math.pi / sides)
    return outer * np.stack((np.cos(angles), np.sin(angles)), axis=1)


@dataclass(frozen=True, slots=True)
class Touch:
    """The robot touched shape `index` at `time`; `speed` in m/s of its own surface towards it."""

    time: float
    index: int
    speed: float


@dataclass(slots=True, eq=False)
class FilterRun:
    """The course of a run, every `DT`: times, poses, measured twists, smallest gaps in m.

    `decisions` come with their times. A run ends at the first touch.
    """

    times: list[float] = field(default_factory=list)
    poses: list[Pose] = field(default_factory=list)
    twists: list[Twist] = field(default_factory=list)
    gaps: list[float] = field(default_factory=list)
    decisions: list[tuple[float, Decision]] = field(default_factory=list)
    touch: Touch | None = None

    @property
    def min_gap(self) -> float:
        """The smallest distance in m between outlines; 0 once they touched."""
        return 0.0 if self.touch is not None else min(self.gaps)


class FilterSim:
    """One robot of a platform among shapes.

    `phase`: time of the first scan; `delay`: from command to base; both in s. `braking`: m/s2 and
    rad/s2 (None: as protection assumes). `noise`: the standard deviation of ranges in m. `late`: s
    by which each scan comes later than declared, by its number. `rolling`: each ray is measured at
    its own time, by the platform's sweep. A test may set `has_lidar` and `has_odometry` to false at
    any time, and `pushed` to the m/s (x, y) by which something pushes the robot.
    """

    def __init__(
        self,
        platform: Platform,
        shapes: Sequence[Shape] = (),
        *,
        phase: float = 0.0,
        delay: float = 0.03,
        braking: tuple[float, float] | None = None,
        noise: float = 0.0,
        seed: int = 0,
        late: Callable[[int], float] = lambda seq: 0.0,
        rolling: bool = False,
    ) -> None:
        self._late = late
        self._due = _steps_of_rays(platform.scan) if rolling else np.zeros(1, np.intp)
        self._begun, self._rolled = -1, np.empty(0)  # the sweep in progress
        self.platform, self.shapes = platform, tuple(shapes)
        self.pose, self.twist, self.time = HERE, ZERO, 0.0
        self.has_lidar = self.has_odometry = True
        self.pushed = 0.0, 0.0
        self.commander, self.sensors = Commander(platform), Sensors(platform)
        self.protection = self.commander.protection
        self.sensors.on_driver(True, "a simulation", self.time)
        settings = platform.protection["barrier"] or {"braking_linear": 1.0, "braking_angular": 3.0}
        self._braking = braking or (settings["braking_linear"], settings["braking_angular"])
        accelerating = platform.body["linear_acceleration"], platform.body["angular_acceleration"]
        self._accelerating = (
            max(accelerating[0], self._braking[0]),
            max(accelerating[1], self._braking[1]),
        )
        self._line = [ZERO] * (round(delay / DT) + 1)
        self._noise, self._rng = noise, np.random.default_rng(seed)
        self._phase, self._seq, self._step = phase, 0, 0
        self._coming: list[tuple[float, Scan]] = []
        self._near: dict[int, tuple[Array, Array]] = {}

    def run(
        self, requested: RequestedCommand, seconds: float, permit: Permit = NO_PERMIT
    ) -> FilterRun:
        """Run for `seconds`, or to the first touch; `requested` may depend on the time."""
        run = FilterRun()
        wanted = requested if callable(requested) else lambda _: requested
        for _ in range(round(seconds / DT)):
            self._sense()
            if self._arrive() or self._step % round(TICK / DT) == 0:
                run.decisions.append((self.time, self._decide(wanted(self.time), permit)))
            self._move()
            gap, touch = self._judge()
            run.times.append(self.time)
            run.poses.append(self.pose)
            run.twists.append(self.twist)
            run.gaps.append(gap)
            if touch is not None:
                run.touch = touch
                break
        return run

    def scan(self) -> Scan:
        """The present scan, as a driver delivers it; all rays are of this instant."""
        bearings = self.platform.scan.bearings
        return self._delivered(self._ranges(bearings), self.time, np.zeros(len(bearings)))

    def _ranges(self, bearings: Array) -> Array:
        """(n,) exact distances in m along rays, from where the sensor is now."""
        sensor = placed(np.array([self.platform.scan.offset]), self.pose)[0]
        outlines = [
            placed(shape.corners if shape.seen is None else shape.seen, shape.at(self.time))
            for shape in self.shapes
        ]
        return cast(sensor, bearings + self.pose.yaw, outlines)

    def _delivered(self, ranges: Array, stamp: float, ages: Array) -> Scan:
        """A scan of exact ranges as a driver delivers it."""
        spec = self.platform.scan
        self._seq += 1
        if self._noise > 0.0:
            ranges = ranges + self._rng.normal(0.0, self._noise, len(ranges))
        else:
            ranges = trembling(ranges, self._seq)
        reported = driver_ranges(ranges, spec)
        return Scan(self._seq, stamp, reported, spec.bearings, spec.range_min, spec.range_max, ages)

    def odometry(self) -> Odometry:
        """The present odometry."""
        return Odometry(self.time, self.pose, self.twist)

    def _sense(self) -> None:
        period = round(1.0 / (self.platform.scan.rate * DT))
        begins = (self._step - round(self._phase / DT)) % period == 0 and self.has_lidar
        if len(self._due) > 1:
            self._roll(begins)
        elif begins:
            at = self.time + self.platform.scan.latency + self._late(self._seq)
            self._coming.append((at - 1e-9, self.scan()))
        if self._step % round(TICK / DT) == 0 and self.has_odometry:
            odometry = self.odometry()
            self.sensors.on_odometry(odometry, self.time)
            self.commander.on_odometry(odometry)

    def _roll(self, begins: bool) -> None:
        """Measure the rays of this step: the last ones of a sweep, then the first of the next."""
        self._measure()
        if begins:
            self._begun, self._rolled = self._step, np.empty(len(self._due))
            self._measure()

    def _measure(self) -> None:
        if self._begun < 0:
            return
        since, spec = self._step - self._begun, self.platform.scan
        is_due = self._due == since
        self._rolled[is_due] = self._ranges(spec.bearings[is_due])
        last = int(self._due.max())
        if since == last:
            ages = DT * (last - self._due).astype(np.float64)
            waits = max(spec.latency - float(ages.mean()), 0.0) + self._late(self._seq)
            scan = self._delivered(self._rolled, self._begun * DT, ages)
            self._coming.append((self.time + waits - 1e-9, scan))
            self._begun = -1

    def _arrive(self) -> bool:
        """Deliver the scans that have arrived; true if a valid one is among them."""
        is_new = False
        while self._coming and self._coming[0][0] <= self.time:
            _, scan = self._coming.pop(0)
            is_new = self.sensors.on_scan(scan, self.time)
            if is_new and self.sensors.scan is not None:
                self.commander.observe(self.sensors.scan, self.sensors.context(self.time))
        return is_new

    def _decide(self, requested: Twist, permit: Permit) -> Decision:
        decision = self.commander.decide(
            requested,
            self.sensors.context(self.time),
            is_running=True,
            hold=self.sensors.hold(self.time),
            permit=permit,
        )
        self._line[-1] = decision.safe
        return decision

    def _move(self) -> None:
        command = self._line[0]
        self._line = [*self._line[1:], self._line[-1]]
        (b_v, b_w), (a_v, a_w) = self._braking, self._accelerating
        v = ramped(self.twist.linear, command.linear, a_v, b_v)
        w = ramped(self.twist.angular, command.angular, a_w, b_w)
        u = ramped(self.twist.lateral, command.lateral, a_v, b_v)
        yaw = self.pose.yaw + 0.5 * w * DT
        cos, sin = math.cos(yaw), math.sin(yaw)
        x = self.pose.x + (v * cos - u * sin + self.pushed[0]) * DT
        y = self.pose.y + (v * sin + u * cos + self.pushed[1]) * DT
        self.pose = Pose(x, y, yaw + 0.5 * w * DT)
        self.twist = Twist(v, w, u)
        self._step += 1
        self.time = self._step * DT

    def _judge(self) -> tuple[float, Touch | None]:
        outline = placed(self.platform.footprint, self.pose)
        smallest = math.inf
        for index, shape in enumerate(self.shapes):
            gap, at, towards = separation(outline, placed(shape.corners, shape.at(self.time)))
            if gap <= 0.0:
                return 0.0, Touch(self.time, index, self._speed(*self._near[index]))
            self._near[index] = at, towards
            smallest = min(smallest, gap)
        return smallest, None

    def _speed(self, at: Array, towards: Array) -> float:
        """How fast the robot's own surface moves at a place in a direction (world frame)."""
        v, w, u = self.twist.linear, self.twist.angular, self.twist.lateral
        cos, sin = math.cos(self.pose.yaw), math.sin(self.pose.yaw)
        x, y = at[0] - self.pose.x, at[1] - self.pose.y
        moves = np.array([v * cos - u * sin - w * y, v * sin + u * cos + w * x])
        return float(moves @ towards)


def ramped(now: float, wanted: float, accelerating: float, braking: float) -> float:
    """The speed a step later: towards zero it changes with `braking`, away from it faster."""
    is_braking = now != 0.0 and (now * wanted < 0.0 or abs(wanted) < abs(now))
    if is_braking:
        target = 0.0 if now * wanted < 0.0 else wanted
        return now + min(max(target - now, -braking * DT), braking * DT)
    return now + min(max(wanted - now, -accelerating * DT), accelerating * DT)


def _steps_of_rays(spec: ScanSpec) -> NDArray[np.intp]:
    """(n,) steps of `DT` after the begin of a sweep at which each ray is measured."""
    assert spec.sweep is not None
    turned = (spec.sweep.direction * (spec.bearings - spec.sweep.start) + 1e-9) % (2.0 * math.pi)
    return np.rint(turned / (2.0 * math.pi) * spec.sweep.duration / DT).astype(np.intp)


def driver_ranges(ranges: Array, spec: ScanSpec) -> Array:
    """True distances as the ranges of the platform's driver: too near, too far, or as they are."""
    nothing = 0.0 if spec.zero == "lds" else math.inf
    near = nothing if spec.near == "lost" else -math.inf
    reported = np.where(ranges > spec.range_max, nothing, ranges)
    return np.where(ranges < spec.range_min, near, reported)


def placed(points: Array, pose: Pose) -> Array:
    """Points (k, 2) of a frame at `pose`, in the frame in which the pose is."""
    cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
    turned: Array = points @ np.array([[cos, sin], [-sin, cos]])
    there: Array = turned + np.array([pose.x, pose.y])
    return there


def cast(sensor: Array, angles: Array, outlines: Sequence[Array]) -> Array:
    """(n,) distances in m from a place along `angles` (n,) to the nearest outline; inf: none."""
    ranges = np.full(len(angles), np.inf)
    rays = np.stack((np.cos(angles), np.sin(angles)), axis=1)[:, None]
    for corners in outlines:
        start, edge = corners - sensor, _edges(corners)
        cross = rays[..., 0] * edge[:, 1] - rays[..., 1] * edge[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            along = (start[:, 0] * edge[:, 1] - start[:, 1] * edge[:, 0]) / cross
            share = (start[:, 0] * rays[..., 1] - start[:, 1] * rays[..., 0]) / cross
        hit = (along > 0.0) & (share >= 0.0) & (share <= 1.0)
        ranges = np.minimum(ranges, np.where(hit, along, np.inf).min(axis=1))
    return ranges


def separation(one: Array, other: Array) -> tuple[float, Array, Array]:
    """Gap in m between two convex polygons, the place on `one` and the direction to `other`.

    0 where they overlap, with a place and direction that mean nothing. The arrays below are (k, j),
    by the corners of `one` and of `other`.
    """
    edges, facing = _edges(one), _edges(other)
    x = other[:, 0] - one[:, 0, None]
    y = other[:, 1] - one[:, 1, None]
    ex, ey, fx, fy = edges[:, :1], edges[:, 1:], facing[:, 0], facing[:, 1]
    is_apart = (ex * y < ey * x).all(1).any() or (fx * y > fy * x).all(0).any()
    if not is_apart:
        return 0.0, one[0], np.zeros(2)
    share = _clipped((x * fx + y * fy) / -(fx * fx + fy * fy))
    i, j, near = _least(x + share * fx, y + share * fy)
    back = _clipped((x * ex + y * ey) / (ex * ex + ey * ey))
    k, m, far = _least(x - back * ex, y - back * ey)
    if near <= far:
        gap, at, to = near, one[i], other[j] + share[i, j] * facing[j]
    else:
        gap, at, to = far, one[k] + back[k, m] * edges[k], other[m]
    return gap, at, (to - at) / max(gap, 1e-12)


def outline_point(corners: Array, point: Array) -> tuple[float, Array, Array]:
    """Gap in m from a convex outline to a point, the nearest place on it and the way to the point.

    0 for points inside, with a place and way that mean nothing.
    """
    edge = _edges(corners)
    x, y = (point - corners).T
    if (edge[:, 0] * y - edge[:, 1] * x >= 0.0).all():
        return 0.0, point, np.zeros(2)
    share = _clipped((x * edge[:, 0] + y * edge[:, 1]) / (edge * edge).sum(1))
    _, i, gap = _least((x - share * edge[:, 0])[None], (y - share * edge[:, 1])[None])
    at = corners[i] + share[i] * edge[i]
    return gap, at, (point - at) / gap


def _edges(corners: Array) -> Array:
    """(k, 2) from each corner to the next; `numpy.roll` takes twice as long as all of this."""
    edges = np.empty_like(corners)
    np.subtract(corners[1:], corners[:-1], out=edges[:-1])
    np.subtract(corners[0], corners[-1], out=edges[-1])
    return edges


def _clipped(share: Array) -> Array:
    return np.minimum(np.maximum(share, 0.0), 1.0)


def _least(x: Array, y: Array) -> tuple[int, int, float]:
    """Row, column and length in m of the shortest vector of components `x` and `y` (k, j)."""
    row, column = divmod(int((x * x + y * y).argmin()), x.shape[1])
    return row, column, math.hypot(x[row, column], y[row, column])
