"""Converts ROS messages to the core's values, and safe commands to ROS messages.

Ranges are not conditioned here: zeros, infinities and NaN pass as the sensor gave them, and the
limits of the range come from the platform's file (`swarmd.robot.sensing.conditioning`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from swarmd.core.errors import CodecError
from swarmd.core.finding import Finding
from swarmd.core.values import Array, Odometry, Pose, Scan, ScanSpec, SharedPose, Twist
from swarmd.driver_api.hw_codec import MAX_RAYS
from swarmd.drivers.ros import messages as ros
from swarmd.drivers.ros.absence import why_absent

_MAX_SPAN = 1.1 * 2.0 * math.pi  # of a scan: some sensors repeat their first rays at the end
_MAX_FIRST_ANGLE = 4.0 * math.pi
_MAX_PERIODS = 1.5  # periods of the scan rate that one sweep may take at most
_MAX_SWEEP_ERROR = 0.2  # of the duration: an LDS turns at 5 Hz within a tenth
_MAX_RAYS_OFF = 1.5  # increments between the last ray and angle_max
_MAX_ROUNDING = 0.01  # of the angle between the first ray and the last
_NANOSECONDS = 1_000_000_000  # of a second
MAX_TILT_DEG = 45.0
"""Degrees by which the pose of a base may be tilted: no base drives on a steeper slope."""
MAX_MEASURED = 100.0
"""m/s or rad/s of a measured twist: no base is faster."""
_TURNS = {True: "counter-clockwise", False: "clockwise"}
_ROUNDING = 1e-9  # of a covariance
_FULL = {"share": 1.0, "percent": 100.0}  # what a full battery's percentage is
_MAX_CHARGE = 1.2  # times full; OpenCR's firmware for ROS 2 reports up to 1.17 at 12.6 V


def stamp_of(stamp: ros.Time) -> float:
    """Seconds on the sender's clock; only differences have a meaning.

    CodecError for a nanosec of a second and more: its time would not be known.
    """
    if not 0 <= stamp.nanosec < _NANOSECONDS:
        raise CodecError(
            f"its stamp has a nanosec of {stamp.nanosec}; expected less than 10^9: what stamps it"
            " mixes up its units"
        )
    return stamp.sec + 1e-9 * stamp.nanosec


def scan_of(
    message: ros.LaserScan,
    seq: int,
    spec: ScanSpec,
    yaw: float = 0.0,
    *,
    is_upside_down: bool = False,
) -> Scan:
    """The scan of a LaserScan, with bearings in the base frame.

    The scan has ages of its rays only if its sweep is unknown (`spec.is_sweep_unknown`), and if the
    message gives a possible `time_increment`. Otherwise the platform's `scan.sweep` gives
    the ages. Raises CodecError for more than MAX_RAYS rays, and if the angles span more than one
    turn.

    Args:
        message: the LaserScan.
        seq: the number of the scan.
        spec: the platform's section `scan`.
        yaw: rad, the bearing of the sensor's angle 0.
        is_upside_down: the angles of the sensor rise clockwise.
    """
    count = len(message.ranges)
    first = message.angle_min
    step = message.angle_increment
    span = step * max(count - 1, 0)
    if count > MAX_RAYS:
        raise CodecError(f"{count} rays; expected at most {MAX_RAYS}")
    if not (abs(first) <= _MAX_FIRST_ANGLE and abs(span) <= _MAX_SPAN):  # false for NaN too
        raise CodecError(f"rays from {first:g} rad over {span:g} rad; expected one turn at most")
    turn_sign = -1.0 if is_upside_down else 1.0
    bearings = _bearings(yaw + turn_sign * first, turn_sign * step, count)
    with np.errstate(invalid="ignore"):  # numpy warns of a signalling NaN
        ranges = message.ranges.astype(np.float64)
    # `time_increment` is not reliable: both drivers of TurtleBot3's lidars, rplidar_ros and
    # sllidar_ros2 give a positive value for rays in falling order of time, and hls_lfcd_lds_driver
    # gives a value 18 times too short. So the platform's `scan.sweep` is used where it is declared,
    # and a robot that does not know its sweep takes from these ages only the duration of a scan.
    ages = _ages(message.time_increment, count, 1.0 / spec.rate) if spec.is_sweep_unknown else None
    stamp = stamp_of(message.header.stamp)
    return Scan(seq, stamp, ranges, bearings, spec.range_min, spec.range_max, ages)


def header_fault(message: ros.LaserScan) -> str:
    """How `angle_max` contradicts the number of rays of a scan; empty if it does not.

    Some drivers set `angle_max` to the angle of the last ray, others to one increment more, and the
    increment is rounded. A value of 0 means that the driver does not set `angle_max`.
    """
    count = len(message.ranges)
    step = message.angle_increment
    first = message.angle_min
    last = message.angle_max
    if count == 0 or last == 0.0:
        return ""
    span = step * (count - 1)
    tolerance = _MAX_RAYS_OFF * abs(step) + _MAX_ROUNDING * abs(span)
    if abs(last - (first + span)) <= tolerance:  # false for NaN
        return ""
    text = (
        f"its header contradicts itself: angle_max is {last:.4g} rad, but {count} rays of"
        f" {step:.4g} rad from {first:.4g} rad end at {first + span:.4g} rad"
    )
    if abs(last - (first - span)) <= tolerance:
        text += ": one has the wrong sign, which would mirror left and right"
    return f"{text}; hold something to the left of the sensor, and correct its driver"


def sweep_finding(message: ros.LaserScan, spec: ScanSpec, *, is_upside_down: bool) -> Finding:
    """The finding on the order in time of a scan's rays (the sweep).

    The platform's `scan.sweep` counts if it is declared: a `time_increment` that differs is no
    fault, since many drivers send a wrong value. Without a declared sweep an impossible
    `time_increment` is a fault.
    """
    claim = _claimed_sweep(message, spec, is_upside_down=is_upside_down)
    step = message.time_increment
    if claim is not None:
        message_text = f"time_increment says {claim.duration:.3g} s a scan, {claim.turn}"
    elif step == 0.0:
        message_text = "time_increment is 0"
    else:
        message_text = f"time_increment of {step:g} s is impossible at {spec.rate:g} Hz"
    is_good = claim is not None or step == 0.0  # 0: the driver does not say
    sweep = spec.sweep
    if spec.is_sweep_unknown:
        doubt = "" if claim is None else ", but many drivers reverse their rays"
        text = (
            f"direction not known: {message_text}{doubt}; each ray counts as old as the"
            " oldest: give the platform's scan.sweep, which `swarmctl calibrate` measures"
        )
        return Finding("scan sweep", is_good, text, is_measured=False)
    if sweep is None:
        text = (
            f"the platform's scan.sweep is null: all rays count as of one instant; {message_text}"
        )
        return Finding("scan sweep", is_good, text)
    declared = _Sweep(sweep.duration, _TURNS[sweep.direction > 0.0])
    text = f"the platform's scan.sweep is {declared.duration:.3g} s, {declared.turn}"
    if claim is not None and declared.agrees_with(claim):
        text += ", as time_increment says"
    elif step == 0.0:
        text += "; time_increment is 0"
    else:
        text += f", and counts; {message_text}"
    return Finding("scan sweep", True, text)


class _Sweep(NamedTuple):
    """The duration of a sweep in s, and its turn as seen from above, a value of _TURNS."""

    duration: float
    turn: str

    def agrees_with(self, claim: _Sweep) -> bool:
        """True if a message claims this sweep, up to _MAX_SWEEP_ERROR of this duration."""
        error_s = abs(claim.duration - self.duration)
        return error_s < _MAX_SWEEP_ERROR * self.duration and claim.turn == self.turn


def _claimed_sweep(
    message: ros.LaserScan, spec: ScanSpec, *, is_upside_down: bool
) -> _Sweep | None:
    """The sweep that `time_increment` of a message claims; None if it is 0 or impossible."""
    step = message.time_increment
    count = len(message.ranges)
    if _ages(step, count, 1.0 / spec.rate) is None:
        return None
    # Does the bearing (counter-clockwise from above) rise with time? A negative step of time, a
    # negative step of angle, and a sensor that hangs upside down each reverse the direction.
    is_rising = (step > 0.0) == (message.angle_increment > 0.0)
    if is_upside_down:
        is_rising = not is_rising
    return _Sweep(abs(step) * count, _TURNS[is_rising])


def odometry_of(message: ros.Odometry) -> Odometry:
    """Pose and twist; CodecError, with the value, if no base can have them.

    That is a value that is not finite, too great or marked as not measured, and a tilted pose.
    """
    if lacks := why_absent(message, "pose.pose") or why_absent(message, "twist.twist"):
        raise CodecError(lacks)
    position = message.pose.pose.position
    orientation = message.pose.pose.orientation
    linear = message.twist.twist.linear
    angular = message.twist.twist.angular
    pose = Pose(position.x, position.y, level_yaw_of(orientation))
    twist = Twist(linear.x, angular.z, linear.y)
    odometry = Odometry(stamp_of(message.header.stamp), pose, twist)
    if fault := odometry.fault:
        raise CodecError(fault)
    fastest = max(twist.linear, twist.angular, twist.lateral, key=abs)
    if abs(fastest) > MAX_MEASURED:
        raise CodecError(
            f"its twist has {fastest:.4g} m/s or rad/s; expected at most {MAX_MEASURED:g}"
        )
    return odometry


def shared_pose_of(
    message: ros.PoseStamped | ros.PoseWithCovarianceStamped, error: float, yaw_error: float
) -> SharedPose:
    """The pose in a shared frame, with errors of at least `error` m and `yaw_error` rad.

    If the message has a covariance, the errors are at least three standard deviations: of the worst
    direction in the plane, and of yaw. CodecError if the pose or its covariance is not finite or
    impossible, or the name of its frame is not proper.
    """
    pose: Any = message.pose
    if hasattr(pose, "covariance"):
        # x y z roll pitch yaw
        covariance = np.reshape(pose.covariance, (6, 6))
        pose = pose.pose
        plane = covariance[:2, :2]
        yaw_variance = float(covariance[5, 5])
        if not (np.isfinite(plane).all() and 0.0 <= yaw_variance < math.inf):
            raise CodecError("the covariance is not finite, or negative")
        # Variances in m2 along the main axes; a covariance is symmetric but for rounding.
        least, most = np.linalg.eigvalsh(0.5 * (plane + plane.T)).tolist()
        if least < -_ROUNDING * max(most, 1.0):
            raise CodecError("the covariance is negative")
        error = max(error, 3.0 * math.sqrt(max(most, 0.0)))
        yaw_error = max(yaw_error, min(3.0 * math.sqrt(yaw_variance), math.pi))
    shared_pose = SharedPose(
        stamp_of(message.header.stamp),
        Pose(pose.position.x, pose.position.y, level_yaw_of(pose.orientation)),
        error,
        yaw_error,
        message.header.frame_id.lstrip("/"),
    )
    if not shared_pose.is_valid:
        raise CodecError(
            "the pose is not finite, too far or too inaccurate, or its frame has no proper name"
        )
    return shared_pose


def yaw_of(q: ros.Quaternion) -> float:
    """The rotation about the vertical axis in rad; CodecError without a unit quaternion."""
    square = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
    if not 0.8 < square < 1.2:  # false for NaN too
        raise CodecError(
            f"its orientation ({q.x:.3g}, {q.y:.3g}, {q.z:.3g}, {q.w:.3g}) is no unit quaternion"
        )
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z)


def level_yaw_of(q: ros.Quaternion) -> float:
    """The rotation of a base about the vertical axis in rad; CodecError if it is tilted.

    A tilt of more than MAX_TILT_DEG is that of a frame whose z is not up (REP 103), as of a tracker
    with y up: the rotation about its z is no yaw.
    """
    yaw = yaw_of(q)
    square = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
    up = 1.0 - 2.0 * (q.x * q.x + q.y * q.y) / square  # the cosine of the tilt
    tilt_deg = math.degrees(math.acos(max(-1.0, min(1.0, up))))
    if tilt_deg > MAX_TILT_DEG:
        raise CodecError(
            f"its pose is tilted by {tilt_deg:.0f} deg; expected at most {MAX_TILT_DEG:g}, in a"
            " frame with x forward, y left and z up (REP 103)"
        )
    return yaw


def imu_readings(message: ros.Imu) -> dict[str, float]:
    """`yaw` in rad, unless the sensor has none; CodecError without a unit quaternion."""
    return {} if no_yaw(message) else {"yaw": yaw_of(message.orientation)}


def no_yaw(message: ros.Imu) -> str:
    """Why a message gives no `yaw`; empty if it does."""
    lacks = why_absent(message, "orientation.w")
    return f"no yaw: {lacks}" if lacks else ""


def battery_readings(
    message: ros.BatteryState,
    volts: tuple[float, float] | None = None,
    percentage: str | None = None,
) -> dict[str, float]:
    """The values `battery` (0 to 1) and `battery_voltage` in V that the message measures.

    With `volts`, the voltages of an empty and a full pack, `battery` is interpolated from the
    voltage. Otherwise `battery` is the field `percentage` of the message, if the argument
    `percentage` names its unit: `share` (0 to 1, as sensor_msgs defines) or `percent`, as some
    drivers send. A value that is impossible in this unit is left out.
    """
    voltage = message.voltage
    share = math.nan
    if not 0.0 <= voltage < math.inf or why_absent(message, "voltage", voltage):
        voltage = math.nan
    if volts is not None:
        share = max((voltage - volts[0]) / (volts[1] - volts[0]), 0.0)
    elif not why_absent(message, "percentage", message.percentage):
        share = message.percentage / _FULL.get(percentage or "", math.nan)
        share = share if 0.0 <= share <= _MAX_CHARGE else math.nan
    values = {"battery": min(share, 1.0), "battery_voltage": voltage}
    return {name: value for name, value in values.items() if not math.isnan(value)}


def no_battery(
    message: ros.BatteryState, volts: tuple[float, float] | None, percentage: str | None
) -> str:
    """Why a message gives no `battery`."""
    field = "percentage"
    value = message.percentage
    if volts is not None:
        field = "voltage"
        value = message.voltage
    if lacks := why_absent(message, field, value):
        return f"no battery: {lacks}"
    if volts is not None:
        return f"no battery: a voltage of {value:.3g} V is not measured"
    if percentage is None:
        return "no battery: set driver_options.battery_volts or .battery_percentage"
    if math.isnan(value):
        return "no battery: its percentage is not measured; set driver_options.battery_volts"
    return f"no battery: a percentage of {value:.3g} is no {percentage}"


def twist_message(twist: Twist) -> ros.Twist:
    """A command as a Twist."""
    return ros.Twist(
        linear=ros.Vector3(x=twist.linear, y=twist.lateral, z=0.0),
        angular=ros.Vector3(x=0.0, y=0.0, z=twist.angular),
    )


def command_message(twist: Twist, message_type: type, frame: str) -> ros.Twist | ros.TwistStamped:
    """A command as a Twist, or as a TwistStamped in that frame.

    The stamp is zero, which ros2_control takes for "now". ros2_control refuses commands that are
    old on its own clock, and the clocks of two machines need not agree.
    """
    message = twist_message(twist)
    if message_type is ros.Twist:
        return message
    header = ros.Header(stamp=ros.Time(sec=0, nanosec=0), frame_id=frame)
    return ros.TwistStamped(header=header, twist=message)


def twist_of(message: Any) -> Twist:
    """The command of a Twist or TwistStamped, of ROS 2 or ROS 1."""
    twist: Any = getattr(message, "twist", message)
    return Twist(twist.linear.x, twist.angular.z, twist.linear.y)


class RangeRingDecoder:
    """Makes one scan of several range sensors, each with its own topic.

    A scan ends once each sensor has sent a value since the last scan. It also ends before a sensor
    sends a second value: the rays of silent sensors are then NaN. A value with the stamp of the
    sensor's last value is a repeat, and is ignored. All rays have the same age.

    `bearings`: (n,) rad, of the sensors. `distances`: (n,) m from the origin of the scan to each
    sensor; a range of the scan is the value of the sensor plus this distance.
    """

    def __init__(
        self, bearings: Sequence[float], distances: Sequence[float], spec: ScanSpec
    ) -> None:
        self._bearings = _wrapped(np.array(bearings, dtype=np.float64))
        self._at_once = np.zeros(len(self._bearings))
        self._bearings.flags.writeable = False
        self._at_once.flags.writeable = False
        self._distances = tuple(distances)
        self._spec = spec
        self._round: dict[int, ros.Range] = {}
        self._stamps: dict[int, float] = {}
        self._seq = 0

    def take(self, index: int, message: ros.Range) -> Scan | None:
        """Add a value of a sensor; returns the scan that it completes, or None."""
        stamp = stamp_of(message.header.stamp)
        if self._stamps.get(index) == stamp:
            return None
        self._stamps[index] = stamp
        is_again = index in self._round
        scan = self._close() if is_again else None
        self._round[index] = message
        return self._close() if len(self._round) == len(self._bearings) else scan

    def _close(self) -> Scan:
        ranges = np.full(len(self._bearings), np.nan, np.float32)  # as a recording keeps them
        for index, message in self._round.items():
            value = message.range
            ranges[index] = value if value == 0.0 else value + self._distances[index]
        stamp = max(stamp_of(message.header.stamp) for message in self._round.values())
        self._round = {}
        self._seq += 1
        values = ranges.astype(np.float64)
        limits = self._spec.range_min, self._spec.range_max
        return Scan(self._seq, stamp, values, self._bearings, *limits, self._at_once)


@lru_cache(maxsize=8)
def _ages(step: float, count: int, period: float) -> Array | None:
    """(count,) s by which each ray is older than the newest ray; None if `step` is impossible.

    `step`: s between two rays in the order of the message; below 0 if the rays are in reversed
    order of time. A step is impossible if it is 0, or if `count` steps would take longer than
    _MAX_PERIODS times `period`, the s between two scans.
    """
    if step == 0.0 or not abs(step) * count <= _MAX_PERIODS * period:  # false for NaN too
        return None
    since = abs(step) * np.arange(count, dtype=np.float64)
    ages = since[::-1].copy() if step > 0.0 else since
    ages.flags.writeable = False
    return ages


@lru_cache(maxsize=8)
def _bearings(first: float, step: float, count: int) -> Array:
    """Bearings within [-pi, pi); one array for equal scans, computed once."""
    bearings = _wrapped(first + step * np.arange(count, dtype=np.float64))
    bearings.flags.writeable = False
    return bearings


def _wrapped(angles: Array) -> Array:
    return (angles + math.pi) % (2.0 * math.pi) - math.pi
