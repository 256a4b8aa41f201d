"""What a daemon publishes for viewers: motion, pose, decision, scans, tracks and messages."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from swarmd.core.clock import boottime
from swarmd.core.codec import encode
from swarmd.core.messages import ShownMessage, Status
from swarmd.core.values import Value
from swarmd.daemon.network import Network
from swarmd.driver_api.driver import StateDisplay
from swarmd.driver_api.hw_codec import encode_scan
from swarmd.robot.robot import Robot


class ViewerFeed:
    """Publishes the values of a robot that viewers follow, and shows its state on the driver.

    The network encodes a value only if a viewer subscribes to it. `display`: the driver, if it
    shows the state of its robot, such as on ROS topics.
    """

    def __init__(self, robot: Robot, network: Network, display: StateDisplay | None) -> None:
        self._robot = robot
        self._network = network
        self._display = display
        self._status: Status | None = None  # for the display, with the next motion
        self._shown_scan = -1  # sequence number of the last published scan

    def show_status(self, status: Callable[[], Status]) -> None:
        """Keep the present status for the display of the driver, if there is one."""
        if self._display is not None:
            self._status = status()

    def publish_motion(self) -> None:
        """Publish motion, pose and decision, and each new scan with tracks."""
        self._network.publish("motion", self._motion)
        self._network.publish("pose", self._pose)
        self._network.publish("decision", self._decision)
        if self._display is not None:
            status = self._status
            self._status = None
            now = boottime()
            self._display.show(status, self._robot.motion(now), self._robot.shared_pose(now))
        scan = self._robot.scan
        if scan is not None and scan.seq != self._shown_scan:
            self._shown_scan = scan.seq
            self._network.publish("scan", lambda: encode_scan(scan))
            self._network.publish("tracks", self._tracks)

    def publish_message(self, channel: str, value: Value) -> None:
        """Publish a message of the own pattern."""
        self._network.publish("message", partial(self._message, channel, value))

    # Each method encodes a present value; None without a value.

    def _motion(self) -> bytes | None:
        motion = self._robot.motion(boottime())
        return None if motion is None else encode(motion)

    def _pose(self) -> bytes | None:
        pose = self._robot.shared_pose(boottime())
        return None if pose is None else encode(pose)

    def _decision(self) -> bytes:
        return encode(self._robot.shown_decision(boottime()))

    def _tracks(self) -> bytes | None:
        tracks = self._robot.tracks(boottime())
        return None if tracks is None else encode(tracks)

    def _message(self, channel: str, value: Value) -> bytes:
        shown = ShownMessage(robot=self._robot.id, at=boottime(), channel=channel, value=value)
        return encode(shown)
