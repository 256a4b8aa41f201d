"""What a ROS robot says: each topic's messages as values for a sink, and a record of each topic."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from swarmd.core.values import Odometry as Measured
from swarmd.core.values import Platform, Scan
from swarmd.driver_api.driver import Sink
from swarmd.drivers.ros import from_ros as conversion
from swarmd.drivers.ros.cdr import decode
from swarmd.drivers.ros.messages import BatteryState, Imu, LaserScan, Odometry, Range
from swarmd.drivers.ros.options import RosOptions, ring_of, topic
from swarmd.drivers.ros.topic_stats import Sense

Deliver = Callable[[Sink], None]

_LIVELY = (LaserScan, Range, Odometry)


class Subscriptions:
    """Reads the robot's topics. One for each run of the driver: sequences begin anew with it."""

    def __init__(self, options: RosOptions, platform: Platform) -> None:
        """`senses`: the record of each topic by its name in here."""
        self._spec = platform.scan
        self._yaw = math.radians(options.scan_yaw_deg)
        self._is_upside_down = options.scan_upside_down
        self._scan_seq = 0
        self.scan: Scan | None = None
        self.heard_at = -math.inf
        self._readings: dict[str, float] = {}
        self._ring = ring_of(options)
        self._merge = conversion.RangeRing(
            [bearing for _, bearing, _ in self._ring],
            [distance for _, _, distance in self._ring],
            platform.scan,
        )
        self.senses: Mapping[str, Sense] = {
            sense.name: sense for sense in _senses(options, platform)
        }

    def take(self, name: str, payload: bytes, now: float) -> Deliver:
        """Read one message; what to do with it once the base counts as there. CodecError."""
        sense = self.senses[name]
        message: Any = decode(sense.kind, payload)
        stamp = conversion.stamp_of(message.header.stamp)
        deliver, text = self._read(name, message)
        sense.hear(now, stamp, text)
        if sense.kind in _LIVELY:
            self.heard_at = now
        return deliver

    def missing(self, now: float, silence: float) -> tuple[Sense, ...]:
        """The topics that are needed and have not spoken for that long."""
        return tuple(
            sense
            for sense in self.senses.values()
            if sense.is_needed and now - sense.heard_at() > silence
        )

    def _read(self, name: str, message: object) -> tuple[Deliver, str]:
        if isinstance(message, LaserScan):
            self._scan_seq += 1
            scan = conversion.scan_of(
                message,
                self._scan_seq,
                self._spec,
                self._yaw,
                is_upside_down=self._is_upside_down,
            )
            return self._given(scan), f"{len(scan.ranges)} rays"
        if isinstance(message, Range):
            index = next(i for i, (topic, _, _) in enumerate(self._ring) if name == _named(topic))
            return self._given(self._merge.take(index, message)), f"{message.range:.3g} m"
        if isinstance(message, Odometry):
            return partial(_odometry, conversion.odometry_of(message)), ""
        if isinstance(message, Imu):
            return self._told(conversion.imu_readings(message))
        assert isinstance(message, BatteryState)
        return self._told(conversion.battery_readings(message))

    def _given(self, scan: Scan | None) -> Deliver:
        if scan is None:
            return _nothing
        self.scan = scan
        return partial(_scan, scan)

    def _told(self, values: Mapping[str, float]) -> tuple[Deliver, str]:
        self._readings = {**self._readings, **values}
        text = ", ".join(f"{name} {value:.3g}" for name, value in values.items())
        return partial(_readings, self._readings), text


def _senses(options: RosOptions, platform: Platform) -> list[Sense]:
    ring = ring_of(options)
    needs_odometry = "odometry" in platform.provides
    found = [
        Sense(_named(name), "ranges", topic(options, name), Range, is_needed=True)
        for name, _, _ in ring
    ]
    if not ring:
        found = [Sense("scan", "scan", topic(options, options.scan), LaserScan, is_needed=True)]
    found.append(
        Sense("odometry", "odometry", topic(options, options.odometry), Odometry, needs_odometry)
    )
    if options.imu is not None:
        found.append(Sense("imu", "imu", topic(options, options.imu), Imu))
    if options.battery is not None:
        found.append(Sense("battery", "battery", topic(options, options.battery), BatteryState))
    return found


def _named(topic: str) -> str:
    return f"ranges.{topic}"


def _nothing(sink: Sink) -> None:
    pass


def _scan(scan: Scan, sink: Sink) -> None:
    sink.scan(scan)


def _odometry(odometry: Measured, sink: Sink) -> None:
    sink.odometry(odometry)


def _readings(values: Mapping[str, float], sink: Sink) -> None:
    sink.readings(values)
