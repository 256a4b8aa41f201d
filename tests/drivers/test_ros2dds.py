"""The ros2dds driver against a stand-in for a robot behind its bridge, over real Zenoh."""

from __future__ import annotations

from swarmd.testing.driver_contract import DriverContract
from tests.drivers.ros.robots import BridgedRobot


class TestContract(DriverContract):
    def rig(self) -> BridgedRobot:
        return BridgedRobot()
