"""The topics on which any ROS node stops a robot: the bytes of a message, its operator, a flood."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.messages import Code, Reply
from swarmd.core.values import Value
from swarmd.driver_api.command_source import Answer, DriverCommand
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros.options import Ros1Options, RosOptions, TopicOptions, read_options
from swarmd.drivers.ros.stop_topics import MAX_REASON, StopTopics
from swarmd.drivers.ros1 import serialization
from swarmd.drivers.ros2.dds_bridge import Ros2Dds
from swarmd.drivers.ros2.services import CommandServices

STOP, ESTOP = "/tb3_01/swarmd/stop", "/tb3_01/swarmd/estop"
HEAD = b"\0\1\0\0"  # of CDR, little-endian
SMOKE = b"\6\0\0\0smoke\0"


class Door:
    """The daemon's side of the topics of one robot."""

    def __init__(self, kind: type[TopicOptions] = RosOptions, **options: Any) -> None:
        self.commands: list[DriverCommand] = []
        self.shown: list[str] = []
        self.stops = StopTopics(
            read_options(kind, {"namespace": "{robot}", **options}, "d", "tb3-01"),
            self.shown.append,
        )
        self.stops.serve(self._take)

    def _take(self, command: DriverCommand, answer: Answer) -> None:
        self.commands.append(command)
        answer(Reply(id="i", robot="r", code=Code.APPLIED, text="estopped: commanded zero"))

    def hear(
        self, topic: str, payload: bytes, decode: Callable[..., Any] = cdr.decode, now: float = 0.0
    ) -> bool:
        return self.stops.hear(topic, payload, decode, now)


def test_each_topic_is_its_verb_and_the_result_is_shown() -> None:
    door = Door()
    assert door.hear(STOP, HEAD + b"\0")
    assert door.hear(ESTOP, HEAD + SMOKE)
    stop, estop = door.commands
    assert (stop.verb, stop.operator, stop.source) == ("stop", "ROS", f"ROS topic {STOP}")
    assert (estop.verb, estop.reason, estop.source) == ("estop", "smoke", f"ROS topic {ESTOP}")
    assert door.shown == ["estopped: commanded zero"] * 2


HOSTILE = {
    "empty": b"",
    "one byte": b"\0",
    "the header alone": HEAD,
    "a truncated length": HEAD + b"\6\0",
    "a truncated text": HEAD + b"\6\0\0\0smo",
    "a length of 4 GB": HEAD + b"\xff\xff\xff\xffsmoke\0",
    "no UTF-8": HEAD + b"\6\0\0\0\xff\xfe\xfd\xfcx\0",
    "no end of the text": HEAD + b"\6\0\0\0smoke!",
    "more than the message": HEAD + SMOKE + bytes(9),
    "another type, a Float64": HEAD + bytes(4) + bytes(8),
    "another header": b"\7\7\0\0" + SMOKE,
    "a huge text": HEAD + (2**20).to_bytes(4, "little") + b"x" * (2**20 - 1) + b"\0",
    "random": bytes(range(256)),
}


@pytest.mark.parametrize("decode", [cdr.decode, serialization.decode], ids=["ROS 2", "ROS 1"])
@pytest.mark.parametrize("payload", HOSTILE.values(), ids=HOSTILE)
def test_a_message_that_cannot_be_read_stops_without_a_reason(
    payload: bytes, decode: Callable[..., Any]
) -> None:
    door = Door()
    assert door.hear(STOP, payload, decode)
    assert door.hear(ESTOP, payload, decode)
    assert [one.verb for one in door.commands] == ["stop", "estop"]
    assert len(door.commands[1].reason) <= MAX_REASON


def test_a_text_of_ros_1_is_a_reason() -> None:
    door = Door(Ros1Options)
    door.hear(ESTOP, b"\5\0\0\0smoke", serialization.decode)
    assert door.commands[0].reason == "smoke"


def test_a_reason_is_cut_and_stays_in_its_line() -> None:
    door = Door()
    text = "smöke\n2026 INFO: reset\x1b[2J\u202e" + "x" * 9000
    raw = text.encode() + b"\0"
    door.hear(ESTOP, HEAD + len(raw).to_bytes(4, "little") + raw)
    reason = door.commands[0].reason
    assert reason.startswith("smöke 2026 INFO: reset [2J ")
    assert reason.isprintable()
    assert len(reason) == MAX_REASON == 200


def test_a_flood_is_cut_and_each_topic_has_its_own_limit() -> None:
    """Ten messages at once and ten a second, as docs/ros_commands.md says."""
    door = Door()
    taken = [door.hear(STOP, b"x", now=0.001 * n) for n in range(1000)]
    assert taken[:10] == [True] * 10
    assert 15 <= sum(taken) <= 20
    assert door.hear(ESTOP, b"x", now=1.0)
    assert door.hear(STOP, b"x", now=1.2)


def test_nothing_is_taken_before_the_daemon_serves() -> None:
    shown: list[str] = []
    stops = StopTopics(read_options(RosOptions, {}, "d", "r"), shown.append)
    assert not stops.hear("/swarmd/stop", HEAD, cdr.decode, 0.0)


@pytest.mark.parametrize("kind", [RosOptions, Ros1Options])
def test_an_option_names_the_operator(kind: type[TopicOptions]) -> None:
    door = Door(kind, stop_operator="ros-lab")
    door.hear(STOP, b"")
    assert door.commands[0].operator == "ros-lab"
    assert {one.operator for one in door.stops.runs.values()} == {"ros-lab"}
    assert set(door.stops.runs) == {STOP, ESTOP}
    assert not Door(kind).stops.runs  # `--check` of a secured swarm finds no fault in a default


@pytest.mark.parametrize("operator", ["ROS", "ros lab", ""])
def test_an_operator_is_a_name_of_a_roster(operator: str) -> None:
    with pytest.raises(ConfigError, match="stop_operator"):
        read_options(Ros1Options, {"stop_operator": operator}, "ros1", "r")


@pytest.mark.parametrize(("given", "wanted"), [({}, "anna"), ({"stop_operator": "bob"}, "bob")])
def test_the_operator_of_the_services_counts_without_the_option(
    given: dict[str, Any], wanted: str
) -> None:
    services_given: dict[str, Value] = {"operator": "anna"}
    options = read_options(RosOptions, {"services": services_given, **given}, "ros2dds", "r")
    commands: list[DriverCommand] = []
    services = CommandServices(Ros2Dds(), options, lambda: False)
    services.serve(lambda command, answer: commands.append(command))
    services.hear("/swarmd/stop", HEAD, cdr.decode, 0.0)
    assert commands[0].operator == wanted
