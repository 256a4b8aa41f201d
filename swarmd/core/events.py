"""The inputs of a robot: one tagged union of bounded structs, `Input`.

Everything that happens to a robot is an input, and `Robot.step(input, now)` takes all inputs. A
shell (daemon, lockstep simulator, replay, test harness) makes inputs. A recording contains the
bytes and the time of each input. A new kind of input needs a struct here, a place in the union, and
a row of the table in `robot/robot.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, Struct

from swarmd.core.bounds import Count, Line, Name, Seconds, Word
from swarmd.core.codec import MAX_MESSAGE
from swarmd.core.errors import CodecError
from swarmd.core.goal import Goal
from swarmd.core.hazard import Hazard
from swarmd.core.host_messages import HostEvent
from swarmd.core.kin_message import KinMessage
from swarmd.core.messages import Body, Latch, PeerFault, Reason
from swarmd.core.values import (
    MAX_DETECTIONS,
    Array,
    Detection,
    Neighbor,
    Odometry,
    PeerPlace,
    Scan,
    SharedPose,
    Twist,
    Value,
)
from swarmd.core.verbs import Request

MAX_ROBOTS = 10_000
"""Robots in one input: neighbours, peers or latches."""
Generation = Annotated[int, Meta(ge=0, le=2**53)]
Text = Annotated[str, Meta(max_length=10_000)]
"""Words of a driver or of the daemon, with those of a foreign library in them."""


# From the driver


class ScanInput(Struct, frozen=True, array_like=True, tag="scan"):
    """A raw scan of the lidar arrived."""

    scan: Scan


class RangesInput(Struct, frozen=True, array_like=True, tag="ranges"):
    """A raw scan of the platform's ring of range sensors arrived."""

    scan: Scan


class OdometryInput(Struct, frozen=True, array_like=True, tag="odometry"):
    """A measured pose and twist arrived."""

    odometry: Odometry


class NeighborsInput(Struct, frozen=True, array_like=True, tag="neighbors"):
    """All present neighbours: from the driver if the base senses them, else all members."""

    neighbors: Annotated[tuple[Neighbor, ...], Meta(max_length=MAX_ROBOTS)]


class PoseInput(Struct, frozen=True, array_like=True, tag="pose"):
    """The robot's own pose in a frame that robots share."""

    pose: SharedPose


class ReadingsInput(Struct, frozen=True, array_like=True, tag="readings"):
    """All scalar sensors by name; NaN for a sensor without a fresh value."""

    readings: Annotated[dict[str, float], Meta(max_length=1000)]


class DetectionsInput(Struct, frozen=True, array_like=True, tag="detections"):
    """All objects that the robot recognises now; None: no fresh value."""

    detections: Annotated[tuple[Detection, ...], Meta(max_length=MAX_DETECTIONS)] | None


class HazardsInput(Struct, frozen=True, array_like=True, tag="hazards"):
    """All hazards that the base senses now.

    Without such an input the base has no hazards, or cannot sense hazards. A driver whose source of
    hazards falls silent while the base is connected reports the hazard NOT_HEARD.
    """

    hazards: Annotated[tuple[Hazard, ...], Meta(max_length=1000)]


class DriverInput(Struct, frozen=True, array_like=True, tag="driver"):
    """The base is connected (`is_up`) or lost: `Sink.state` (driver_api/driver.py) as an input."""

    is_up: bool
    text: Text
    hold: Reason | None = None
    gets_zero: bool = False


# From other robots


class MessageInput(Struct, frozen=True, array_like=True, tag="message"):
    """A message from `sender`: from the pattern of a robot, or with `is_program` from a program.

    `channel`: such as `<pattern>/<channel>`. `is_program`: the sender is a Zenoh program. `size`:
    bytes of the encoded value; 0: not known, so that the robot encodes the value to measure its
    size.
    """

    sender: Name
    channel: Annotated[str, Meta(max_length=127)]
    value: Value
    is_program: bool = False
    size: Annotated[int, Meta(ge=0, le=MAX_MESSAGE)] = 0


class PeersInput(Struct, frozen=True, array_like=True, tag="peers"):
    """The bodies that all other robots report; None for a robot without a report yet.

    Contains each robot that was heard since the start of the daemon and not forgotten.
    """

    bodies: Annotated[dict[str, Body | None], Meta(max_length=MAX_ROBOTS)]


class PeerFaultsInput(Struct, frozen=True, array_like=True, tag="peer_faults"):
    """All present faults of robots, this one among them, that only peers can tell."""

    faults: Annotated[tuple[PeerFault, ...], Meta(max_length=MAX_ROBOTS)]


class PlaceInput(Struct, frozen=True, array_like=True, tag="place"):
    """The own place that a peer reports in a shared frame."""

    place: PeerPlace


class KinInput(Struct, frozen=True, array_like=True, tag="kin"):
    """A peer told its motion and what it sees."""

    robot: Name
    message: KinMessage


class LatchesInput(Struct, frozen=True, array_like=True, tag="latches"):
    """The latches that a peer holds, by id; a latch of scope `swarm` holds this robot, too."""

    latches: Annotated[dict[str, Latch], Meta(max_length=MAX_ROBOTS)]


class GoalInput(Struct, frozen=True, array_like=True, tag="goal"):
    """A goal that a peer holds, set `age` s ago; None: the peer does not know the age.

    `may_join`: the goals of all other peers are known, too, so that the robot may join a run.
    """

    goal: Goal
    age: Seconds | None
    may_join: bool


class LeaseInput(Struct, frozen=True, array_like=True, tag="lease"):
    """The operator of the goal with the id `goal` was heard; `count` rises with each message.

    `age`: s since the operator sent the message, at most; None: the message may be a replayed one.
    """

    goal: Name
    count: Count
    age: Seconds | None = 0.0  # a swarm without keys takes each message as new


class DuplicateInput(Struct, frozen=True, array_like=True, tag="duplicate"):
    """Another daemon, the instance `holder`, uses this robot's id; None: that daemon has left."""

    holder: Line | None


# From the pattern host and the operators


class HostInput(Struct, frozen=True, array_like=True, tag="host"):
    """An event of the pattern host arrived."""

    event: HostEvent


class RequestInput(Struct, frozen=True, array_like=True, tag="request"):
    """A request arrived; its reply follows from this input or from a later host event."""

    request: Request


class DriveInput(Struct, frozen=True, array_like=True, tag="drive"):
    """A command of the operator `driver`, who drives the robot by the hand `hand`.

    `order` rises with each command of the hand. `sent`: s on the clock of the sender.
    """

    hand: Name
    driver: Annotated[str, Meta(max_length=128)]
    order: Count
    sent: Seconds
    twist: Twist


class CodeInput(Struct, frozen=True, array_like=True, tag="code"):
    """The code of a pattern was replaced or removed: the next run uses a fresh host."""


class ProvisionalInput(Struct, frozen=True, array_like=True, tag="provisional"):
    """The generations of the present run and load whose code is provisional."""

    generations: Annotated[tuple[Generation, ...], Meta(max_length=1000)]


# From the daemon


class ForgetInput(Struct, frozen=True, array_like=True, tag="forget"):
    """The digests (hex) of the goals whose issuers are no longer operators."""

    digests: Annotated[tuple[Word, ...], Meta(max_length=1000)]


class NetworkInput(Struct, frozen=True, array_like=True, tag="network"):
    """The daemon has changed to another network (`text` describes the change). The run ends."""

    text: Line


class RosterInput(Struct, frozen=True, array_like=True, tag="roster"):
    """The daemon has taken a roster; `is_revoked`: the roster lacks this robot. The run ends."""

    text: Line
    is_revoked: bool


class LeaveInput(Struct, frozen=True, array_like=True, tag="leave"):
    """The daemon ends in order: the run ends."""


class NoteInput(Struct, frozen=True, array_like=True, tag="note"):
    """A line for the events of `describe`."""

    text: Text


class TickInput(Struct, frozen=True, array_like=True, tag="tick"):
    """A tick of the shell: at 20 Hz, at rest at 10 Hz, and at `Robot.wake_at`."""


SensorInput = (
    ScanInput
    | RangesInput
    | OdometryInput
    | NeighborsInput
    | PoseInput
    | ReadingsInput
    | DetectionsInput
    | HazardsInput
)
"""The inputs that drivers hand over to `Sink.take` (driver_api/driver.py)."""
Input = (
    SensorInput
    | DriverInput
    | MessageInput
    | PeersInput
    | PeerFaultsInput
    | PlaceInput
    | KinInput
    | LatchesInput
    | GoalInput
    | LeaseInput
    | DuplicateInput
    | HostInput
    | RequestInput
    | DriveInput
    | CodeInput
    | ProvisionalInput
    | ForgetInput
    | NetworkInput
    | RosterInput
    | LeaveInput
    | NoteInput
    | TickInput
)
TICK_INPUT = TickInput()


def _encoded(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return np.ascontiguousarray(value, np.float64).tobytes()
    if hasattr(value, "keys"):  # a mapping that is no dict
        return dict(value)
    raise TypeError(f"{type(value).__name__} is no type of MessagePack")


def _decoded(kind: Any, value: Any) -> Array:
    return np.frombuffer(value).copy()  # the kernels refuse read-only arrays


_decoder: msgspec.msgpack.Decoder[Input] = msgspec.msgpack.Decoder(Input, dec_hook=_decoded)

encode_input: Callable[[Input], bytes] = msgspec.msgpack.Encoder(enc_hook=_encoded).encode
"""The bytes of an input; arrays as float64."""


def decode_input(data: bytes) -> Input:
    """The input of these bytes; CodecError if they are malformed or exceed a bound."""
    try:
        return _decoder.decode(data)
    except (msgspec.MsgspecError, ValueError, TypeError) as error:
        raise CodecError(f"no input: {error}") from error


def tag_of(input: Input) -> str:
    """The kind of an input, such as `scan`."""
    return str(type(input).__struct_config__.tag)
