"""The zero sender of the watchdog, without Zenoh; over Zenoh: `test_dds_bridge.py`."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from swarmd.drivers.ros2 import dds_bridge as ros2dds
from swarmd.drivers.ros2 import rmw_zenoh
from swarmd.drivers.ros2 import zero_sender as zero
from tests.drivers.ros2.robots import HASHES
from tests.support import ros2_types as dds
from tests.support.processes import wait_until


class Hub:
    """The hub at the endpoint, unless `is_there` is false; its sessions keep what is put."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.is_there = True
        self.sent: list[tuple[str, bytes, bytes | None]] = []
        self.is_faulty = False
        monkeypatch.setattr(zero, "open_session", self._open)
        monkeypatch.setattr(zero, "command_publisher", self._publisher)

    def _open(self, endpoint: str, *, within: float) -> Any:
        return SimpleNamespace(close=lambda: None) if self.is_there else None

    def _publisher(self, session: object, key: str) -> Any:
        def put(payload: bytes, *, attachment: bytes | None) -> None:
            if self.is_faulty:
                raise zenoh.ZError("closed")
            self.sent.append((key, payload, attachment))

        return SimpleNamespace(put=put)


@pytest.fixture
def hub(monkeypatch: pytest.MonkeyPatch) -> Hub:
    return Hub(monkeypatch)


def test_zero_goes_out_on_the_keys_of_every_distribution(hub: Hub) -> None:
    given = {"domain": 3, "cmd_vel_type": "twist_stamped", "cmd_vel_frame": "base"}
    sender = rmw_zenoh.make_zero_sender(robot="r", given=given)  # type: ignore[arg-type]
    sender.open()
    sender.send_zero()
    prefix = "3/cmd_vel/geometry_msgs::msg::dds_::TwistStamped_/"
    keys = [key for key, _, _ in hub.sent]
    assert sorted(keys) == [prefix + HASHES["TwistStamped"], prefix + "TypeHashNotSupported"]
    wanted = dds.TwistStamped(dds.stamped(0.0, ""), dds.Twist()).serialize()
    assert all(payload == wanted for _, payload, _ in hub.sent)
    read = dds.Twist.deserialize(wanted + bytes(48))  # as a base that takes it for a Twist
    assert abs(read.linear.x) + abs(read.linear.y) + abs(read.angular.z) < 1e-300
    assert all(attachment is not None and len(attachment) == 33 for _, _, attachment in hub.sent)


def test_the_zero_has_the_type_that_the_base_wants_once_the_driver_knows_it(hub: Hub) -> None:
    sender = ros2dds.make_zero_sender(robot="r", given={})
    sender.open()
    twist, stamped = dds.Twist(), dds.TwistStamped(dds.stamped(0.0, ""), dds.Twist())
    cases = (("", stamped), ("Twist", twist), ("TwistStamped", stamped), ("other", stamped))
    for hint, wanted in cases:
        sender.take_hint(hint)
        sender.send_zero()
        assert hub.sent.pop()[:2] == ("cmd_vel", wanted.serialize())
        assert not hub.sent
    sender.close()


def test_a_hub_that_is_not_there_is_tried_again(hub: Hub) -> None:
    hub.is_there = False
    sender = ros2dds.make_zero_sender(robot="r", given={})
    sender.open()
    sender.send_zero()
    assert not sender.is_connected
    hub.is_there = True
    wait_until(lambda: sender.is_connected, "the sender has found the hub before it must send zero")
    assert not hub.sent
    sender.send_zero()
    assert hub.sent
    sender.close()


def test_a_zero_that_cannot_be_put_ends_nothing(hub: Hub) -> None:
    sender = ros2dds.make_zero_sender(robot="r", given={})
    sender.open()
    hub.is_faulty = True
    sender.send_zero()
    hub.is_faulty = False
    sender.send_zero()
    assert len(hub.sent) == 1
