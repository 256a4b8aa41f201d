"""The goal of a swarm: which robots are to run which pattern. A record that spreads by gossip.

On every robot the greatest goal counts. Goals are ordered by generation, then by the issuer's name,
then by their bytes. In a secured swarm the operator signs the goal. Order and digest of a goal
depend on its content only, neither on the signature nor on the encoding in which the goal was
received.
"""

from __future__ import annotations

from enum import StrEnum
from functools import cache
from typing import Annotated, Literal, NamedTuple

import msgspec
from msgspec import Meta, Struct

from swarmd.core import record
from swarmd.core.bounds import MAX_SECONDS, Line, Name, ParamValues, Seconds, Word
from swarmd.core.codec import decode
from swarmd.core.errors import CodecError
from swarmd.core.record import Record

MAX_GOAL = 1000  # bytes with the signature, so that a datagram carries it
MAX_UNSIGNED = 2**31
"""The greatest generation of a goal without a signature, where keys are in force: a robot that was
taken over stops the swarm by such goals, and an operator can set a greater one."""
MAX_LABELS = 32

Validity = Annotated[float, Meta(gt=0.0, le=1e7)]


class Goal(Record, frozen=True, kw_only=True):
    """The run that an operator wants of the targeted robots.

    - `id`: the id of the request that set the goal.
    - `pattern`: None: the robots stand.
    - `seconds`, `conditions`: the ends of the run, as `seconds` and `until` of `RunRequest`.
    - `on_join`: what a robot does that receives the goal from a peer. `offer`: the robot shows the
      goal to operators. `run`: the robot runs the pattern if the goal is younger than `valid` s.
    - `lease`: s without a message of the operator after which the run ends.
    - `undoes`: the id of a goal that this goal revokes: no robot carries out the revoked goal.
    - `signature`: the signature of the goal's bytes without this field.
    """

    id: Name
    pattern: Name | None = None
    params: ParamValues = {}  # noqa: RUF012 - msgspec copies it
    seconds: Annotated[float, Meta(gt=0.0, le=1e7)] | None = None
    conditions: tuple[Word, ...] = ()
    on_join: Literal["offer", "run"] = "offer"
    valid: Validity | None = None
    lease: Annotated[float, Meta(ge=1.0, le=3600.0)] | None = None
    undoes: Name | None = None
    signature: Annotated[bytes, Meta(max_length=64)] = b""

    @property
    def text(self) -> str:
        """The goal in words, such as `goal 7 of bob: flocking`."""
        return f"goal {self.generation} of {self.issuer}: {self.pattern or 'stand'}"


class GoalState(StrEnum):
    """The state of a robot's own goal."""

    LOADING = "loading"
    RUNNING = "running"
    STANDING = "standing"  # the goal has no pattern
    OFFERED = "offered"  # received from a peer and not run; `resume` runs the goal
    ENDED = "ended"  # the run has ended or did not begin; `resume` runs the goal again


class GoalRecord(Struct, frozen=True, kw_only=True):
    """The record of a robot on disk: its goals, the end of its run, and its labels.

    - `held`: the greatest goal seen, also if it is for other robots.
    - `before`: the goal that `held` replaced.
    - `own`: the greatest goal whose targets include this robot.
    - `ended`: why the run of `own` ended; empty if the run has not ended.
    - `may_join`: the robot may run `own` without a request; False after a stop or reset.
    - `stood`: when the robot was last stopped, emergency-stopped or reset, in s on `clock`.
    - `ran`: the run of `own` is on, or was on when the daemon ended, and no stop came since.
    - `labels`: None: the labels of the swarm file.
    """

    held: Goal | None = None
    own: Goal | None = None
    before: Goal | None = None
    ended: Line = ""
    may_join: bool = True
    stood: Seconds | None = None
    ran: bool = False
    clock: Word = ""
    labels: Annotated[tuple[Word, ...], Meta(max_length=MAX_LABELS)] | None = None


class KnownGoal(Struct, frozen=True, kw_only=True):
    """A goal as a robot knows it; `digest` is in hex.

    `age`: s since the goal was set, as handed on from robot to robot; None after a restart, until a
    peer sends the age.
    """

    goal: Goal
    digest: Word
    age: Seconds | None


class GoalStatus(Struct, frozen=True, kw_only=True):
    """The goals of a robot, for its status.

    - `held`: the greatest goal (latest generation) seen, also if it is for other robots.
    - `before`: the goal that `held` replaced, with another id.
    - `own`: the greatest goal whose targets include this robot; None without a goal.
    - `state`: how far the robot has carried out `own`; None without a goal.
    - `reason`: why the robot does not carry out `own`; empty if the robot does.
    - `superseded`: the goal that ended the last run, such as `goal 7 of bob: flocking`.
    - `lease_left`: s until the run ends if its operator is not heard.
    """

    held: KnownGoal | None = None
    before: Goal | None = None
    own: KnownGoal | None = None
    state: GoalState | None = None
    reason: Line = ""
    superseded: Line = ""
    lease_left: Seconds | None = None


_encoder = msgspec.msgpack.Encoder(order="deterministic")  # equal goals have equal bytes


@cache  # made at the first goal: most commands read none
def _decoder() -> msgspec.msgpack.Decoder[Goal]:
    return msgspec.msgpack.Decoder(Goal)


def encode_goal(goal: Goal) -> bytes:
    """The bytes of a goal. CodecError if they exceed MAX_GOAL."""
    content = _encoder.encode(goal)
    if len(content) > MAX_GOAL:
        raise CodecError(
            f"a goal of {len(content)} bytes; at most {MAX_GOAL}: use fewer targets, or a glob"
        )
    return content


def signed_part(goal: Goal) -> bytes:
    """The bytes that an operator signs, by which goals are ordered, compared and hashed."""
    return _encoder.encode(msgspec.structs.replace(goal, signature=b""))


def decode_goal(content: bytes) -> Goal:
    """The goal in these bytes. CodecError if they are malformed, or too long once encoded again."""
    if len(content) > MAX_GOAL:
        raise CodecError(f"a goal of {len(content)} bytes; at most {MAX_GOAL}")
    goal = decode(_decoder(), content, "a goal")
    encode_goal(goal)
    return goal


def digest_of(goal: Goal | None) -> bytes:
    """The digest of a goal, for beacons; empty without a goal."""
    return b"" if goal is None else record.digest_of(goal.generation, signed_part(goal))


class HeldGoal(NamedTuple):
    """A goal with its signed bytes (`content`) and digest.

    `issued`: when the goal was set, in s on the own clock; None if unknown.
    """

    goal: Goal
    content: bytes
    digest: bytes
    issued: float | None

    @classmethod
    def of(cls, goal: Goal, issued: float | None) -> HeldGoal:
        """A goal that was set at `issued`. CodecError if it exceeds MAX_GOAL."""
        encode_goal(goal)
        return cls(goal, signed_part(goal), digest_of(goal), issued)

    @property
    def order(self) -> tuple[int, str, bytes]:
        """The sort key of goals: generation, issuer and signed bytes."""
        return *self.goal.order, self.content

    def age(self, now: float) -> float | None:
        """Seconds since the goal was set, at most MAX_SECONDS; None if unknown."""
        return None if self.issued is None else min(max(now - self.issued, 0.0), MAX_SECONDS)
