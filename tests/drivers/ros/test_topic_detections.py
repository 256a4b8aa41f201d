"""Detected objects of topics: boxes of an image, positions and tags, with their age."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores

from swarmd.core.errors import ConfigError
from swarmd.core.values import Detection, Value
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros.message_types import MessageTypes
from swarmd.drivers.ros.options import Ros1Options, RosOptions, TopicOptions, read_options
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.drivers.ros.topic_detections import TopicDetections
from swarmd.testing.driver_contract import CollectingSink, DriverHarness, play
from tests.drivers.ros2 import robots
from tests.drivers.ros2.harness import check
from tests.drivers.ros2.robots import BridgedRobot
from tests.support.vendor_messages import detections_folder, write_package

TAGS: dict[str, Value] = {
    "topic": "tags",
    "type": "apriltag_msgs/AprilTagDetectionArray",
    "image_width": 640,
    "field_of_view_deg": 90,
    "size": 0.1,
}
BOXES: dict[str, Value] = {**TAGS, "topic": "boxes", "type": "vision_msgs/Detection2DArray"}
LEFT, DIAGONAL = round(math.pi / 4, 6), round(math.sqrt(2.0), 6)
CLOUD: dict[str, Value] = {"topic": "cloud", "type": "vision_msgs/Detection3DArray"}


class Topics:
    """Makes messages of the packages in a folder."""

    def __init__(self, root: Path) -> None:
        self.path = str(detections_folder(root))
        self._types = MessageTypes(Stores.ROS2_JAZZY, [self.path])
        self._stamps = itertools.count(1)

    @property
    def header(self) -> Any:
        """The next one: stamps rise."""
        stamp = self.make("builtin_interfaces/Time", next(self._stamps), 0)
        return self.make("std_msgs/Header", stamp, "camera")

    def make(self, kind: str, *fields: Any) -> Any:
        return self._types.kind(kind)(*fields)

    def options(self, **entries: Mapping[str, Value]) -> RosOptions:
        given: dict[str, Any] = {"detections": entries, "message_path": self.path}
        return read_options(RosOptions, given, "ros2dds", "r")

    def tags(self, *found: tuple[int, float, float]) -> bytes:
        """Tags by id, column and side in pixels; each is turned away, and so half as wide."""
        items = []
        for number, u, side in found:
            half = 0.5 * side
            corners = [(-0.5, -1), (0.5, -1), (0.5, 1), (-0.5, 1)]
            points = [
                self.make("apriltag_msgs/Point", u + half * x, 200.0 + half * y) for x, y in corners
            ]
            centre, pose = self.make("apriltag_msgs/Point", u, 200.0), np.eye(3).ravel()
            fields = "36h11", number, 0, 1.0, 50.0, centre, points, pose
            items.append(self.make("apriltag_msgs/AprilTagDetection", *fields))
        return cdr.encode(self.make("apriltag_msgs/AprilTagDetectionArray", self.header, items))

    def hypotheses(self, kind: str) -> list[Any]:
        place = self.make(
            "geometry_msgs/PoseWithCovariance", self.pose(0.0, 0.0, 0.0), np.zeros(36)
        )
        hypothesis = self.make("vision_msgs/ObjectHypothesis", kind, 0.9)
        return [self.make("vision_msgs/ObjectHypothesisWithPose", hypothesis, place)]

    def pose(self, x: float, y: float, z: float) -> Any:
        turn = self.make("geometry_msgs/Quaternion", 0.0, 0.0, 0.0, 1.0)
        return self.make("geometry_msgs/Pose", self.make("geometry_msgs/Point", x, y, z), turn)

    def cloud(self, kind: str, *places: tuple[float, float, float]) -> bytes:
        size = self.make("geometry_msgs/Vector3", 0.1, 0.1, 0.1)
        items = [
            self.make(
                "vision_msgs/Detection3D",
                self.header,
                self.hypotheses(kind) if kind else [],
                self.make("vision_msgs/BoundingBox3D", self.pose(*place), size),
                f"track {index}",
            )
            for index, place in enumerate(places)
        ]
        return cdr.encode(self.make("vision_msgs/Detection3DArray", self.header, items))

    def boxes(self, kind: str, u: float, height: float) -> bytes:
        at = self.make("vision_msgs/Pose2D", self.make("vision_msgs/Point2D", u, 10.0), 0.0)
        box = self.make("vision_msgs/BoundingBox2D", at, 20.0, height)
        item = self.make("vision_msgs/Detection2D", self.header, self.hypotheses(kind), box, "")
        return cdr.encode(self.make("vision_msgs/Detection2DArray", self.header, [item]))


@pytest.fixture
def topics(tmp_path: Path) -> Topics:
    return Topics(tmp_path)


def told(options: RosOptions, payloads: Mapping[str, bytes]) -> list[Detection]:
    """The last that a sink hears of these messages."""
    subscriptions, sink = Subscriptions(options, robots.PLATFORM), CollectingSink()
    for name, payload in payloads.items():
        subscriptions.read(f"detections.{name}", payload, 1.0)(sink)
    return rounded(sink.taken["detections"][-1])


def rounded(found: tuple[Detection, ...] | None) -> list[Detection]:
    assert found is not None
    places = [(round(one.bearing, 6), one.distance) for one in found]
    return [
        Detection(one.kind, bearing, None if away is None else round(away, 6), one.id)
        for one, (bearing, away) in zip(found, places, strict=True)
    ]


def test_a_tag_has_bearing_and_distance_by_its_side_in_the_image(topics: Topics) -> None:
    found = told(topics.options(one=TAGS), {"one": topics.tags((5, 0.0, 32.0), (6, 320.0, 64.0))})
    # Focal length 320 pixels: 0.1 m are 32 pixels in a depth of 1 m.
    assert found == [
        Detection("36h11", LEFT, DIAGONAL, "5"),
        Detection("36h11", 0.0, 0.5, "6"),
    ]


@pytest.mark.parametrize("column", [math.inf, -math.inf, math.nan])
def test_a_tag_without_a_column_is_left_out(topics: Topics, column: float) -> None:
    options = topics.options(tags={**TAGS, "size": None})
    found = told(options, {"tags": topics.tags((7, column, 32.0), (8, 320.0, 32.0))})
    assert [one.id for one in found] == ["8"]


def test_the_place_of_the_camera_counts(topics: Topics) -> None:
    mounted: dict[str, Value] = {
        **TAGS,
        "at": [0.2, 0.1],
        "bearing_deg": 90.0,
        "kinds": {"5": "door"},
    }
    found = told(topics.options(one=mounted), {"one": topics.tags((5, 320.0, 32.0))})
    bearing, distance = math.atan2(1.1, 0.2), math.hypot(1.1, 0.2)
    assert found == [Detection("door", round(bearing, 6), round(distance, 6), "5")]


def test_a_tag_of_the_table_is_the_robot_that_carries_it(topics: Topics) -> None:
    camera: dict[str, Value] = {**TAGS, "robots": {"5": "tb3-02"}}
    found = told(
        topics.options(one=camera), {"one": topics.tags((5, 320.0, 32.0), (6, 320.0, 32.0))}
    )
    assert found == [Detection("robot", 0.0, 1.0, "tb3-02"), Detection("36h11", 0.0, 1.0, "6")]


def test_a_box_of_an_image_has_a_distance_if_its_height_is_known(topics: Topics) -> None:
    payload = topics.boxes("person", 640.0, 16.0)
    found = told(topics.options(one=BOXES), {"one": payload})
    assert found == [Detection("person", -LEFT, 2.828427)]
    unknown: dict[str, Value] = {key: value for key, value in BOXES.items() if key != "size"}
    found = told(topics.options(one={**unknown, "at": [1.0, 1.0]}), {"one": payload})
    assert found == [Detection("person", -LEFT)]


@pytest.mark.parametrize(
    ("frame", "place"), [("optical", (-1.0, 5.0, 1.0)), ("body", (1.0, 1.0, 5.0))]
)
def test_positions_are_in_the_axes_of_camera_or_base(
    topics: Topics, frame: str, place: tuple[float, float, float]
) -> None:
    options = topics.options(one={**CLOUD, "frame": frame})
    found = told(options, {"one": topics.cloud("", place, (math.nan, math.nan, math.nan))})
    assert found == [Detection("object", LEFT, DIAGONAL, "track 0")]


def test_nothing_is_known_without_fresh_messages_of_all_topics(topics: Topics) -> None:
    late: dict[str, Value] = {**CLOUD, "stale_after": 0.5}
    subscriptions = Subscriptions(topics.options(one=TAGS, two=late), robots.PLATFORM)
    sink = CollectingSink()
    subscriptions.deliver_inputs(sink, 0.0, again=True)
    subscriptions.read("detections.one", topics.tags(), 1.0)(sink)
    assert sink.taken["detections"][-1] is None
    subscriptions.read("detections.two", topics.cloud("box", (0.0, 0.0, 1.0)), 1.0)(sink)
    assert sink.taken["detections"][-1] == (Detection("box", 0.0, 1.0, "track 0"),)
    count = len(sink.taken["detections"])
    subscriptions.deliver_inputs(sink, 1.4)
    assert len(sink.taken["detections"]) == count
    subscriptions.deliver_inputs(sink, 1.6)
    assert sink.taken["detections"][count:] == [None]


@pytest.mark.parametrize("kind", [RosOptions, Ros1Options])
@pytest.mark.parametrize(
    ("change", "subject"),
    [
        ({"type": "std_msgs/String"}, "detections.tags.type"),
        ({"image_width": None}, "detections.tags.image_width"),
        ({"field_of_view_deg": 180.0}, "detections.tags.field_of_view_deg"),
        ({"topic": "odom"}, "odometry and detections.tags"),
    ],
)
def test_a_wrong_entry_is_one_line_that_names_it(
    topics: Topics, kind: type[TopicOptions], change: dict[str, Value], subject: str
) -> None:
    given: dict[str, Any] = {
        "detections": {"tags": {**TAGS, **change}},
        "message_path": topics.path,
    }
    with pytest.raises(ConfigError) as caught:
        read_options(kind, given, "ros", "r")
    assert subject in str(caught.value)


def test_types_that_are_not_there_are_named() -> None:
    with pytest.raises(ConfigError) as caught:
        read_options(RosOptions, {"detections": {"tags": TAGS}}, "ros", "r")
    assert "detections.tags.type" in str(caught.value)


def test_the_definition_of_another_version_is_read(tmp_path: Path) -> None:
    """vision_msgs of ROS 1: a class is a number, and a box has no position."""
    share = write_package(
        tmp_path / "old",
        "vision_msgs",
        {
            "ObjectHypothesisWithPose": "int64 id\nfloat64 score\n",
            "BoundingBox2D": "geometry_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n",
            "Detection2D": (
                "vision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox2D bbox\n"
            ),
            "Detection2DArray": "vision_msgs/Detection2D[] detections\n",
        },
    )
    given: dict[str, Any] = {"detections": {"boxes": BOXES}, "message_path": str(share)}
    (entry,) = read_options(Ros1Options, given, "ros1", "r").topic_entries["detections"].values()
    box = SimpleNamespace(
        center=SimpleNamespace(x=320.0, y=1.0, theta=0.0), size_x=1.0, size_y=32.0
    )
    item = SimpleNamespace(results=[SimpleNamespace(id=3, score=0.5)], bbox=box)
    message = SimpleNamespace(detections=[item])
    assert isinstance(entry, TopicDetections)
    assert rounded(entry.read(message)) == [Detection("3", 0.0, 1.0)]


def test_they_arrive_over_a_bridge_and_go_stale(topics: Topics) -> None:
    robot = BridgedRobot()

    async def story(harness: DriverHarness) -> None:
        sink = harness.sink

        def has_come() -> bool:
            robot.put("tags", topics.tags((5, 320.0, 64.0)))
            last = sink.taken["detections"][-1] if sink.taken["detections"] else None
            return bool(last) and rounded(last) == [Detection("36h11", 0.0, 0.5, "5")]

        await harness.until(has_come, publishing=True)
        await harness.until(lambda: sink.taken["detections"][-1] is None, publishing=True)
        assert sink.is_up

    entries: dict[str, Value] = {"one": {**TAGS, "stale_after": 0.3}}
    play(robot, story, detections=entries, message_path=topics.path)


@pytest.mark.long
@pytest.mark.parametrize("is_heard", [True, False])
def test_a_check_tells_what_is_detected(topics: Topics, is_heard: bool) -> None:
    robot = BridgedRobot()

    def publish() -> None:
        robot.publish()
        if is_heard:
            robot.put("tags", topics.tags((5, 320.0, 64.0)))

    entries: dict[str, Value] = {"one": TAGS}
    found = check(robot, publish, detections=entries, message_path=topics.path)["detections.one"]
    assert found.is_well is is_heard
    assert "/tags" in found.text
    assert ("36h11 5 at 0 deg, 0.5 m" in found.text) is is_heard
