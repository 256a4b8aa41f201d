"""The roster: the names of a swarm with their roles, signed by its certificate authority. Pure.

A roster has a generation. A roster of a greater generation replaces a roster of a smaller
generation, never the reverse. `content_signature.py` makes and verifies the signature.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from enum import StrEnum
from functools import cache
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from swarmd.core.bounds import Id
from swarmd.core.codec import decode
from swarmd.core.errors import CodecError
from swarmd.core.names import MAX_NAMES
from swarmd.link.keys.content_signature import SIGNATURE_BYTES, Purpose, is_signed_by

PUBLIC_KEY_BYTES = 64
MAX_ROSTER = 256 * 1024

PublicKey = Annotated[bytes, Meta(min_length=PUBLIC_KEY_BYTES, max_length=PUBLIC_KEY_BYTES)]
"""A point of P-256: `x || y`, big endian."""
Sha256 = Annotated[bytes, Meta(min_length=32, max_length=32)]
Signature = Annotated[bytes, Meta(max_length=SIGNATURE_BYTES)]
MAX_MAY = 32
MayText = Annotated[str, Meta(min_length=1, max_length=128)]
RobotsText = Annotated[str, Meta(max_length=256)]


class Role(StrEnum):
    """The role of a name.

    A robot publishes below its own Zenoh key, an operator sends requests, a viewer only reads. A
    name with a permit sends the requests that its `KeyPermit` lists.
    """

    ROBOT = "robot"
    OPERATOR = "operator"
    VIEWER = "viewer"
    PERMIT = "permit"


class KeyPermit(Struct, frozen=True, kw_only=True):
    """What the key of one name may do. `key_permit.py` judges requests by it.

    - `role`: the name of the permit, which several names may share, such as `pupils`.
    - `may`: the requests, such as `stop`, `run attraction` or `param attraction.*`.
    - `robots`: names, ranges and globs such as `tb3-0[1-3]`; empty: all robots.
    - `longest`: the longest run in s; None: no bound. On the wire `for`.
    - `speed`: the greatest speed of a run in m/s; None: that of the robot.
    - `until`: the end of the permit and of the certificate of its name, s since 1970 (UTC).
    """

    role: Id
    key: PublicKey
    may: Annotated[tuple[MayText, ...], Meta(max_length=MAX_MAY)]
    robots: RobotsText = ""
    longest: Annotated[float, Meta(gt=0.0, le=1e7)] | None = msgspec.field(name="for", default=None)
    speed: Annotated[float, Meta(gt=0.0, le=100.0)] | None = None
    until: Annotated[int, Meta(ge=0, le=2**40)]


class Roster(Struct, frozen=True, kw_only=True):
    """The names of a swarm with their roles.

    - `operators`: by name, the public key that verifies the operator's goals and pushed patterns.
    - `secret_digest`: SHA-256 of the swarm's secret, from which the datagram keys derive.
    - `readers`: by name that is no robot, the digest of the name's datagram keys (`reader_digest`).
      Any robot may hand these keys over; the digest shows whether the robot has changed them.
    - `permits`: by name, what its key may. Robots of version 0.2 do not know this field, so such a
      name is in no other field: they refuse the name, and take the roster.
    """

    swarm: Id
    generation: Annotated[int, Meta(ge=1, le=2**32 - 1)]
    robots: Annotated[tuple[Id, ...], Meta(max_length=MAX_NAMES)] = ()
    operators: Annotated[dict[Id, PublicKey], Meta(max_length=MAX_NAMES)] = {}
    viewers: Annotated[tuple[Id, ...], Meta(max_length=MAX_NAMES)] = ()
    secret_digest: Sha256
    readers: Annotated[dict[Id, Sha256], Meta(max_length=2 * MAX_NAMES)] = {}
    permits: Annotated[dict[Id, KeyPermit], Meta(max_length=MAX_NAMES)] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """All names: robots, operators, viewers, names with a permit."""
        return (*self.robots, *self.operators, *self.viewers, *self.permits)

    @property
    def askers(self) -> tuple[str, ...]:
        """The names that ask robots: operators, viewers, names with a permit."""
        return (*self.operators, *self.viewers, *self.permits)

    def role_of(self, name: str) -> Role | None:
        """The role of a name; None if the name is not on the roster."""
        if name in self.permits:
            return Role.PERMIT
        if name in self.robots:
            return Role.ROBOT
        if name in self.operators:
            return Role.OPERATOR
        return Role.VIEWER if name in self.viewers else None


class SignedRoster(Struct, frozen=True, array_like=True):
    """The bytes of a roster, and the authority's signature of these bytes."""

    content: Annotated[bytes, Meta(max_length=MAX_ROSTER)]
    signature: Signature


# Made at the first roster: a swarm without keys has none.
@cache
def _roster_decoder() -> msgspec.msgpack.Decoder[Roster]:
    return msgspec.msgpack.Decoder(Roster)


@cache
def _signed_decoder() -> msgspec.msgpack.Decoder[SignedRoster]:
    return msgspec.msgpack.Decoder(SignedRoster)


encode_roster: Callable[[Roster], bytes] = msgspec.msgpack.encode
"""The bytes that the authority signs."""


def pack_roster(content: bytes, signature: bytes) -> bytes:
    """A signed roster as it is stored and sent."""
    return msgspec.msgpack.encode(SignedRoster(content, signature))


def same_bytes(data: bytes, known: bytes) -> bytes:
    """`known` if both are signed rosters of equal content, else `data` as `pack_roster` writes it.

    So another encoding or signature of the same roster counts as equal. CodecError if malformed.
    """
    signed = _decoded(data)[0]
    if known and _decoded(known)[0].content == signed.content:
        return known
    return pack_roster(signed.content, signed.signature)


def stored_roster(data: bytes) -> Roster:
    """The roster in `data`, without a check: it was verified before it was stored. CodecError."""
    return _decoded(data)[1]


def read_roster(data: bytes, authority: bytes) -> Roster:
    """The roster in `data`; CodecError unless the authority with that public key signed it."""
    signed, roster = _decoded(data)
    if not is_signed_by(authority, Purpose.ROSTER, signed.content, signed.signature):
        raise CodecError("a roster without a valid signature of this swarm's authority")
    return roster


def _decoded(data: bytes) -> tuple[SignedRoster, Roster]:
    signed = decode(_signed_decoder(), data, "a roster")
    roster = decode(_roster_decoder(), signed.content, "a roster")
    others = {*roster.robots, *roster.operators, *roster.viewers}
    if twice := sorted(roster.permits.keys() & others):
        raise CodecError(f"a roster with a permit for {twice[0]}, which has another role, too")
    return signed, roster


def digest_of(secret: bytes) -> bytes:
    """SHA-256 of the secret of a swarm, for `Roster.secret_digest`."""
    return hashlib.sha256(secret).digest()
