"""What robots in lockstep tell one another of messages, as the beacons of daemons do.

Only of a scenario with a fault of the radio: of any other nothing would be told, at a cost that
grows with the square of the number of robots. Such a fault lets beacons pass.
"""

from __future__ import annotations

from typing import NamedTuple

from swarmd.link.members.beacon_times import BEACON_PERIOD
from swarmd.link.members.hearing import Hearing, Report

BEACON_RATE = 1.0 / BEACON_PERIOD
CHANNEL = "beacon"
"""The name of beacons among the messages of the radio."""


class ShownBeacon(NamedTuple):
    """The part of a robot's beacon that tells of messages; see `Hearing.on_beacon`."""

    robot: str
    instance: bytes
    number: int
    sent: int
    report: Report


class Beacons:
    """The beacons of one life of a robot, and what it hears of others.

    `sent`: messages and kin reports that it has sent.
    """

    def __init__(self, robot: str, instance: str) -> None:
        self.hearing = Hearing(robot)
        self.sent = 0
        self._robot = robot
        self._instance = instance.encode()
        self._number = 0

    def next(self) -> ShownBeacon:
        """The next beacon to all."""
        self._number += 1
        report = self.hearing.report
        return ShownBeacon(self._robot, self._instance, self._number, self.sent, report)
