"""Hazards of topics: by type, list, field and place, with their silence."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from random import Random
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.errors import ConfigError
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.values import Value
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros.options import Ros1Options, RosOptions, TopicOptions, read_options
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import CollectingSink
from tests.drivers.ros2 import robots
from tests.support import ros2_types as dds
from tests.support.examples import examples
from tests.support.vendor_messages import PACKAGE, vendor_folder, write_package

PAGE = Path(__file__).resolve().parents[3] / "docs" / "robots" / "turtlebot4.md"
SHOWN: Any = yaml.safe_load(re.findall(r"^```yaml\n(.*?)^```", PAGE.read_text(), re.M | re.S)[0])
CREATE: dict[str, Value] = SHOWN["driver_options"]["hazards"]["base"]
KIDNAP: dict[str, Value] = SHOWN["driver_options"]["hazards"]["kidnap"]
BUMPER: dict[str, Value] = {"topic": "bumper", "type": "std_msgs/Bool", "means": "bump front"}
BUMP = Hazard(HazardKind.BUMP, "front")
SILENT = Hazard(HazardKind.NOT_HEARD, "/bumper")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The share folder of a ROS installation with the messages of Create 3 and TurtleBot 3."""
    sensors = "std_msgs/Header header\nuint8 bumper\nfloat32 cliff\nfloat32 battery\n"
    write_package(tmp_path / "share", "turtlebot3_msgs", {"SensorState": sensors})
    return vendor_folder(tmp_path)


def options(hazards: Mapping[str, Value], folder: Path | None = None, **more: Value) -> RosOptions:
    path: dict[str, Value] = {} if folder is None else {"message_path": str(folder)}
    given: dict[str, Value] = {"hazards": dict(hazards), **path, **more}
    return read_options(RosOptions, given, "ros2dds", "r")


class Heard:
    """Subscriptions of a robot with a sink, and messages for them."""

    def __init__(self, given: RosOptions) -> None:
        self.subscriptions, self.sink = Subscriptions(given, robots.PLATFORM), CollectingSink()
        self._given, self._types, self._stamp = given, given.message_types, 0

    def tell(self, name: str, message: Any, now: float) -> tuple[Hazard, ...]:
        """A message arrives; what the sink knows then."""
        payload = message.serialize() if hasattr(message, "serialize") else cdr.encode(message)
        entry = self._given.topic_entries["hazards"][name]
        topics = self.subscriptions.topics.values()
        stats = next(stats for stats in topics if stats.topic == entry.topic)
        self.subscriptions.read(stats.name, payload, now)(self.sink)
        present: tuple[Hazard, ...] = self.sink.taken["hazards"][-1]
        return present

    def at(self, now: float) -> tuple[Hazard, ...]:
        """What the sink knows at a time."""
        self.subscriptions.deliver_inputs(self.sink, now)
        present: tuple[Hazard, ...] = self.sink.taken["hazards"][-1]
        return present

    def header(self, frame: str = "base_link") -> Any:
        self._stamp += 1
        time = self._types.kind("builtin_interfaces/Time")(sec=self._stamp, nanosec=0)
        return self._types.kind("std_msgs/Header")(stamp=time, frame_id=frame)

    def vector(self, *hazards: tuple[int, str]) -> Any:
        """What Create 3 tells: types and frames."""
        kind = self._types.kind(f"{PACKAGE}/HazardDetection")
        found = [kind(header=self.header(frame), type=number) for number, frame in hazards]
        whole = self._types.kind(f"{PACKAGE}/HazardDetectionVector")
        return whole(header=self.header(), detections=found)

    def message(self, name: str, **fields: Any) -> Any:
        return self._types.kind(name)(header=self.header(), **fields)


def test_a_turtlebot_4_as_its_page_tells_gives_kind_and_place(folder: Path) -> None:
    given = {**load_platform("turtlebot4").drivers["ros2dds"], **SHOWN["driver_options"]}
    del given["command_timeout"]
    heard = Heard(read_options(RosOptions, {**given, "message_path": str(folder)}, "ros2dds", "r"))
    silent = heard.at(0.0)
    assert {one.kind for one in silent} == {HazardKind.NOT_HEARD}
    assert len(silent) == 2
    heard.tell("kidnap", heard.message(f"{PACKAGE}/KidnapStatus", is_kidnapped=False), 0.0)
    assert heard.tell("base", heard.vector(), 0.0) == ()
    assert heard.tell("base", heard.vector((1, "bump_front_left"), (3, "left_wheel")), 0.1) == (
        Hazard(HazardKind.BUMP, "front left"),
        Hazard(HazardKind.STALL, "left wheel"),
    )
    assert heard.tell("base", heard.vector((4, "wheel_drop_left"), (4, "base_link")), 0.2) == (
        Hazard(HazardKind.WHEEL_DROP, "left"),
        Hazard(HazardKind.WHEEL_DROP),
    )
    assert heard.tell("base", heard.vector((0, "base_link"), (5, "base_link")), 0.3) == ()
    lifted = heard.message(f"{PACKAGE}/KidnapStatus", is_kidnapped=True)
    assert heard.tell("kidnap", lifted, 0.4) == (Hazard(HazardKind.LIFTED),)


def test_numbers_limits_and_signs_of_one_message(folder: Path) -> None:
    state: dict[str, Value] = {"topic": "sensor_state", "type": "turtlebot3_msgs/SensorState"}
    bumpers: Value = {**state, "field": "bumper", "means": {1: "bump front", 2: "bump rear"}}  # type: ignore[dict-item]
    cliff: Value = {**state, "field": "cliff", "means": "cliff", "below": 20.0}
    heard = Heard(options({"bumper": bumpers, "cliff": cliff}, folder))

    def told(bumper: int, cliff: float, now: float) -> tuple[Hazard, ...]:
        fields = {"bumper": bumper, "cliff": cliff, "battery": 12.0}
        return heard.tell("cliff", heard.message("turtlebot3_msgs/SensorState", **fields), now)

    assert told(0, 50.0, 0.0) == ()
    assert told(1, 50.0, 0.1) == (BUMP,)
    assert told(2, 10.0, 0.2) == (Hazard(HazardKind.BUMP, "rear"), Hazard(HazardKind.CLIFF))


def test_a_silent_topic_is_a_hazard_before_its_first_message_and_after_its_last() -> None:
    heard = Heard(options({"bumper": {**BUMPER, "stale_after": 0.5}}))
    assert heard.at(0.0) == (SILENT,)
    assert heard.tell("bumper", dds.Bool(data=True), 1.0) == (BUMP,)
    assert heard.tell("bumper", dds.Bool(data=False), 1.1) == ()
    assert heard.at(1.5) == ()
    assert heard.at(1.7) == (SILENT,)
    assert heard.tell("bumper", dds.Bool(data=False), 1.8) == ()
    assert len(heard.sink.taken["hazards"]) == 5  # each change once


def test_what_is_published_on_change_counts_while_its_publisher_is_there() -> None:
    heard = Heard(options({"bumper": {**BUMPER, "stale_after": "never"}}))
    assert heard.at(0.0) == (SILENT,)
    assert heard.tell("bumper", dds.Bool(data=True), 1.0) == (BUMP,)
    assert heard.at(1000.0) == (BUMP,)
    assert heard.tell("bumper", dds.Bool(data=False), 1001.0) == ()
    assert heard.at(2000.0) == ()
    heard.subscriptions.forget("/scan")
    assert heard.at(2001.0) == ()
    heard.subscriptions.forget("/bumper")  # its publisher has gone
    assert heard.at(2002.0) == (SILENT,)


def test_an_earlier_message_that_was_asked_for_counts_if_none_is_known() -> None:
    heard = Heard(options({"bumper": {**BUMPER, "stale_after": "never"}}))
    assert set(heard.subscriptions.kept_topics) == {"/bumper"}
    for data, wanted in ((True, (BUMP,)), (False, (BUMP,))):
        payload = dds.Bool(data=data).serialize()
        heard.subscriptions.read("hazards.bumper", payload, 1.0, is_kept=True)(heard.sink)
        assert heard.sink.taken["hazards"][-1] == wanted


def test_a_reading_and_hazards_of_one_topic_share_it(folder: Path) -> None:
    state: dict[str, Value] = {"topic": "sensor_state", "type": "turtlebot3_msgs/SensorState"}
    reading: Value = {"battery_now": {**state, "field": "battery"}}
    bumper: Value = {**state, "field": "bumper", "means": "bump"}
    heard = Heard(options({"bumper": bumper}, folder, readings=reading))
    assert "hazards.bumper" not in heard.subscriptions.topics
    message = heard.message("turtlebot3_msgs/SensorState", bumper=1, cliff=0.0, battery=12.0)
    payload = cdr.encode(message)
    heard.subscriptions.read("readings.battery_now", payload, 0.0)(heard.sink)
    assert heard.sink.taken["readings"][-1] == {"battery_now": 12.0}
    assert heard.sink.taken["hazards"][-1] == (Hazard(HazardKind.BUMP),)


def test_a_message_that_repeats_its_stamp_is_no_news(folder: Path) -> None:
    heard = Heard(options({"base": CREATE}, folder))
    frozen = heard.vector()
    for tenth in range(5):
        assert heard.tell("base", frozen, 0.1 * tenth) == ()
    assert heard.tell("base", frozen, 0.6)[0].kind is HazardKind.NOT_HEARD


def test_a_number_that_is_not_finite_is_no_news() -> None:
    entry: Value = {**BUMPER, "type": "std_msgs/Float32", "above": 0.5}
    heard = Heard(options({"bumper": entry}))
    assert heard.tell("bumper", dds.Float32(data=0.4), 0.0) == ()
    assert heard.tell("bumper", dds.Float32(data=0.6), 0.1) == (BUMP,)
    heard.tell("bumper", dds.Float32(data=float("nan")), 0.8)
    assert heard.tell("bumper", dds.Float32(data=float("nan")), 1.2) == (SILENT,)


@pytest.mark.parametrize(
    ("limit", "value", "wanted"),
    [
        ({"above": 0.5}, "inf", (BUMP,)),  # a floor sensor over a cliff sees nothing
        ({"above": 0.5}, "-inf", ()),
        ({"below": 0.5}, "-inf", (BUMP,)),
        ({"below": 0.5}, "inf", ()),
        ({"above": 0.0, "below": 0.0}, "inf", (BUMP,)),
    ],
)
def test_an_infinite_range_is_beyond_a_limit(
    limit: dict[str, Value], value: str, wanted: tuple[Hazard, ...]
) -> None:
    heard = Heard(options({"bumper": {**BUMPER, "type": "std_msgs/Float32", **limit}}))
    within = dds.Float32(data=0.0 if len(limit) == 2 else 0.6 if "below" in limit else 0.4)
    assert heard.tell("bumper", within, 0.0) == ()
    assert heard.tell("bumper", dds.Float32(data=float(value)), 0.1) == wanted


def test_without_the_option_no_sink_hears_of_hazards() -> None:
    heard = Heard(options({}))
    heard.subscriptions.deliver_inputs(heard.sink, 0.0, again=True)
    assert not heard.sink.taken["hazards"]


def test_a_zero_sender_needs_no_hazards(folder: Path) -> None:
    from swarmd.drivers.ros.options import of_commands

    assert not of_commands({"hazards": {}, "message_path": str(folder), "readings": {}})


@pytest.mark.parametrize("kind", [RosOptions, Ros1Options])
@pytest.mark.parametrize(
    ("change", "subject"),
    [
        ({"type": "irobot_create_msgs/Hazard"}, "hazards.base.type"),
        ({"list": "detection"}, "'detections'"),
        ({"list": "header"}, "hazards.base.list"),
        ({"list": None}, "hazards.base.field"),
        ({"field": "header"}, "hazards.base.field"),
        ({"place_field": "type"}, "hazards.base.place_field"),
        ({"place_field": "header.frame"}, "'frame_id'"),
        ({"means": "bmp"}, "'bump'"),
        ({"means": "not_heard"}, "hazards.base.means"),
        ({"means": {"1": "crash"}}, "hazards.base.means"),
        ({"means": {"one": "bump"}}, "hazards.base.means"),
        ({"above": 1.0}, "hazards.base.means"),
        ({"means": {}}, "hazards.base.means"),
        ({"means": "cliff", "above": float("inf")}, "hazards.base.above"),
        ({"means": "cliff", "below": float("nan")}, "hazards.base.below"),
        ({"means": "cliff", "above": 0.02, "below": 0.06}, "hazards.base.below"),
        ({"stale_after": 0.0}, "hazards.base.stale_after"),
        ({"kinds": {}}, "kinds"),
        ({"topic": "odom"}, "odometry and hazards.base"),
        ({"topic": "1st"}, "hazards.base"),
    ],
)
def test_a_wrong_entry_is_one_line_that_names_it(
    folder: Path, kind: type[TopicOptions], change: dict[str, Value], subject: str
) -> None:
    given: dict[str, Value] = {"hazards": {"base": {**CREATE, **change}}}
    with pytest.raises(ConfigError) as caught:
        read_options(kind, {**given, "message_path": str(folder)}, "ros", "r")
    assert subject in str(caught.value)
    assert "\n" not in str(caught.value)


@settings(max_examples=examples(100), deadline=None)
@given(st.randoms(use_true_random=False))
def test_what_a_sink_knows_is_never_older_than_the_topics(chance: Random) -> None:
    """In random histories each present hazard is told, and a silent topic is a hazard."""
    heard = Heard(
        options(
            {
                "bumper": {**BUMPER, "stale_after": 0.5},
                "lift": {"topic": "/lift", "type": "std_msgs/Bool", "means": "lifted"},
            }
        )
    )
    now, last = 0.0, {"bumper": (-9.0, False), "lift": (-9.0, False)}
    for _ in range(40):
        now += chance.choice((0.0, 0.05, 0.3, 0.6, 1.1))
        name = chance.choice(("bumper", "lift", ""))
        if name:
            last[name] = now, chance.random() < 0.5
            heard.tell(name, dds.Bool(data=last[name][1]), now)
        wanted = set[Hazard]()
        for name, limit, topic, hazard in (
            ("bumper", 0.5, "/bumper", BUMP),
            ("lift", 1.0, "/lift", Hazard(HazardKind.LIFTED)),
        ):
            at, is_present = last[name]
            if now - at > limit:
                wanted.add(Hazard(HazardKind.NOT_HEARD, topic))
            elif is_present:
                wanted.add(hazard)
        assert set(heard.at(now)) == wanted
