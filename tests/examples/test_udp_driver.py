"""The example driver, held to the contract of all drivers by a base on loopback."""

from __future__ import annotations

import importlib.util
import itertools
import json
import socket
import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType

import msgspec
import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Scan, Twist, Value
from swarmd.driver_api.driver import Driver
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import DriverContract

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "udp_driver"


def load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("udp_base", FOLDER / "udp_base.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["udp_base"] = module
    spec.loader.exec_module(module)
    return module


UDP = load()


class UdpBase:
    """A rig: the base, with a socket of its own."""

    platform = load_platform("burger")

    def __init__(self) -> None:
        self._stamps = itertools.count(1)
        self._peer: object = None
        self._taken: list[Twist] = []
        self._port = 0
        self.reconnect()

    def make(self, options: Mapping[str, Value]) -> Driver:
        given = {"base": f"127.0.0.1:{self._port}", **options}
        driver: Driver = UDP.UdpDriver(swarm="s", robot="r", platform=self.platform, options=given)
        return driver

    def reconnect(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", self._port))
        self._socket.setblocking(False)
        self._port = self._socket.getsockname()[1]

    def disconnect(self) -> None:
        self._socket.close()

    def publish(self) -> None:
        ranges = np.linspace(1.0, 2.0, 360)
        self._send({"is": "scan", "stamp": self._stamp(), "ranges": ranges.tolist()})
        self.publish_odometry()

    def publish_scan(self, scan: Scan) -> None:
        stamp = scan.stamp + 1e4
        self._send({"is": "scan", "stamp": stamp, "ranges": scan.ranges.tolist()})

    def publish_odometry(self) -> None:
        pose = {"x": 0.1, "y": 0.2, "yaw": 0.3, "linear": 0.1, "angular": 0.0}
        self._send({"is": "odometry", "stamp": self._stamp(), **pose})

    def publish_garbage(self) -> None:
        whole = msgspec.msgpack.encode({"is": "scan", "stamp": 1.0, "ranges": [1.0] * 360})
        for data in (b"", b"\xff" * 80, whole[:-9], json.dumps({"is": "scan"}).encode()):
            self._say(data)

    def commands(self) -> Sequence[Twist]:
        self._listen()
        taken, self._taken = self._taken, []
        return taken

    def close(self) -> None:
        self._socket.close()

    def _stamp(self) -> float:
        return 0.1 * next(self._stamps)

    def _listen(self) -> None:
        while True:
            try:
                data, self._peer = self._socket.recvfrom(65536)
            except BlockingIOError:
                return
            said = msgspec.msgpack.decode(data)
            if said:
                self._taken.append(Twist(said["linear"], said["angular"]))

    def _send(self, said: Mapping[str, object]) -> None:
        self._say(msgspec.msgpack.encode(said))

    def _say(self, data: bytes) -> None:
        self._listen()
        if isinstance(self._peer, tuple):
            self._socket.sendto(data, self._peer)


@pytest.mark.long
class TestUdpDriver(DriverContract):
    def rig(self) -> UdpBase:
        return UdpBase()


def test_a_base_without_a_port_is_refused() -> None:
    base = UdpBase()
    with pytest.raises(ConfigError, match="nowhere"):
        base.make({"base": "nowhere"})
    base.close()


def test_its_zero_sender_sends_zero() -> None:
    base = UdpBase()
    driver = base.make({})
    spec = driver.zero_sender()  # type: ignore[attr-defined]
    sender = UDP.UdpZeroSender(**spec.options)
    sender.open()
    sender.send_zero()
    assert [twist.is_zero for twist in base.commands()] == [True]
    sender.close()
    base.close()


def test_its_package_names_it() -> None:
    project = tomllib.loads((FOLDER / "pyproject.toml").read_text())["project"]
    module, _, name = project["entry-points"]["swarmd.drivers"]["udp"].partition(":")
    assert module == UDP.__name__
    assert hasattr(UDP, name)
