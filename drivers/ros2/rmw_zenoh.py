"""ROS 2 over Zenoh itself (rmw_zenoh_cpp): no bridge; a key holds the type and its hash.

Keys, attachments and tokens as in rmw_zenoh's `docs/design.md`. The driver subscribes to a topic
whatever its type and hash, so that the robot may run any distribution; commands go out on the exact
key. `make_robots` is the robots' side, for simulated robots; its hashes are Jazzy's.
"""

from __future__ import annotations

import struct
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import xxhash

from swarmd.core.values import Platform, Value
from swarmd.driver_api.driver import ZeroSenderSpec
from swarmd.driver_api.emulator import OnCommand
from swarmd.drivers.ros.cdr import known_hashes, name_of, type_hash
from swarmd.drivers.ros.diagnosis import Endpoint
from swarmd.drivers.ros.messages import dds_name, ros_name
from swarmd.drivers.ros.options import RmwOptions, RosOptions, read_options
from swarmd.drivers.ros2.driver import RosDriver
from swarmd.drivers.ros2.emulator import EmulatedEndpoint, EmulatedRobots, EmulatorSpec
from swarmd.drivers.ros2.key_scheme import Ros2Middleware
from swarmd.drivers.ros2.zero_sender import RosZeroSender, zero_sender_of

NAME = "rmw_zenoh"
NO_HASH = "TypeHashNotSupported"
"""Humble's placeholder for every type's hash."""

_NODE, _EMULATED_NODE = "swarmd", "base"
_MAX_KEY = 600
_RELIABLE_1 = "::,1:,:,:,,"  # reliable, volatile, keep last 1: only what differs is written
_RELIABLE_10 = "::,10:,:,:,,"
_BEST_EFFORT_1 = "2::,1:,:,:,,"
_BEST_EFFORT_5 = "2::,5:,:,:,,"
_ATTACHMENT = struct.Struct("<qqB16s")


def make_driver(
    *, swarm: str, robot: str, platform: Platform, options: Mapping[str, Value]
) -> RosDriver:
    """A driver that has not connected yet; ConfigError for unknown options."""
    read = read_options(RmwOptions, options, NAME, robot)
    spec = ZeroSenderSpec(f"{__name__}:make_zero_sender", {"robot": robot, "given": dict(options)})
    return RosDriver(NAME, _scheme(read), platform, read, spec)


def make_zero_sender(*, robot: str, given: Mapping[str, Value]) -> RosZeroSender:
    """The zero sender of the watchdog's process."""
    read = read_options(RmwOptions, given, NAME, robot)
    return zero_sender_of(_scheme(read), read)


def make_robots(
    *, robots: Mapping[str, Platform], endpoint: str, on_command: OnCommand
) -> EmulatedRobots:
    """Robots, each a node in a namespace of its own, at one rmw_zenohd that is at `endpoint`."""
    return EmulatedRobots(
        EmulatorSpec(NAME, RmwOptions, _emulated_node), robots, endpoint, on_command
    )


def gid_of(token: str) -> bytes:
    """The 16 bytes that identify an endpoint: XXH3-128 of its token, low half first."""
    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(16, "little")


def attachment_of(sequence: int, gid: bytes) -> bytes:
    """The attachment of a publisher's message of that number, sent now."""
    return _ATTACHMENT.pack(sequence, time.time_ns(), 16, gid)


def _scheme(options: RmwOptions) -> RmwZenoh:
    return RmwZenoh(options.domain, options.topic(options.cmd_vel))


def _emulated_node(options: RosOptions, index: int) -> EmulatedNode:
    assert isinstance(options, RmwOptions)
    return EmulatedNode(options.domain, options.namespace, index)


class RmwZenoh(Ros2Middleware):
    """`<domain>/<topic>/<type>/<hash>`, and the attachment that each publication must carry."""

    hub = "rmw_zenohd"
    start = "start `ros2 run rmw_zenoh_cpp rmw_zenohd` on the robot"
    silent = (
        "announces no topic at all; start the robot's nodes with RMW_IMPLEMENTATION=rmw_zenoh_cpp"
    )
    tokens = "@ros2_lv/**"
    nodes = ""

    def __init__(self, domain: int, cmd_vel: str) -> None:
        """`cmd_vel`: the full name of the command topic."""
        self.domain: int | None = domain
        self._cmd_vel = cmd_vel
        self._is_humble = False
        self._sequence = 0
        self._gid = bytes(16)

    def subscription_key(self, topic: str) -> str:
        """Any type and hash of this very topic: a longer name is another topic."""
        return f"{self.domain}{topic}/*/*"

    def key_fault(self, key: str, topic: str, message_type: type) -> str:
        """Another type, or a hash that the type has in no distribution."""
        prefix = f"{self.domain}{topic}/"
        type_name, _, hashed = key.removeprefix(prefix).partition("/")
        is_one = bool(type_name) and bool(hashed) and "*" not in key and "/" not in hashed
        if not (is_one and key.startswith(prefix) and key.isprintable() and len(key) < _MAX_KEY):
            return f"sent on key {key[:80]!a}"
        wanted = name_of(message_type)
        if type_name != dds_name(wanted):
            return f"it carries {ros_name(type_name)}; wanted is {wanted}"
        if hashed != NO_HASH and hashed not in known_hashes(message_type):
            return f"its {wanted} has the type hash {hashed[:19]}, which no distribution has"
        if topic != self._cmd_vel:  # others publish there: a watchdog sends zero on every key
            self._is_humble = hashed == NO_HASH
        return ""

    def parse_token(self, token: str) -> Endpoint | None:
        """From `@ros2_lv/<domain>/<zid>/<nid>/<eid>/{MP|MS}/<enclave>/<ns>/<node>/<topic>/...`."""
        parts = token.split("/")
        if len(parts) < 13 or parts[5] not in ("MP", "MS") or not parts[1].isdecimal():
            return None
        node = f"{parts[7]}%{parts[8]}".replace("%", "/").replace("//", "/")
        topic = parts[9].replace("%", "/")
        return Endpoint(parts[5] == "MP", topic, ros_name(parts[10]), parts[2], int(parts[1]), node)

    def command_keys(self, topic: str, message_type: type) -> tuple[str, ...]:
        """One with the type's hash, and Humble's without."""
        return tuple(
            self._key(topic, message_type, hashed) for hashed in (type_hash(message_type), NO_HASH)
        )

    def command_key(self, topic: str, message_type: type) -> str:
        """With Humble's placeholder for the hash if the robot's samples have it."""
        return self._key(topic, message_type, self._hash_of(message_type))

    def attachment(self) -> bytes | None:
        """Sequence number, time in ns since 1970, and the publisher's gid."""
        self._sequence += 1
        return attachment_of(self._sequence, self._gid)

    def own_tokens(self, zid: str, topics: Iterable[tuple[str, type]]) -> tuple[str, ...]:
        """A node that subscribes to the topics and publishes the last of them, the command."""
        node = f"@ros2_lv/{self.domain}/{zid}/0"
        tokens = [f"{node}/0/NN/%/%/{_NODE}"]
        for index, (name, message_type) in enumerate(topics, start=1):
            is_command = name == self._cmd_vel
            direction, qos = ("MP", _RELIABLE_1) if is_command else ("MS", _BEST_EFFORT_1)
            tokens.append(
                f"{node}/{index}/{direction}/%/%/{_NODE}/{_mangled(name)}"
                f"/{dds_name(name_of(message_type))}/{self._hash_of(message_type)}/{qos}"
            )
            if is_command:
                self._gid = gid_of(tokens[-1])
        return tuple(tokens)

    def _hash_of(self, message_type: type) -> str:
        return NO_HASH if self._is_humble else type_hash(message_type)

    def _key(self, topic: str, message_type: type, hashed: str) -> str:
        return f"{self.domain}{topic}/{dds_name(name_of(message_type))}/{hashed}"


class EmulatedNode:
    """One node of a robot: `index` is its number in the session that all robots share."""

    def __init__(self, domain: int, namespace: str, index: int) -> None:
        self._domain, self._namespace, self._index = domain, f"/{namespace.strip('/')}", index
        self._sent: Counter[str] = Counter()
        self._gids: dict[str, bytes] = {}

    def key(self, topic: str, message_type: type) -> str:
        """`<domain>/<topic>/<type>/<hash>`."""
        type_name = dds_name(name_of(message_type))
        return f"{self._domain}{topic}/{type_name}/{type_hash(message_type)}"

    def tokens(
        self, zid: str, ends: Sequence[EmulatedEndpoint]
    ) -> tuple[Sequence[str], Sequence[str]]:
        """The node's token, and one for each of its endpoints."""
        first = self._index * 100
        context = f"@ros2_lv/{self._domain}/{zid}/{self._index}"
        node = f"%/{_mangled(self._namespace)}/{_EMULATED_NODE}"
        tokens = []
        for number, end in enumerate(ends, start=first + 1):
            direction = "MP" if end.is_publisher else "MS"
            qos = _BEST_EFFORT_5 if end.is_sensor else _RELIABLE_10
            tokens.append(
                f"{context}/{number}/{direction}/{node}/{_mangled(end.topic)}"
                f"/{dds_name(name_of(end.message_type))}/{type_hash(end.message_type)}/{qos}"
            )
        self._gids = {token: gid_of(token) for token in tokens}
        return (f"{context}/{first}/NN/{node}",), tuple(tokens)

    def attachment(self, token: str) -> bytes | None:
        """The publisher's sequence number, the time and its gid."""
        self._sent[token] += 1
        return attachment_of(self._sent[token], self._gids[token])


def _mangled(name: str) -> str:
    return name.replace("/", "%")
