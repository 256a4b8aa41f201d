"""The drives of a calibration, as a pattern, which runs under protection like any other pattern."""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping, Sequence
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np

from swarmd.core.values import ZERO, Array, Inputs, Outputs, Pose, Scalar, Scan, Twist
from swarmd.kit.behavior import Context, Pattern
from swarmd.kit.formation_geometry import to_base_frame
from swarmd.kit.params import Params, Recovery, about
from swarmd.operator.calibration import figures
from swarmd.operator.calibration.estimators import (
    Braking,
    is_steady,
    mean_of,
    scale_of,
    stop_of,
    stopping,
    turn_delay,
)
from swarmd.operator.calibration.figures import AXES, Figure
from swarmd.operator.calibration.floor import needed_floor, tolerance, top_speeds, travel
from swarmd.operator.calibration.ray_order import RayOrder
from swarmd.operator.calibration.scan_matching import Located, Reference, points_of
from swarmd.robot.protection.binding_range import REACTION_TIME
from swarmd.robot.sensing.delay_by_stamps import delay_by_stamps
from swarmd.robot.sensing.scan_delay import TOLERANCE

_SLOW = 0.35  # speed of the slower drives, as a share of the top speed
_CLEAR = 0.3  # s for which a drive continues once steady, so that the cruise excludes its start
_SETTLE = 0.4  # s at standstill by odometry before a stop counts as over
_STILL = 0.01  # share of the top speed, per s: slower counts as standstill
_LONGEST_STOP = 8.0  # s
_LONGEST_DRIVE = 8.0  # s
_UNSEEN_TIME = 0.7  # s at the end of a drive over which odometry must show motion
_UNSEEN_SHARE = 0.03  # least share of the commanded distance that odometry must show in that time
_BRAKED_SHARE = 0.75  # share of a drive's longest distance at which it brakes
_LOOKS = 6  # scans at rest before the first drive
_LOOK_TIME = 10.0  # s within which these scans must arrive
# count; s a swing; share of top turn rate
_SWINGS = 3.0
_SWING_PERIOD = 3.0
_SWING_SHARE = 0.5
_LEAST_WAY = 0.08  # m between two scans that give a scale of odometry
_ASTRAY = math.radians(
    30.0
)  # least angle between the ways by scans and by odometry that is a fault
_RETRIES = 3  # drives without a measured stop before the calibration gives up
_SLOWER = 0.7  # factor of the top speed for the next try
_STANDS = "the base stands (motors off, a stop button), its odometry does not change"
_NO_SLIDE = "its wheels do not slide (limits.lateral: 0)"


class _Axis(NamedTuple):
    """The words of messages for the moves on an axis.

    `astray`, `unsteady`, `unseen`: likely causes; `astray`: of scans that show another direction
    than odometry.
    """

    move: str
    unit: str
    way: str
    astray: str
    unsteady: str = ""
    unseen: str = _STANDS


_AXES = {
    "linear": _Axis(
        "drive",
        "m/s",
        "way",
        "the lidar is turned by {:.0f} deg, or motors and odometry have the wrong sign",
    ),
    "lateral": _Axis(
        "drive sideways",
        "m/s",
        "way sideways",
        "the scan is mirrored (a lidar upside down), or motors and odometry sideways have the wrong"
        " sign",
        f", or {_NO_SLIDE}",
        f"{_NO_SLIDE}, its driver measures no way sideways",
    ),
    "angular": _Axis(
        "turn",
        "rad/s",
        "turn",
        "the scan is mirrored (a lidar upside down), left and right motors are swapped, or the turn"
        " of odometry has the wrong sign",
    ),
}

_Drives: TypeAlias = Generator[Twist, Inputs, None]
_Distances: TypeAlias = tuple[float, float]
"""The distance of one drive in m by odometry, and by scans."""


class CalibrationParams(Params, frozen=True, kw_only=True):
    """The floor and the number of drives."""

    floor: Annotated[
        float,
        about(
            "side of the free square floor around the robot",
            ge=0.5,
            le=50.0,
            unit="m",
            source="ours: what protection needs beside the drives, at least 2 m",
            derived=needed_floor,
        ),
    ]
    repeats: Annotated[
        int,
        about(
            "drives to and fro, at each of two speeds",
            ge=1,
            le=20,
            unit="drives",
            source="ours: brakes are within 5 % with noise of 2 % in each reading of odometry",
        ),
    ] = 4
    recovery: Recovery = False


class _EndError(Exception):
    """Ends the calibration without figures, with the reason as text."""


class Calibration(Pattern[CalibrationParams]):
    """Measures decelerations, delays and the scales of odometry by a few short drives.

    `swarmctl calibrate` asks for the size of the free floor, starts this pattern, and prints the
    figures. The robot drives to and fro and turns within the floor; a base that moves sideways also
    drives to both sides. A calibration takes about 90 s (sideways 130 s).
    """

    params_type = CalibrationParams
    needs = frozenset({"scan", "odometry"})
    rate = 50.0
    scan_delay = 0.5  # a late scan must not hold the pattern that measures this delay

    def __init__(self, params: CalibrationParams, context: Context) -> None:
        super().__init__(params, context)
        platform = context.platform
        self._spec = platform.scan
        self._speeds = top_speeds(platform)
        self._farthest = {
            axis: math.inf if axis == "angular" else _BRAKED_SHARE * travel(speed)
            for axis, speed in self._speeds.items()
        }
        self._step_name = "looks"
        self._report: dict[str, Scalar] = {}
        # Odometry: stamp, x, y, yaw (not wrapped). `_offset`: robot's clock less odometry's clock.
        self._odometry: list[tuple[float, float, float, float]] = []
        self._offset = math.inf
        self._lags: list[float] = []  # s, of each reading: arrival on the robot's clock less stamp
        self._now = 0.0
        self._scan: Scan | None = None
        self._scan_at = -math.inf
        self._scan_count = 0
        self._late = 0.0  # s by which scans seem to arrive later than declared
        self._drives = self._script()
        self._done: str | None = None
        next(self._drives)

    def step(self, inputs: Inputs) -> Outputs:
        """The next command of the drives; zero and `done` at the end of the drives."""
        if self._done is not None:
            return Outputs(ZERO, report=self._report, done=self._done)
        self._now = inputs.now
        twist = ZERO
        try:
            self._record(inputs)
            twist = self._drives.send(inputs)
            self._report = {"state": "measures", "step": self._step_name}
        except StopIteration:
            self._done = figures.DONE
        except _EndError as end:
            self._done = str(end)
            self._report = {"state": figures.REFUSED, "why": self._done}
        return Outputs(twist, report=self._report, done=self._done)

    # Samples

    def _record(self, inputs: Inputs) -> None:
        odometry = inputs.odometry
        if odometry is not None:
            stamp = odometry.stamp
            pose = odometry.pose
            rows = self._odometry
            if rows and stamp < rows[-1][0]:
                raise _EndError("the clock of odometry was set back")
            if not rows or stamp > rows[-1][0]:
                before = rows[-1][3] if rows else pose.yaw
                turned = math.remainder(pose.yaw - before, 2.0 * math.pi)
                rows.append((stamp, pose.x, pose.y, before + turned))
            self._offset = min(self._offset, inputs.now - stamp)
            self._lags.append(inputs.now - stamp)
        if inputs.is_new_scan and inputs.scan is not None:
            self._scan = inputs.scan
            self._scan_at = inputs.now
            self._scan_count += 1

    def _track(self, since: float) -> Array:
        """(n, 4) odometry since `since` on the robot's clock: time on this clock, x, y, yaw."""
        rows = self._odometry
        begin = since - self._offset
        first = next((i for i in range(len(rows), 0, -1) if rows[i - 1][0] < begin), 0)
        track = np.array(rows[max(first - 1, 0) :]).reshape(-1, 4)
        track[:, 0] += self._offset
        return track

    def _pose_at(self, at: float) -> Pose:
        track = self._track(at - 1.0)
        x, y, yaw = (float(np.interp(at, track[:, 0], track[:, i])) for i in (1, 2, 3))
        return Pose(x, y, yaw)

    # Drives

    def _script(self) -> _Drives:
        yield ZERO
        yield from self._look()
        scales = dict[str, list[_Distances]]()
        stops = dict[str, list[tuple[float, Braking]]]()
        for axis in (axis for axis in _AXES if axis in self._speeds):
            stops[axis] = []
            scales[axis] = []
            yield from self._stops(axis, stops[axis], scales[axis])
        self._step_name = "swings"
        seen, track = yield from self._swing()
        self._step_name = "matches scans"
        headings: list[tuple[float, float]] = []
        for arrival, scan in seen:
            yield ZERO  # only one scan is matched in each step, to keep the step short
            points = points_of(scan, self._spec.offset)
            guess = self._relative(self._pose_at(arrival - self._spec.latency - self._late))
            located = self._locate(points, guess, _mirrored(guess))
            if located is not None and located.binds_yaw:
                error = math.remainder(located.pose.yaw - guess.yaw, 2.0 * math.pi)
                headings.append((arrival, guess.yaw + error))
        scan_delay, turn_scale = self._of_turns(headings, track)
        sweep = None
        if self._spec.is_sweep_unknown:
            sweep = yield from self._sweep(seen, scan_delay, turn_scale, track)
        self._finish(stops, scales, scan_delay, turn_scale)
        if sweep is not None:
            self._report[figures.SWEEP] = sweep.text

    def _sweep(
        self,
        seen: Sequence[tuple[float, Scan]],
        scan_delay: Figure,
        turn_scale: Figure,
        track: Array,
    ) -> Generator[Twist, Inputs, figures.SweepFigure]:
        """The order of the rays by the scans of the turns; compares one scan in each step.

        `seen`: arrival in s and scan. `scan_delay`, `turn_scale`: see `_of_turns`. `track`: (n, 4)
        odometry: s, x, y, yaw.
        """
        if not scan_delay.is_measured:
            return figures.SweepFigure(why=f"no scan delay: {scan_delay.why}")
        yaws = (track[:, 3] - self._start.yaw) / turn_scale.value
        headings = np.column_stack((track[:, 0], yaws))
        order = RayOrder(self._looks, self._spec.offset, 1.0 / self._spec.rate, headings)
        for arrival, scan in seen:
            yield ZERO
            order.add(scan, arrival - scan_delay.value)
        return order.figure()

    def _look(self) -> _Drives:
        """Take scans of the floor and check it, before the robot moves."""
        looks: list[Scan] = []
        arrivals: list[tuple[float, float]] = []
        begin = None
        count = 0
        while len(looks) < _LOOKS:
            yield ZERO
            begin = self._now if begin is None else begin
            if self._scan_count != count and self._scan is not None:
                count = self._scan_count
                looks.append(self._scan)
                arrivals.append((self._scan_at, self._scan.stamp))
            if self._now - begin > _LOOK_TIME:
                what = "odometry" if looks else "scans"
                raise _EndError(f"too few {what} within {_LOOK_TIME:g} s")
        if not self._odometry:
            raise _EndError("no odometry")
        self._check_size(arrivals, self._scan)
        _, x, y, yaw = self._odometry[-1]
        self._start = Pose(x, y, yaw)
        self._looks = looks
        points = [points_of(look, self._spec.offset) for look in looks]
        for of_look in points:
            self._check_floor(of_look, Pose())
        self._reference = Reference(points) if any(map(len, points)) else None

    def _check_size(self, arrivals: list[tuple[float, float]], scan: Scan | None) -> None:
        """End if the floor is too small for the scan delay that the stamps show."""
        odometry = [(stamp + self._offset, stamp) for stamp, *_ in self._odometry]
        figure = delay_by_stamps(arrivals, odometry, scan, self._spec)
        late = 0.0 if figure.delay is None else figure.delay - self._spec.latency
        self._late = late if late > TOLERANCE else 0.0
        platform = self.context.platform
        floor = self.params.floor
        needed = needed_floor(platform, self._late)
        if floor < needed:
            late_text = f" with scans that come {self._late:.2f} s late" if self._late else ""
            raise _EndError(
                f"a floor of {floor:g} m is too small for {platform.name}{late_text}:"
                f" {needed:g} m needed"
            )

    def _check_floor(self, points: Array, pose: Pose) -> None:
        """End if a return lies on the floor; `points` are seen from `pose` in the start frame."""
        half = 0.5 * self.params.floor
        half -= tolerance(half)
        cos = math.cos(pose.yaw)
        sin = math.sin(pose.yaw)
        x = pose.x + cos * points[:, 0] - sin * points[:, 1]
        y = pose.y + sin * points[:, 0] + cos * points[:, 1]
        inside = np.flatnonzero((np.abs(x) < half) & (np.abs(y) < half))
        if len(inside):
            ranges = np.hypot(points[inside, 0], points[inside, 1])
            nearest = points[inside[int(ranges.argmin())]]
            bearing = math.degrees(math.atan2(nearest[1], nearest[0]))
            side = self.params.floor
            raise _EndError(
                f"the floor of {side:g} x {side:g} m {figures.NOT_FREE}: something stands"
                f" {float(ranges.min()):.2f} m from the axle at {bearing:.0f} deg (90: left);"
                " remove it, or put the robot elsewhere"
            )

    def _relative(self, pose: Pose) -> Pose:
        """An odometry pose in the frame of the start."""
        x, y = to_base_frame((pose.x, pose.y), self._start)
        return Pose(x, y, pose.yaw - self._start.yaw)

    def _locate(self, points: Array, guess: Pose, *others: Pose) -> Located | None:
        """The pose of a scan near `guess`, or else near one of `others`; None if none matches.

        `others` are the poses by odometry as a lidar or motors with a fault would show them.
        """
        best: Located | None = None
        reference = self._reference
        for pose in (guess, *others):
            located = None if reference is None else reference.locate(points, pose)
            best = best or located
            if located is not None and located.binds_place:
                return located
        return best

    def _stops(
        self, axis: str, stops: list[tuple[float, Braking]], scales: list[_Distances]
    ) -> _Drives:
        """Measure stops on an axis: to and fro, from two speeds.

        `stops` and `scales` are filled: `stops` with the commanded speed and the measured stop of
        each drive, `scales` with the distances of each drive in m by odometry and by scans. After a
        drive without a measured stop (`_stop` gives None), all drives are repeated at a slower
        speed. _EndError after more than _RETRIES such drives.
        """
        failures = 0
        words = _AXES[axis]
        # To and fro at the top speed, then to and fro at a slow speed; this `repeats` times.
        speed_shares = (1.0, -1.0, _SLOW, -_SLOW)
        drive_count = len(speed_shares) * self.params.repeats
        while len(stops) < drive_count:
            self._step_name = f"{words.move} {len(stops) + 1} of {drive_count}"
            share = speed_shares[len(stops) % len(speed_shares)]
            speed = abs(share) * self._speeds[axis]
            stop = yield from self._stop(math.copysign(speed, share), axis, scales)
            if stop is not None:
                stops.append((speed, stop))
                continue
            failures += 1
            if failures > _RETRIES:
                raise _EndError(
                    f"it does not {words.move} steadily when {speed:.2f} {words.unit} are"
                    " commanded: protection limits it, or the base takes too long to get there"
                    f"{words.unsteady}"
                )
            stops.clear()  # `scales` stay: the scale of odometry does not depend on the speed
            self._speeds[axis] *= _SLOWER

    def _stop(
        self, speed: float, axis: str, scales: list[_Distances]
    ) -> Generator[Twist, Inputs, Braking | None]:
        """Drive or turn until the speed is steady, then stop; yields the command of each step.

        `speed` in m/s or rad/s, signed. `axis`: the field of Twist: linear, lateral or angular. The
        distances by odometry and by scans are appended to `scales`. Returns the measured stop. If
        the drive got too long, or odometry does not show its speed before the stop, the robot
        drives back, and the result is None. Ends the calibration by _EndError if odometry shows no
        motion.
        """
        # 1. Drive until _CLEAR s after the speed was first steady, or until the drive is too long.
        twist = Twist(**{axis: speed})
        sign = math.copysign(1.0, speed)
        before = self._rest()  # the poses by odometry and by the last scan
        begin = self._now
        steady_since: float | None = None  # set once: the speed is not compared again
        is_too_long = False
        while not is_too_long and (steady_since is None or self._now - steady_since < _CLEAR):
            yield twist
            track = self._track(begin)
            times = track[:, 0]
            distances = _distances(track, axis, sign)
            if steady_since is None and is_steady(times, distances):
                steady_since = self._now
            drive_time = self._now - begin
            is_too_long = distances[-1] > self._farthest[axis] or drive_time > _LONGEST_DRIVE
            if drive_time > _UNSEEN_TIME:
                self._check_motion(times, distances, speed, axis)

        # 2. Stop, and measure the stop.
        stop_time = self._now
        yield from self._stand()
        after = self._rest()
        distances_by_both = None
        if axis != "angular":  # turns are compared with scans in `_of_turns`
            distances_by_both = self._compare(axis, before, after)
        self._check_rest(after)
        track = self._track(begin)
        stop = stop_of(track[:, 0], _distances(track, axis, sign), stop_time)
        if stop is None or is_too_long:
            yield from self._back(twist, stop_time - begin)
            return None
        if distances_by_both is not None:
            scales.append(distances_by_both)
        return stop

    def _check_motion(self, times: Array, distances: Array, speed: float, axis: str) -> None:
        """End if odometry shows hardly any motion in the last _UNSEEN_TIME s of a drive.

        `distances`: (n,) travelled m or rad at `times` (n,) s. `speed`: the commanded speed on
        `axis` in m/s or rad/s.
        """
        recent = distances[-1] - np.interp(self._now - _UNSEEN_TIME, times, distances)
        if recent < _UNSEEN_SHARE * abs(speed) * _UNSEEN_TIME:
            words = _AXES[axis]
            raise _EndError(
                f"odometry shows no {words.way} when {abs(speed):.2f} {words.unit} are"
                f" commanded: {words.unseen}, or protection stops it"
            )

    def _back(self, twist: Twist, seconds: float) -> _Drives:
        """Undo a drive that failed, so that the robot stays on the floor."""
        begin = self._now
        while self._now - begin < seconds:
            yield Twist(-twist.linear, -twist.angular, -twist.lateral)
        yield from self._stand()
        self._check_rest(self._rest())

    def _stand(self) -> _Drives:
        """Command zero until the robot stands by odometry and a whole scan was taken since."""
        begin = self._now
        still = self._now
        sweep = 0.0 if self._scan is None or self._scan.ages is None else self._scan.ages.max()
        latency = self._spec.latency + self._late
        settle = max(_SETTLE, latency + 1.5 / self._spec.rate, float(sweep))
        while self._now - still < _SETTLE or self._scan_at - still < settle:
            yield ZERO
            track = self._track(self._now - 0.15)
            moved = float(np.hypot(*(track[-1, 1:3] - track[0, 1:3])))
            turned = abs(float(track[-1, 3] - track[0, 3]))
            limit = _STILL * max(float(track[-1, 0] - track[0, 0]), 0.05)
            if moved > limit * self._speeds["linear"] or turned > limit * self._speeds["angular"]:
                still = self._now
            if self._now - begin > _LONGEST_STOP:
                raise _EndError("the robot does not come to rest, or scans have stopped")

    def _rest(self) -> tuple[Pose, Located | None]:
        """The pose at rest by odometry, and by the last scan (None if it does not match)."""
        pose = self._relative(self._pose_at(self._now))
        if self._scan is None:
            return pose, None
        # As a lidar shows it that is turned by 180, 90 or -90 degrees.
        opposite, left, right = (
            Pose(x, y, pose.yaw)
            for x, y in ((-pose.x, -pose.y), (-pose.y, pose.x), (pose.y, -pose.x))
        )
        points = points_of(self._scan, self._spec.offset)
        return pose, self._locate(points, pose, opposite, left, right, _mirrored(pose))

    def _check_rest(self, rest: tuple[Pose, Located | None]) -> None:
        """End if a return of the last scan lies on the floor; `rest`: the poses from `_rest`."""
        pose, located = rest
        if located is not None and located.binds_place and located.binds_yaw:
            pose = located.pose
        if self._scan is not None:
            self._check_floor(points_of(self._scan, self._spec.offset), pose)

    def _compare(
        self,
        axis: str,
        before: tuple[Pose, Located | None],
        after: tuple[Pose, Located | None],
    ) -> _Distances | None:
        """The distances of a drive by odometry and by scans in m; None if scans show no distance.

        `before`, `after`: the poses at rest from `_rest`. Ends the calibration by _EndError if
        scans show another direction than odometry.
        """
        (start, start_by_scan) = before
        (end, end_by_scan) = after
        if start_by_scan is None or end_by_scan is None:
            return None
        if not (start_by_scan.binds_place and end_by_scan.binds_place):
            return None
        scan_end = end_by_scan.pose
        way = to_base_frame((end.x, end.y), start)
        scan_way = to_base_frame((scan_end.x, scan_end.y), start_by_scan.pose)
        distance = math.hypot(*scan_way)
        if distance < _LEAST_WAY:
            return None
        direction = math.atan2(way[1], way[0])
        scan_direction = math.atan2(scan_way[1], scan_way[0])
        astray = math.remainder(scan_direction - direction, 2.0 * math.pi)
        if abs(astray) > _ASTRAY:
            words = _AXES[axis]
            angle = math.degrees(astray)
            raise _EndError(
                f"scans show a {words.way} in another direction than odometry, by {angle:.0f} deg:"
                f" {words.astray.format(-angle)}"
            )
        return math.hypot(*way), distance

    def _swing(self) -> Generator[Twist, Inputs, tuple[list[tuple[float, Scan]], Array]]:
        """Turn to and fro at a changing rate.

        Returns the arrival in s and each scan, and odometry as `_track`.
        """
        begin = self._now
        last_scan = self._scan
        seen: list[tuple[float, Scan]] = []
        top_rate = _SWING_SHARE * self._speeds["angular"]
        while self._now - begin < _SWINGS * _SWING_PERIOD:
            phase = 2.0 * math.pi * (self._now - begin) / _SWING_PERIOD
            yield Twist(angular=top_rate * math.sin(phase))
            if self._scan is not last_scan and self._scan is not None:
                last_scan = self._scan
                seen.append((self._scan_at, last_scan))
        yield from self._stand()
        self._check_rest(self._rest())
        return seen, self._track(begin - 2.0)

    # Figures

    def _finish(
        self,
        stops: Mapping[str, Sequence[tuple[float, Braking]]],
        scales: Mapping[str, Sequence[_Distances]],
        scan_delay: Figure,
        turn_scale: Figure,
    ) -> None:
        """Compute all figures from the samples of the drives, and set the report.

        `stops`: by axis, pairs of commanded speed and stop. `scales`: by axis, pairs of distances
        in m by odometry and by scans. `scan_delay`, `turn_scale`: see `_of_turns`.
        """
        why = "what stands around does not show the way: too little of it, or a bare corridor"
        measured: dict[str, Figure] = {}
        for axis, pairs in stops.items():
            scale = turn_scale if axis == "angular" else scale_of(scales[axis], why)
            measured |= self._of_axis(axis, pairs, scale)
        measured["margin"] = self._margin(*(measured[f"reaction_{axis}"] for axis in stops))
        # The fastest reading counts as new on arrival: its lag is the offset of the clocks.
        ages = np.array(self._lags) - self._offset
        measured["odometry_age"] = mean_of(ages.tolist(), "no odometry")
        measured["scan_delay"] = scan_delay
        self._report = {
            "state": figures.DONE,
            "drove": " ".join(f"{self._speeds[axis]:.6g}" for axis in AXES if axis in stops),
            **{name: figure.text for name, figure in measured.items()},
        }

    def _of_turns(
        self, headings: Sequence[tuple[float, float]], track: Array
    ) -> tuple[Figure, Figure]:
        """The scan delay in s, and the scale of odometry in turns.

        The scan delay is the mean age of the rays of a scan on arrival. `headings`: arrival in s
        and heading in rad of each matched scan. `track`: (n, 4) odometry: s, x, y, yaw.
        """
        if self._reference is None or not headings:
            why = "what stands around shows no turn: too few returns, or a round room"
            no_figure = Figure(why=why)
            return no_figure._replace(assumed=self._spec.latency), no_figure
        arrivals, scan_headings = np.array(headings).T
        odometry_headings = track[:, 3] - self._start.yaw
        delay, scale = turn_delay(arrivals, scan_headings, track[:, 0], odometry_headings)
        if scale.is_measured and scale.value < 0.0:
            raise _EndError(
                f"scans show turns in the other direction than odometry: {_AXES['angular'].astray}"
            )
        if delay.is_measured and self._scan is not None and self._scan.ages is not None:
            # `turn_delay` gives the age of the newest ray, since a matched pose is the pose at that
            # ray. So the mean time by which rays are older than the newest ray is added. This time
            # is 0 while the order of the rays is unknown: all ages are equal then, and a matched
            # pose is the pose at the mean ray.
            ray_ages = self._scan.ages - self._scan.ages.min()
            delay = delay._replace(value=delay.value + float(ray_ages.mean()))
        return delay._replace(assumed=self._spec.latency), scale

    def _of_axis(
        self, axis: str, pairs: Sequence[tuple[float, Braking]], scale: Figure
    ) -> dict[str, Figure]:
        """The deceleration, the reaction delay, the speed and the scale of an axis, by name.

        `pairs`: commanded speed and stop of each drive. `scale`: the scale of odometry. The speed
        is the measured speed divided by the commanded speed, of the drives at the top speed.
        """
        deceleration, reaction = stopping([stop for _, stop in pairs])
        top_speed = max(speed for speed, _ in pairs)
        speed_ratios = [stop.speed / speed for speed, stop in pairs if speed == top_speed]
        speed_ratio = mean_of(speed_ratios, "no steady drive")
        if scale.is_measured:  # to metres by scans, by which protection measures its gaps
            speed_ratio = speed_ratio.over(scale)
            deceleration = deceleration.over(scale)
        # `braking_linear` also holds for the lateral axis.
        key = "braking_angular" if axis == "angular" else "braking_linear"
        barrier = self.context.platform.protection.get("barrier") or {}
        declared = float(barrier.get(key, math.nan))
        return {
            f"braking_{axis}": deceleration._replace(assumed=declared),
            f"reaction_{axis}": reaction._replace(assumed=REACTION_TIME),
            f"speed_{axis}": speed_ratio._replace(assumed=1.0),
            f"odometry_{axis}": scale._replace(assumed=1.0),
        }

    def _margin(self, *delays: Figure) -> Figure:
        """The protection margin in m that a base needs if it responds later than assumed.

        `delays`: the reaction delays of the axes in s; each counts with two standard deviations.
        The longest delay may exceed REACTION_TIME. In the time beyond REACTION_TIME the robot's
        surface and an object still approach each other, and the margin grows by the distance of
        this approach.
        """
        barrier = self.context.platform.protection.get("barrier")
        if barrier is None:
            return Figure(why="mode barrier has no settings")
        others_speed = float(barrier["others_speed"])
        limits = self.context.platform.limits
        top_speed = math.hypot(limits.linear, limits.lateral)
        # A barrier without `surface_speed` limits the own surface to `others_speed` near obstacles.
        surface_speed = max(barrier.get("surface_speed") or others_speed, top_speed)
        reactions = [delay.value + 2.0 * delay.spread for delay in delays if delay.is_measured]
        reaction = max(reactions, default=0.0)
        excess = max(reaction - REACTION_TIME, 0.0) * (surface_speed + others_speed)
        margin = float(barrier["margin"])
        return Figure(margin + excess, 0.0, sum(delay.samples for delay in delays), margin)


def _mirrored(pose: Pose) -> Pose:
    """The pose as a mirrored scan shows it, or a scan of a base that turns the other way."""
    return Pose(pose.x, -pose.y, -pose.yaw)


def _distances(track: Array, axis: str, sign: float) -> Array:
    """The distances travelled on an axis since the first row of `track`, (n,) m or rad.

    `track`: (n, 4) odometry: time, x, y, yaw. `axis`: linear (along the first heading), lateral (to
    its left) or angular. `sign`: -1.0 for a drive in the negative direction.
    """
    _, x, y, turned = (track - track[0]).T
    yaw = float(track[0, 3])
    cos = math.cos(yaw)
    sin = math.sin(yaw)
    distances: dict[str, Array] = {
        "linear": cos * x + sin * y,
        "lateral": cos * y - sin * x,
        "angular": turned,
    }
    return sign * distances[axis]
