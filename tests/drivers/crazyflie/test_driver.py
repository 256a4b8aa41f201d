"""The driver, by the maker's cflib over loopback, with the emulated firmware."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from swarmd.core.events import OdometryInput, ScanInput
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.values import Odometry, Platform, Pose, Scan, Twist, Value
from swarmd.driver_api.driver import Driver
from swarmd.drivers.crazyflie.driver import make_driver
from swarmd.drivers.crazyflie.emulator import CrtpRobots
from swarmd.drivers.crazyflie.firmware import IS_TUMBLED
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import DriverContract

pytest.importorskip("cflib", reason="extra crazyflie")

PLATFORM = load_platform("crazyflie")
QUICK = {"take_off_rate": 1.0, "land_rate": 1.0, "land_after": 1.0}


class Drone:
    """A rig: one emulated drone."""

    platform: Platform = PLATFORM
    hazard = Hazard(HazardKind.LIFTED, "tumbled")
    hazard_options: Mapping[str, Value] = {"clear": 0.3}

    def __init__(self) -> None:
        self._stamps = itertools.count(1)
        self._taken: list[Twist] = []
        self._endpoint = "udp/127.0.0.1:0"
        self._tells_status = True
        self.reconnect()

    def make(self, options: Mapping[str, Value]) -> Driver:
        self._tells_status = not options  # a rig of hazards tells these alone
        given = {**self.robots.driver_options, **QUICK, **options}
        return make_driver(swarm="s", robot="cf", platform=PLATFORM, options=given)

    def reconnect(self) -> None:
        self.robots = CrtpRobots(
            {"cf": PLATFORM}, self._endpoint, lambda robot, twist: self._taken.append(twist)
        )
        uri = self.robots.driver_options["uri"]["cf"]  # type: ignore[index,call-overload]
        self._endpoint = str(uri).replace("udp://", "udp/")

    def disconnect(self) -> None:
        self.robots.close()

    def publish(self) -> None:
        stamp = 0.1 * next(self._stamps)
        spec = PLATFORM.scan
        ranges = np.array([1.0, 1.5, np.inf, 1.2])
        scan = Scan(1, stamp, ranges, spec.bearings, spec.range_min, spec.range_max)
        self.robots.tells_status = self._tells_status
        self.robots.publish("cf", ScanInput(scan))
        odometry = Odometry(stamp, Pose(0.1, 0.2, 0.3), Twist(0.1, 0.2, 0.05))
        self.robots.publish("cf", OdometryInput(odometry))

    def publish_hazard(self, *, is_present: bool) -> None:
        self.robots.firmware("cf").faults = IS_TUMBLED if is_present else 0
        self.robots.publish_status("cf")

    def commands(self) -> Sequence[Twist]:
        taken, self._taken = self._taken, []
        return taken

    def close(self) -> None:
        self.robots.close()


class TestCrazyflieDriver(DriverContract):
    def rig(self) -> Drone:
        return Drone()
