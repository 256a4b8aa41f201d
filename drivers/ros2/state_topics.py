"""The state of the robot as ROS 2 topics: pose, markers and diagnostics, by the driver's session.

`show` keeps the newest values; the driver's own task publishes them, so that no command waits. A
message is made only while a node subscribes to its topic.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
import zenoh
from zenoh.handlers import Callback

from swarmd.core.finding import Finding
from swarmd.core.messages import Motion, ShownPose, State, Status
from swarmd.core.values import Array, Platform, Pose
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros import messages as ros
from swarmd.drivers.ros.options import RosOptions
from swarmd.drivers.ros.to_ros import header, pose_message
from swarmd.drivers.ros2.key_scheme import KeyScheme, TopicEnd
from swarmd.link.carriers.session import has_subscriber

log = logging.getLogger(__name__)

POSE = "swarmd/pose"
MARKERS = "swarmd/markers"
DIAGNOSTICS = "diagnostics"
ODOMETRY_FRAME = "odom"
MAX_AGE = 1.0  # s after which a position by odometry is too old to publish
_TYPES: Mapping[str, type] = {
    POSE: ros.PoseStamped,
    MARKERS: ros.MarkerArray,
    DIAGNOSTICS: ros.DiagnosticArray,
}
_NO_DATA = np.empty(0, dtype=np.uint8)
_LIFETIME = 2  # s after which RViz removes the markers of a robot that is silent
_HELD = (0.95, 0.55, 0.1)  # the colour of a robot that runs and may not move: red, green, blue
_COLOURS: Mapping[State, tuple[float, float, float]] = {
    State.IDLE: (0.2, 0.4, 0.9),
    State.RUNNING: (0.1, 0.7, 0.2),
    State.STOPPED: (0.9, 0.8, 0.1),
    State.ESTOPPED: (0.7, 0.0, 0.0),
    State.FAULTED: (0.6, 0.1, 0.7),
}


class StateTopics:
    """Publishes the state of one robot; does nothing unless `options.publish_state`."""

    def __init__(self, scheme: KeyScheme, platform: Platform, options: RosOptions) -> None:
        self.is_on = options.publish_state
        self._scheme = scheme
        self._footprint = platform.footprint
        self._topics = {name: options.topic(name) for name in _TYPES if self.is_on}
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._watched: dict[str, bool] = {}
        self._unsure: set[str] = set()
        self._tokens: Mapping[str, str] = {}
        self._status: Status | None = None
        self._place: tuple[ros.Header, Pose] | None = None
        self._changed: set[str] = set()
        if self.is_on:
            cdr.build_codecs(*_TYPES.values())

    @property
    def ends(self) -> list[TopicEnd]:
        """The publishers, as a node announces them."""
        return [
            TopicEnd(topic, _TYPES[name], is_publisher=True, is_reliable=True, depth=1)
            for name, topic in self._topics.items()
        ]

    def findings(self) -> tuple[Finding, ...]:
        """The finding of `swarmd --check` on option `publish_state`."""
        if not self.is_on:
            return ()
        return (Finding("state topics", True, f"publishes {', '.join(self._topics.values())}"),)

    def show(
        self,
        status: Status | None,
        motion: Motion | None,
        pose: ShownPose | None,
        odometry_age: float,
    ) -> None:
        """Keep the newest state of the robot, for the next `publish`.

        `status` None: the last status still holds. `pose`: in a shared frame; None: not known.
        Without `pose`, the pose of `motion` by odometry counts, unless `odometry_age`, the age of
        its measurement in s, is above MAX_AGE. With neither, no pose is published. The stamp of a
        message is the time of the measurement.
        """
        if status is not None:
            self._status = status
            self._changed.add(DIAGNOSTICS)
        if pose is not None:
            head = header(time.time() - pose.age, pose.frame)
            self._place = head, Pose(pose.x, pose.y, pose.yaw)
        elif motion is not None and odometry_age <= MAX_AGE:
            head = header(time.time() - odometry_age, ODOMETRY_FRAME)
            self._place = head, Pose(motion.x, motion.y, motion.yaw)
        else:
            self._place = None
        self._changed |= {POSE, MARKERS}

    def open(self, session: zenoh.Session) -> None:
        """Declare the publishers on a new session."""
        for name, topic in self._topics.items():
            self._publishers[name] = publisher = session.declare_publisher(
                self._scheme.key(topic, _TYPES[name]),
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.BACKGROUND,
                allowed_destination=zenoh.Locality.REMOTE,
            )
            on_change = Callback(partial(self._on_subscribers, name), indirect=False)
            publisher.declare_matching_listener(on_change)
            self._unsure.add(name)

    def announced(self, tokens: Mapping[str, str]) -> None:
        """Set the liveliness tokens of the publishers, by topic."""
        self._tokens = tokens

    def publish(self) -> None:
        """Publish the topics that have changed and have subscribers. The driver's task calls this.

        A topic whose message raises an error is not published until the next session. The other
        topics and the driver are not affected.
        """
        changed = self._changed
        self._changed = set()
        for name in changed & self._publishers.keys():
            try:
                if self._update_watched(name) and (message := self._make(name)) is not None:
                    attachment = self._scheme.attachment(self._tokens.get(self._topics[name], ""))
                    with suppress(zenoh.ZError):  # the session is closing
                        self._publishers[name].put(cdr.encode(message), attachment=attachment)
            except Exception:
                log.exception("%s is not published any more", self._topics[name])
                del self._publishers[name]

    def close(self) -> None:
        """Forget the publishers of the session and the changes that were not published."""
        self._publishers.clear()
        self._changed.clear()
        self._tokens = {}

    def _on_subscribers(self, name: str, _: zenoh.MatchingStatus) -> None:
        """Note a first or last subscriber; a thread of Zenoh calls it."""
        self._unsure.add(name)

    def _update_watched(self, name: str) -> bool:
        """Ask Zenoh, after a change, whether a topic has subscribers; True if it has any."""
        if name in self._unsure:
            self._unsure.discard(name)  # before the question: a later change adds it again
            self._watched[name] = has_subscriber(self._publishers[name])
        return self._watched[name]

    def _make(self, name: str) -> object | None:
        status = self._status
        if name == DIAGNOSTICS:
            return None if status is None else diagnostics(status, time.time())
        if self._place is None:
            return None
        head, pose = self._place
        if name == POSE:
            return ros.PoseStamped(header=head, pose=pose_message(pose))
        return None if status is None else markers(status, pose, head, self._footprint)


def markers(status: Status, pose: Pose, head: ros.Header, footprint: Array) -> ros.MarkerArray:
    """Markers for RViz: the robot's outline, heading and text, in the colour of its state.

    `footprint`: (n, 2) m, the corners of the outline in the base frame. `pose`: in the frame of
    `head`.
    """
    is_held = status.state is State.RUNNING and status.reason is not None
    red, green, blue = _HELD if is_held else _COLOURS[status.state]
    length = float(abs(footprint[:, 0]).max())
    outline = [ros.Point(x=float(x), y=float(y), z=0.0) for x, y in (*footprint, footprint[0])]
    heading = [ros.Point(x=0.0, y=0.0, z=0.0), ros.Point(x=1.5 * length, y=0.0, z=0.0)]
    reason = "" if status.reason is None else f"\n{status.reason.value}"
    text = f"{status.robot}: {status.state.value}{reason}"
    make: Callable[..., Any] = partial(
        ros.Marker,
        header=head,
        ns=f"swarmd/{status.robot}",
        action=ros.Marker.ADD,
        pose=pose_message(pose),
        color=ros.ColorRGBA(r=red, g=green, b=blue, a=1.0),
        lifetime=ros.Duration(sec=_LIFETIME, nanosec=0),
        # These fields have no meaning here, but a message needs a value for each of its fields.
        frame_locked=False,
        colors=[],
        texture_resource="",
        texture=ros.CompressedImage(header=head, format="", data=_NO_DATA),
        uv_coordinates=[],
        mesh_resource="",
        mesh_file=ros.MeshFile(filename="", data=_NO_DATA),
        mesh_use_embedded_materials=False,
    )
    return ros.MarkerArray(
        markers=[
            make(id=0, type=ros.Marker.LINE_STRIP, scale=_scale(0.02), points=outline, text=""),
            make(id=1, type=ros.Marker.ARROW, scale=_scale(0.02, 0.05), points=heading, text=""),
            make(id=2, type=ros.Marker.TEXT_VIEW_FACING, scale=_scale(0.1), points=[], text=text),
        ]
    )


def diagnostics(status: Status, stamp: float) -> ros.DiagnosticArray:
    """The robot's state, reason, hold and speed limit by protection, as a diagnostic status.

    `stamp`: s of the message. The level is ERROR for a robot that is stopped or has a fault, and
    WARN for a robot that is held, has findings or has lost its base.
    """
    decision = status.decision
    reason = "" if status.reason is None else status.reason.value
    is_held = status.state is State.RUNNING and bool(reason)
    # Protection's strongest speed limit, the first constraint: m/s towards an obstacle.
    limit = ""
    if decision.rows:
        constraint = decision.rows[0]
        limit = (
            f"{constraint.cap:.2f} m/s towards {math.degrees(constraint.bearing):.0f} deg,"
            f" gap {constraint.gap:.2f} m"
        )
    values = {
        "state": status.state.value,
        "reason": reason,
        "detail": status.detail,
        "pattern": status.pattern or "",
        "hold": reason if is_held else "",
        "protection": "active" if decision.is_active else "clear",
        "limit": limit,
        "speed_share": f"{decision.speed_share:.2f}",
        "scan_rate": f"{status.health.scan_rate:.1f}",
        "driver": status.health.driver,
        "findings": "; ".join(status.findings),
        "emergency_stops": str(len(status.latches)),
    }
    kind = ros.DiagnosticStatus
    base_text = "" if status.health.driver_up else "base lost"
    if status.state in (State.ESTOPPED, State.FAULTED):
        level = kind.ERROR
    elif is_held or status.findings or base_text:
        level = kind.WARN
    else:
        level = kind.OK
    texts = (status.state.value, reason, status.detail, base_text)
    diagnostic = kind(
        level=level,
        name=f"swarmd: {status.robot}",
        message=": ".join(filter(None, texts)),
        hardware_id=status.robot,
        values=[ros.KeyValue(key=key, value=value) for key, value in values.items()],
    )
    return ros.DiagnosticArray(header=header(stamp, ""), status=[diagnostic])


def _scale(x: float, y: float | None = None) -> ros.Vector3:
    """The size of a marker in m. `x`: of a line, a shaft or a text. `y`: of an arrow's head."""
    return ros.Vector3(x=x, y=x if y is None else y, z=x)
