"""The rmw_zenoh driver against a stand-in for a robot's nodes and router, over real Zenoh."""

from __future__ import annotations

from swarmd.testing.driver_contract import DriverContract
from tests.drivers.ros.robots import ZenohRobot


class TestContract(DriverContract):
    def rig(self) -> ZenohRobot:
        return ZenohRobot()
