"""The messages of a ROS robot's topics as values for a sink, with statistics of each topic."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from swarmd.core.values import Platform, Scan
from swarmd.driver_api.driver import Finding, Sink
from swarmd.drivers.ros import cdr, from_ros
from swarmd.drivers.ros.messages import (
    BatteryState,
    Imu,
    LaserScan,
    Odometry,
    PoseStamped,
    PoseWithCovarianceStamped,
    Range,
)
from swarmd.drivers.ros.options import TopicOptions
from swarmd.drivers.ros.topic_readings import Readings
from swarmd.drivers.ros.topic_stats import READING, TopicStats

Deliver = Callable[[Sink], None]
Decode = Callable[[type, bytes], Any]
"""Reads a message of the given class; raises CodecError."""

_SIGNS_OF_LIFE = (LaserScan, Range, Odometry)


class Subscriptions:
    """Reads a robot's topics. A driver makes one for each run: scan sequences begin again with it.

    `topics`: the statistics of each topic by its name in this driver, such as `scan`.
    `last_arrival`: of a scan, a range or odometry. `scan`: the last one, None before the first.
    """

    def __init__(
        self, options: TopicOptions, platform: Platform, decode: Decode = cdr.decode
    ) -> None:
        """Nothing received yet."""
        self._decode, self._spec = decode, platform.scan
        self._yaw = math.radians(options.scan_yaw_deg)
        self._is_upside_down = options.scan_upside_down
        self._pose_errors = options.shared_pose_error, math.radians(options.shared_pose_error_deg)
        self._scan_seq = 0
        self.scan: Scan | None = None
        self._laser: LaserScan | None = None
        self.last_arrival = -math.inf
        readings = options.topic_readings()
        self._readings = Readings(readings)
        self._readings_of: dict[str, list[str]] = {}
        for name, reading in readings.items():
            self._readings_of.setdefault(reading.topic, []).append(name)
        ring = options.ring()
        self._ring = from_ros.RangeRing(
            [bearing for _, bearing, _ in ring], [away for _, _, away in ring], platform.scan
        )
        self._ring_index = {_range_name(name): index for index, (name, _, _) in enumerate(ring)}
        self.topics: Mapping[str, TopicStats] = {
            stats.name: stats for stats in _topics(options, platform)
        }

    def read(self, name: str, payload: bytes, now: float) -> Deliver:
        """Decode one message; how to deliver it once the base is connected. Raises CodecError."""
        stats = self.topics[name]
        message = self._decode(stats.message_type, payload)
        if stats.is_reading:
            return self._read_readings(stats, message, now)
        stamp = from_ros.stamp_of(message.header.stamp)
        deliver, summary = self._value(stats, message, now)
        stats.record(now, stamp, summary)
        if stats.message_type in _SIGNS_OF_LIFE:
            self.last_arrival = now
        return deliver

    def _read_readings(self, stats: TopicStats, message: Any, now: float) -> Deliver:
        """The readings of a message; a message that repeats a stamp is as old as its first copy.

        Standard messages have no stamp, and many publishers fill in none: then the arrival counts.
        """
        header = getattr(message, "header", None)
        stamp = 0.0 if header is None else from_ros.stamp_of(header.stamp)
        summary = stats.summary
        if not (stamp and stats.stamps and stamp == stats.stamps[-1]):
            names = self._readings_of[stats.topic]
            summary = ", ".join(self._readings.take(name, message, now) for name in names)
        stats.record(now, stamp or now, summary)
        return self._deliver_readings(now)

    def stale_readings(self, now: float) -> Deliver | None:
        """How to deliver that a reading has become stale; None without news."""
        changed = self._readings.changed(now)
        return None if changed is None else lambda sink: sink.readings(changed)

    def silent(self, now: float, timeout: float) -> tuple[TopicStats, ...]:
        """The needed topics without a message for longer than `timeout` s."""
        return tuple(
            stats
            for stats in self.topics.values()
            if stats.is_needed and now - stats.last_arrival() > timeout
        )

    def sweep_finding(self) -> Finding | None:
        """How the rays of the last scan follow one another; None without a scan of one message."""
        if self._laser is None:
            return None
        return from_ros.sweep_finding(self._laser, self._spec, is_upside_down=self._is_upside_down)

    def _value(self, stats: TopicStats, message: Any, now: float) -> tuple[Deliver, str]:
        if stats.message_type is LaserScan:
            self._scan_seq += 1
            self._laser = message
            self.scan = scan = from_ros.scan_of(
                message, self._scan_seq, self._spec, self._yaw, is_upside_down=self._is_upside_down
            )
            return partial(_deliver_scan, scan), f"{len(scan.ranges)} rays"
        if stats.message_type is Range:
            whole = self._ring.take(self._ring_index[stats.name], message)
            self.scan = whole or self.scan
            return partial(_deliver_scan, whole), f"{message.range:.3g} m"
        if stats.message_type is Odometry:
            odometry = from_ros.odometry_of(message)
            return lambda sink: sink.odometry(odometry), ""
        if stats.message_type in (PoseStamped, PoseWithCovarianceStamped):
            pose = from_ros.shared_pose_of(message, *self._pose_errors)
            return lambda sink: sink.pose(pose), f"frame {pose.frame}"
        is_imu = stats.message_type is Imu
        values = (from_ros.imu_readings if is_imu else from_ros.battery_readings)(message)
        self._readings.take_own(values)
        summary = ", ".join(f"{name} {value:.3g}" for name, value in values.items())
        return self._deliver_readings(now), summary

    def _deliver_readings(self, now: float) -> Deliver:
        values = self._readings.at(now)
        return lambda sink: sink.readings(values)


def _deliver_scan(scan: Scan | None, sink: Sink) -> None:
    if scan is not None:
        sink.scan(scan)


def _topics(options: TopicOptions, platform: Platform) -> list[TopicStats]:
    topic = options.topic
    found = [
        TopicStats(_range_name(name), "ranges", topic(name), Range, is_needed=True)
        for name in options.ranges
    ] or [TopicStats("scan", "scan", topic(options.scan), LaserScan, is_needed=True)]
    needs_odometry = "odometry" in platform.provides
    found.append(
        TopicStats("odometry", "odometry", topic(options.odometry), Odometry, needs_odometry)
    )
    for name, given, message_type in (
        ("imu", options.imu, Imu),
        ("battery", options.battery, BatteryState),
        ("shared_pose", options.shared_pose, options.pose_type),
    ):
        if given is not None:
            found.append(TopicStats(name, name, topic(given), message_type))
    of_readings: dict[str, TopicStats] = {}
    for reading in options.topic_readings().values():
        name = f"{READING}{reading.name}"
        one = TopicStats(name, name, reading.topic, reading.message_type)
        one.stale_after = reading.stale_after
        of_readings.setdefault(reading.topic, one)
    return [*found, *of_readings.values()]


def _range_name(topic: str) -> str:
    return f"ranges.{topic}"
