"""ROS 2's messages as cyclonedds knows them: a third codec, and types for a DDS participant.

The definitions are those of `second_codec.py`, made anew for this library.
"""

# No `from __future__ import annotations`: cyclonedds reads the annotations as types.

from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from types import new_class
from typing import Any, get_args

import pycdr2
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, sequence, uint8

from tests.support import second_codec as second


@cache
def _twin(kind: Any) -> Any:
    """The same message for cyclonedds."""
    types = {one.name: _type(one.type) for one in fields(kind)}
    defaults: dict[str, Any] = {}
    for one in fields(kind):
        is_struct = types[one.name] is not one.type and isinstance(types[one.name], type)
        make = types[one.name] if is_struct else one.default_factory
        defaults[one.name] = one.default if make is MISSING else field(default_factory=make)
    body = {"__annotations__": types, "__doc__": kind.__name__, **defaults}
    name = {"typename": kind.__idl_typename__}
    return dataclass(new_class(kind.__name__, (IdlStruct,), name, lambda own: own.update(body)))


def _type(kind: Any) -> Any:
    if isinstance(kind, type) and issubclass(kind, pycdr2.IdlStruct):
        return _twin(kind)
    shape = get_args(kind)[-1] if get_args(kind) else None
    if isinstance(shape, pycdr2.types.sequence):
        return sequence[shape.subtype]
    if isinstance(shape, pycdr2.types.array):
        return array[shape.subtype, shape.length]
    return kind  # the libraries have the scalars in common


Time, Header, Vector3 = _twin(second.Time), _twin(second.Header), _twin(second.Vector3)
Twist, TwistStamped = _twin(second.Twist), _twin(second.TwistStamped)
LaserScan, Odometry = _twin(second.LaserScan), _twin(second.Odometry)


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
