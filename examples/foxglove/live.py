"""Show a living swarm in Foxglove, from Zenoh alone: no import of swarmd.

pip install eclipse-zenoh msgpack foxglove-sdk
swarmctl zenoh --out meadow.json5
python examples/foxglove/live.py meadow.json5 meadow

In Foxglove: Open connection, ws://127.0.0.1:8765, a 3D panel with the frame `odometry`.

The server only shows. It listens on this machine alone, but it asks for no secret and looks at no
origin: every program here, and every web page that is open in a browser here, can read what it
shows. Each pose is by the robot's own odometry, so the places of robots are not comparable unless
their frames are one.
"""

import argparse
import contextlib
import math
import queue
import struct

import foxglove
import msgpack
import zenoh
from foxglove.channels import FrameTransformChannel, PointCloudChannel
from foxglove.messages import (
    FrameTransform,
    PackedElementField,
    PackedElementFieldNumericType,
    PointCloud,
    Pose,
    Quaternion,
    Vector3,
)

VERSION = 1  # the first byte of each payload; MessagePack follows


def turn(yaw: float) -> Quaternion:
    """The rotation by `yaw` rad about the vertical axis."""
    return Quaternion(x=0.0, y=0.0, z=math.sin(yaw / 2.0), w=math.cos(yaw / 2.0))


def floats(data: bytes) -> list[float]:
    """The numbers of little-endian float32."""
    return [one for (one,) in struct.iter_unpack("<f", data)]


def points(robot: str, ranges: list[float], bearings: bytes | list[float]) -> PointCloud:
    """The returns of a scan (m), in the frame of the robot.

    `bearings`: (first, step) in rad, or one for each ray as float32.
    """
    if isinstance(bearings, bytes):
        angles = floats(bearings)
    else:
        first, step = bearings
        angles = [first + step * index for index in range(len(ranges))]
    data = b"".join(
        struct.pack("<3f", reach * math.cos(angle), reach * math.sin(angle), 0.0)
        for reach, angle in zip(ranges, angles, strict=True)
        if math.isfinite(reach)
    )
    kind = PackedElementFieldNumericType.Float32
    return PointCloud(
        frame_id=robot,
        pose=Pose(position=Vector3(x=0.0, y=0.0, z=0.0), orientation=turn(0.0)),
        point_stride=12,
        fields=[
            PackedElementField(name=axis, offset=4 * index, type=kind)
            for index, axis in enumerate("xyz")
        ],
        data=data,
    )


def main() -> None:
    """Subscribe to motion, scans and statuses of all robots, and hand them to Foxglove."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("config", help="what `swarmctl zenoh --out` wrote")
    parser.add_argument("swarm", help="the name of the swarm")
    parser.add_argument("--port", type=int, default=8765, help="of this machine; 0: any free one")
    parser.add_argument("--count", type=int, default=0, help="messages until the end; 0: no end")
    options = parser.parse_args()
    arrived: queue.SimpleQueue[tuple[str, str, bytes]] = queue.SimpleQueue()
    poses = FrameTransformChannel("/tf")
    scans: dict[str, PointCloudChannel] = {}
    statuses: dict[str, foxglove.Channel] = {}

    def take(sample: zenoh.Sample) -> None:
        """Hand over robot, name and payload of a sample, on a thread of Zenoh."""
        _, _, robot, _, name = str(sample.key_expr).split("/")
        arrived.put((robot, name, sample.payload.to_bytes()))

    def show(robot: str, name: str, value: object) -> None:
        """Hand a message to Foxglove."""
        if name == "motion" and isinstance(value, list):
            place = Vector3(x=value[2], y=value[3], z=0.0)
            poses.log(
                FrameTransform(
                    parent_frame_id="odometry",
                    child_frame_id=robot,
                    translation=place,
                    rotation=turn(value[4]),
                )
            )
        elif name == "scan" and isinstance(value, list):
            cloud = scans.setdefault(robot, PointCloudChannel(f"/{robot}/scan"))
            cloud.log(points(robot, floats(value[2]), value[3]))
        elif name == "status" and isinstance(value, dict):
            if robot not in statuses:
                statuses[robot] = foxglove.Channel(f"/{robot}/status", message_encoding="json")
            statuses[robot].log({key: value[key] for key in ("state", "reason", "pattern")})

    server = foxglove.start_server(name=f"swarm {options.swarm}", port=options.port)
    print(f"Foxglove: ws://127.0.0.1:{server.port}", flush=True)
    count = 0
    with (
        contextlib.suppress(KeyboardInterrupt),
        zenoh.open(zenoh.Config.from_file(options.config)) as session,
    ):
        for name in ("motion", "scan", "status"):
            session.declare_subscriber(f"swarm/{options.swarm}/*/state/{name}", take)
        while not options.count or count < options.count:
            robot, name, payload = arrived.get()
            if payload[0] == VERSION:
                show(robot, name, msgpack.unpackb(payload[1:]))
                count += 1
    server.stop()
    print(f"messages: {count}")


if __name__ == "__main__":
    main()
