"""Driver `rmw_zenoh`: ROS 2 with rmw_zenoh_cpp, without a bridge; a key has type and type hash.

Keys, attachments and tokens follow rmw_zenoh's `docs/design.md`. The driver subscribes to a topic
with any type and hash, so that the robot may run any distribution. Commands are published on the
exact key. `make_robots` makes simulated robots of this middleware, with the hashes of Jazzy.
"""

from __future__ import annotations

import itertools
import struct
import time
from collections import Counter
from collections.abc import Mapping, Sequence

import xxhash

from swarmd.core.errors import CodecError
from swarmd.core.values import Platform, Value
from swarmd.driver_api.driver import ZeroSenderSpec
from swarmd.driver_api.emulator import OnCommand
from swarmd.drivers.ros.cdr import known_hashes, name_of, type_hash
from swarmd.drivers.ros.endpoints import Endpoint
from swarmd.drivers.ros.messages import Odometry, dds_name, ros_name
from swarmd.drivers.ros.options import RmwOptions, RosOptions, of_commands, read_options
from swarmd.drivers.ros2.driver import RosDriver
from swarmd.drivers.ros2.emulator import EmulatedRobots, EmulatorSpec
from swarmd.drivers.ros2.key_scheme import Ros2Middleware, TopicEnd
from swarmd.drivers.ros2.zero_sender import RosZeroSender

NAME = "rmw_zenoh"
NO_HASH = "TypeHashNotSupported"
"""The placeholder of Humble for the hash of every type."""

TRIGGER = "std_srvs::srv::dds_::Trigger_"
TRIGGER_HASH = "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
"""Type name and hash (REP 2016) of std_srvs/Trigger, equal in all distributions from Iron on."""

_MAX_KEY = 600
# rmw's numbers for reliability and for durability
_BEST_EFFORT = "2"
_TRANSIENT_LOCAL = "1"
_ATTACHMENT = struct.Struct("<qqB16s")


def make_driver(
    *, swarm: str, robot: str, platform: Platform, options: Mapping[str, Value]
) -> RosDriver:
    """A driver that has not connected yet; ConfigError for unknown options."""
    read = read_options(RmwOptions, options, NAME, robot, platform)
    spec = ZeroSenderSpec(
        f"{__name__}:make_zero_sender", {"robot": robot, "given": of_commands(options)}
    )
    return RosDriver(NAME, _scheme(read), platform, read, spec)


def make_zero_sender(*, robot: str, given: Mapping[str, Value]) -> RosZeroSender:
    """The zero sender of the watchdog's process."""
    read = read_options(RmwOptions, given, NAME, robot)
    return RosZeroSender(_scheme(read), read)


def make_robots(
    *, robots: Mapping[str, Platform], endpoint: str, on_command: OnCommand
) -> EmulatedRobots:
    """Simulated robots, each a node in its own namespace, at one rmw_zenohd at `endpoint`."""
    spec = EmulatorSpec(NAME, RmwOptions, _emulated)
    return EmulatedRobots(spec, robots, endpoint, on_command)


def gid_of(token: str) -> bytes:
    """The 16-byte gid of an endpoint: XXH3-128 of its token, little-endian."""
    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(16, "little")


def _scheme(options: RmwOptions) -> RmwZenoh:
    return RmwZenoh(options.domain, options.topic(options.cmd_vel))


def _emulated(options: RosOptions, index: int) -> RmwZenoh:
    assert isinstance(options, RmwOptions)
    cmd_vel = options.topic(options.cmd_vel)
    return RmwZenoh(options.domain, cmd_vel, f"/{options.namespace.strip('/')}", "base", index)


class RmwZenoh(Ros2Middleware):
    """`<domain>/<topic>/<type>/<hash>`, and the attachment that each publication must carry."""

    hub = "rmw_zenohd"
    start = "start `ros2 run rmw_zenoh_cpp rmw_zenohd` on the robot"
    silent = (
        "announces no topic at all; start the robot's nodes with RMW_IMPLEMENTATION=rmw_zenoh_cpp"
    )
    announcements = "@ros2_lv/**"
    admin_space = ""
    is_node = True
    crashed = "rmw_zenohd will forget the first within a minute"
    lease = 62.0  # a router of rmw_zenoh gives a silent session up after 60 s

    def __init__(
        self, domain: int, cmd_vel: str, namespace: str = "/", node: str = "swarmd", index: int = 0
    ) -> None:
        """A scheme of one node.

        `cmd_vel`: full name of the command topic. `namespace`, `node`: the names under which the
        node is announced. `index`: number of this node within its Zenoh session.
        """
        self.domain: int | None = domain
        self._cmd_vel = cmd_vel
        self._node = f"%/{_mangled(namespace)}/{node}"
        self._index = index
        self._is_humble = False
        self._has_odometry = False  # heard: it decides `_is_humble` from then on
        self._sent: Counter[str] = Counter()

    def subscription_key(self, topic: str) -> str:
        """The key expression for any type and hash of this name, without longer names."""
        return f"{self.domain}{topic}/*/*"

    def key_fault(self, key: str, topic: str, message_type: type) -> str:
        """The fault of a key: another topic or type, or a hash that no distribution has."""
        prefix = f"{self.domain}{topic}/"
        type_name, _, hashed = key.removeprefix(prefix).partition("/")
        # A key of one topic: a type and a hash behind the topic, and no wildcard.
        is_one = bool(type_name) and bool(hashed) and "*" not in key and "/" not in hashed
        if not (is_one and key.startswith(prefix) and key.isprintable() and len(key) < _MAX_KEY):
            return f"sent on key {key[:80]!a}"
        wanted = name_of(message_type)
        if type_name != dds_name(wanted):
            return f"it carries {ros_name(type_name)}; expected {wanted}"
        if hashed != NO_HASH and hashed not in known_hashes(message_type):
            return f"its {wanted} has the type hash {hashed[:19]}, which no distribution has"
        # On the topic of commands other nodes publish, such as a watchdog that uses every key. The
        # node that takes the commands publishes odometry; a lidar may be of another distribution.
        is_odometry = message_type is Odometry
        if topic != self._cmd_vel and (is_odometry or not self._has_odometry):
            self._is_humble = hashed == NO_HASH
        self._has_odometry = self._has_odometry or is_odometry
        return ""

    def parse_token(self, token: str) -> Endpoint | None:
        """The endpoint of a token.

        `@ros2_lv/<domain>/<zid>/<nid>/<eid>/{MP|MS}/<enclave>/<ns>/<node>/<topic>/<type>/...`
        """
        parts = token.split("/")
        if len(parts) < 13 or parts[5] not in ("MP", "MS") or not parts[1].isdecimal():
            return None
        node = f"{parts[7]}%{parts[8]}".replace("%", "/").replace("//", "/")
        topic = parts[9].replace("%", "/")
        reliability, _, others = parts[12].partition(":")  # empty where it is the default
        quality = "best effort" if reliability == _BEST_EFFORT else "reliable"
        quality += ", transient local" if others.partition(":")[0] == _TRANSIENT_LOCAL else ""
        domain = int(parts[1])
        type_name = ros_name(parts[10])
        return Endpoint(parts[5] == "MP", topic, type_name, parts[2], domain, node, quality)

    def key(self, topic: str, message_type: type) -> str:
        """The key with the type's hash, or Humble's placeholder if the robot's keys have it."""
        return self._key(topic, message_type, self._hash_of(message_type))

    def command_keys(self, topic: str, message_type: type) -> tuple[str, ...]:
        """Two keys: with the hash of the type, and with Humble's placeholder."""
        return tuple(
            self._key(topic, message_type, hashed) for hashed in (type_hash(message_type), NO_HASH)
        )

    def tokens(
        self, zid: str, ends: Sequence[TopicEnd], services: Sequence[str] | None = None
    ) -> tuple[str, ...]:
        """The node's token, and a token for each service and end.

        Default qualities are left out of tokens. A node with `services` is `<node>_services`.
        """
        index = self._index + (services is not None)
        node = self._node if services is None else f"{self._node}_services"
        context = f"@ros2_lv/{self.domain}/{zid}/{index}"
        numbers = itertools.count(100 * index)
        found = [f"{context}/{next(numbers)}/NN/{node}"]
        for service in services or ():
            end = f"{_mangled(service)}/{TRIGGER}/{TRIGGER_HASH}/::,10:,:,:,,"
            found.append(f"{context}/{next(numbers)}/SS/{node}/{end}")
        for one in ends:
            qos = f"{'' if one.is_reliable else _BEST_EFFORT}::,{one.depth}:,:,:,,"
            found.append(
                f"{context}/{next(numbers)}/{'MP' if one.is_publisher else 'MS'}/{node}"
                f"/{_mangled(one.topic)}/{dds_name(name_of(one.message_type))}"
                f"/{self._hash_of(one.message_type)}/{qos}"
            )
        return tuple(found)

    def attachment(self, token: str = "") -> bytes | None:
        """Sequence number, ns since 1970, and the publisher's gid; gid 0 without a token."""
        self._sent[token] += 1
        gid = gid_of(token) if token else bytes(16)
        return _ATTACHMENT.pack(self._sent[token], time.time_ns(), 16, gid)

    def call_stamp(self, key: str, attachment: bytes | None) -> float | None:
        """The stamp of the caller. CodecError for a wildcard, a foreign type or attachment."""
        if "*" in key or not key.endswith((f"/{TRIGGER}/{TRIGGER_HASH}", f"/{TRIGGER}/{NO_HASH}")):
            raise CodecError("no call of a client")
        _, stamp, _ = _unpacked(attachment)
        return stamp * 1e-9

    def reply_attachment(self, attachment: bytes | None) -> bytes | None:
        """Sequence number and gid of the call, and the present time."""
        sequence, _, gid = _unpacked(attachment)
        return _ATTACHMENT.pack(sequence, time.time_ns(), len(gid), gid)

    def _hash_of(self, message_type: type) -> str:
        return NO_HASH if self._is_humble else type_hash(message_type)

    def _key(self, topic: str, message_type: type, hashed: str) -> str:
        return f"{self.domain}{topic}/{dds_name(name_of(message_type))}/{hashed}"


def _unpacked(attachment: bytes | None) -> tuple[int, int, bytes]:
    """Sequence number, ns since 1970 and gid; CodecError for any other attachment."""
    if attachment is None or len(attachment) != _ATTACHMENT.size:
        raise CodecError("no attachment of rmw_zenoh")
    sequence, stamp, size, gid = _ATTACHMENT.unpack(attachment)
    if size != len(gid):
        raise CodecError("no attachment of rmw_zenoh")
    return sequence, stamp, gid


def _mangled(name: str) -> str:
    return name.replace("/", "%")
