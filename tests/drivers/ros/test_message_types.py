"""Message types from a vendor's `.msg` files."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest
from rosbags.typesys import Stores

from swarmd.core.errors import ConfigError
from swarmd.core.values import Value
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros.cdr import name_of
from swarmd.drivers.ros.message_types import MessageTypes
from swarmd.drivers.ros.options import Ros1Options, RosOptions, TopicOptions, read_options
from swarmd.drivers.ros1 import serialization
from tests.support.roscore import why_no_ros1
from tests.support.vendor_messages import PACKAGE, vendor_folder, write_package

HAZARDS = f"{PACKAGE}/HazardDetectionVector"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The share folder of a ROS installation with a vendor's package."""
    return vendor_folder(tmp_path)


def types(*folders: Path, distro: Stores = Stores.ROS2_JAZZY) -> MessageTypes:
    return MessageTypes(distro, [str(one) for one in folders])


def error_of(folder: Path, name: str, distro: Stores = Stores.ROS2_JAZZY) -> str:
    with pytest.raises(ConfigError) as caught:
        types(folder, distro=distro).kind(name)
    return str(caught.value)


@pytest.mark.parametrize("within", ["", PACKAGE])
@pytest.mark.parametrize("name", [HAZARDS, HAZARDS.replace("/", "/msg/")])
def test_a_type_is_found_in_a_folder_of_packages_and_in_a_package(
    folder: Path, within: str, name: str
) -> None:
    kind = types(folder / within).kind(name)
    assert name_of(kind) == f"{PACKAGE}/msg/HazardDetectionVector"


def vector(kinds: MessageTypes, *hazards: int) -> Any:
    header = kinds.kind("std_msgs/Header")(
        stamp=kinds.kind("builtin_interfaces/Time")(sec=1, nanosec=2), frame_id="base_link"
    )
    hazard, whole = kinds.kind(f"{PACKAGE}/HazardDetection"), kinds.kind(HAZARDS)
    return whole(header=header, detections=[hazard(header=header, type=one) for one in hazards])


def test_a_message_with_standard_types_and_others_of_its_folder_is_read(folder: Path) -> None:
    message = vector(types(folder), 1, 4)
    read: Any = cdr.decode(type(message), cdr.encode(message))
    assert [one.type for one in read.detections] == [1, 4]
    assert read.detections[0].header.frame_id == "base_link"


def test_two_robots_may_have_two_definitions_of_one_name(tmp_path: Path) -> None:
    for version, kind in (("a", "uint8"), ("b", "float64")):
        write_package(tmp_path / version, "maker_msgs", {"Level": f"{kind} level"})
    first, second = (types(tmp_path / one).kind("maker_msgs/Level") for one in "ab")
    assert cdr.encode(first(level=3))[4:] == b"\x03"
    assert len(cdr.encode(second(level=3.0))) == 12
    assert "maker_msgs/msg/Level" not in cdr.store().types


@pytest.mark.parametrize("kind", [RosOptions, Ros1Options])
@pytest.mark.parametrize(
    "name",
    ["HazardDetectionVector", "DockStatus", "KidnapStatus", "WheelStatus", "SlipStatus",
     "StopStatus", "HazardDetection"],
)  # fmt: skip
def test_a_reading_may_be_of_a_vendors_type(
    folder: Path, kind: type[TopicOptions], name: str
) -> None:
    fields = {"HazardDetectionVector": "detections.0.type", "WheelStatus": "current_ma_left"}
    fields |= {"DockStatus": "is_docked", "KidnapStatus": "is_kidnapped", "HazardDetection": "type"}
    fields |= {"SlipStatus": "is_slipping", "StopStatus": "is_stopped"}
    entry: dict[str, Value] = {"topic": "x", "type": f"{PACKAGE}/{name}", "field": fields[name]}
    given: dict[str, Value] = {"readings": {"x": entry}, "message_path": str(folder)}
    read = read_options(kind, given, "ros", "r").topic_entries["readings"]["x"]
    assert name_of(read.message_type).endswith(name)


@pytest.mark.parametrize(
    ("name", "subject"),
    [
        ("irobot_create_msgs/HazardDetectionVectr", "'irobot_create_msgs/HazardDetectionVector'"),
        ("sensor_msgs/Temprature", "'sensor_msgs/Temperature'"),
        ("Temperature", "'sensor_msgs/Temperature'"),
        ("zzz/Qqq", "message_path"),
        ("a" * 200, "message_path"),
        ("../irobot_create_msgs/DockStatus", "DockStatus"),
    ],
)
def test_an_unknown_type_is_one_short_line(folder: Path, name: str, subject: str) -> None:
    text = error_of(folder, name)
    assert subject in text
    assert len(text) <= 200


@pytest.mark.parametrize(
    ("definition", "subject"),
    [
        ("uint8 level\nuint8 = 3\n", "Broken.msg:2"),
        ("# text\n\nfloat12 x y\n", "Broken.msg:3"),
        ("uint8 level\nmaker_msgs/Missing other\n", "Broken.msg:2"),
        ("uint8 level\n\nMissing[] other\n", "Broken.msg:3"),
        ("Broken itself\n", "Broken.msg:1"),
        ("uint8 level\nuint8 level\n", "Broken.msg"),
        ("wstring text\n", "Broken.msg:1"),
    ],
)
def test_an_error_in_a_file_names_file_and_line(
    tmp_path: Path, definition: str, subject: str
) -> None:
    write_package(tmp_path, "maker_msgs", {"Broken": definition})
    text = error_of(tmp_path, "maker_msgs/Broken")
    assert subject in text
    assert "\n" not in text


def test_files_may_have_windows_line_ends_and_comments_in_any_encoding(tmp_path: Path) -> None:
    write_package(tmp_path, "maker_msgs", {})
    file = tmp_path / "maker_msgs" / "msg" / "Level.msg"
    file.write_bytes(b"# f\xfcr\r\nuint8 kLow=1\r\nodd 1=2\r\nuint8 level # \xb0C\r\n")
    assert cdr.encode(types(tmp_path).kind("maker_msgs/Level")(level=3))[4:] == b"\x03"


@pytest.mark.parametrize("path", ["msgs", "/nowhere/at/all", "~no_such_user/x", "empty"])
def test_a_folder_without_message_files_is_refused(tmp_path: Path, path: str) -> None:
    given: Value = str(tmp_path) if path == "empty" else path
    with pytest.raises(ConfigError) as caught:
        read_options(RosOptions, {"message_path": [given]}, "ros2dds", "r")
    assert "message_path" in str(caught.value)


STANDARD = {
    "std_msgs": {"Header": "uint32 seq\ntime stamp\nstring frame_id\n"},
    "geometry_msgs": {"Vector3": "float64 x\nfloat64 y\nfloat64 z\n"},
}


@pytest.mark.integration
@pytest.mark.parametrize(
    "definition",
    [
        "uint8 low=01\nstring NAME=a # b\nbool ON=True\nfloat32 X=1.50 # m\nuint8 level\n",
        "Header header\nchar c\nbyte[] raw\ntime at\nduration[2] waits\nstring[] names\n",
        "geometry_msgs/Vector3[3] axes\nOther other\nmaker_msgs/Other[] others\n",
    ],
)
def test_the_md5_sum_of_ros1_is_that_of_genmsg(tmp_path: Path, definition: str) -> None:
    """A publisher of another definition has another sum, and rospy refuses its messages."""
    if lacks := why_no_ros1():
        pytest.skip(lacks)
    write_package(tmp_path, "maker_msgs", {"One": definition, "Other": "int32 SIX=+6\nbyte b\n"})
    for package, definitions in STANDARD.items():
        write_package(tmp_path, package, definitions)
    script = """if True:
        import sys, genmsg, genmsg.gentools
        context = genmsg.MsgContext.create_default()
        packages = "std_msgs", "geometry_msgs", "maker_msgs"
        path = {one: [f"{sys.argv[1]}/{one}/msg"] for one in packages}
        spec = genmsg.load_msg_by_type(context, "maker_msgs/One", path)
        genmsg.load_depends(context, spec, path)
        print(genmsg.gentools.compute_md5(context, spec))
    """
    command = ["/usr/bin/python3", "-c", script, str(tmp_path)]
    wanted = subprocess.run(command, capture_output=True, text=True, check=True, timeout=30)
    kind = types(tmp_path, distro=Stores.ROS1_NOETIC).kind("maker_msgs/One")
    assert serialization.definition(kind)[1] == wanted.stdout.strip()
