"""A vendor's message over a real roscore, and what an adapter keeps of topics without one."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from rosbags.typesys import Stores

from swarmd.core.values import Value
from swarmd.drivers.ros.message_types import MessageTypes
from swarmd.drivers.ros1.adapter_process import DATA, DATA_HEAD, KeptTopic
from swarmd.drivers.ros1.serialization import encode
from swarmd.testing.driver_contract import DriverHarness, play
from tests.drivers.ros1.rig import RosRobot
from tests.support.roscore import RosCore
from tests.support.vendor_messages import PACKAGE, vendor_folder


def test_a_vendors_message_is_read(roscore: RosCore, tmp_path: Path) -> None:
    robot, path = RosRobot(roscore), str(vendor_folder(tmp_path))
    name = f"{PACKAGE}/DockStatus"
    types = MessageTypes(Stores.ROS1_NOETIC, [path])
    stamp = types.kind("builtin_interfaces/Time")(1, 2)
    header = types.kind("std_msgs/Header")(3, stamp, "base")
    made: type = types.kind(name)
    message = made(header=header, dock_visible=False, is_docked=True)

    async def story(harness: DriverHarness) -> None:
        def is_read() -> bool:
            robot.put("status", message, encode(message))
            return harness.sink.taken["readings"][-1:] == [{"docked": 1.0}]

        await harness.until(is_read, publishing=True)

    entry: dict[str, Value] = {"topic": "status", "type": name, "field": "is_docked"}
    play(robot, story, readings={"docked": entry}, message_path=path)


class _Driver:
    """The adapter's side of a socket that its driver reads, or not."""

    def __init__(self) -> None:
        self.reads, self.got = True, list[Any]()

    def send(self, *packet: bytes) -> bool:
        self.got += [b"".join(packet)] if self.reads else []
        return self.reads

    def event(self, event: Any) -> bool:
        self.got += [event] if self.reads else []
        return self.reads


def kept_topic(driver: Any, *ends: Any) -> KeptTopic:
    topic = KeptTopic(3, driver)
    topic.subscriber = SimpleNamespace(impl=SimpleNamespace(connections=list(ends)))
    return topic


def test_a_message_that_the_driver_did_not_read_is_sent_again() -> None:
    driver = _Driver()
    topic = kept_topic(driver)
    driver.reads = False
    topic.take({}, DATA_HEAD.pack(DATA, 3, 1.0), b"a")
    topic.take({}, DATA_HEAD.pack(DATA, 3, 2.0), b"b")
    topic.send_again()
    driver.reads = True
    topic.send_again()
    topic.send_again()
    assert driver.got == [DATA_HEAD.pack(DATA, 3, 2.0) + b"b"]


def test_the_end_of_a_publisher_is_told_once_the_driver_reads() -> None:
    driver, header = _Driver(), {"callerid": "/base"}
    end = SimpleNamespace(header=header, socket=object())
    topic = kept_topic(driver, end)
    topic.report_end()
    topic.take(header, b"D")
    topic.report_end()
    end.socket = None
    driver.reads = False
    topic.report_end()
    driver.reads = True
    topic.report_end()
    topic.report_end()
    assert driver.got == [b"D", {"event": "gone", "topic": 3}]


def test_a_connection_that_was_made_again_is_another() -> None:
    driver, header = _Driver(), {"callerid": "/base"}
    end = SimpleNamespace(header=header, socket=object())
    topic = kept_topic(driver, end)
    topic.take(header, b"D")
    end.header = dict(header)
    topic.report_end()
    assert driver.got == [b"D", {"event": "gone", "topic": 3}]
