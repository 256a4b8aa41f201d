"""ROS 2 over Zenoh itself (rmw_zenoh_cpp): no bridge, the type and its hash stand in the key.

Keys, attachments and tokens as in rmw_zenoh's `docs/design.md`. A topic is listened to whatever its
type and hash, so that the robot may run any distribution; commands go out on the exact key.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Iterable, Mapping

import xxhash

from swarmd.core.values import Platform, Value
from swarmd.driver_api.driver import SenderSpec
from swarmd.drivers.ros.cdr import known_hashes, name_of, type_hash
from swarmd.drivers.ros.messages import dds_name, ros_name
from swarmd.drivers.ros.options import RmwOptions, read_options, topic
from swarmd.drivers.ros2.driver import RosDriver
from swarmd.drivers.ros2.key_scheme import Endpoint
from swarmd.drivers.ros2.zero_sender import RosZeroSender, zero_sender_of

NAME = "rmw_zenoh"
NO_HASH = "TypeHashNotSupported"
"""What stands for every type's hash in Humble."""

_NODE = "swarmd"
_LONGEST = 600
_COMMANDING = "::,1:,:,:,,"  # reliable, volatile, keep last 1: only what differs is written
_SENSING = "2::,1:,:,:,,"  # best effort
_ATTACHMENT = struct.Struct("<qqB16s")


def make_driver(
    *, swarm: str, robot: str, platform: Platform, options: Mapping[str, Value]
) -> RosDriver:
    """A driver that has not connected yet; ConfigError for options it does not know."""
    read = read_options(RmwOptions, options, NAME, robot)
    stopping = SenderSpec(f"{__name__}:make_zero_sender", {"robot": robot, "given": dict(options)})
    return RosDriver(NAME, _scheme(read), platform, read, stopping)


def make_zero_sender(*, robot: str, given: Mapping[str, Value]) -> RosZeroSender:
    """What the stopper's process says zero with."""
    read = read_options(RmwOptions, given, NAME, robot)
    return zero_sender_of(_scheme(read), read)


def gid_of(token: str) -> bytes:
    """The 16 bytes that name an endpoint: XXH3-128 of its token, low half first."""
    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(16, "little")


def attachment_of(sequence: int, gid: bytes) -> bytes:
    """What goes with a publisher's message of that number, now."""
    return _ATTACHMENT.pack(sequence, time.time_ns(), 16, gid)


def _scheme(options: RmwOptions) -> RmwZenoh:
    return RmwZenoh(options.domain, topic(options, options.cmd_vel))


class RmwZenoh:
    """`<domain>/<topic>/<type>/<hash>`, and what each publication must carry beside its payload."""

    hub = "rmw_zenohd"
    start = "start `ros2 run rmw_zenoh_cpp rmw_zenohd` on the robot"
    silent = "start the robot's nodes with RMW_IMPLEMENTATION=rmw_zenoh_cpp"
    graph = "@ros2_lv/**"
    nodes = ""

    def __init__(self, domain: int, cmd_vel: str) -> None:
        """`cmd_vel`: the full name of the topic that commands go to."""
        self.domain: int | None = domain
        self._cmd_vel = cmd_vel
        self._is_humble = False
        self._sequence = 0
        self._gid = bytes(16)

    def listening(self, topic: str) -> str:
        """Any type and hash of this very topic: one with more after it is another."""
        return f"{self.domain}{topic}/*/*"

    def fault(self, key: str, topic: str, kind: type) -> str:
        """Another type, or a hash that no distribution has for it."""
        prefix = f"{self.domain}{topic}/"
        told, _, hashed = key.removeprefix(prefix).partition("/")
        is_one = bool(told) and bool(hashed) and "*" not in key and "/" not in hashed
        if not (is_one and key.startswith(prefix) and key.isprintable() and len(key) < _LONGEST):
            return f"said on key {key[:80]!a}"
        wanted = name_of(kind)
        if told != dds_name(wanted):
            return f"it carries {ros_name(told)}; wanted is {wanted}"
        if hashed != NO_HASH and hashed not in known_hashes(kind):
            return f"its {wanted} has the type hash {hashed[:19]}, which no distribution has"
        if topic != self._cmd_vel:  # there others speak: a stopper says zero on every key
            self._is_humble = hashed == NO_HASH
        return ""

    def announced(self, token: str) -> Endpoint | None:
        """From `@ros2_lv/<domain>/<zid>/<nid>/<eid>/{MP|MS}/<enclave>/<ns>/<node>/<topic>/...`."""
        parts = token.split("/")
        if len(parts) < 13 or parts[5] not in ("MP", "MS") or not parts[1].isdecimal():
            return None
        node = f"{parts[7]}%{parts[8]}".replace("%", "/").replace("//", "/")
        topic = parts[9].replace("%", "/")
        return Endpoint(parts[5] == "MP", topic, ros_name(parts[10]), parts[2], int(parts[1]), node)

    def command_keys(self, topic: str, kind: type) -> tuple[str, ...]:
        """One with the hash, and Humble's without."""
        return tuple(self._key(topic, kind, hashed) for hashed in (type_hash(kind), NO_HASH))

    def command_key(self, topic: str, kind: type) -> str:
        """With Humble's word for the hash if that is what the robot says."""
        return self._key(topic, kind, self._hash_of(kind))

    def attachment(self) -> bytes | None:
        """Sequence number, time in ns since 1970, and who says it."""
        self._sequence += 1
        return attachment_of(self._sequence, self._gid)

    def introduce(self, zid: str, heard: Iterable[tuple[str, type]]) -> tuple[str, ...]:
        """A node that hears the topics given and, last of them, says the first: the command."""
        node = f"@ros2_lv/{self.domain}/{zid}/0"
        tokens = [f"{node}/0/NN/%/%/{_NODE}"]
        for index, (name, kind) in enumerate(heard, start=1):
            is_command = name == self._cmd_vel
            what, qos = ("MP", _COMMANDING) if is_command else ("MS", _SENSING)
            mangled = name.replace("/", "%")
            tokens.append(
                f"{node}/{index}/{what}/%/%/{_NODE}/{mangled}/{dds_name(name_of(kind))}"
                f"/{self._hash_of(kind)}/{qos}"
            )
            if is_command:
                self._gid = gid_of(tokens[-1])
        return tuple(tokens)

    def _hash_of(self, kind: type) -> str:
        return NO_HASH if self._is_humble else type_hash(kind)

    def _key(self, topic: str, kind: type, hashed: str) -> str:
        return f"{self.domain}{topic}/{dds_name(name_of(kind))}/{hashed}"
