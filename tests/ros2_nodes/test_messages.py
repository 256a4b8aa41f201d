"""Messages behave as those of rclpy: fields, defaults, checks, copies; types of `.msg` texts."""

from __future__ import annotations

import array
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.ros2_nodes.message_classes import MessageClasses
from swarmd.ros2_nodes.node_files import NodeFiles
from tests.support.ros2_nodes import written

OWN = {
    "swarm_msgs/msg/State.msg": (
        "# of a robot\n"
        "int8 IDLE=0\n"
        "int8 BUSY=1\n"
        "string NAME='a b'\n"
        "std_msgs/Header header\n"
        "int8 state 1\n"
        "float64 gain 2.5  # a default\n"
        "string<=4 word\n"
        "uint8[3] color\n"
        "float32[] ranges\n"
        "int32[<=2] few\n"
        "string[] names\n"
        "bool[2] flags\n"
        "Place[] places\n"
    ),
    "swarm_msgs/msg/Place.msg": "geometry_msgs/Point at\n",
    "swarm_msgs/srv/Ask.srv": "int64 a\n---\nint64 b\n",
}


@pytest.fixture
def types(tmp_path: Path) -> MessageClasses:
    folder = written(tmp_path, OWN)
    return MessageClasses(NodeFiles(folder), [folder])


def state(types: MessageClasses) -> Any:
    return types.kind("swarm_msgs/msg/State")


def test_fields_have_the_defaults_of_rclpy(types: MessageClasses) -> None:
    made = state(types)()
    assert (made.state, made.gain, made.word, made.names) == (1, 2.5, "", [])
    assert made.ranges == array.array("f")
    assert made.few == array.array("i")
    assert made.color.dtype == np.uint8
    assert made.color.tolist() == [0, 0, 0]
    assert made.flags == [False, False]
    assert made.header.stamp.sec == 0
    assert (made.IDLE, made.BUSY) == (0, 1)
    rotation: Any = types.kind("geometry_msgs/msg/Quaternion")()
    assert (rotation.x, rotation.w) == (0.0, 1.0)


def test_a_constructor_takes_fields_by_name(types: MessageClasses) -> None:
    point: Any = types.kind("geometry_msgs/msg/Point")(x=1.0, z=2.0)
    assert (point.x, point.y, point.z) == (1.0, 0.0, 2.0)
    assert repr(point) == "geometry_msgs.msg.Point(x=1.0, y=0.0, z=2.0)"
    assert point == types.kind("geometry_msgs/msg/Point")(x=1.0, z=2.0)
    with pytest.raises(AssertionError, match="speed"):
        types.kind("geometry_msgs/msg/Point")(speed=1.0)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("state", 1.0), ("state", 128), ("gain", 1), ("gain", "1"), ("word", "abcde"),
        ("word", b"a"), ("color", [1, 2]), ("color", [1, 2, 300]), ("color", np.zeros(3)),
        ("ranges", [1, 2]), ("ranges", "ab"), ("ranges", 1.0), ("few", [1, 2, 3]),
        ("names", [1]), ("names", "ab"), ("flags", [1, 0]), ("places", [1]), ("header", 1),
    ],
)  # fmt: skip
def test_a_value_of_another_type_is_refused_as_by_rclpy(
    types: MessageClasses, field: str, value: object
) -> None:
    made = state(types)()
    before = getattr(made, field)
    with pytest.raises(AssertionError, match=field):
        setattr(made, field, value)
    assert np.array_equal(getattr(made, field), before)


def test_a_subscriber_gets_a_copy_in_the_bits_of_the_message(types: MessageClasses) -> None:
    """0.1 has 24 bits in a float32: 0.100000001490116."""
    made = state(types)()
    made.names = ["a"]
    made.places = [types.kind("swarm_msgs/msg/Place")()]
    made.ranges = [0.1, float("inf")]
    copied = state(types).copied(made)
    made.names.append("b")
    made.places[0].at.x = 3.0
    made.ranges[1] = 0.0
    assert copied.names == ["a"]
    assert copied.places[0].at.x == 0.0
    assert copied.ranges.tolist() == [0.10000000149011612, float("inf")]
    temperature: Any = types.kind("std_msgs/msg/Float32")(data=0.1)
    assert temperature.copied(temperature).data == 0.10000000149011612


def test_plain_values_give_the_same_message(types: MessageClasses) -> None:
    made = state(types)(
        ranges=[1.5], names=["a"], color=[1, 2, 3], few=[7], word="abc", flags=[True, False]
    )
    made.places = [types.kind("swarm_msgs/msg/Place")()]
    plain = state(types).plain(made)
    assert plain[1:9] == [1, 2.5, "abc", [1, 2, 3], [1.5], [7], ["a"], [True, False]]
    assert state(types).of_plain(plain) == made


def test_services_have_a_request_and_a_response(types: MessageClasses) -> None:
    ask: Any = types.service("swarm_msgs/srv/Ask")
    assert ask.Request(a=1).a == 1
    assert ask.Response().b == 0
    trigger: Any = types.service("std_srvs/srv/Trigger")
    assert trigger.Response(success=True, message="done").success is True


@pytest.mark.parametrize(
    ("files", "asked", "named"),
    [
        ({}, "geometry_msgs/msg/Twits", "Twist"),
        ({}, "swarm_msgs/msg/Stat", "State"),
        ({"swarm_msgs/msg/Bad.msg": "int8 -\n"}, "swarm_msgs/msg/Bad", "Bad"),
        ({"swarm_msgs/msg/Loop.msg": "Loop[] again\n"}, "swarm_msgs/msg/Loop", "itself"),
        ({"swarm_msgs/msg/Far.msg": "other_msgs/Name one\n"}, "swarm_msgs/msg/Far", "other_msgs"),
    ],
)
def test_a_type_that_is_unknown_or_wrong_is_named(
    tmp_path: Path, files: dict[str, str], asked: str, named: str
) -> None:
    folder = written(tmp_path, {**OWN, **files})
    with pytest.raises(ConfigError) as caught:
        MessageClasses(NodeFiles(folder), [folder]).kind(asked)
    assert named in str(caught.value)
    assert len(str(caught.value)) < 250


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("uint8 x 300\n", "x"), ("int32 x 2.5\n", "x"), ("int32 x abc\n", "x"),
        ("bool x maybe\n", "x"), ("float64 x abc\n", "x"), ("int32[2] x [1, 2, 3]\n", "x"),
        ("int8[] x [1, 300]\n", "x"), ("string<=2 x 'abc'\n", "x"),
        ("int8 x\nint8 x\n", "'x'"), ("int8 x=1\nint8 x\n", "parse"), ("int8 copied\n", "'copied'"),
        ("int8 FIELDS\n", "FIELDS"), ("int8 FIELDS=1\nint8 x\n", "FIELDS"), ("int8 __x\n", "__x"),
        ("int8 x_\n", "'x_'"), ("float64[9000000000000] x\n", "9000000000000"),
        ("float64[-1] x\n", "Odd"), ("Odd x\n", "itself"), ("Odd[] x\nOdd[] y\n", "itself"),
        ("no_such/Type x\n", "no_such"), ("\0", "Odd"), ("int8\n", "Odd"), ("[" * 3000, "Odd"),
        ("Big[2000] x\n", "2000000"), ("#\n" * 40_000, "80000"), ("int8 x y z\n", "Odd"),
        ("\ud800", "Odd"),
    ],
)  # fmt: skip
def test_an_odd_definition_is_one_line(tmp_path: Path, text: str, named: str) -> None:
    (tmp_path / "odd" / "msg").mkdir(parents=True)
    (tmp_path / "odd" / "msg" / "Big.msg").write_text("float64[1000] x\n")
    (tmp_path / "odd" / "msg" / "Odd.msg").write_bytes(text.encode(errors="surrogatepass"))
    with pytest.raises(ConfigError) as caught:
        MessageClasses(NodeFiles(tmp_path), [tmp_path]).kind("odd/msg/Odd")()
    line = str(caught.value)
    assert "Odd" in line
    assert named in line
    assert line.isprintable()


def test_lists_have_the_defaults_of_the_definition(tmp_path: Path) -> None:
    """As https://docs.ros.org/en/jazzy/Concepts/Basic/About-Interfaces.html has them."""
    text = "int32[] samples [-200, -100, 0]\nfloat32[2] pair [1, 2.5]\nstring[] names ['a', 'b']\n"
    written(tmp_path, {"odd/msg/Odd.msg": text})
    kind: Any = MessageClasses(NodeFiles(tmp_path), [tmp_path]).kind("odd/msg/Odd")
    made = kind()
    assert (made.samples.tolist(), made.pair.tolist(), made.names) == (
        [-200, -100, 0],
        [1.0, 2.5],
        ["a", "b"],
    )
    made.samples.append(1)
    assert kind().samples.tolist() == [-200, -100, 0]
