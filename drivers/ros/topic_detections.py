"""Option `detections`: objects in messages: boxes of a camera image, positions, AprilTags."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from swarmd.core.angles import wrap
from swarmd.core.errors import ConfigError
from swarmd.core.events import DetectionsInput
from swarmd.core.values import MAX_DETECTIONS, MAX_WORD, ROBOT, Detection
from swarmd.drivers.ros.absence import why_absent
from swarmd.drivers.ros.message_types import MessageTypes
from swarmd.drivers.ros.topic_inputs import TopicEntry, TopicInputs, faults_of
from swarmd.drivers.ros.topic_readings import Step, Text, path_of, value_at

OBJECT = "object"
"""The kind of an object without a class in its message."""

TAGS = "apriltag_msgs/AprilTag"
"""Prefix of the message types of tags."""

Metres = Annotated[float, Meta(ge=-10.0, le=10.0)]
Kind = Annotated[str, Meta(min_length=1, max_length=MAX_WORD)]
_MAX_LISTED = 3  # objects in the text of a message
_MIN_DEPTH = 1e-3  # m
_DEFAULT_SIZE = 0.1  # m, of a tag without option `size`


class DetectionOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One entry of the option `detections`.

    - `type`: Detection2DArray or Detection3DArray of vision_msgs, or AprilTagDetectionArray of
      apriltag_msgs.
    - `at`, `bearing_deg`: position in m and direction of the camera in the base frame.
    - `frame`: the axes of positions: `optical` (x right, z forward) or `body` (x forward, y left).
    - `image_width`, `field_of_view_deg`: pixels, and the horizontal angle, of images without
      distortion.
    - `size`: m, the side of the tags or the height of the objects; the distance follows from it.
    - `robots`: maps the class or id of an object to the robot that carries it, such as a tag on a
      peer; the robot's patterns then have the place of that neighbour.
    - `kinds`: maps the class or id of an object to its kind; else the kind is the class.
    - `stale_after`: s without a message after which the objects are not known.
    """

    topic: Text
    type: Annotated[str, Meta(min_length=3, max_length=200)]
    at: tuple[Metres, Metres] = (0.0, 0.0)
    bearing_deg: Annotated[float, Meta(ge=-360.0, le=360.0)] = 0.0
    frame: Literal["optical", "body"] = "optical"
    image_width: Annotated[float, Meta(ge=1.0, le=100_000.0)] | None = None
    field_of_view_deg: Annotated[float, Meta(ge=1.0, le=175.0)] | None = None
    size: Annotated[float, Meta(gt=0.0, le=100.0)] | None = None
    robots: dict[str, Kind] = {}
    kinds: dict[str, Kind] = {}
    stale_after: Annotated[float, Meta(ge=0.1, le=3600.0)] = 1.0

    def topics(self, name: str) -> dict[str, str]:
        """The topic of the entry `name`, by the option that messages name."""
        return {f"detections.{name}": self.topic}


@dataclass(frozen=True, slots=True)
class _Layout:
    """The names of a detection's fields in a message type.

    Each field has alternative names, since definitions differ between versions of vision_msgs. The
    first name that the definition has is used.
    """

    kind: Sequence[str]
    id: Sequence[str]
    place: Sequence[str]  # a pixel of the image, or a position
    is_image: bool = True  # `place` is a pixel
    height: Sequence[str] = ()  # of the object in the image
    corners: Sequence[str] = ()  # of a tag in the image


_CLASSES = "results.0.hypothesis.class_id", "results.0.id"
_IDS = "id", "tracking_id"
_LAYOUTS = {
    "vision_msgs/Detection2DArray": _Layout(
        _CLASSES, _IDS, ("bbox.center.position", "bbox.center"), height=("bbox.size_y",)
    ),
    "vision_msgs/Detection3DArray": _Layout(
        _CLASSES, _IDS, ("bbox.center.position",), is_image=False
    ),
    f"{TAGS}DetectionArray": _Layout(("family",), ("id",), ("centre",), corners=("corners",)),
}


@dataclass(frozen=True, slots=True)
class TopicDetections(TopicEntry):
    """Reads the objects in messages by the steps to their fields; None: no such field."""

    options: DetectionOptions
    is_image: bool  # `place` is a pixel
    place: tuple[Step, ...]
    kind: tuple[Step, ...] | None
    id: tuple[Step, ...] | None
    height: tuple[Step, ...] | None
    corners: tuple[Step, ...] | None

    def read(self, message: Any) -> tuple[Detection, ...]:
        """The objects in a message whose place is there and finite."""
        read = (self._detection(item) for item in message.detections[:MAX_DETECTIONS])
        return tuple(item for item in read if item is not None and item.is_valid)

    def _detection(self, item: Any) -> Detection | None:
        """An object in the base frame; None without a place."""
        bearing, distance = self._from_camera(item)
        if why_absent(item, "bbox") or not math.isfinite(bearing):
            return None
        bearing += math.radians(self.options.bearing_deg)
        if distance is not None:
            x, y = self.options.at
            x = x + distance * math.cos(bearing)
            y = y + distance * math.sin(bearing)
            bearing = math.atan2(y, x)
            distance = math.hypot(x, y)
        own = self._word(item, self.id)
        given = self._word(item, self.kind)
        kinds = self.options.kinds
        kind = kinds.get(own) or kinds.get(given) or given or OBJECT
        if robot := self.options.robots.get(own) or self.options.robots.get(given):
            return Detection(ROBOT, wrap(bearing), distance, robot)
        return Detection(kind[:MAX_WORD], wrap(bearing), distance, own[:MAX_WORD])

    def _from_camera(self, item: Any) -> tuple[float, float | None]:
        """Bearing in rad and distance in m from the camera, in the camera's frame.

        In an image the distance follows from the size in pixels by the pinhole model. The distance
        is None without the option `size`. The bearing is NaN without a place in the image.
        """
        place = value_at(item, self.place)
        if not self.is_image:
            is_optical = self.options.frame == "optical"
            ahead, left = (place.z, -place.x) if is_optical else (place.x, place.y)
            return math.atan2(left, ahead), math.hypot(left, ahead)
        width = self.options.image_width or 1.0
        focal = _focal(width, self.options.field_of_view_deg or 90.0)
        if not math.isfinite(place.x):
            return math.nan, None
        bearing = math.atan2(0.5 * width - place.x, focal)
        pixels = self._pixels(item)
        size = self.options.size
        if size is None or not 0.0 < pixels < math.inf:
            return bearing, None
        return bearing, focal * size / pixels / math.cos(bearing)

    def _pixels(self, item: Any) -> float:
        """The height of an object, or the longest side of a tag, in pixels; 0 if not known."""
        if self.height is not None:
            return float(value_at(item, self.height))
        if self.corners is None:
            return 0.0
        corners = value_at(item, self.corners)
        # A tag that is turned about the vertical looks narrower: the longest side counts.
        sides = zip(corners, [*corners[1:], corners[0]], strict=True)
        return max(math.hypot(a.x - b.x, a.y - b.y) for a, b in sides)

    def pixels(self, seen: Detection) -> tuple[float, float] | None:
        """The horizontal position and the side length of an object in the image, in pixels.

        None if the object is outside the image or has no distance. The inverse of `read`, for
        simulated cameras.
        """
        if seen.distance is None:
            return None
        camera_x, camera_y = self.options.at
        x = seen.distance * math.cos(seen.bearing) - camera_x
        y = seen.distance * math.sin(seen.bearing) - camera_y
        bearing = wrap(math.atan2(y, x) - math.radians(self.options.bearing_deg))
        width = self.options.image_width or 1.0
        view = self.options.field_of_view_deg or 90.0
        if abs(bearing) > math.radians(0.5 * view):
            return None
        depth = max(math.hypot(x, y) * math.cos(bearing), _MIN_DEPTH)
        focal = _focal(width, view)
        side = focal * (self.options.size or _DEFAULT_SIZE) / depth
        return 0.5 * width - focal * math.tan(bearing), side

    @staticmethod
    def _word(item: Any, path: tuple[Step, ...] | None) -> str:
        try:
            value = "" if path is None else str(value_at(item, path))
        except IndexError:  # the detection has no hypothesis
            return ""
        return value if value.isprintable() else ""


def _focal(width: float, view_deg: float) -> float:
    """The focal length in pixels of a pinhole camera with this horizontal field of view."""
    return 0.5 * width / math.tan(0.5 * math.radians(view_deg))


def topic_detections(
    name: str, options: DetectionOptions, full_name: Callable[[str], str], types: MessageTypes
) -> tuple[TopicDetections]:
    """The reader of the entry `name` of option `detections`, as `EntryKind.read` returns readers.

    `full_name(topic)` returns the full name of a topic. `types`: the known message types.
    ConfigError names the key that is wrong.
    """
    option = f"detections.{name}"
    type_name = options.type.replace("/msg/", "/")
    if type_name not in _LAYOUTS:
        raise ConfigError(f"{option}.type is {options.type!r}; expected {', '.join(_LAYOUTS)}")
    layout = _LAYOUTS[type_name]
    with faults_of(f"{option}.type"):
        message_type = types.kind(options.type)
        item_type = _item_type(types, message_type)
        place = _first(types, item_type, layout.place)
        if place is None:
            raise ConfigError(f"its definition has no {layout.place[0]}")
    if layout.is_image:
        for key in ("image_width", "field_of_view_deg"):
            if getattr(options, key) is None:
                raise ConfigError(f"{option}.{key} is missing; expected that of the images")
    entry = TopicDetections(
        name=name,
        option=option,
        topic=full_name(options.topic),
        message_type=message_type,
        stale_after=options.stale_after,
        options=options,
        is_image=layout.is_image,
        place=place,
        kind=_first(types, item_type, layout.kind),
        id=_first(types, item_type, layout.id),
        height=_first(types, item_type, layout.height),
        corners=_first(types, item_type, layout.corners),
    )
    return (entry,)


def _item_type(types: MessageTypes, message_type: type) -> type:
    """The message type of the items of the list `detections` in messages of a type."""
    _, (_, list_detail) = path_of(types, message_type, "detections")
    item_node = list_detail[0]  # rosbags' node of an item: (kind of node, name of the type)
    return types.kind(item_node[1])


def _first(types: MessageTypes, item_type: type, fields: Sequence[str]) -> tuple[Step, ...] | None:
    """The steps to the first of `fields` that the definition has; None if it has none of them."""
    for field in fields:
        try:
            return path_of(types, item_type, field)[0]
        except ConfigError:
            continue
    return None


class Detections(TopicInputs[TopicDetections, tuple[Detection, ...]]):
    """The objects that all topics together detect now."""

    def __init__(self, entries: Mapping[str, TopicDetections]) -> None:
        super().__init__(entries)
        self._is_reported = not entries  # the present values were returned by `input`
        self._was_known = False

    def take(self, name: str, message: Any, now: float, *, is_kept: bool = False) -> str:
        """See `TopicInputs`."""
        objects = self._entries[name].read(message)
        self._values[name] = (objects, now)
        self._is_reported = False
        unplaced = min(len(message.detections), MAX_DETECTIONS) - len(objects)
        unplaced_text = [f"{unplaced} without a place"] if unplaced else []
        return ", ".join((*_texts(objects), *unplaced_text)) or "no object"

    def input(self, now: float, *, again: bool = False) -> DetectionsInput | None:
        """The objects of all topics together; None if they have not changed since the last call.

        While a topic has been silent for longer than its `stale_after`, or was never heard, the
        objects are not known: the `DetectionsInput` has None in place of objects. `again`: return
        an input although nothing has changed.
        """
        is_known = not any(self._stale(now))
        is_due = again or not self._is_reported or (self._was_known and not is_known)
        if not (self._entries and is_due):
            return None
        self._is_reported = True
        self._was_known = is_known
        seen = (self._values[name][0] for name in self._entries) if is_known else ()
        objects = tuple(chain.from_iterable(seen))[:MAX_DETECTIONS]
        return DetectionsInput(objects if is_known else None)


def _texts(objects: Sequence[Detection]) -> Iterator[str]:
    for detection in objects[:_MAX_LISTED]:
        distance = "" if detection.distance is None else f", {detection.distance:.3g} m"
        name = f"{detection.kind} {detection.id}".rstrip()
        yield f"{name} at {math.degrees(detection.bearing):.0f} deg{distance}"
    if len(objects) > _MAX_LISTED:
        yield f"{len(objects) - _MAX_LISTED} more"
