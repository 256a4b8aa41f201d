"""The structs and the codec of the swarm's datagrams. Pure: bytes in, structs out.

Every version of swarmd can read a datagram. The head has a fixed layout. The body is a MessagePack
array: later versions append fields at the end, and older versions ignore unknown fields::

    offset  bytes
    0       4      magic b"SWMD"
    4       1      kind
    5       8      tag of profile, swarm and authority, zeros for any swarm
    13      2      length of the body, big endian
    15      n      body
    15 + n  0..    the signature of a secured swarm (`signature.py`), ignored here

Reading raises nothing but `CodecError`. The bounds of the fields also refuse NaN and infinity.
"""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Callable, Collection
from enum import IntEnum
from functools import cache
from typing import Annotated, Any, Literal, get_args

import msgspec
from msgspec import Meta, Struct

from swarmd.core.bounds import MAX_SECONDS, Line, Name, Seconds, Word
from swarmd.core.codec import decode
from swarmd.core.errors import CodecError
from swarmd.core.goal import MAX_GOAL
from swarmd.core.kin_message import KinMessage
from swarmd.core.messages import Body, Latch, Presence, State
from swarmd.core.record import Digest, RecordKind

MAGIC = b"SWMD"
TAG_BYTES = 8
ANY_SWARM = bytes(TAG_BYTES)
Address = tuple[str, int]
"""Host and port; a link-local IPv6 host ends with `%` and the number of the interface."""
# Bytes; fits one frame of WiFi and Ethernet with the heads of IPv6 and UDP.
MAX_DATAGRAM = 1400
MAX_TRAILER = 77  # bytes of the longest signature, within MAX_DATAGRAM
MAX_KINDS = 8  # kinds of records whose digests a beacon shows
MAX_UNHEARD = 8  # robots that a beacon names as unheard
MAX_STATUS_PARTS = 8  # datagrams of one status; a greater status is asked for on a link
STATUS_PART_BYTES = 1200  # within MAX_DATAGRAM with the other fields of a `StatusPart`
MAX_HOPS = 4  # a stop or a report travels at most this far from robot to robot
_HEAD = struct.Struct(f">4sB{TAG_BYTES}sH")
MAX_MS = round(1000 * MAX_SECONDS)
_ROUNDING = 1e-6  # mm: error of a whole number of mm that was computed from m

RobotId = Annotated[str, Meta(pattern=r"^[a-z0-9][a-z0-9_-]{0,62}\Z")]
Bytes6 = Annotated[bytes, Meta(min_length=6, max_length=6)]
Milliseconds = Annotated[int, Meta(ge=0, le=MAX_MS)]
Nanoseconds = Annotated[int, Meta(ge=0, le=2**62)]
Millimetres = Annotated[int, Meta(ge=0, le=100_000)]
Coordinate = Annotated[int, Meta(ge=-1_000_000_000, le=1_000_000_000)]
"""Millimetres in a shared frame."""
Milliradians = Annotated[int, Meta(ge=-3142, le=3142)]
Number = Annotated[int, Meta(ge=0, le=2**53)]
Hops = Annotated[int, Meta(ge=0, le=MAX_HOPS)]
Host = Annotated[str, Meta(max_length=64)]
Short = Annotated[str, Meta(max_length=128)]
Reason = Annotated[str, Meta(max_length=256)]
HandSpeed = Annotated[float, Meta(ge=-100.0, le=100.0)]
"""m/s or rad/s: beyond what any platform does."""


class Kind(IntEnum):
    """The kind of a datagram; numbers are never reused."""

    BEACON = 1
    SOLICIT = 2
    MEMBER_LIST = 3
    STOP = 4
    ACK = 5
    LATCHES = 6
    MESSAGE = 7
    SWARM = 8
    PLACE = 9
    CLOCK_QUERY = 10
    CLOCK_REPLY = 11
    GOAL = 12
    RUN_LEASE = 13
    KIN = 14
    STATUS = 15
    DRIVE = 16


class Flag(IntEnum):
    """The flags of a beacon, which are bits.

    No IntFlag: its `&` takes ten times as long, and each beacon is asked four times.
    """

    JOINING = 1  # the robot claims its id and does not own it yet
    LEFT = 2  # the daemon ends in order


STATES = tuple(State)  # the index of a state on the wire; append only
PRESENCES = tuple(Presence)

KIND_OFFSET = 4
URGENT = (Kind.STOP, Kind.ACK, Kind.LATCHES)
"""Kinds that are sent by all ways at once, and that no flood of other kinds may shut out."""

OnDatagram = Callable[[bytes, Address, float], object]
"""Takes a datagram from a carrier: bytes, source, and s for which it waited on this machine."""


class _Datagram(Struct, frozen=True, kw_only=True, array_like=True):
    """The body of a datagram."""


class BodyReport(_Datagram, frozen=True, kw_only=True):
    """A `Body` in mm and mm/s; None: not known."""

    platform: Annotated[str, Meta(max_length=63)]
    surface_speed: Millimetres
    radius: Millimetres
    scan_plane: Millimetres | None
    lowest: Millimetres | None
    highest: Millimetres | None

    @classmethod
    def of(cls, body: Body) -> BodyReport:
        """The report of a body; speed and radius are rounded up."""
        heights = (body.scan_plane, body.lowest, body.highest)
        plane, lowest, highest = (None if h is None else round(1000.0 * h) for h in heights)
        return cls(
            platform=body.platform[:63],
            surface_speed=math.ceil(1000.0 * body.surface_speed - _ROUNDING),
            radius=math.ceil(1000.0 * body.radius - _ROUNDING),
            scan_plane=plane,
            lowest=lowest,
            highest=highest,
        )

    @property
    def body(self) -> Body:
        """The body in m and m/s."""
        heights = (self.scan_plane, self.lowest, self.highest)
        plane, lowest, highest = (None if h is None else h / 1000.0 for h in heights)
        return Body(
            platform=self.platform,
            surface_speed=self.surface_speed / 1000.0,
            radius=self.radius / 1000.0,
            scan_plane=plane,
            lowest=lowest,
            highest=highest,
        )


class Beacon(_Datagram, frozen=True, kw_only=True):
    """Shows that a robot is there: sent once a second, at each change, and when solicited."""

    robot: RobotId
    instance: Bytes6
    sequence: Number  # rises with each beacon of an instance
    wire: Annotated[int, Meta(ge=0, le=255)]  # the version of the requests that the daemon reads
    state: Annotated[int, Meta(ge=0, le=255)]  # an index in STATES, unknown from a later version
    revision: Number  # counts the changes of the robot
    flags: Annotated[int, Meta(ge=0, le=255)] = 0
    digests: Annotated[tuple[Digest, ...], Meta(max_length=MAX_KINDS)] = ()  # by `RecordKind`
    echo: Number = 0  # the number of the `Solicit` that the beacon answers
    version: Annotated[str, Meta(max_length=32)] = ""  # of the package; only answers have it
    body: BodyReport | None = None  # None from an older version
    number: Number = 0  # counts the beacons to all, so that losses show; 0: sent to one receiver
    said: Number = 0  # messages of patterns that the instance has sent; only in answers
    clock: Milliseconds = 0  # the instance's clock, as `Place.sent`; only in answers
    # Only in an answer to a `Solicit` with `wants_status`: the number of `StatusPart`s that follow.
    # 0: the status is asked for on a link.
    status_parts: Annotated[int, Meta(ge=0, le=255)] = 0
    # Only in beacons to all (`hearing.py`): how many messages of patterns, places and kin reports
    # the instance has sent; of which robots it misses them although beacons tell of them; and of
    # how many robots they arrive.
    sent: Number = 0
    unheard: Annotated[tuple[RobotId, ...], Meta(max_length=MAX_UNHEARD)] = ()
    heard: Annotated[int, Meta(ge=0, le=1024)] = 0

    def digest(self, kind: RecordKind) -> bytes:
        """The digest of the records of a kind; empty without a record."""
        return self.digests[kind] if kind < len(self.digests) else b""


class Solicit(_Datagram, frozen=True, kw_only=True):
    """Asks robots to answer at once with a beacon, and with the lists that `wants_...` names.

    The answer repeats `echo`. By the echo the asker measures the round trip, and detects replayed
    answers in a secured swarm.
    """

    echo: Number
    wants_members: bool = False
    wants_latches: bool = False
    wants_goal: bool = False
    # The only robot that is asked, which answers also while it claims its id; None: all.
    robot: RobotId | None = None
    wants_status: bool = False  # ignored by an earlier version, and in a secured swarm


class MemberReport(_Datagram, frozen=True, kw_only=True):
    """The report of a robot on another member."""

    robot: RobotId
    instance: Bytes6
    presence: Annotated[int, Meta(ge=0, le=255)]  # an index in PRESENCES
    age: Milliseconds  # since the member was heard (alive), or since it left or failed
    hops: Hops = 0  # 0: heard directly, from `host` and `port`
    host: Host = ""
    port: Annotated[int, Meta(ge=0, le=65535)] = 0


class MemberList(_Datagram, frozen=True, kw_only=True):
    """A part of a robot's list of the other members; `part` counts from 0 to `parts` - 1.

    `members`: the members in this part. `roster`: names of robots that the settings of `robot`
    expect, as far as they are in this part. Over all parts, the names follow the members.
    """

    robot: RobotId
    instance: Bytes6
    members: Annotated[tuple[MemberReport, ...], Meta(max_length=64)]
    part: Annotated[int, Meta(ge=0, le=255)] = 0
    parts: Annotated[int, Meta(ge=1, le=256)] = 1
    echo: Number = 0
    roster: Annotated[tuple[RobotId, ...], Meta(max_length=64)] = ()


class Stop(_Datagram, frozen=True, kw_only=True):
    """A stop or an emergency stop, as its operator or a relaying robot sends it."""

    id: Name
    verb: Literal["stop", "estop"]
    operator: Short
    # The robots to stop; None: every robot.
    targets: Annotated[tuple[RobotId, ...], Meta(max_length=1024)] | None = None
    scope: Literal["swarm", "robots"] = "swarm"  # swarm: the latch spreads to robots that join
    reason: Reason = ""
    # ms since the operator issued the stop: each sender adds the time that it held the stop. The
    # time on the network is not included.
    age: Milliseconds = 0
    hops: Hops = 0  # the number of relays
    # Only in a secured swarm (`stop_freshness.py`): the operator's installation, and a number that
    # rises with each stop of that installation.
    origin: Annotated[bytes, Meta(max_length=4)] = b""
    counter: Number = 0
    repeated: Milliseconds = 0  # the age when the operator itself sent the copy that was relayed
    # The clock of the operator's machine (`core/clock.clock_id`), and the time in s on this clock
    # at which the stop was issued; empty from an older version.
    clock: Word = ""
    issued: Seconds = 0.0

    @property
    def is_relayed(self) -> bool:
        """True for a copy that a robot sent."""
        return self.hops > 0


class Ack(_Datagram, frozen=True, kw_only=True):
    """The answer of `robot` to a stop or emergency stop.

    `via`: the robot that has handed the answer on; empty if `robot` itself sent the datagram.
    `code` and `refusal` are values of `Code` and `Refusal`; a later version may send new values.
    `is_moving`: the base is not known to rest. `proof`: in a secured swarm it shows the operator
    that `robot` made the ack, also if another robot has handed the ack on (`signature.py`).
    """

    id: Name
    robot: RobotId
    instance: Bytes6
    revision: Number
    code: Annotated[str, Meta(max_length=32)]
    refusal: Annotated[str, Meta(max_length=64)] | None = None
    text: Line = ""
    via: Annotated[str, Meta(max_length=63)] = ""
    proof: Annotated[bytes, Meta(max_length=8)] = b""
    is_moving: bool = False


class Latches(_Datagram, frozen=True, kw_only=True):
    """A part of a robot's swarm-wide latches; `digest`: of all of them, as in its beacon."""

    robot: RobotId
    instance: Bytes6
    digest: Digest
    held: Annotated[dict[Name, Latch], Meta(max_length=33)]


class GoalReport(_Datagram, frozen=True, kw_only=True):
    """The answer to a `Solicit` with `wants_goal` and this `echo`: the goal that a robot holds.

    `goal`: the bytes of the goal, see core/goal.py. `age`: ms since the goal was set, summed from
    robot to robot without a shared clock; None if the robot does not know the age.
    """

    robot: RobotId
    instance: Bytes6
    echo: Number
    goal: Annotated[bytes, Meta(max_length=MAX_GOAL)]
    age: Milliseconds | None


class RunLease(_Datagram, frozen=True, kw_only=True):
    """Renews the lease of a run. A run whose lease is not renewed in time ends.

    The operator sends a `RunLease` at least each third of the time of the lease. `id`: of the goal
    that is run. `count` rises with each `RunLease`. A robot ignores a count that is not greater
    than the last count.
    """

    id: Name
    operator: Short
    count: Number
    # The robot for which the lease is, and what its clock showed at the least when the lease was
    # sent (`Beacon.clock`): in a secured swarm a lease without these counts as a replayed one
    # (`lease_freshness.py`). Empty from an older version.
    instance: Annotated[bytes, Meta(max_length=6)] = b""
    clock: Milliseconds = 0


class Message(_Datagram, frozen=True, kw_only=True):
    """A message of a pattern on the channel `<pattern>/<name>`.

    `sequence` rises by one with each message of an instance on any channel, so that losses show.
    """

    robot: RobotId
    instance: Bytes6
    sequence: Number
    channel: Annotated[str, Meta(min_length=3, max_length=127)]
    payload: Annotated[bytes, Meta(max_length=1024)]


class Place(_Datagram, frozen=True, kw_only=True):
    """The position of a robot in a shared frame, sent up to 10 times a second."""

    robot: RobotId
    instance: Bytes6
    sent: Milliseconds  # on the sender's clock: receivers estimate delays from it
    age: Milliseconds  # from the measurement until `sent`
    frame: Annotated[str, Meta(min_length=1, max_length=63)]
    x: Coordinate
    y: Coordinate
    error: Millimetres  # bound of the distance to the true position
    heading: Milliradians | None = None  # in the shared frame; None from an older version


class KinReport(_Datagram, frozen=True, kw_only=True):
    """The motion of a robot and what it sees, sent while a robot needs the places of its peers."""

    robot: RobotId
    instance: Bytes6
    message: KinMessage


class StatusPart(_Datagram, frozen=True, kw_only=True):
    """A part of a robot's status, in answer to a `Solicit` with `wants_status` and this `echo`.

    `content` of all parts, in order: the encoded status, as on a link. `part` counts from 0 to
    `parts` - 1.
    """

    robot: RobotId
    instance: Bytes6
    echo: Number
    part: Annotated[int, Meta(ge=0, lt=MAX_STATUS_PARTS)]
    parts: Annotated[int, Meta(ge=1, le=MAX_STATUS_PARTS)]
    content: Annotated[bytes, Meta(max_length=STATUS_PART_BYTES)]


class Drive(_Datagram, frozen=True, kw_only=True):
    """A command of the operator who drives `robot` by hand, sent ten times a second.

    `hand`: the id of the request by which the robot was taken. `order` rises with each command.
    `sent`: on the sender's clock, from which the robot knows a late command. Speeds in m/s and
    rad/s.
    """

    robot: RobotId
    hand: Name
    operator: Short
    order: Number
    sent: Milliseconds
    linear: HandSpeed
    angular: HandSpeed
    lateral: HandSpeed = 0.0


class ClockQuery(_Datagram, frozen=True, kw_only=True):
    """Asks a robot for its clock's time; `sent`: on the asker's clock, repeated in the answer."""

    sent: Nanoseconds


class ClockReply(_Datagram, frozen=True, kw_only=True):
    """The answer to a `ClockQuery`."""

    robot: RobotId
    clock: Bytes6  # the id of the robot's clock
    sent: Nanoseconds  # as in the query
    answered: Nanoseconds  # the time on the robot's clock


class Swarm(_Datagram, frozen=True, kw_only=True):
    """The answer to a `Solicit` of any swarm: the name of the robot's swarm and its profile."""

    swarm: RobotId
    profile: Annotated[str, Meta(max_length=16)]
    robot: RobotId


Datagram = (
    Beacon
    | Solicit
    | MemberList
    | Stop
    | Ack
    | Latches
    | Message
    | Swarm
    | Place
    | ClockQuery
    | ClockReply
    | GoalReport
    | RunLease
    | KinReport
    | StatusPart
    | Drive
)
"""In the order of `Kind`."""
_TYPES: dict[Kind, type[_Datagram]] = dict(zip(Kind, get_args(Datagram), strict=True))
_KINDS = {kind: number for number, kind in _TYPES.items()}
_encoder = msgspec.msgpack.Encoder()


def tag_of(profile: str, swarm: str, authority: bytes = b"") -> bytes:
    """The tag of a swarm, which differs for each profile, swarm and authority.

    `authority`: the public key of a secured swarm; empty for a swarm without keys.
    """
    content = f"{profile}/{swarm}".encode() + (b"/" + authority if authority else b"")
    return hashlib.blake2b(content, digest_size=TAG_BYTES).digest()


def pack(tag: bytes, body: Datagram) -> bytes:
    """The bytes of a datagram. Raises CodecError if it exceeds MAX_DATAGRAM."""
    content = _encoder.encode(body)
    if _HEAD.size + len(content) > MAX_DATAGRAM:
        raise CodecError(f"a datagram of {_HEAD.size + len(content)} bytes; at most {MAX_DATAGRAM}")
    return _HEAD.pack(MAGIC, _KINDS[type(body)], tag, len(content)) + content


def unpack(tag: bytes, payload: bytes) -> Datagram | None:
    """Decode a datagram of the swarm with this tag; None for another swarm or an unknown kind.

    `payload`: head, body and perhaps a signature, which is not read. A `Solicit` or `Swarm` with
    the tag ANY_SWARM is decoded, too. Raises CodecError for a malformed datagram.
    """
    if len(payload) < _HEAD.size or len(payload) > MAX_DATAGRAM or payload[:4] != MAGIC:
        raise CodecError("no datagram of a swarm")
    _, kind, present_tag, length = _HEAD.unpack_from(payload)
    is_for_any = present_tag == ANY_SWARM and kind in (Kind.SOLICIT, Kind.SWARM)
    if kind not in _TYPES or (present_tag != tag and not is_for_any):
        return None
    if _HEAD.size + length > len(payload):
        raise CodecError("a datagram that is cut short")
    content = memoryview(payload)[_HEAD.size : _HEAD.size + length]
    body: Datagram = decode(_decoder_of(kind), content, "a datagram")
    return body


@cache  # made at the first datagram of a kind: swarmctl reads few kinds, and starts sooner
def _decoder_of(kind: int) -> msgspec.msgpack.Decoder[Any]:
    return msgspec.msgpack.Decoder(_TYPES[Kind(kind)])


def length_without_trailer(payload: bytes) -> int:
    """The length of head and body. Raises CodecError if the datagram is cut short."""
    if len(payload) < _HEAD.size:
        raise CodecError("a datagram that is cut short")
    length: int = _HEAD.size + _HEAD.unpack_from(payload)[3]
    if length > len(payload):
        raise CodecError("a datagram that is cut short")
    return length


def is_of_swarm(tag: bytes, payload: bytes) -> bool:
    """True if a datagram has the tag of this swarm."""
    return payload[5 : 5 + TAG_BYTES] == tag


def is_for_any_swarm(payload: bytes) -> bool:
    """True if the tag of a valid datagram is that of any swarm."""
    return payload[5 : 5 + TAG_BYTES] == ANY_SWARM


def only_names(word: MemberList, names: Collection[str]) -> MemberList:
    """A member list without robots that are not among `names`."""
    members = tuple(member for member in word.members if member.robot in names)
    roster = tuple(name for name in word.roster if name in names)
    return msgspec.structs.replace(word, members=members, roster=roster)


def in_parts(
    members: tuple[MemberReport, ...], *, roster: tuple[str, ...] = ()
) -> list[tuple[tuple[MemberReport, ...], tuple[str, ...]]]:
    """Members and names of the roster in parts, within the bounds of `MemberList` and datagram."""
    parts: list[tuple[list[MemberReport], list[str]]] = [([], [])]
    room = _ROOM
    items: tuple[MemberReport | str, ...] = (*members, *roster)
    for item in items:
        size = len(_encoder.encode(item))
        full = len(parts[-1][0]) >= 64 or len(parts[-1][1]) >= 64
        if size > room or full:
            parts.append(([], []))
            room = _ROOM
        room -= size
        if isinstance(item, str):
            parts[-1][1].append(item)
        else:
            parts[-1][0].append(item)
    return [(tuple(members_of_part), tuple(names)) for members_of_part, names in parts[:256]]


def status_parts(robot: str, instance: bytes, echo: int, content: bytes) -> list[StatusPart]:
    """The parts of an encoded status; none if it exceeds MAX_STATUS_PARTS, or is empty."""
    pieces = [
        content[start : start + STATUS_PART_BYTES]
        for start in range(0, len(content), STATUS_PART_BYTES)
    ]
    if len(pieces) > MAX_STATUS_PARTS:
        return []
    return [
        StatusPart(
            robot=robot,
            instance=instance,
            echo=echo,
            part=number,
            parts=len(pieces),
            content=piece,
        )
        for number, piece in enumerate(pieces)
    ]


_LIST_FIELDS = 110  # bytes of a `MemberList` beside members and roster: name, instance, numbers
_ROOM = MAX_DATAGRAM - MAX_TRAILER - _HEAD.size - _LIST_FIELDS
