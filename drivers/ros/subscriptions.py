"""The messages of a ROS robot's topics as values for a sink, with statistics of each topic."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from itertools import chain
from typing import Any

from swarmd.core.errors import CodecError
from swarmd.core.events import (
    OdometryInput,
    PoseInput,
    RangesInput,
    ScanInput,
    SensorInput,
)
from swarmd.core.finding import Finding
from swarmd.core.values import Platform, Scan
from swarmd.driver_api.driver import Sink
from swarmd.drivers.ros import cdr, from_ros, messages
from swarmd.drivers.ros.carried_pose import CarriedPose
from swarmd.drivers.ros.odometry_jumps import OdometryJumps
from swarmd.drivers.ros.options import TopicOptions
from swarmd.drivers.ros.topic_entries import ENTRY_KINDS
from swarmd.drivers.ros.topic_inputs import TopicEntry, TopicInputs
from swarmd.drivers.ros.topic_readings import BATTERY, IMU, Readings
from swarmd.drivers.ros.topic_stats import TopicStats
from swarmd.robot.protection.footprint import Footprint
from swarmd.robot.sensing.scan_content import ScanContent

Deliver = Callable[[Sink], None]
Decode = Callable[[type, bytes], Any]
"""Reads a message of the given class; raises CodecError."""

_SIGNS_OF_LIFE = (messages.LaserScan, messages.Range, messages.Odometry)


class Subscriptions:
    """Decodes the messages of a robot's topics, and keeps statistics of each topic.

    A driver makes a new object for each run, so sequence numbers of scans begin anew with a run.
    `topics`: the statistics of each topic by its name in this driver, such as `scan`.
    `last_arrival`: s of the last scan, range or odometry. `contents`: what the scans show, by the
    option that names their topics (`scan` or `ranges`).
    """

    def __init__(
        self, options: TopicOptions, platform: Platform, decode: Decode = cdr.decode
    ) -> None:
        """Start without a message; `decode` reads the bytes of a message of a class."""
        self._decode = decode
        self._spec = platform.scan
        self._yaw = math.radians(options.scan_yaw_deg)
        self._is_upside_down = options.scan_upside_down
        self._pose_errors = options.shared_pose_error, math.radians(options.shared_pose_error_deg)
        self._carried_pose = CarriedPose()
        self._jumps = OdometryJumps()
        self._battery = options.battery_volts, options.battery_percentage
        self._scan_seq = 0
        self._laser: messages.LaserScan | None = None  # the last
        self.last_arrival = -math.inf
        self.contents: dict[str, ScanContent] = {}
        has_lidar = not options.ranges or platform.ranges is not None
        if has_lidar:
            self.contents["scan"] = ScanContent(
                platform.scan, gaps=Footprint(platform.footprint).gaps
            )
        self._add_ring(options, platform)
        self._add_entries(options)
        self.topics: Mapping[str, TopicStats] = {
            stats.name: stats for stats in _topics(options, platform, has_lidar)
        }

    def _add_ring(self, options: TopicOptions, platform: Platform) -> None:
        """Make the decoder of the ring: of the range sensors whose values make one scan.

        The option `ranges` names a topic for each sensor; a robot without the option has no ring.
        The section `ranges` of the platform describes a ring beside a lidar. Without this section
        the ring takes the place of the lidar, and the section `scan` describes the ring.
        """
        ring_spec = platform.ranges
        section = "ranges"
        if ring_spec is None:
            ring_spec = platform.scan
            section = "scan"
        if options.ranges:
            self.contents["ranges"] = ScanContent(ring_spec, section)
        ring = options.ring()  # name, bearing in rad and distance in m of each sensor
        self._ring = from_ros.RangeRingDecoder(
            [bearing for _, bearing, _ in ring], [distance for _, _, distance in ring], ring_spec
        )
        self._ring_index = {_range_name(name): index for index, (name, _, _) in enumerate(ring)}

    def _add_entries(self, options: TopicOptions) -> None:
        """Set `_inputs` and `_entries_of` for the entries of the options in ENTRY_KINDS.

        An entry, such as `readings.light`, reads a value from the messages of a topic. `_inputs`:
        by option, the object that collects the values of all entries of the option. `_entries_of`:
        by topic, the pairs of such an object and an entry that reads the topic.
        """
        entries = options.topic_entries
        self._inputs = {
            option: kind.inputs(entries[option]) for option, kind in ENTRY_KINDS.items()
        }
        self._entries_of: dict[str, list[tuple[TopicInputs[Any, Any], TopicEntry]]] = {}
        for option, inputs in self._inputs.items():
            for entry in entries[option].values():
                self._entries_of.setdefault(entry.topic, []).append((inputs, entry))

    def read(self, name: str, payload: bytes, now: float, *, is_kept: bool = False) -> Deliver:
        """Decode a message; returns the function that delivers its values to a sink.

        The caller must call the returned function only while the base is connected. Raises
        CodecError.

        Args:
            name: of the topic in `topics`.
            payload: the message.
            now: s on the caller's clock, the arrival.
            is_kept: the message comes from the cache of a publisher of `kept_topics`, and may be
                older than messages that have arrived.
        """
        stats = self.topics[name]
        message = self._decode(stats.message_type, payload)
        header = getattr(message, "header", None)
        stamp = 0.0 if header is None else from_ros.stamp_of(header.stamp)  # 0: not set
        entries_text = self._take_entries(stats, message, stamp, now, is_kept)
        deliver_entries = partial(self.deliver_inputs, now=now)
        if stats.has_only_entries:
            if is_kept and stats.stamps:
                stamp = stats.stamps[-1]  # an older stamp would look like a second publisher
            measured_at = stamp or now  # some messages have no stamp
            summary = entries_text or stats.summary  # a copy that no entry takes has no text
            stats.record(now, measured_at, summary)
            return deliver_entries
        if is_kept and stats.message_type is messages.PoseWithCovarianceStamped:
            pose = from_ros.shared_pose_of(message, *self._pose_errors)
            self._carried_pose.on_kept_pose(pose)
        if is_kept:  # only the entries of a standard topic, such as odometry, take a kept message
            return deliver_entries
        deliver, value_text = self._value(stats, message, now)
        stats.record(now, stamp, ", ".join(filter(None, (value_text, entries_text))))
        if stats.message_type in _SIGNS_OF_LIFE:
            self.last_arrival = now
        return partial(_deliver_all, (deliver, deliver_entries)) if entries_text else deliver

    def _take_entries(
        self, stats: TopicStats, message: Any, stamp: float, now: float, is_kept: bool
    ) -> str:
        """Hand a message to the entries of its topic; returns their values as text.

        The text is empty without entries. `stamp`: s; 0 without a stamp. An entry whose values
        become stale takes no copy (a message with the stamp of the message before) and no kept
        message, since neither shows that the sensor still measures.
        """
        is_copy = bool(stamp and stats.stamps and stamp == stats.stamps[-1])
        taken = (
            inputs.take(entry.name, message, now, is_kept=is_kept)
            for inputs, entry in self._entries_of.get(stats.topic, ())
            if entry.is_never_stale or not (is_copy or is_kept)
        )
        return ", ".join(taken)

    @property
    def kept_topics(self) -> dict[str, TopicStats]:
        """The topics whose last message counts until the next message, by their full names."""
        return {
            stats.topic: stats
            for stats in self.topics.values()
            if stats.message_type is messages.PoseWithCovarianceStamped
            or any(entry.is_never_stale for _, entry in self._entries_of.get(stats.topic, ()))
        }

    def forget(self, topic: str | None = None) -> None:
        """Drop the values of `topic` that never become stale; None: those of all topics.

        Called when a message may have been missed, such as after the publisher has left.
        """
        for inputs in self._inputs.values():
            inputs.forget(topic)
        localised = messages.PoseWithCovarianceStamped
        if topic is None:
            self._carried_pose = CarriedPose()
        elif any(
            one.topic == topic and one.message_type is localised for one in self.topics.values()
        ):
            self._carried_pose.forget()

    def deliver_inputs(self, sink: Sink, now: float, *, again: bool = False) -> None:
        """Deliver the inputs whose values have changed or have become stale.

        `again`: deliver all inputs. Call this function only while the base is connected.
        """
        for inputs in self._inputs.values():
            input = inputs.input(now, again=again)
            if input is not None:
                sink.take(input)

    def awaited(self, now: float) -> tuple[TopicStats, ...]:
        """The topics whose silence holds the robot, and which have been silent for too long."""
        silent = {topic for inputs in self._inputs.values() for topic in inputs.awaited(now)}
        return tuple(stats for stats in self.topics.values() if stats.topic in silent)

    def silent(self, now: float, timeout: float) -> tuple[TopicStats, ...]:
        """The needed topics without a message for longer than `timeout` s."""
        return tuple(
            stats
            for stats in self.topics.values()
            if stats.is_needed and now - stats.last_arrival() > timeout
        )

    def odometry_age(self, now: float) -> float:
        """Seconds since the last odometry has arrived; inf before the first."""
        return now - self.topics["odometry"].last_arrival()

    @property
    def scan(self) -> Scan | None:
        """The last scan of the lidar, or of the range ring in its place; None before the first."""
        return (self.contents.get("scan") or self.contents["ranges"]).last

    def sweep_finding(self) -> Finding | None:
        """The finding on the sweep of the last LaserScan; None without a LaserScan."""
        if self._laser is None:
            return None
        return from_ros.sweep_finding(self._laser, self._spec, is_upside_down=self._is_upside_down)

    def _value(self, stats: TopicStats, message: Any, now: float) -> tuple[Deliver, str]:
        """The function that delivers a message's value to a sink, and the value as text.

        The message is of a standard topic: scan, ranges, odometry, shared pose, imu or battery. The
        text is for a check.
        """
        if stats.message_type is messages.LaserScan:
            return self._scan_value(stats, message), ""
        if stats.message_type is messages.Range:
            return self._range_value(stats, message), f"{message.range:.3g} m"
        if stats.message_type is messages.Odometry:
            odometry = from_ros.odometry_of(message)
            stats.doubt = self._jumps.take(odometry, now)
            poses = self._carried_pose.on_odometry(odometry)
            return partial(_deliver, (OdometryInput(odometry), *poses)), ""
        if stats.message_type in (messages.PoseStamped, messages.PoseWithCovarianceStamped):
            try:
                pose = from_ros.shared_pose_of(message, *self._pose_errors)
            except CodecError:  # such as the error of a localisation that is lost
                self._carried_pose.forget()
                raise
            if stats.message_type is messages.PoseWithCovarianceStamped:
                self._carried_pose.on_pose(pose)
            return partial(_deliver, (PoseInput(pose),)), f"frame {pose.frame}"
        if stats.message_type is messages.Imu:
            values = self._take_imu(message)
            missing = from_ros.no_yaw(message)
        else:
            values = from_ros.battery_readings(message, *self._battery)
            self._readings.take_own(BATTERY, values)
            missing = "" if "battery" in values else from_ros.no_battery(message, *self._battery)
        texts = [f"{name} {value:.3g}" for name, value in values.items()]
        return partial(self.deliver_inputs, now=now), ", ".join(filter(None, (*texts, missing)))

    @property
    def _readings(self) -> Readings:
        """The object that collects all readings: of option `readings`, `imu` and `battery`."""
        readings = self._inputs["readings"]
        assert isinstance(readings, Readings)
        return readings

    def _take_imu(self, message: Any) -> Mapping[str, float]:
        """The readings of a message of option `imu`. After a CodecError there is no yaw."""
        self._readings.take_own(IMU, {})  # so that a message without a yaw ends the earlier yaw
        values = from_ros.imu_readings(message)
        self._readings.take_own(IMU, values)
        return values

    def _range_value(self, stats: TopicStats, message: Any) -> Deliver:
        """How to deliver the scan of the ring that a sensor's value completes, if any."""
        ring_scan = self._ring.take(self._ring_index[stats.name], message)
        if ring_scan is None:
            return partial(_deliver, ())
        self.contents["ranges"].take(ring_scan)
        has_lidar = "scan" in self.contents  # without a lidar the ring takes its place
        kind = RangesInput if has_lidar else ScanInput
        return partial(_deliver, (kind(ring_scan),))

    def _scan_value(self, stats: TopicStats, message: messages.LaserScan) -> Deliver:
        """How to deliver a LaserScan; nothing is delivered while the sensor has not measured."""
        self._scan_seq += 1
        self._laser = message
        scan = from_ros.scan_of(
            message, self._scan_seq, self._spec, self._yaw, is_upside_down=self._is_upside_down
        )
        content = self.contents["scan"]
        content.take(scan, message.range_max)
        unmeasured = "" if content.has_measured else content.fault
        doubt = unmeasured or from_ros.header_fault(message)
        stats.doubt = (stats.doubt or doubt) if doubt else ""
        return partial(_deliver, () if unmeasured else (ScanInput(scan),))


def _deliver_all(parts: Iterable[Deliver], sink: Sink) -> None:
    for deliver in parts:
        deliver(sink)


def _deliver(inputs: Iterable[SensorInput], sink: Sink) -> None:
    for input in inputs:
        sink.take(input)


def _topics(options: TopicOptions, platform: Platform, has_lidar: bool) -> list[TopicStats]:
    """The statistics of each topic that the options name: one for each full name of a topic.

    An entry (topic_entries.py) may share a topic with a sensor, or with another entry. The topic
    then has the statistics of the first option that names it.
    """
    topic = options.topic
    topics = [
        TopicStats(_range_name(name), "ranges", topic(name), messages.Range, is_needed=True)
        for name in options.ranges
    ]
    if has_lidar:
        scan_topic = topic(options.scan_topic)
        scan = TopicStats("scan", "scan", scan_topic, messages.LaserScan, is_needed=True)
        topics.insert(0, scan)
    needs_odometry = "odometry" in platform.provides
    topics.append(
        TopicStats(
            "odometry",
            "odometry",
            topic(options.odometry),
            messages.Odometry,
            is_needed=needs_odometry,
        )
    )
    for option, name, message_type in (
        ("imu", options.imu, messages.Imu),
        ("battery", options.battery, messages.BatteryState),
        ("shared_pose", options.shared_pose, options.pose_type),
    ):
        if name is not None:
            topics.append(TopicStats(option, option, topic(name), message_type))
    by_topic = {stats.topic: stats for stats in topics}
    entries = chain.from_iterable(given.values() for given in options.topic_entries.values())
    # The sensors of a list in a message, such as `data.*`, are several entries of one option, with
    # equal topic, type and `stale_after`. The option counts once.
    for option, entry in {entry.option: entry for entry in entries}.items():
        if entry.topic in by_topic:
            by_topic[entry.topic].further.append(option)
        else:
            by_topic[entry.topic] = TopicStats(
                option, option, entry.topic, entry.message_type, has_only_entries=True
            )
        stats = by_topic[entry.topic]
        stats.stale_after = min(stats.stale_after, entry.stale_after)
    return list(by_topic.values())


def _range_name(topic: str) -> str:
    return f"ranges.{topic}"
