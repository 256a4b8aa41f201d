"""Serves a living swarm to Foxglove by its WebSocket protocol, read only.

The messages are those of Foxglove's SDK. `FoxgloveServer.publish` encodes a message only if a
client subscribes to its channel.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from foxglove import messages

from swarmd.core.closing import Closing
from swarmd.core.state_colours import colour_of
from swarmd.core.values import Array
from swarmd.view.foxglove_socket import Channel, FoxgloveSocket, protobuf_channel
from swarmd.view.source import ShownRobot, Source, json_of

PERIOD = 0.1
"""Seconds between two calls of `publish`; Foxglove gets statuses at a tenth of that rate."""
WORLD = "world"
"""The common parent frame. Real robots have no common frame: each pose is by its own odometry."""
_STATUS_EVERY = 10
_MAX_NEW_LINES = 50
_STATUS_SCHEMA: dict[str, Any] = {
    "type": "object",
    "title": "swarmd.RobotRow",
    "properties": {
        "state": {"type": "string"},
        "why": {"type": "string"},
        "pattern": {"type": "string"},
        "presence": {"type": "string"},
        "protection": {"type": "string"},
        "near": {"type": "number"},
        "age": {"type": "number"},
        "report": {"type": "object"},
        "readings": {"type": "object"},
        "requested": {"type": "array", "items": {"type": "number"}},
        "safe": {"type": "array", "items": {"type": "number"}},
    },
}


class FoxgloveServer(Closing):
    """Serves a source to Foxglove until `close`; a context manager.

    `address`: of the server; its path has the secret. Channels: `/tf` (poses), `/robots` (outlines,
    headings and names in the colours of states), `/events`, and for each robot `/NAME/status` and
    `/NAME/scan`.
    """

    def __init__(self, source: Source, host: str, port: int) -> None:
        """Listen; port 0: any free port. NetworkError if the address cannot be bound."""
        self._source = source
        self._places = protobuf_channel("/tf", messages.FrameTransforms)
        self._scene = protobuf_channel("/robots", messages.SceneUpdate)
        self._events = protobuf_channel("/events", messages.Log)
        self._statuses: dict[str, Channel] = {}
        self._scans: dict[str, Channel] = {}
        self._count = 0
        self._shown: set[tuple[float, str]] = set()
        self._socket = FoxgloveSocket(f"swarm {source.swarm}", host, port)
        self._socket.add([self._places, self._scene, self._events])
        self.address = self._socket.address

    def close(self) -> None:
        """End the server and its connections."""
        self._socket.close()

    def publish(self) -> None:
        """Send the present state to the Foxglove clients; call it each PERIOD.

        Only channels that a client reads are filled: transforms (poses), the scene (outlines and
        names), scans as point clouds, and every _STATUS_EVERY periods the statuses as JSON.
        """
        is_status_due = self._count % _STATUS_EVERY == 0
        # By robot, the values of the last status. Scene and transforms show which robots are
        # absent.
        needs_rows = is_status_due or self._scene.is_read or self._places.is_read
        rows = self._source.rows() if needs_rows else {}
        robots = self._source.robots
        for robot in robots:
            if robot.name not in self._statuses:
                self._add(robot.name)
        # The source gets the scans of selected robots only.
        self._source.select([name for name, channel in self._scans.items() if channel.is_read])
        _, places = self._source.frame()  # (k, 4): index of the robot, x, y (m), yaw (rad)
        # A robot may have joined since `robots` was read.
        placed = [(robots[int(row[0])], row[1:]) for row in places if int(row[0]) < len(robots)]
        stamp = messages.Timestamp.now()
        if self._places.is_read:
            self._publish_places(placed, rows, stamp)
        if self._scene.is_read:
            entities = [_entity(robot, rows.get(robot.name, {}), stamp) for robot, _ in placed]
            self._socket.send(self._scene, messages.SceneUpdate(entities=entities).encode())
        self._publish_scans(stamp)
        if is_status_due:
            self._publish_statuses(rows)
        self._publish_events()
        self._count += 1

    def _publish_places(
        self,
        placed: Sequence[tuple[ShownRobot, Array]],
        rows: Mapping[str, Mapping[str, Any]],
        stamp: messages.Timestamp,
    ) -> None:
        """Send the poses (x, y, yaw) of robots as transforms.

        The transform of an absent robot has the stamp of the robot's last message, so that Foxglove
        does not show the robot as present.
        """
        now = time.time()
        old_stamps = {name: _heard(row, now) for name, row in rows.items() if _is_absent(row)}
        transforms = [
            _transform(robot, pose, old_stamps.get(robot.name, stamp)) for robot, pose in placed
        ]
        frames = messages.FrameTransforms(transforms=transforms)
        self._socket.send(self._places, frames.encode())

    def _publish_scans(self, stamp: messages.Timestamp) -> None:
        for name, channel in self._scans.items():
            points = self._source.scan(name) if channel.is_read else None
            if points is not None:
                self._socket.send(channel, _cloud(name, points, stamp).encode())

    def _publish_statuses(self, rows: Mapping[str, Mapping[str, Any]]) -> None:
        for name, channel in self._statuses.items():
            if channel.is_read and name in rows:
                self._socket.send(channel, json_of(rows[name]).encode())

    def _publish_events(self) -> None:
        if not self._events.is_read:
            return
        marks = self._source.marks()
        new = [mark for mark in marks if mark[:2] not in self._shown]
        self._shown = {mark[:2] for mark in marks}
        monotonic_to_epoch = time.time() - time.monotonic()  # s
        for at, text, names in new[-_MAX_NEW_LINES:]:
            line = messages.Log(
                timestamp=messages.Timestamp.from_epoch_secs(at + monotonic_to_epoch),
                level=messages.LogLevel.Info,
                message=text,
                name=", ".join(names),
            )
            self._socket.send(self._events, line.encode())

    def _add(self, name: str) -> None:
        title, schema = _STATUS_SCHEMA["title"], json.dumps(_STATUS_SCHEMA)
        self._statuses[name] = Channel(f"/{name}/status", "json", title, "jsonschema", schema)
        self._scans[name] = protobuf_channel(f"/{name}/scan", messages.PointCloud)
        self._socket.add([self._statuses[name], self._scans[name]])


def _is_absent(row: Mapping[str, Any]) -> bool:
    """True for a robot that does not answer: its pose and state now are not known."""
    return bool(row.get("presence", "alive") != "alive")


def _heard(row: Mapping[str, Any], now: float) -> messages.Timestamp:
    """The time at which a robot was last heard, as the stamp of its pose; 0 if not known."""
    at = now - float(row.get("age", math.inf))
    return messages.Timestamp.from_epoch_secs(max(at, 0.0))


def _transform(
    robot: ShownRobot, place: Array, stamp: messages.Timestamp
) -> messages.FrameTransform:
    x, y, yaw = map(float, place)
    return messages.FrameTransform(
        timestamp=stamp,
        parent_frame_id=WORLD,
        child_frame_id=robot.name,
        translation=messages.Vector3(x=x, y=y, z=0.0),
        rotation=messages.Quaternion(x=0.0, y=0.0, z=math.sin(0.5 * yaw), w=math.cos(0.5 * yaw)),
    )


def _entity(
    robot: ShownRobot, row: Mapping[str, Any], stamp: messages.Timestamp
) -> messages.SceneEntity:
    """Outline, heading and name of a robot in its own frame; Foxglove removes them after 2 s.

    `row`: the values of its last status. A robot that does not answer is grey and without a state.
    A robot that runs and may not move (`held`) has a colour of its own.
    """
    is_absent = _is_absent(row)
    state = "" if is_absent else str(row.get("state", ""))
    is_held = row.get("stands") == "held" and not is_absent
    red, green, blue = colour_of(state, is_held=is_held)
    colour = messages.Color(r=red, g=green, b=blue, a=1.0)
    outline = [messages.Point3(x=float(x), y=float(y), z=0.0) for x, y in robot.footprint]
    arrow_length = float(np.abs(robot.footprint[:, 0]).max())  # m, to the farther end
    third_line = row.get("why") or row.get("pattern") or ""
    label = "\n".join(filter(None, (robot.name, state, third_line)))
    return messages.SceneEntity(
        timestamp=stamp,
        frame_id=robot.name,
        id=robot.name,
        lifetime=messages.Duration(2),
        frame_locked=True,
        lines=[
            messages.LinePrimitive(
                type=messages.LinePrimitiveLineType.LineLoop,
                pose=_pose(0.0),
                thickness=0.02,
                points=outline,
                color=colour,
            )
        ],
        arrows=[
            messages.ArrowPrimitive(
                pose=_pose(0.0),
                shaft_length=arrow_length,
                shaft_diameter=0.02,
                head_length=0.5 * arrow_length,
                head_diameter=0.05,
                color=colour,
            )
        ],
        texts=[
            messages.TextPrimitive(
                pose=_pose(0.2),
                billboard=True,
                font_size=12.0,
                scale_invariant=True,
                color=colour,
                text=label,
            )
        ],
    )


def _cloud(name: str, points: Array, stamp: messages.Timestamp) -> messages.PointCloud:
    """The returns of a scan, in the frame of the robot."""
    flat = np.zeros((len(points), 3), dtype="<f4")
    flat[:, :2] = points
    kind = messages.PackedElementFieldNumericType.Float32
    return messages.PointCloud(
        timestamp=stamp,
        frame_id=name,
        pose=_pose(0.0),
        point_stride=12,
        fields=[
            messages.PackedElementField(name=axis, offset=4 * i, type=kind)
            for i, axis in enumerate("xyz")
        ],
        data=flat.tobytes(),
    )


def _pose(z: float) -> messages.Pose:
    return messages.Pose(
        position=messages.Vector3(x=0.0, y=0.0, z=z),
        orientation=messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
    )
