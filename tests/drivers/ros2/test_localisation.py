"""A localisation that publishes as AMCL does: after motion, and its last pose to late nodes."""

from __future__ import annotations

import math

import numpy as np
import pytest
import zenoh
import zenoh.ext

from swarmd.core.values import SharedPose
from swarmd.testing.driver_contract import DriverHarness
from tests.drivers.ros2.robots import CLOCKS_APART, BridgedRobot
from tests.support import ros2_types as dds
from tests.support.stories import story

pytestmark = pytest.mark.long


class Amcl:
    """A node of the robot's hub with a latched topic `amcl_pose`."""

    def __init__(self, robot: BridgedRobot) -> None:
        cache = zenoh.ext.CacheConfig(1)
        self._publisher = zenoh.ext.declare_advanced_publisher(robot.hub, "amcl_pose", cache=cache)
        self._token = robot.announce(
            "MP", "amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped"
        )

    def put(self, stamp: float, x: float, y: float, yaw: float) -> None:
        """A pose with the covariance of a localised AMCL: 1 cm and 0.02 rad at one sigma."""
        covariance = np.zeros((6, 6))
        covariance[0, 0] = covariance[1, 1] = 1e-4
        covariance[5, 5] = 4e-4
        turned = dds.Quaternion(0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))
        pose = dds.PoseWithCovariance(dds.Pose(dds.Vector3(x, y), turned), covariance.ravel())
        message = dds.PoseWithCovarianceStamped(header=dds.stamped(stamp, "map"), pose=pose)
        self._publisher.put(message.serialize())

    def close(self) -> None:
        self._token.undeclare()
        self._publisher.undeclare()


def last(harness: DriverHarness) -> SharedPose | None:
    poses = harness.sink.taken["pose"]
    return poses[-1] if poses else None


@story(BridgedRobot, connected=False, shared_pose="amcl_pose",
       shared_pose_type="pose_with_covariance")  # fmt: skip
async def test_a_robot_at_rest_has_the_pose_of_a_localisation_that_is_silent(
    harness: DriverHarness, robot: BridgedRobot
) -> None:
    amcl = Amcl(robot)
    amcl.put(50.0, 3.0, 1.0, 0.5)  # before the driver connects; no further one comes at rest
    await harness.connect()
    await harness.until(lambda: last(harness) is not None, publishing=True)
    kept = last(harness)
    assert kept is not None
    assert kept.frame == "map"
    assert (kept.pose.x, kept.pose.y) == pytest.approx((3.0, 1.0))
    assert kept.error == pytest.approx(0.05 + 0.25)  # of the options, and the motion it may hide
    # The localisation corrects itself by 2 m: the pose jumps, and odometry carries it on.
    stamp = harness.sink.taken["odometry"][-1].stamp
    assert stamp > CLOCKS_APART
    amcl.put(stamp, 5.0, 1.0, 0.5)

    def is_carried() -> bool:
        pose = last(harness)
        return pose is not None and pose.stamp > stamp + 1.0 and pose.pose.x > 4.0

    await harness.until(is_carried, publishing=True)
    carried = last(harness)
    assert carried is not None
    pose = carried.pose
    assert (pose.x, pose.y, pose.yaw) == pytest.approx((5.0, 1.0, 0.5))
    assert carried.error == pytest.approx(0.05)
    amcl.close()
