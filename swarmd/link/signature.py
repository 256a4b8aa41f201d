"""The signatures of datagrams, in a trailer after the body. Pure: bytes in, bytes out.

    offset  bytes
    0       1       format
    1       4       generation of the signer's roster, big endian
    5       24      GROUP: a tag for robots, one for operators, one for viewers
    5       16      ANSWER: a tag for the asker's class, and a tag for the asker alone
    5       n + 9   NAMED: the length of the name, the name of the operator or viewer, and its tag

A robot signs answers to an operator or viewer by ANSWER, and all other datagrams by GROUP. An
operator or viewer signs by NAMED. A tag is keyed BLAKE2b (RFC 7693) of 8 bytes over head, body and
the trailer up to the first tag. `datagram_keys.py` describes the keys.

1. All robots have the keys of the classes (robots, operators, viewers). A tag with such a key does
   not show which robot signed. Therefore `Author` names only operators and viewers.
2. Each robot shares a further key with each operator and viewer. A tag with this key, or the proof
   in an `Ack`, shows which robot signed.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from hmac import compare_digest
from typing import NamedTuple

import msgspec

from swarmd.core.errors import CodecError
from swarmd.link.datagram import KIND_OFFSET, MAX_DATAGRAM, Ack, Kind, length_without_trailer
from swarmd.link.keys.datagram_keys import DatagramKeys
from swarmd.link.keys.identity import Identity
from swarmd.link.keys.roster import Role, Roster

SIGNATURE_BYTES = 8
MAX_PAIRS = 64  # keys that a signer caches
PREVIOUS_TIME = 600.0  # s after a new roster for which stops of the generation before count
_START = struct.Struct(">BI")
_PROOF = b"swarmd ack"  # so that a proof is no signature of a datagram
_CLASSES = (Role.ROBOT, Role.OPERATOR, Role.VIEWER)  # the order of the tags of a group
# The class of receivers of each role: a name with a permit has the class key of viewers.
_CLASS_OF = {role: number for number, role in enumerate(_CLASSES)} | {Role.PERMIT: 2}
_GROUP_BYTES = _START.size + len(_CLASSES) * SIGNATURE_BYTES
_ANSWER_BYTES = _START.size + 2 * SIGNATURE_BYTES


class Format(IntEnum):
    """The formats of a trailer; numbers are never reused."""

    GROUP = 1
    ANSWER = 2
    NAMED = 3


class Flaw(StrEnum):
    """Why a datagram is refused; the values are the keys of the drop counts."""

    UNSIGNED = "unsigned"  # no trailer, or a trailer of another format or length
    FORGED = "forged"  # a tag does not fit, or the name is not on the roster
    OLDER = "older_roster"
    NEWER = "newer_roster"
    ROLE = "role"  # its signer may not send datagrams of this kind
    REPEATED = "repeated"  # the robot has sent a later datagram
    UNPROVEN = "unproven"  # its robot has not answered a question yet: it may be replayed


class Author(NamedTuple):
    """The author of a datagram."""

    role: Role
    name: str = ""  # the name of an operator or viewer; empty for a robot
    is_previous: bool = False  # signed with keys of the generation before the current roster


class Signer:
    """Signs datagrams as the owner of `keys`.

    `previous`: a signer with the keys of the roster before, for answers to an operator that still
    has this older roster. Such an operator cannot verify newer keys, but must learn that its stop
    has arrived.
    """

    def __init__(
        self, keys: DatagramKeys, role: Role, name: str, previous: Signer | None = None
    ) -> None:
        self._keys = keys
        self._previous = previous
        self._role = role
        self._name = name.encode()
        self._group = (keys.robots, keys.operators, keys.viewers)
        self._pairs: dict[str, bytes] = {}

    def sign(self, payload: bytes, asker: Author | None = None) -> bytes:
        """The datagram `payload` with a signature. Raises CodecError if it exceeds MAX_DATAGRAM.

        `asker`: the author of the question that the datagram answers; None: not an answer.
        """
        if asker is not None and asker.is_previous and self._previous is not None:
            return self._previous.sign(payload, asker)
        generation = self._keys.generation
        if self._role is not Role.ROBOT:
            start = _START.pack(Format.NAMED, generation)
            signed = payload + start + bytes([len(self._name)]) + self._name
            keys: tuple[bytes, ...] = (self._keys.own,)
        elif asker is None or asker.role is Role.ROBOT:
            signed = payload + _START.pack(Format.GROUP, generation)
            keys = self._group
        else:
            signed = payload + _START.pack(Format.ANSWER, generation)
            keys = self._group[_CLASS_OF[asker.role]], self._pair(asker.name)
        whole = signed + b"".join([_tag(key, signed) for key in keys])
        if len(whole) > MAX_DATAGRAM:
            raise CodecError(f"a signed datagram of {len(whole)} bytes; at most {MAX_DATAGRAM}")
        return whole

    def proof(self, ack: Ack, operator: str) -> bytes:
        """The proof for `operator` that this robot made the ack; it holds for relayed copies."""
        return _proof(self._pair(operator), ack)

    def _pair(self, name: str) -> bytes:
        """The key that this robot shares with an operator or viewer, cached."""
        key = self._pairs.get(name)
        if key is None:
            if len(self._pairs) >= MAX_PAIRS:
                self._pairs.clear()
            key = self._pairs[name] = self._keys.answer_to(name)
        return key


@dataclass(frozen=True, slots=True)
class Previous:
    """The keys and roster before the current ones; stops signed with them count until `until`."""

    keys: DatagramKeys
    roster: Roster
    until: float


class Verifier:
    """Verifies as the owner of `keys` with the role `role`."""

    def __init__(
        self, keys: DatagramKeys, role: Role, roster: Roster, previous: Previous | None = None
    ) -> None:
        self._role = role
        self._keys = keys
        self._roster = roster
        self._names: dict[str, tuple[Author, bytes]] = {}  # those on the roster that were heard
        self._index = _CLASS_OF[role]
        self._class_key = (keys.robots, keys.operators, keys.viewers)[self._index]
        self._previous = (
            None if previous is None else Verifier(previous.keys, role, previous.roster)
        )
        self._until = 0.0 if previous is None else previous.until

    @property
    def generation(self) -> int:
        """The generation of the roster."""
        return self._keys.generation

    def verify(self, payload: bytes, now: float) -> Author | Flaw:
        """The author of a datagram whose head `unpack` accepts, or the flaw of its signature.

        A datagram signed with keys of another generation of the roster has a flaw, except a stop of
        the previous generation.
        """
        try:
            trailer_begin = length_without_trailer(payload)
            form, generation = _START.unpack_from(payload, trailer_begin)
        except (CodecError, struct.error):
            return Flaw.UNSIGNED
        if generation == self._keys.generation:
            return self._author(payload, trailer_begin, form)
        previous = self._previous if now < self._until else None
        is_stop = payload[KIND_OFFSET] == Kind.STOP
        if previous is not None and is_stop and generation == previous.generation:
            author = previous._author(payload, trailer_begin, form)
            return author if isinstance(author, Flaw) else author._replace(is_previous=True)
        return Flaw.NEWER if generation > self._keys.generation else Flaw.OLDER

    def is_answer_of(self, robot: str, payload: bytes) -> bool | None:
        """True if this robot signed the answer for this asker; None if the pair's key is missing.

        `payload`: a datagram that `verify` has accepted.
        """
        end = length_without_trailer(payload)
        key = self._keys.answers.get(robot)
        if payload[end] != Format.ANSWER:
            return False
        return None if not key else _fits(key, payload[: end + _START.size], payload[-8:])

    def is_proven(self, ack: Ack) -> bool | None:
        """True if the robot in the ack made it for this operator; None if the key is missing."""
        key = self._keys.answers.get(ack.robot)
        return compare_digest(_proof(key, ack), ack.proof) if key else None

    def has_key_of(self, robot: str) -> bool:
        """True if this operator or viewer has the key that it shares with the robot."""
        return bool(self._keys.answers.get(robot))

    def _author(self, payload: bytes, end: int, form: int) -> Author | Flaw:
        size = len(payload) - end
        start = payload[: end + _START.size]
        if form == Format.GROUP and size == _GROUP_BYTES:
            at = len(start) + self._index * SIGNATURE_BYTES
            tag = payload[at : at + SIGNATURE_BYTES]
        elif form == Format.ANSWER and size == _ANSWER_BYTES and self._role is not Role.ROBOT:
            tag = payload[len(start) : len(start) + SIGNATURE_BYTES]
        elif form == Format.NAMED and self._role is Role.ROBOT:
            return self._named(payload, len(start))
        else:
            return Flaw.UNSIGNED
        return Author(Role.ROBOT) if _fits(self._class_key, start, tag) else Flaw.FORGED

    def _named(self, payload: bytes, at: int) -> Author | Flaw:
        """The operator or viewer that signed a trailer NAMED, whose name begins at `at`."""
        if len(payload) <= at or len(payload) != at + 1 + payload[at] + SIGNATURE_BYTES:
            return Flaw.UNSIGNED
        signed = payload[:-SIGNATURE_BYTES]
        tag = payload[-SIGNATURE_BYTES:]
        name = signed[at + 1 :].decode(errors="replace")
        known = self._names.get(name)
        if known is None:
            role = self._roster.role_of(name)
            if role is None or role is Role.ROBOT:
                return Flaw.FORGED
            known = self._names[name] = Author(role, name), self._keys.of_name(name)
        author, key = known
        return author if _fits(key, signed, tag) else Flaw.FORGED


@dataclass(frozen=True, slots=True)
class Trust:
    """How one name of a secured swarm signs and verifies."""

    name: str
    role: Role
    signer: Signer
    verifier: Verifier

    @classmethod
    def of(cls, identity: Identity, previous: Previous | None = None) -> Trust:
        """The signer and verifier of an identity."""
        keys = identity.datagram_keys
        role = identity.role
        verifier = Verifier(keys, role, identity.roster, previous)
        before = None if previous is None else Signer(previous.keys, role, identity.name)
        return cls(identity.name, role, Signer(keys, role, identity.name, before), verifier)


def generation_of(payload: bytes) -> int:
    """The generation that the trailer of a datagram states, unverified; 0 without a trailer."""
    try:
        generation: int = _START.unpack_from(payload, length_without_trailer(payload))[1]
    except (CodecError, struct.error):
        return 0
    return generation


def _tag(key: bytes, signed: bytes) -> bytes:
    return hashlib.blake2b(signed, key=key, digest_size=SIGNATURE_BYTES).digest()


def _fits(key: bytes, signed: bytes, tag: bytes) -> bool:
    return bool(key) and compare_digest(_tag(key, signed), tag)


def _proof(key: bytes, ack: Ack) -> bytes:
    """The proof over all fields that the acking robot sets; a relaying robot sets `via`."""
    content = msgspec.msgpack.encode(msgspec.structs.replace(ack, via="", proof=b""))
    hashed = hashlib.blake2b(content, key=key, digest_size=SIGNATURE_BYTES, person=_PROOF)
    return hashed.digest()
