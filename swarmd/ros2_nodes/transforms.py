"""`tf2_ros` of one robot: a buffer of transforms, and what fills it from `/tf` and `/tf_static`.

The buffer answers from what it has: a callback never waits.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable
from types import ModuleType
from typing import Any, NamedTuple, NoReturn, TypeAlias

from swarmd.ros2_nodes.node import RobotSide
from swarmd.ros2_nodes.qos import DurabilityPolicy, QoSProfile
from swarmd.ros2_nodes.ros_time import S_TO_NS

TF_MESSAGE = "tf2_msgs/msg/TFMessage"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
KEPT = 10 * S_TO_NS
"""ns for which a transform is kept, as tf2 does."""
MAX_FRAMES = 1_000
Vector: TypeAlias = tuple[float, float, float]
Rotation: TypeAlias = tuple[float, float, float, float]
"""A unit quaternion x, y, z, w."""


class TransformException(Exception):
    """The base of the errors of tf2."""


class LookupException(TransformException):
    """A frame is not known."""


class ConnectivityException(TransformException):
    """Two frames are not connected."""


class ExtrapolationException(TransformException):
    """There is no transform at that time."""


class InvalidArgumentException(TransformException):
    """An argument is no frame, or a quaternion has no length."""


class TimeoutException(TransformException):
    """Never raised: nothing waits."""


class Transform(NamedTuple):
    """Where a frame is in another one: its origin in m, and its rotation."""

    origin: Vector = (0.0, 0.0, 0.0)
    rotation: Rotation = (0.0, 0.0, 0.0, 1.0)

    def then(self, inner: Transform) -> Transform:
        """Where a frame is that is at `inner` in this frame."""
        x, y, z = _turned(self.rotation, inner.origin)
        at = (self.origin[0] + x, self.origin[1] + y, self.origin[2] + z)
        return Transform(at, _product(self.rotation, inner.rotation))

    def inverse(self) -> Transform:
        """Where the outer frame is in this one."""
        x, y, z, w = self.rotation
        back = (-x, -y, -z, w)
        ox, oy, oz = _turned(back, self.origin)
        return Transform((-ox, -oy, -oz), back)


class Frames:
    """The transforms of a robot by the child frame: its parent, and its places over time.

    Pure: times are given in ns.
    """

    def __init__(self) -> None:
        self._parents: dict[str, str] = {}
        self._static: dict[str, Transform] = {}
        self._times: dict[str, list[int]] = {}
        self._places: dict[str, list[Transform]] = {}

    def set(self, parent: str, child: str, at: int, place: Transform, *, is_static: bool) -> None:
        """Keep where `child` is in `parent` at a time.

        A time before the newest is left out. InvalidArgumentException for a wrong frame or place.
        """
        parent = parent.lstrip("/")
        child = child.lstrip("/")
        if not parent or not child or parent == child:
            raise InvalidArgumentException(f"a transform from {parent!r} to {child!r} is none")
        if not all(map(math.isfinite, (*place.origin, *place.rotation))):
            raise InvalidArgumentException(f"the transform of {child!r} has a NaN")
        if abs(math.hypot(*place.rotation) - 1.0) > 0.01:
            raise InvalidArgumentException(f"the rotation of {child!r} is no unit quaternion")
        if child not in self._parents and len(self._parents) >= MAX_FRAMES:
            raise InvalidArgumentException(f"more than {MAX_FRAMES} frames")
        if self._parents.get(child, parent) != parent:  # as tf2: the last parent counts
            self._times.pop(child, None)
            self._places.pop(child, None)
        self._parents[child] = parent
        if is_static:
            self._static[child] = place
            return
        self._static.pop(child, None)
        times = self._times.setdefault(child, [])
        places = self._places.setdefault(child, [])
        if times and at <= times[-1]:
            return
        times.append(at)
        places.append(place)
        old = bisect_right(times, at - KEPT)
        del times[:old], places[:old]

    def lookup(self, target: str, source: str, at: int) -> tuple[Transform, int]:
        """Where `source` is in `target`, and the time in ns; `at` 0: the newest common time.

        LookupException, ConnectivityException or ExtrapolationException without an answer.
        """
        target = target.lstrip("/")
        source = source.lstrip("/")
        for what, frame in (("target_frame", target), ("source_frame", source)):
            if frame not in self._parents and frame not in self._parents.values():
                raise LookupException(
                    f'"{frame}" passed to lookupTransform argument {what} does not exist.'
                )
        above_target = self._above(target)
        above_source = self._above(source)
        common = next((one for one in above_source if one in above_target), None)
        if common is None:
            raise ConnectivityException(
                f"Could not find a connection between '{target}' and '{source}' because they are"
                " not part of the same tree. Tf has two or more unconnected trees."
            )
        down = above_source[: above_source.index(common)]
        up = above_target[: above_target.index(common)]
        if at == 0:
            moving = [self._times[one][-1] for one in (*down, *up) if one not in self._static]
            at = min(moving, default=0)
        place = self._chain(up, at).inverse().then(self._chain(down, at))
        return place, at

    def _above(self, frame: str) -> list[str]:
        """The frame, its parent, and so on; a loop ends where it closes."""
        found = [frame]
        while (parent := self._parents.get(found[-1])) is not None and parent not in found:
            found.append(parent)
        return found

    def _chain(self, frames: Iterable[str], at: int) -> Transform:
        """Where the first of these frames is in the parent of the last one."""
        place = Transform()
        for frame in frames:
            place = self._at(frame, at).then(place)
        return place

    def _at(self, frame: str, at: int) -> Transform:
        if frame in self._static:
            return self._static[frame]
        times = self._times[frame]
        if not times[0] <= at <= times[-1]:
            when = "past" if at < times[0] else "future"
            raise ExtrapolationException(
                f"Lookup would require extrapolation into the {when}: requested"
                f" {at / S_TO_NS:.6f} s, {frame} is known from {times[0] / S_TO_NS:.6f} to"
                f" {times[-1] / S_TO_NS:.6f} s"
            )
        after = bisect_right(times, at)
        if times[after - 1] == at:
            return self._places[frame][after - 1]
        first = times[after - 1]
        last = times[after]
        before, behind = self._places[frame][after - 1 : after + 1]
        return _between(before, behind, (at - first) / (last - first))


def _product(a: Rotation, b: Rotation) -> Rotation:
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def _turned(rotation: Rotation, vector: Vector) -> Vector:
    x, y, z, w = rotation
    turned = _product(_product(rotation, (*vector, 0.0)), (-x, -y, -z, w))
    return turned[:3]


def _between(a: Transform, b: Transform, share: float) -> Transform:
    """Linear between two places; their rotations are near to one another."""
    rest = 1.0 - share
    sign = 1.0 if sum(p * q for p, q in zip(a.rotation, b.rotation, strict=True)) >= 0.0 else -1.0
    x, y, z, w = (rest * p + sign * share * q for p, q in zip(a.rotation, b.rotation, strict=True))
    length = math.hypot(x, y, z, w)
    ox, oy, oz = (rest * p + share * q for p, q in zip(a.origin, b.origin, strict=True))
    return Transform((ox, oy, oz), (x / length, y / length, z / length, w / length))


# tf2_ros


def tf2_ros(side: RobotSide) -> dict[str, ModuleType]:
    """The stand-in for `tf2_ros`, and its submodules that nodes import."""

    class Buffer:
        """Keeps transforms, and looks them up."""

        def __init__(self, *_: Any, **__: Any) -> None:
            self._frames = Frames()

        def set_transform(self, transform: Any, authority: str = "") -> None:
            self._set(transform, is_static=False)

        def set_transform_static(self, transform: Any, authority: str = "") -> None:
            self._set(transform, is_static=True)

        def lookup_transform(
            self, target_frame: str, source_frame: str, time: Any = None, timeout: Any = None
        ) -> Any:
            at = 0 if time is None else int(time.nanoseconds)
            place, found = self._frames.lookup(target_frame, source_frame, at)
            message: Any = side.graph.types.kind(TRANSFORM)()
            message.header.stamp = side.time(nanoseconds=found).to_msg()
            message.header.frame_id = target_frame.lstrip("/")
            message.child_frame_id = source_frame.lstrip("/")
            translation = message.transform.translation
            rotation = message.transform.rotation
            translation.x, translation.y, translation.z = place.origin
            rotation.x, rotation.y, rotation.z, rotation.w = place.rotation
            return message

        def can_transform(
            self,
            target_frame: str,
            source_frame: str,
            time: Any = None,
            timeout: Any = None,
            return_debug_tuple: bool = False,
        ) -> Any:
            text = ""
            try:
                at = 0 if time is None else int(time.nanoseconds)
                self._frames.lookup(target_frame, source_frame, at)
            except TransformException as error:
                text = str(error)
            side.graph.count_question("waits for a transform")
            return (not text, text) if return_debug_tuple else not text

        def __getattr__(self, name: str) -> Any:
            if name in ("transform", "transform_full", "lookup_transform_full") or "async" in name:
                _refuse(side, f"Buffer.{name}")
            raise AttributeError(name)

        def _set(self, transform: Any, *, is_static: bool) -> None:
            stamp = transform.header.stamp
            t = transform.transform.translation
            r = transform.transform.rotation
            self._frames.set(
                transform.header.frame_id,
                transform.child_frame_id,
                stamp.sec * S_TO_NS + stamp.nanosec,
                Transform((t.x, t.y, t.z), (r.x, r.y, r.z, r.w)),
                is_static=is_static,
            )

    class TransformListener:
        """Fills a buffer from `/tf` and `/tf_static`."""

        def __init__(self, buffer: Any, node: Any, *_: Any, **__: Any) -> None:
            kind = side.graph.types.kind(TF_MESSAGE)

            def on_tf(message: Any) -> None:
                for one in message.transforms:
                    buffer.set_transform(one)

            def on_static(message: Any) -> None:
                for one in message.transforms:
                    buffer.set_transform_static(one)

            node.create_subscription(kind, "/tf", on_tf, 100)
            node.create_subscription(kind, "/tf_static", on_static, _latched())

        def unregister(self) -> None:
            pass

    class Broadcaster:
        """Publishes transforms."""

        topic = "/tf"

        def __init__(self, node: Any, *_: Any, **__: Any) -> None:
            profile = _latched() if self.topic == "/tf_static" else 100
            self._kind = side.graph.types.kind(TF_MESSAGE)
            self._publisher = node.create_publisher(self._kind, self.topic, profile)

        def sendTransform(self, transform: Any) -> None:  # the name in tf2_ros
            many = transform if isinstance(transform, list | tuple) else [transform]
            self._publisher.publish(self._kind(transforms=list(many)))

    static = type("StaticTransformBroadcaster", (Broadcaster,), {"topic": "/tf_static"})
    errors = {
        kind.__name__: kind
        for kind in (
            *(TransformException, LookupException, ConnectivityException, TimeoutException),
            *(ExtrapolationException, InvalidArgumentException),
        )
    }
    parts: dict[str, dict[str, Any]] = {
        "buffer": {"Buffer": Buffer},
        "transform_listener": {"TransformListener": TransformListener},
        "transform_broadcaster": {"TransformBroadcaster": Broadcaster},
        "static_transform_broadcaster": {"StaticTransformBroadcaster": static},
    }
    made = {"tf2_ros": ModuleType("tf2_ros"), "tf2_py": ModuleType("tf2_py")}
    made["tf2_ros"].__dict__["__path__"] = []
    made["tf2_py"].__dict__.update(errors)
    for name, members in parts.items():
        made[f"tf2_ros.{name}"] = ModuleType(f"tf2_ros.{name}")
        made[f"tf2_ros.{name}"].__dict__.update({**members, **errors})
        made["tf2_ros"].__dict__.update({**members, **errors, name: made[f"tf2_ros.{name}"]})
    return made


def _latched() -> QoSProfile:
    return QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def _refuse(side: RobotSide, name: str) -> NoReturn:
    side.graph.refuse(f"tf2_ros: {name}: use lookup_transform, which answers at once")
