"""ROS 2's messages as cyclonedds knows them: a second codec, and types for a DDS participant.

The simulated robots of the tests use it, so that the drivers are compared with a second library.
Only the definitions come from rosbags; `tests/drivers/ros/test_cdr.py` compares their hashes with
ROS's.
"""

# No `from __future__ import annotations`: cyclonedds reads the annotations as types.

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from types import new_class
from typing import Any

from cyclonedds.idl import IdlStruct, types
from cyclonedds.idl.types import array, sequence, uint8
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

_store = cache(get_typestore)


@cache
def _message(name: str, distro: Stores = Stores.ROS2_JAZZY) -> Any:
    """The class of a message; a field is zero or empty by default, the w of a quaternion 1."""
    hints: dict[str, Any] = {}
    members: dict[str, Any] = {"__annotations__": hints, "__doc__": name}
    for key, node in _store(distro).get_msgdef(name).fields:
        hints[key], make = _field(node)
        members[key] = field(default_factory=make)
    if name.endswith("/Quaternion"):
        members["w"] = 1.0
    package, _, kind = name.split("/")
    head = {"typename": f"{package}.msg.dds_.{kind}_"}
    return dataclass(new_class(kind, (IdlStruct,), head, lambda own: own.update(members)))


def _field(node: Any) -> tuple[Any, Callable[[], Any]]:
    """The type of a field, and what makes its default."""
    match node:
        case Nodetype.NAME, name:
            return _message(name), _message(name)
        case Nodetype.SEQUENCE, (item, _):
            return sequence[_field(item)[0]], list
        case Nodetype.ARRAY, (item, length):
            kind, make = _field(item)
            return array[kind, length], lambda: [make() for _ in range(length)]
        case _, ("string", _):
            return str, str
        case _, ("bool", _):
            return bool, bool
        case _, ("char", _):  # of ROS, not of IDL
            return uint8, int
        case _, (base, _):
            return getattr(types, base), float if base.startswith("float") else int
    raise TypeError(f"{node} is no field of a message")


Time = _message("builtin_interfaces/msg/Time")
Header = _message("std_msgs/msg/Header")
Vector3 = _message("geometry_msgs/msg/Vector3")
Quaternion = _message("geometry_msgs/msg/Quaternion")
Twist = _message("geometry_msgs/msg/Twist")
TwistStamped = _message("geometry_msgs/msg/TwistStamped")
Pose = _message("geometry_msgs/msg/Pose")
PoseWithCovariance = _message("geometry_msgs/msg/PoseWithCovariance")
TwistWithCovariance = _message("geometry_msgs/msg/TwistWithCovariance")
PoseStamped = _message("geometry_msgs/msg/PoseStamped")
PoseWithCovarianceStamped = _message("geometry_msgs/msg/PoseWithCovarianceStamped")
Odometry = _message("nav_msgs/msg/Odometry")
LaserScan = _message("sensor_msgs/msg/LaserScan")
Temperature = _message("sensor_msgs/msg/Temperature")
Joy = _message("sensor_msgs/msg/Joy")
Float32 = _message("std_msgs/msg/Float32")
Float32MultiArray = _message("std_msgs/msg/Float32MultiArray")
Bool = _message("std_msgs/msg/Bool")
Int32 = _message("std_msgs/msg/Int32")
Byte = _message("std_msgs/msg/Byte")
ByteMultiArray = _message("std_msgs/msg/ByteMultiArray")
Char = _message("std_msgs/msg/Char")
Range = _message("sensor_msgs/msg/Range")
OlderRange = _message("sensor_msgs/msg/Range", Stores.ROS2_HUMBLE)
Imu = _message("sensor_msgs/msg/Imu")
BatteryState = _message("sensor_msgs/msg/BatteryState")
GoalStatus = _message("action_msgs/msg/GoalStatus")
GoalStatusArray = _message("action_msgs/msg/GoalStatusArray")
MarkerArray = _message("visualization_msgs/msg/MarkerArray")
DiagnosticArray = _message("diagnostic_msgs/msg/DiagnosticArray")


@dataclass
class Gid(IdlStruct, typename="rmw_dds_common.msg.dds_.Gid_"):
    """Of 16 bytes since Iron."""

    data: array[uint8, 16]


@dataclass
class NodeEntitiesInfo(IdlStruct, typename="rmw_dds_common.msg.dds_.NodeEntitiesInfo_"):
    """rmw_dds_common/msg/NodeEntitiesInfo."""

    node_namespace: str
    node_name: str
    reader_gid_seq: sequence[Gid]
    writer_gid_seq: sequence[Gid]


@dataclass
class ParticipantEntitiesInfo(
    IdlStruct, typename="rmw_dds_common.msg.dds_.ParticipantEntitiesInfo_"
):
    """What a ROS 2 process tells of its nodes on topic `ros_discovery_info`."""

    gid: Gid
    node_entities_info_seq: sequence[NodeEntitiesInfo]


def empty(typename: str) -> Any:
    """A message with one byte, under any name of DDS such as `p::srv::dds_::S_Request_`."""
    hints = {"__annotations__": {"unused": uint8}, "unused": 0}
    head = {"typename": typename.replace("::", ".")}
    return dataclass(new_class("Empty", (IdlStruct,), head, lambda own: own.update(hints)))


@dataclass
class TriggerCall(IdlStruct, typename="std_srvs.srv.dds_.Trigger_Request_"):
    """A call of a std_srvs/Trigger as rmw_cyclonedds writes it, with the header of a request."""

    client: types.uint64 = 0
    number: types.int64 = 0
    unused: uint8 = 0


@dataclass
class TriggerAnswer(IdlStruct, typename="std_srvs.srv.dds_.Trigger_Response_"):
    """The answer to the call with the same header."""

    client: types.uint64 = 0
    number: types.int64 = 0
    success: bool = False
    message: str = ""


@dataclass
class TriggerResponse(IdlStruct, typename="std_srvs.srv.dds_.Trigger_Response_"):
    """The answer as it is on Zenoh, without a header."""

    success: bool = False
    message: str = ""


def stamped(seconds: float, frame: str = "base_link") -> Any:
    whole = int(seconds)
    return Header(Time(whole, round((seconds - whole) * 1e9) % 10**9), frame)
