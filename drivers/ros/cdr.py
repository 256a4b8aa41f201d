"""Decodes and encodes ROS 2 messages by rosbags: CDR with four bytes of header.

rosbags reads a 360-ray LaserScan within its budget of 10 us and writes a Twist in 3 us
(`benchmarks.cdr`), so that no code of our own is needed.
"""

from __future__ import annotations

from contextlib import suppress
from functools import lru_cache
from typing import Any, TypeVar, cast

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from swarmd.core.errors import CodecError
from swarmd.drivers.ros.messages import Range

MAX_PAYLOAD = 256 * 1024
DISTROS = (Stores.ROS2_HUMBLE, Stores.ROS2_IRON, Stores.ROS2_JAZZY, Stores.ROS2_KILTED,
           Stores.ROS2_LYRICAL)  # fmt: skip

STORE = "__typestore__"
"""The attribute of a class from a `.msg` file with the typestore that read the file."""

M = TypeVar("M")


def decode(kind: type[M], payload: bytes) -> M:
    """The message; arrays are views of `payload`. CodecError if the bytes are malformed.

    A Range is also read in the form of Humble and Iron, which has no variance.
    """
    if len(payload) > MAX_PAYLOAD:
        raise CodecError(f"{len(payload)} bytes; expected at most {MAX_PAYLOAD}")
    try:
        return cast(M, store_of(kind).deserialize_cdr(payload, name_of(kind)))
    except SerdeError as error:
        if cast(Any, kind) is Range:
            with suppress(SerdeError):
                return cast(M, store(Stores.ROS2_HUMBLE).deserialize_cdr(payload, name_of(kind)))
        raise CodecError(str(error)) from error


def encode(message: object) -> bytes:
    """The bytes of a message, little-endian."""
    kind = type(message)
    return bytes(store_of(kind).serialize_cdr(message, name_of(kind), little_endian=True))


def build_codecs(*kinds: type) -> None:
    """Build the readers and writers of message types now: else the first use takes milliseconds."""
    for kind in kinds:
        store_of(kind).get_msgdef(name_of(kind))


def name_of(kind: type) -> str:
    """Such as `sensor_msgs/msg/LaserScan`."""
    name: str = kind.__msgtype__  # type: ignore[attr-defined]  # a field of rosbags' dataclasses
    return name


def type_hash(kind: type) -> str:
    """The hash of the type's newest definition, such as `RIHS01_64c1...` (REP 2016)."""
    return str(store_of(kind).hash_rihs01(name_of(kind)))


@lru_cache(maxsize=32)
def known_hashes(kind: type) -> frozenset[str]:
    """The hashes that the type has in any distribution from Humble on, or by its `.msg` file."""
    name = name_of(kind)
    known = (store_of(kind, distro) for distro in DISTROS)
    return frozenset(one.hash_rihs01(name) for one in known if name in one.types)


def store_of(kind: type, distro: Stores = Stores.ROS2_JAZZY) -> Typestore:
    """The typestore with the definition of a type; for a type from a `.msg` file its own store."""
    own: Typestore | None = getattr(kind, STORE, None)
    return own or store(distro)


@lru_cache(maxsize=len(Stores))
def store(distro: Stores = Stores.ROS2_JAZZY) -> Typestore:
    """The definitions of a distribution, also of ROS 1; loading takes some tens of milliseconds."""
    return get_typestore(distro)
