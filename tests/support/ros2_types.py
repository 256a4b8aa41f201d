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


_NAMES = {
    "Time": "builtin_interfaces/msg/Time",
    "Header": "std_msgs/msg/Header",
    "Vector3": "geometry_msgs/msg/Vector3",
    "Quaternion": "geometry_msgs/msg/Quaternion",
    "Twist": "geometry_msgs/msg/Twist",
    "TwistStamped": "geometry_msgs/msg/TwistStamped",
    "Pose": "geometry_msgs/msg/Pose",
    "PoseWithCovariance": "geometry_msgs/msg/PoseWithCovariance",
    "TwistWithCovariance": "geometry_msgs/msg/TwistWithCovariance",
    "PoseStamped": "geometry_msgs/msg/PoseStamped",
    "PoseWithCovarianceStamped": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "Odometry": "nav_msgs/msg/Odometry",
    "LaserScan": "sensor_msgs/msg/LaserScan",
    "Temperature": "sensor_msgs/msg/Temperature",
    "Joy": "sensor_msgs/msg/Joy",
    "Float32": "std_msgs/msg/Float32",
    "Float32MultiArray": "std_msgs/msg/Float32MultiArray",
    "Bool": "std_msgs/msg/Bool",
    "String": "std_msgs/msg/String",
    "Int32": "std_msgs/msg/Int32",
    "Byte": "std_msgs/msg/Byte",
    "ByteMultiArray": "std_msgs/msg/ByteMultiArray",
    "Char": "std_msgs/msg/Char",
    "Range": "sensor_msgs/msg/Range",
    "Imu": "sensor_msgs/msg/Imu",
    "BatteryState": "sensor_msgs/msg/BatteryState",
    "GoalStatus": "action_msgs/msg/GoalStatus",
    "GoalStatusArray": "action_msgs/msg/GoalStatusArray",
    "MarkerArray": "visualization_msgs/msg/MarkerArray",
    "DiagnosticArray": "diagnostic_msgs/msg/DiagnosticArray",
}
_OLDER = {"OlderRange": ("sensor_msgs/msg/Range", Stores.ROS2_HUMBLE)}


def __getattr__(name: str) -> Any:
    """The class of a message, made when a test asks for it: all take 0.4 s of CPU."""
    if name in _NAMES:
        return _message(_NAMES[name])
    if name in _OLDER:
        return _message(*_OLDER[name])
    raise AttributeError(f"no message {name}")


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
    time = _message(_NAMES["Time"])(whole, round((seconds - whole) * 1e9) % 10**9)
    return _message(_NAMES["Header"])(time, frame)
