"""The ROS messages of the drivers, as rosbags' dataclasses under their plain names.

The definitions are Jazzy's; only `Range` differs between the distributions from Humble on.
"""

from __future__ import annotations

from typing import TypeAlias

from rosbags.typesys.stores import ros2_jazzy

Time: TypeAlias = ros2_jazzy.builtin_interfaces__msg__Time
Header: TypeAlias = ros2_jazzy.std_msgs__msg__Header
Empty: TypeAlias = ros2_jazzy.std_msgs__msg__Empty
Float64: TypeAlias = ros2_jazzy.std_msgs__msg__Float64
String: TypeAlias = ros2_jazzy.std_msgs__msg__String
Vector3: TypeAlias = ros2_jazzy.geometry_msgs__msg__Vector3
Quaternion: TypeAlias = ros2_jazzy.geometry_msgs__msg__Quaternion
Point: TypeAlias = ros2_jazzy.geometry_msgs__msg__Point
Pose: TypeAlias = ros2_jazzy.geometry_msgs__msg__Pose
PoseStamped: TypeAlias = ros2_jazzy.geometry_msgs__msg__PoseStamped
PoseWithCovariance: TypeAlias = ros2_jazzy.geometry_msgs__msg__PoseWithCovariance
PoseWithCovarianceStamped: TypeAlias = ros2_jazzy.geometry_msgs__msg__PoseWithCovarianceStamped
Twist: TypeAlias = ros2_jazzy.geometry_msgs__msg__Twist
TwistStamped: TypeAlias = ros2_jazzy.geometry_msgs__msg__TwistStamped
TwistWithCovariance: TypeAlias = ros2_jazzy.geometry_msgs__msg__TwistWithCovariance
LaserScan: TypeAlias = ros2_jazzy.sensor_msgs__msg__LaserScan
Range: TypeAlias = ros2_jazzy.sensor_msgs__msg__Range
Imu: TypeAlias = ros2_jazzy.sensor_msgs__msg__Imu
BatteryState: TypeAlias = ros2_jazzy.sensor_msgs__msg__BatteryState
GoalStatusArray: TypeAlias = ros2_jazzy.action_msgs__msg__GoalStatusArray
ActionlibStatusArray: TypeAlias = ros2_jazzy.actionlib_msgs__msg__GoalStatusArray
Duration: TypeAlias = ros2_jazzy.builtin_interfaces__msg__Duration
ColorRGBA: TypeAlias = ros2_jazzy.std_msgs__msg__ColorRGBA
CompressedImage: TypeAlias = ros2_jazzy.sensor_msgs__msg__CompressedImage
Marker: TypeAlias = ros2_jazzy.visualization_msgs__msg__Marker
MarkerArray: TypeAlias = ros2_jazzy.visualization_msgs__msg__MarkerArray
MeshFile: TypeAlias = ros2_jazzy.visualization_msgs__msg__MeshFile
DiagnosticArray: TypeAlias = ros2_jazzy.diagnostic_msgs__msg__DiagnosticArray
DiagnosticStatus: TypeAlias = ros2_jazzy.diagnostic_msgs__msg__DiagnosticStatus
KeyValue: TypeAlias = ros2_jazzy.diagnostic_msgs__msg__KeyValue
Odometry: TypeAlias = ros2_jazzy.nav_msgs__msg__Odometry


def dds_name(name: str) -> str:
    """`sensor_msgs::msg::dds_::LaserScan_` for `sensor_msgs/msg/LaserScan`."""
    package, _, rest = name.partition("/")
    folder, _, kind = rest.partition("/")
    return f"{package}::{folder}::dds_::{kind}_"


def ros_name(dds: str) -> str:
    """`sensor_msgs/msg/LaserScan` for `sensor_msgs::msg::dds_::LaserScan_`."""
    return dds.replace("::dds_::", "::").replace("::", "/").removesuffix("_")
